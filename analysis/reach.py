"""How near the striking joint comes to objects placed all around: `python -m analysis.reach [-o FILE.csv] [overrides]`.

Stage 1 runs once a seed, its motion is the same wherever the object is; stage 2 runs for every placement, with the
seeds in turn. The gap is that of `hoi.method.attraction.reach_gap`; beside it stands what stage 2 does to the motion.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.config import Config
from hoi.config.compose import config_of
from hoi.data import Array
from hoi.errors import InputError
from hoi.terminal.program import program

from . import command, sheets

if TYPE_CHECKING:
    import pandas as pd

    from hoi.method.optimization import Walk

DIRECTIONS, DISTANCES, HEIGHTS = 5, (0.6, 1.2, 2.5), (None, 0.3, 0.6, 0.9)
"""Of the object, as seen from the origin: the first ahead, the others evenly around [m]; None is on the ground."""


def positions(directions: int, distances: Sequence[float], heights: Sequence[float | None]) -> list[list[float | None]]:
    """scene.placement.position of every placement [m]."""
    angles = np.pi / 2 + 2 * np.pi * np.arange(directions) / directions
    return [
        [round(float(distance * np.cos(angle)), 4), round(float(distance * np.sin(angle)), 4), height]
        for height in heights
        for distance in distances
        for angle in angles
    ]


def measure(overrides: Sequence[str], places: Sequence[list[float | None]], seeds: Sequence[int]) -> pd.DataFrame:
    """One row a placement, of the seeds in turn.

    Raises:
        InputError: a bad override, or a config without motion prior or attraction.
        RunError: a stage failed.
    """
    import pandas as pd

    from hoi.body.skinning import joint_paths
    from hoi.method.attraction import Batch
    from hoi.method.object_motion import at_rest, free_motion
    from hoi.method.optimization import Walk
    from hoi.reports import Stages, quiet
    from hoi.runner.scene import load_object

    first = first_stage("analysis.reach", config_of("render=none", *overrides), seeds)
    scene, rows = first.batch.scenes[0], []
    for number, place in enumerate(places):
        seed, state = seeds[number % len(seeds)], first.states[number % len(seeds)]
        z = "null" if place[2] is None else place[2]
        there = config_of("render=none", *overrides, f"scene.placement.position=[{place[0]},{place[1]},{z}]")
        around = replace(scene, object=load_object(there))
        trajectory, _ = free_motion(around, at_rest, quiet("free motion"))
        batch = Batch([around], [seed], "cpu")
        walk = Walk(there, first.plan, batch, at_rest, [Stages()], [replace(state, trajectory=trajectory)])
        walk.distillation = first.distillation
        before = walk.aimed(around, walk.states[0]).motion
        walk.coordinate()
        after, numbers = walk.states[0].motion, walk.stages[0].reports[0].numbers
        assert before is not None and after is not None
        paths = {"before": joint_paths(scene.body, before), "after": joint_paths(scene.body, after)}
        rows.append(
            {"seed": seed, "x": place[0], "y": place[1], "z": trajectory.com[0, 2], "gap": numbers["reach_gap"]}
            | {f"slide {when}": numbers[f"slide_{when}"] for when in paths}
            | {f"jerk {when}": mean_jerk(joints, before.fps) for when, joints in paths.items()}
            | {"pose moved": pose_distance(*paths.values())}
            | {f"off ground {when}": off_ground(joints) for when, joints in paths.items()}
        )
        print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return pd.DataFrame(rows)


def first_stage(module: str, config: Config, seeds: Sequence[int]) -> Walk:
    """The method as far as stage 1 for each of the seeds; the object stays where it is.

    Raises:
        InputError: the config is without a motion prior, which `module` needs.
    """
    import torch

    from hoi.method.attraction import Batch
    from hoi.method.object_motion import at_rest
    from hoi.method.optimization import Walk
    from hoi.plan import make_plan
    from hoi.reports import Stages
    from hoi.runner.scene import build_scene

    plan = make_plan(config)
    if "motion_prior" not in plan.uses:
        raise InputError(f"{module} needs a motion prior: stage/motion=hmsd")
    torch.set_num_threads(config.threads or torch.get_num_threads())
    batch = Batch([build_scene(config, plan)] * len(seeds), seeds, "cpu")
    walk = Walk(config, plan, batch, at_rest, [Stages() for _ in seeds])
    walk.synthesise()
    return walk


def mean_jerk(joints: Array, fps: float) -> float:
    """Mean size of the third derivative of joints (T, 24, 3) [m/s^3]."""
    return float(np.linalg.norm(np.diff(joints, n=3, axis=0) * fps**3, axis=-1).mean())


def pose_distance(before: Array, after: Array) -> float:
    """Mean distance of joints (T, 24, 3) of two motions, each seen from its pelvis [m]."""
    seen = [joints - joints[:, :1] for joints in (before, after)]
    return float(np.linalg.norm(seen[0] - seen[1], axis=-1).mean())


def off_ground(joints: Array) -> float:
    """Largest height of the lowest of the joints (T, 24, 3) over the frames [m]."""
    return float(joints[..., 2].min(axis=1).max())


@command.exit_code("analysis.reach")
def main() -> None:
    parser = command.parser(
        "analysis.reach",
        "How near the striking limb comes to objects all around, before and after stage 2.",
        "-o reach.csv scene=kick_soccer_ball",
    )
    parser.add_argument("-o", "--out", type=Path, help="the table as .csv")
    parser.add_argument("--directions", type=int, default=DIRECTIONS, help=f"default {DIRECTIONS}")
    parser.add_argument("--seeds", type=int, default=10, help="default 10")
    parser.add_argument("overrides", nargs="*", help="config overrides, as for hoi.run")
    arguments = parser.parse_args()
    from hoi.method.attraction import REACHED

    places = positions(max(arguments.directions, 1), DISTANCES, HEIGHTS)
    table = measure(arguments.overrides, places, range(max(arguments.seeds, 1)))
    if arguments.out:
        table.to_csv(arguments.out, index=False)
    print(sheets.plain(table, digits=3))
    reached = table["gap"] <= REACHED
    by_height = table.assign(reached=reached).groupby(table["z"].round(2))[["reached", "gap"]]
    print(by_height.agg({"reached": "sum", "gap": ["count", "median", "max"]}).to_string())
    print(f"{reached.sum()} of {len(table)} within {100 * REACHED:.0f} cm; largest gap {table['gap'].max():.3f} m")


if __name__ == "__main__":
    program(main)
