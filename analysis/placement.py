"""What attraction and placement are worth, each alone: `python -m analysis.placement [-o placement.csv]`.

All scenes, three seeds each, as far as contact detection: which limb strikes, with and without the attraction, with and
without the placement before it (`scene.approach`), and the same without the motion prior. Nothing is simulated after
the contact, no stage 3: this is what w/o Attraction and w/o MDM are about, at a tenth of the benchmark's cost.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from omegaconf import OmegaConf

from hoi.config.compose import config_of
from hoi.files import CONF
from hoi.terminal.program import program

from . import command

if TYPE_CHECKING:
    import pandas as pd

    from hoi.method.optimization import Walk

WAYS = {
    "full": (),
    "w/o Attraction": ("ablation=no_attraction",),
    "w/o placement": ("experiment=unplaced",),
    "w/o both": ("experiment=unplaced", "ablation=no_attraction"),
    "w/o MDM": ("ablation=no_mdm",),
    "w/o MDM and placement": ("experiment=unplaced", "ablation=no_mdm"),
}
"""Of each what differs from the full method."""
ALWAYS = ("render=none", "stage/refine=none")


def scenes() -> list[str]:
    """Those of one strike."""
    files = (CONF / "scene").glob("*.yaml")
    return sorted(file.stem for file in files if "acts" not in OmegaConf.load(file).scene)


def measure(names: Sequence[str], seeds: Sequence[int], overrides: Sequence[str] = ()) -> pd.DataFrame:
    """One row a scene, way and seed; stage 1 is that of the scene for all ways that have it."""
    import pandas as pd

    rows = []
    for name in names:
        first: dict[bool, Walk] = {}
        for way, differs in WAYS.items():
            with_prior = "ablation=no_mdm" not in differs
            walk = walk_of([f"scene={name}", *differs, *ALWAYS, *overrides], seeds, first.get(with_prior))
            first.setdefault(with_prior, walk)
            walk = replace(walk)
            walk.coordinate()
            found = list(met(walk))
            rows += [{"scene": name, "way": way, "seed": seed, **one} for seed, one in zip(seeds, found, strict=True)]
            print(f"{name}, {way}: {sum(one['expected'] for one in found):.0f} of {len(seeds)}", file=sys.stderr)
    return pd.DataFrame(rows)


def walk_of(overrides: Sequence[str], seeds: Sequence[int], first: Walk | None) -> Walk:
    """The method through stage 1; where `first` is given, what that made."""
    import torch

    from hoi.method.attraction import Batch
    from hoi.method.optimization import Walk
    from hoi.plan import make_plan
    from hoi.reports import Stages
    from hoi.runner.scene import build_scene

    config = config_of(*overrides)
    plan = make_plan(config)
    torch.set_num_threads(config.threads or torch.get_num_threads())
    batch = Batch([build_scene(config, plan)] * len(seeds), seeds, "cpu") if first is None else first.batch
    move = config.stage.object.mover(config.object.size, config.threads or 1, "cpu")
    walk = Walk(config, plan, batch, move, [Stages() for _ in seeds])
    if first is None:
        walk.synthesise()
        return walk
    return replace(walk, states=first.states, distillation=first.distillation)


def met(walk: Walk) -> Iterator[dict[str, float]]:
    """Of each run whether anything strikes the object, whether the expected limb does, how fast, and the gap left."""
    from hoi.body.parts import is_with

    model = walk.config.stage.contact
    for scene, state in zip(walk.batch.scenes, walk.states, strict=True):
        assert state.motion is not None and state.trajectory is not None
        search = model.search(scene, state.motion, state.trajectory, state.target.joints if state.target else ())
        push = search.push
        expected = push is not None and is_with(walk.config.scene.expected_limb, push.joint, push.part)
        gap = 0.0 if push is not None else search.smallest_gap
        yield {"any": push is not None, "expected": expected, "v_in": np.nan if push is None else push.v_in, "gap": gap}


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a way: shares of runs, spread of the shares over seeds, means of what is defined."""
    shares = runs.groupby(["way", "seed"], sort=False, as_index=False).agg(expected=("expected", "mean"))
    by_seed = shares.groupby("way", sort=False).agg(expected=("expected", "std"))
    table = runs.groupby("way", sort=False).agg(n=("any", "size"), any=("any", "mean"), expected=("expected", "mean"),
                                                v_in=("v_in", "mean"), gap=("gap", "mean"))  # fmt: skip
    return table.assign(expected_sd=by_seed["expected"])


@command.exit_code("analysis.placement")
def main() -> None:
    parser = command.parser("analysis.placement", "What attraction and placement are worth, each alone.", "-o out.csv")
    parser.add_argument("-o", "--out", type=Path, help="one row a run, as .csv")
    parser.add_argument("--seeds", type=int, default=3, help="default 3")
    parser.add_argument("--scenes", nargs="+", default=scenes(), choices=scenes(), metavar="SCENE", help="default: all")
    options = parser.parse_args()
    runs = measure(options.scenes, range(options.seeds))
    if options.out is not None:
        runs.to_csv(options.out, index=False, float_format="%.6g")
    print(summary(runs).to_string(float_format="%.3g"))


if __name__ == "__main__":
    program(main)
