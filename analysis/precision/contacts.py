"""Contact fidelity against run time: stage 3 in many ways, on contacts that stages 1 and 2 have left.

Every start is a recorded run without stage 3; runs that are there already are not computed again. Two settings: the
laptop's own, and the paper's contact, which is looked for at whole frames alone by a limb that aims at the centre of
mass, and so ends up deep in the object.
"""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from hoi.config import Config
from hoi.config.compose import config_of
from hoi.data import Contact, Motion, Run
from hoi.errors import RunError
from hoi.method.pose import PoseParameters
from hoi.motion.evaluator import load_evaluator
from hoi.motion.prior import load_prior
from hoi.record import read
from hoi.reports import quiet

SETTINGS = {
    "laptop": (),
    "paper": ("stage/contact=impulse", "stage.contact.between_frames=false", "stage.attraction.target=com"),
}
SCENES = (
    "kick_soccer_ball", "kick_basketball", "side_kick_foam_cube", "punch_blue_ball", "jab_beach_ball", "punch_jelly",
    "push_file_cabinet", "push_box",
)  # fmt: skip
QUICK_SCENES, QUICK_SEEDS, SEEDS = SCENES[:1], 1, 3


@dataclass(frozen=True)
class Way:
    """One way to do stage 3."""

    kind: str
    iterations: int
    overrides: tuple[str, ...]

    @property
    def name(self) -> str:
        return f"{self.kind}, {self.iterations} iterations" if self.iterations else self.kind


@dataclass(frozen=True)
class Start:
    """What stages 1 and 2 have left, and the overrides that they were given."""

    setting: str
    scene: str
    seed: int
    run: Run
    overrides: tuple[str, ...]

    @property
    def push(self) -> Contact:
        """The contact that matters; there must be one."""
        push = self.run.state.contact.push if self.run.state.contact else None
        assert push is not None
        return push


def ways(quick: bool = False) -> list[Way]:
    """All that are compared. Those with a number of iterations do them all, needed or not; the others end when the
    limb is out of the object."""
    always = "stage.refine.when=always"

    def of(kind: str, counts: Sequence[int], *overrides: str) -> list[Way]:
        return [Way(kind, n, (*overrides, always, f"stage.refine.iterations={n}")) for n in counts]

    sds, both = ("stage/refine=video_sds",), ("stage/refine=video_sds", "stage.refine.lambda_geometry=1")
    return [
        Way("none", 0, ("stage/refine=none",)),
        *of("geometric", (4,) if quick else (4, 15, 60), "stage/refine=geometric"),
        *([] if quick else [Way("embedded", 0, sds), Way("embedded + geometric", 0, both)]),
        *of("embedded", (4,) if quick else (10, 40), *sds),
        *of("embedded + geometric", (4,) if quick else (10,), *both),
    ]


def starts(folder: Path, scenes: Sequence[str], seeds: int, threads: int) -> Iterator[Start]:
    """The recorded runs in `folder`, computed where they are missing.

    Raises:
        RunError: one cannot be computed; what it said is on standard error.
    """
    for setting, overrides in SETTINGS.items():
        for scene in scenes:
            given = (f"scene={scene}", *overrides, f"threads={threads}")
            place = folder / setting / scene
            paths = [place / f"s{seed}" / "run.mcap" if seeds > 1 else place / "run.mcap" for seed in range(seeds)]
            command = ["stage/refine=none", "render=none", f"seeds={seeds}", f"out={place}"]
            done = subprocess.run([sys.executable, "-m", "hoi.run", *given, *command], stdout=subprocess.DEVNULL)
            if done.returncode:
                raise RunError(f"the run of scene={scene} with {setting} settings ended with {done.returncode}")
            for seed, path in enumerate(paths):
                yield Start(setting, scene, seed, read(path), (*given, f"seed={seed}"))


class Naturalness:
    """Distance to the nearest real motion by the evaluator's embedding, 0 to 2, lower is better."""

    def __init__(self) -> None:
        self._evaluator, self._prior = load_evaluator(), load_prior()

    def __call__(self, start: Start, config: Config, motion: Motion) -> float:
        assert start.run.scene is not None
        distillation = config.stage.motion.prior(start.run.scene, "cpu", False)
        with torch.no_grad():
            features = self._prior.denormalise(distillation.features(PoseParameters.of([motion])))
        return float(self._evaluator.strangeness(features)[0])


def study(folder: Path, scenes: Sequence[str], seeds: int, threads: int, quick: bool = False) -> pd.DataFrame:
    """One row a start and a way; fidelity as `hoi.refine.fidelity`, over the window, in SI units.

    Raises:
        InputError: a prior's weights are missing or damaged. RunError: as `starts`.
    """
    torch.set_num_threads(threads)
    judge, rows = Naturalness(), []
    for start in starts(folder, scenes, seeds, threads):
        motion, scene = start.run.state.motion, start.run.scene
        if motion is None or scene is None or start.run.state.trajectory is None:
            continue
        before: dict[str, float] = {}
        strange = float("nan")
        for way in sorted(ways(quick), key=lambda way: way.kind == "none"):
            config = config_of("render=none", *start.overrides, *way.overrides)
            refine = config.stage.refine.refine
            stage, began = quiet("refine"), time.perf_counter()
            refined = motion if way.kind == "none" else refine(scene, start.run.state, config, "cpu", stage)
            seconds = 0.0 if way.kind == "none" else time.perf_counter() - began
            numbers = stage.numbers
            if not before:
                before = {name: numbers.get(f"{name}_before", np.nan) for name in ("penetration", "touching", "gap")}
                strange = judge(start, config, motion)
            after = {name: numbers.get(f"{name}_after", value) for name, value in before.items()}
            rows.append(
                {
                    "setting": start.setting,
                    "scene": start.scene,
                    "seed": start.seed,
                    "kind": way.kind,
                    "way": way.name,
                    "iterations": stage.iterations,
                    "seconds": seconds,
                    **after,
                    "deepest before": before["penetration"],
                    "strange": strange if refined is motion else judge(start, config, refined),
                    "stopped": numbers.get("stopped", 0.0),
                }
            )
        print(f"{start.setting} {start.scene} seed {start.seed}", file=sys.stderr)
    return pd.DataFrame(rows)
