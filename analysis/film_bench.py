"""Milliseconds a frame of a film: `python -m analysis.film_bench [--threads 1 2]`.

The default scene's person and object, both in motion, 720 x 480 on the scene's ground: dressed, with light and shadows,
with light alone, and unlit; a moment in the viewer; a picture and its gradients; beside them a frame as plain as can
be, of a body that is evenly covered with Gaussians, unlit, by 3DGS's conventions. All in turn, so that a busy machine
slows all alike: the ratios are medians over the rounds.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command

if TYPE_CHECKING:
    from hoi.data import Body, Motion, ObjectTrajectory, Scene

WIDTH, HEIGHT = 720, 480
FRAMES = 12
PLAIN = 26_000
"""Gaussians on the body that is covered evenly."""
MOVED = ("hip", "knee", "shoulder", "elbow")
FIRST = "plain person, unlit"


def swinging(scene: "Scene") -> tuple["Motion", "ObjectTrajectory"]:
    """A person who swings arms and legs, and an object that glides and turns, so that all moves in every frame."""
    from hoi.body.skeleton import JOINT_NAMES
    from hoi.body.skinning import stand_motion
    from hoi.data import ObjectTrajectory

    motion, cloud = stand_motion(scene.body, FRAMES, scene.fps), scene.thing.cloud
    turn = 0.5 * np.sin(np.linspace(0, 2 * np.pi, FRAMES, endpoint=False)).astype(np.float32)
    for side, sign in (("left", 1), ("right", -1)):
        for part in MOVED:
            motion.body_pose[:, JOINT_NAMES.index(f"{side}_{part}") - 1, 0] += sign * turn
    along = np.linspace(0, 0.5, FRAMES)[:, None] * np.array([0.0, 1.0, 0.0])
    spin = np.zeros((FRAMES, 1, 3, 3))
    spin[:, 0, 0, 0], spin[:, 0, 1, 1:], spin[:, 0, 2, 1:] = (
        1.0, np.stack([np.cos(turn), -np.sin(turn)], 1), np.stack([np.sin(turn), np.cos(turn)], 1),
    )  # fmt: skip
    middle = cloud.means.mean(0)
    positions = (cloud.means - middle) @ spin[:, 0].transpose(0, 2, 1) + middle + along[:, None]
    still = np.zeros((FRAMES, 3))
    return motion, ObjectTrajectory(
        positions.astype(np.float32), middle + along, still, still, np.repeat(spin, len(cloud), 1).astype(np.float32)
    )


def plain(body: "Body", count: int = PLAIN) -> "Body":
    """The person's bare skin under even, grey Gaussians, moved by the joint of most weight."""
    from hoi.body.people import bare_skin
    from hoi.data import GaussianCloud
    from hoi.gaussians import sh_from_colours

    found = bare_skin(body, count)
    if found is None:
        raise InputError(f"human={body.name}: no person of the package, whose skin is known")
    points, joints = found
    turns = np.random.default_rng(0).normal(size=(count, 4))
    shape = np.array([0.007, 0.007, 0.001])
    arrays = (points, turns / np.linalg.norm(turns, axis=1, keepdims=True), np.tile(shape, (count, 1)),
              np.full(count, 0.97), sh_from_colours(np.full((count, 3), 0.6)))  # fmt: skip
    cloud = GaussianCloud(*(array.astype(np.float32) for array in arrays))
    return replace(body, cloud=cloud, skinning_weights=np.eye(24, dtype=np.float32)[joints])


def steps(threads: int) -> dict[str, Callable[[], Iterable[object]]]:
    """What is measured: each yields `FRAMES` times."""
    import torch

    from hoi.config import compose
    from hoi.data import State
    from hoi.render import Ground
    from hoi.render.film import cameras_of, film, lit_at
    from hoi.render.look import BARE, Look
    from hoi.render.rasterise import rasterise
    from hoi.render.replay import Replay
    from hoi.render.splats import Splats, join
    from hoi.runner.scene import build_scene
    from hoi.view.moments import pack

    torch.set_num_threads(threads)
    scene = build_scene(compose.config_of())
    motion, trajectory = swinging(scene)
    bare = replace(scene, body=plain(scene.body))
    cameras = cameras_of(Replay(scene, State(motion, trajectory)), "three_quarter", WIDTH, HEIGHT)

    def filmed(shown: "Scene", look: Look) -> Callable[[], Iterable[object]]:
        return lambda: film(Replay(shown, State(motion, trajectory)), cameras, look=look)

    def moments() -> Iterable[object]:
        shown = Replay(scene, State(motion, trajectory))
        for frame in range(shown.frames):
            yield [pack(part) for part in lit_at(shown, shown.parts(frame), Look())]

    def gradients() -> Iterable[object]:
        shown = Replay(scene, State(motion, trajectory))
        for frame in range(shown.frames):
            whole = join([replace(part, surface=None) for part in shown.parts(frame)])
            tensors = (whole.means, whole.covariances, whole.opacities, whole.sh)
            leaves = Splats(*(tensor.detach().clone().requires_grad_() for tensor in tensors))
            picture = rasterise(leaves, cameras[0], settings=Look().settings)
            picture.colour.square().mean().backward()
            yield leaves.means.grad

    return {
        FIRST: filmed(bare, replace(BARE, ground=Ground(scene.setting))),
        "dressed, unlit": filmed(scene, Look(light=None)),
        "dressed, light": filmed(scene, Look(shadows=False)),
        "dressed, light and shadows": filmed(scene, Look()),
        "moment in the viewer": moments,
        "picture and gradients": gradients,
    }


def measure(threads: int, rounds: int) -> list[dict[str, float | str]]:
    """A row of the table each: wall and CPU time a frame, and the ratio of the latter to the plain person's."""
    clocks = (time.perf_counter, time.process_time)
    work = steps(threads)
    spent = {name: np.zeros((rounds + 1, 2)) for name in work}
    for turn in range(rounds + 1):  # the first warms up
        for name, step in work.items():
            began = [clock() for clock in clocks]
            count = sum(1 for _ in step())
            spent[name][turn] = [1e3 * (clock() - start) / count for clock, start in zip(clocks, began, strict=True)]
    rows = []
    for name, all_turns in spent.items():
        turns, first = all_turns[1:], spent[FIRST][1:]
        best, median = turns.min(0), np.median(turns, 0)
        rows.append({
            "frame": name, "threads": threads, "best ms": best[0], "median ms": median[0], "FPS at best": 1e3 / best[0],
            "CPU ms": median[1], "times the plain CPU ms": float(np.median(turns[:, 1] / first[:, 1])),
        })  # fmt: skip
    return rows


@command.exit_code("analysis.film_bench")
def main() -> None:
    parser: argparse.ArgumentParser = command.parser(
        "analysis.film_bench", "Milliseconds a frame of a film, with and without light.", "--threads 1 2"
    )
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--rounds", type=int, default=5, help=f"of {FRAMES} frames each (default: 5)")
    options = parser.parse_args()
    if min(options.rounds, *options.threads) < 1:
        raise InputError("--threads and --rounds must be 1 or more")
    import pandas as pd

    from . import sheets

    rows = [row for threads in options.threads for row in measure(threads, options.rounds)]
    print(f"{WIDTH} x {HEIGHT}, medians of {options.rounds} rounds of {FRAMES} frames")
    print(sheets.plain(pd.DataFrame(rows)))


if __name__ == "__main__":
    program(main)
