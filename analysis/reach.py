"""How near the striking joint comes to objects placed all around: `python -m analysis.reach [-o FILE.csv] [overrides]`.

Stage 1 runs once a seed, its motion is the same wherever the object is; stage 2 runs for every placement, with the
seeds in turn. The gap is that of `hoi.method.attraction.reach_gap`; beside it stands what stage 2 does to the motion.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.config.compose import config_of
from hoi.data import Motion, Scene
from hoi.errors import InputError, RunError

if TYPE_CHECKING:
    import pandas as pd

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

    from hoi.method.attraction import Batch
    from hoi.method.object_motion import at_rest, free_motion
    from hoi.method.optimization import Walk
    from hoi.plan import make_plan
    from hoi.reports import Stages, quiet
    from hoi.runner.jobs import torch_threads
    from hoi.runner.scene import build_scene, load_object

    config = config_of("render=none", *overrides)
    plan = make_plan(config)
    if "motion_prior" not in plan.uses or "attraction" not in plan.uses:
        raise InputError(
            "analysis.reach needs a motion prior and attraction: stage/motion=hmsd stage/attraction=windowed"
        )
    scene, rows = build_scene(config, plan), []
    stages = [Stages() for _ in seeds]
    with torch_threads(config.threads):
        walk = Walk(config, plan, Batch([scene] * len(seeds), seeds, "cpu"), at_rest, stages)
        walk.synthesise()
    for number, place in enumerate(places):
        seed, state = seeds[number % len(seeds)], walk.states[number % len(seeds)]
        z = "null" if place[2] is None else place[2]
        there = config_of("render=none", *overrides, f"scene.placement.position=[{place[0]},{place[1]},{z}]")
        around = replace(scene, object=load_object(there))
        trajectory, _ = free_motion(around, at_rest, quiet("free motion"))
        met = Walk(there, plan, Batch([around], [seed], "cpu"), at_rest, [Stages()], distillation=walk.distillation)
        met.states = [replace(state, trajectory=trajectory)]
        with torch_threads(config.threads):
            before = met.aimed(around, met.states[0]).motion
            met.coordinate()
        after, numbers = met.states[0].motion, met.stages[0].reports[0].numbers
        assert before is not None and after is not None
        rows.append(
            {
                "seed": seed,
                "x": place[0],
                "y": place[1],
                "z": trajectory.com[0, 2],
                "gap": numbers["reach_gap"],
                "slide before": numbers["slide_before"],
                "slide after": numbers["slide_after"],
                "jerk before": mean_jerk(scene, before),
                "jerk after": mean_jerk(scene, after),
                "pose moved": pose_distance(scene, before, after),
                "off ground before": off_ground(scene, before),
                "off ground after": off_ground(scene, after),
            }
        )
        print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return pd.DataFrame(rows)


def mean_jerk(scene: Scene, motion: Motion) -> float:
    """Mean size of the joints' third derivative [m/s^3]."""
    from hoi.body.skinning import joint_paths

    jerk = np.diff(joint_paths(scene.body, motion), n=3, axis=0) * motion.fps**3
    return float(np.linalg.norm(jerk, axis=-1).mean())


def pose_distance(scene: Scene, before: Motion, after: Motion) -> float:
    """Mean distance of the joints, each motion seen from its pelvis [m]."""
    from hoi.body.skinning import joint_paths

    seen = [paths - paths[:, :1] for paths in (joint_paths(scene.body, motion) for motion in (before, after))]
    return float(np.linalg.norm(seen[0] - seen[1], axis=-1).mean())


def off_ground(scene: Scene, motion: Motion) -> float:
    """Largest height of the lowest joint over the frames [m]."""
    from hoi.body.skinning import joint_paths

    return float(joint_paths(scene.body, motion)[..., 2].min(axis=1).max())


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m analysis.reach",
        description="How near the striking limb comes to objects all around, before and after stage 2.",
        epilog="example: python -m analysis.reach -o reach.csv scene=kick_soccer_ball",
    )
    parser.add_argument("-o", "--out", type=Path, help="the table as .csv")
    parser.add_argument("--directions", type=int, default=DIRECTIONS, help=f"default {DIRECTIONS}")
    parser.add_argument("--seeds", type=int, default=10, help="default 10")
    parser.add_argument("overrides", nargs="*", help="config overrides, as for hoi.run")
    arguments = parser.parse_args()
    from hoi.method.attraction import REACHED

    try:
        places = positions(max(arguments.directions, 1), DISTANCES, HEIGHTS)
        table = measure(arguments.overrides, places, range(max(arguments.seeds, 1)))
        if arguments.out:
            table.to_csv(arguments.out, index=False)
    except (InputError, RunError, OSError) as error:
        print(f"analysis.reach: {error}", file=sys.stderr)
        sys.exit(3 if isinstance(error, RunError) else 2)
    print(table.to_string(index=False, float_format=lambda value: f"{value:.3f}"))
    reached = table["gap"] <= REACHED
    by_height = table.assign(reached=reached).groupby(table["z"].round(2))[["reached", "gap"]]
    print(by_height.agg({"reached": "sum", "gap": ["count", "median", "max"]}).to_string())
    print(f"{reached.sum()} of {len(table)} within {100 * REACHED:.0f} cm; largest gap {table['gap'].max():.3f} m")


if __name__ == "__main__":
    main()
