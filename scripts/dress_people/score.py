"""How near a baked person is to the textured mesh it was made of: PSNR of unlit pictures, whole and of the face.

    PYTHONPATH=. python -m scripts.dress_people.score --cache CACHE [man ...]

The pose is that of standing, which the fit has seen; the cameras are none of the fit's. Over all pixels that either
covers, and over those a few pixels inside the outline.
"""

import argparse
import os
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import binary_erosion

from hoi.body.people import PEOPLE as NAMES
from hoi.body.people import load_person
from hoi.render.cameras import look_at
from hoi.render.light import lit
from hoi.render.rasterise import Settings, rasterise
from hoi.render.replay import person_tensors, posed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("people", nargs="*", default=NAMES)
    parser.add_argument("--cache", type=Path, required=True)
    options = parser.parse_args()
    os.environ.setdefault("ANNY_CACHE_DIR", str(options.cache))
    from scripts.bake_people import PEOPLE
    from scripts.dress_people import fit, makehuman
    from scripts.dress_people.outfits import OUTFITS
    from scripts.dress_people.rays import Scene

    data = makehuman.download(options.cache)
    print(
        "| person | Gaussians | whole, 480 x 720 [dB]: all, inside | face, 480 x 480: all, inside |\n|---|---|---|---|"
    )
    for name in options.people:
        person, body = makehuman.base(PEOPLE[name]), load_person(name)
        parts = makehuman.dress(person, data, OUTFITS[name])
        pose = fit.poses(np.random.default_rng(1))[1]
        scene = Scene(parts, fit.place(person, parts, pose))
        middle = (scene.vertices.max(0) + scene.vertices.min(0)) / 2
        eyes = scene.vertices[scene.vertices[:, 1] > scene.vertices[:, 1].max() - 0.2].mean(0)
        cameras = (
            look_at(
                middle + np.array([1.6, 0.5, 3.6]), middle, width=480, height=720, fov_y=np.radians(28), up=(0, 1, 0)
            ),
            look_at(
                eyes + np.array([0.3, 0.05, 0.95]), eyes, width=480, height=480, fov_y=np.radians(24), up=(0, 1, 0)
            ),
        )
        cells = []
        with torch.no_grad():
            splats = lit(posed(person_tensors(body), *pose)[0], None)
            for camera in cameras:
                rgb, alpha = scene.picture(camera, scene.unlit, samples=3)
                drawn = rasterise(splats, camera, settings=Settings(antialiased=True))
                error = drawn.colour.clamp(0, 1).numpy() - (rgb + (1 - alpha)[..., None])
                masks = ((alpha > 0.02) | (drawn.alpha.numpy() > 0.02), binary_erosion(alpha > 0.99, iterations=3))
                cells.append(", ".join(f"{-10 * np.log10((error[mask] ** 2).mean()):.1f}" for mask in masks))
        print(f"| {name} | {len(body.cloud)} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
