"""Human motion score distillation, from a sample of the prior, the standing pose or a motion file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from omegaconf import MISSING

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS
from hoi.data import Check
from hoi.errors import under
from hoi.motion.familiarity import sentence_check
from hoi.motion.files import missing_prior
from hoi.motion.sentence import limbs_in
from hoi.stages.contract import Draft, MotionSource, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config, SceneConf
    from hoi.data import Act, Motion, Scene, Target
    from hoi.method.hmsd import Sampling, ScoreDistillation
    from hoi.reports import Stage


class MotionInit(StrEnum):
    sample = "sample"
    stand = "stand"
    file = "file"


class Sampler(StrEnum):
    ancestral = "ancestral"
    ddim = "ddim"


class Reduction(StrEnum):
    mean = "mean"
    sum = "sum"


class UpAxis(StrEnum):
    vars().update({name: name for name in ("auto", "x", "+x", "-x", "y", "+y", "-y", "z", "+z", "-z")})


AUTO_UP = UpAxis("auto")
STARTS = {
    MotionInit.sample: "a sample of the prior",
    MotionInit.stand: "the standing pose",
    MotionInit.file: "the file",
}
"""What stage 1 starts from."""


@option("stage/motion", "hmsd")
@dataclass
class HMSD(MotionSource):
    """Human motion score distillation."""

    stands_for: ClassVar[dict[str, str]] = {
        "no_mdm": "the motion prior",
        "motion_from_file": "the motion from the sentence",
    }

    checkpoint: str | None = None
    """The motion prior: null for the one in the package, or a file or folder."""
    init: MotionInit = MISSING
    """Start from a sample of the prior, from the standing pose, or from a motion file."""
    path: str | None = None
    """The motion file (.npz, .bvh, .npy), for init=file."""
    start_time: float = 0.0
    """Where in the file the motion begins [s]."""
    up: UpAxis = AUTO_UP
    """The file's up axis; auto tells it from the person's."""
    fps: float | None = None
    """Frames a second of the file, where it does not say or says wrong [1/s]; null takes what it says."""
    names: str | None = None
    """A file that says which joint of a .bvh is which, a line each: left_knee = KnieL."""
    sample_guidance: float = MISSING
    """Guidance scale of that sample [-]."""
    sample_rescale: float = MISSING
    """Share of its overshoot that is taken back [-]."""
    sampler: Sampler = MISSING
    """Ancestral, with fresh noise at each step, or DDIM, without."""
    sample_steps: int | None = MISSING
    """Evenly spaced timesteps of that sample; null takes all."""
    iterations: int = MISSING
    """N_init."""
    learning_rate: float = MISSING
    """Of Adam on X = (r, omega, theta) [-]."""
    guidance: float = MISSING
    """Classifier-free guidance scale of the distillation [-]."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back [-]."""
    reduction: Reduction = MISSING
    """L_HMSD is the mean over frames and features, or the sum, whose gradient is the one that the paper prints."""
    t_min: int = MISSING
    """Diffusion timesteps are drawn from here ..."""
    t_max: int = MISSING
    """... up to the one before this."""

    def check(self, config: Config, require: Requirements) -> None:
        own, key = require.of(self.key), self.key
        rule = "3 or more: the motion prior sees velocities and their changes"
        require(config.scene.frames >= 3, "scene.frames", config.scene.frames, rule)
        own(self.iterations >= 0, "iterations", self.iterations, "0 or more")
        given, named = self.path is not None, self.init is MotionInit.file
        rule = f"{'the path of a .npz, .bvh or .npy file' if named else 'null'}: {key}.init is {self.init.value}"
        own(given == named, "path", "null" if self.path is None else self.path, rule)
        own(self.fps is None or self.fps > 0, "fps", self.fps, "greater than 0 [1/s], or null")
        own(self.start_time >= 0, "start_time", self.start_time, "0 or more [s]")
        for name in ("guidance_rescale", "sample_rescale"):
            own(0 <= getattr(self, name) <= 1, name, getattr(self, name), "in [0, 1]")
        own(
            self.sample_steps is None or self.sample_steps >= 1, "sample_steps", self.sample_steps, "1 or more, or null"
        )
        own(self.learning_rate > 0, "learning_rate", self.learning_rate, "greater than 0")
        own(0 <= self.t_min < self.t_max, "t_min", self.t_min, f"in [0, {key}.t_max = {self.t_max})")

    def plan(self, config: Config, draft: Draft) -> None:
        if self.path is not None and not Path(self.path).is_file():
            draft.lack(f"{self.key}.path", "motion file", self.path, "give a .npz, .bvh or .npy")
        coordinate = config.stage.coordinate
        in_stage_2 = coordinate.lambda_hmsd > 0 and coordinate.iterations > 0
        used = self.init is MotionInit.sample or self.iterations > 0 or in_stage_2
        if used:
            draft.missing += missing_prior(f"{self.key}.checkpoint", self.checkpoint, config.mdm)
            if (said := sentence_check(config.scene.motion_prompt, self.checkpoint)) is not None:
                draft.checks.append(Check("sentence", *said))
        draft.uses += ["motion"] + ["motion_prior"] * used + ["hmsd"] * in_stage_2
        if config.scene.acts:
            said = "; ".join(f"{act.start:g} to {act.end:g} s: {act.prompt}" for act in config.scene.acts)
            draft.check("acts", str(len(config.scene.acts)), f"each denoised by itself, put together: {said}")
        start = STARTS[self.init] if self.path is None else f"{STARTS[self.init]} {self.path}"
        if self.iterations > 0 or self.init is MotionInit.sample:
            detail = f"{self.iterations} iterations, CFG {self.guidance:g}, from {start}"
            draft.run("motion", self.name, detail)
        else:
            where = "in L_HMSD of stage 2 alone" if used else "nowhere"
            draft.run("motion", self.init.value, f"{start}, as it is; the motion prior is used {where}")
        if not used:
            draft.without.append("no_mdm")
            because = "neither stage 1 nor stage 2 distils from it"
            draft.omit("motion prior", because, "importing it and its text encoder")
        if self.init is MotionInit.file:
            draft.without.append("motion_from_file")

    def units(self) -> int:
        return self.iterations

    @property
    def sampling(self) -> Sampling:
        """How stage 1 starts, for init=sample."""
        from hoi.method.hmsd import Sampling

        return Sampling(self.sample_guidance, self.sample_rescale, self.sampler.value, self.sample_steps)

    def prior(self, scene: Scene, device: str, stand: bool, clip: Path | None = None) -> ScoreDistillation:
        from hoi.method.hmsd import load_distillation

        return load_distillation(
            scene,
            device,
            checkpoint=self.checkpoint,
            guidance=self.guidance,
            rescale=self.guidance_rescale,
            summed=self.reduction is Reduction.sum,
            t_min=self.t_min,
            t_max=self.t_max,
            stand=stand,
            clip=clip,
        )

    def motions(
        self, scene: Scene, distillation: ScoreDistillation | None, seeds: Sequence[int], stages: Sequence[Stage]
    ) -> list[Motion]:
        from hoi.method.hmsd import sample_motions, synthesise

        starts = [self._start(scene, stages)] * len(seeds)
        if distillation is None:
            return starts
        if self.init is MotionInit.sample:
            starts = sample_motions(distillation, self.sampling, scene.frames, scene.fps, seeds)
        budget = {"iterations": self.iterations, "learning_rate": self.learning_rate}
        return synthesise(distillation, starts, seeds, stages, **budget)

    def read(self, scene: Scene) -> None:
        self._start(scene, ())

    def _start(self, scene: Scene, stages: Sequence[Stage]) -> Motion:
        """The standing pose, or the file's motion."""
        from hoi.body.skinning import stand_motion

        if self.path is None:
            return stand_motion(scene.body, scene.frames, scene.fps)
        from hoi.importers.motions import read_motion

        with under(self.key, "start_time", "up", "names", "fps"):
            place = (scene.body, scene.frames, scene.fps)
            names = None if self.names is None else Path(self.names)
            motion, notes = read_motion(Path(self.path), *place, self.start_time, self.up, self.fps, names)
        for stage in stages:
            stage.notes.extend(notes)
        return motion

    def target(self, scene: Scene, motion: Motion, conf: SceneConf, act: Act | None = None) -> Target:
        from hoi.body.skinning import joint_paths
        from hoi.method.attraction import choose_target, striking_limb
        from hoi.method.push import choose_push

        joints = joint_paths(scene.body, motion)
        if act is not None:
            first, last = round(act.start * scene.fps), round(act.end * scene.fps)
            found = choose_target(joints[first : last + 1], LIMBS[act.strikes])
            return replace(found, frame=min(found.frame + first, scene.frames - 2))
        if conf.striking_joints:
            together = [JOINT_NAMES.index(name) for name in conf.striking_joints]
            return choose_push(joints, together, round(conf.hold * scene.fps))
        limb = conf.striking_limb
        if limb == "auto":  # a file's motion
            limb = striking_limb(joints, limbs_in(conf.motion_prompt))
        candidates = LIMBS[limb] if limb else range(JOINT_COUNT)
        return choose_target(joints, candidates)
