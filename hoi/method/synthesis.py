"""Stage 1: the person's motion from the sentence alone (paper, Agent Motion Synthesis)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from hoi.body.kinematics import leg_length
from hoi.body.skinning import sole_height, stand_motion
from hoi.config import HMSDConf
from hoi.config.choices import MotionInit, Sampler
from hoi.data import Motion, Scene
from hoi.errors import RunError, under
from hoi.importers.motions import read_motion
from hoi.method.hmsd import PoseParameters, ScoreDistillation, optimise, stream_generators
from hoi.motion import features
from hoi.motion.diffusion import ancestral_sample, ddim_sample
from hoi.motion.prior import load_prior
from hoi.runner.progress import Stage


def load_distillation(scene: Scene, conf: HMSDConf, device: str, stand: bool = False) -> ScoreDistillation:
    """The motion prior, made ready for this scene's prompt and person, who may have to `stand` still."""
    prior = load_prior(Path(conf.checkpoint) if conf.checkpoint else None, device)
    body_leg = leg_length(torch.as_tensor(scene.body.rest_joints))
    return ScoreDistillation(
        prior=prior,
        text=prior.encode_text([scene.motion_prompt]),
        leg_ratio=float(leg_length(prior.rest_joints) / body_leg),
        sole_height=sole_height(scene.body),
        guidance=conf.guidance,
        rescale=conf.guidance_rescale,
        t_min=conf.t_min,
        t_max=min(conf.t_max, prior.timesteps),
        stand=stand,
    )


def synthesise(
    scene: Scene,
    distillation: ScoreDistillation | None,
    conf: HMSDConf,
    seeds: Sequence[int],
    device: str,
    stages: Sequence[Stage],
) -> list[Motion]:
    """N_init iterations of L_HMSD from a sample of the prior, from the standing pose or from a motion file.

    One motion a seed, optimised as one batch; `stages` are told of one each. There need be no distillation where
    neither a sample nor an iteration is wanted (see `hoi.plan.uses_prior`).
    """
    start = stand_motion(scene.body, scene.frames, scene.fps)
    if conf.init is MotionInit.file:
        assert conf.path is not None  # checked by `validate`
        with under("stage.motion", "start_time", "up"):
            start, notes = read_motion(Path(conf.path), scene.body, scene.frames, scene.fps, conf.start_time, conf.up)
        for stage in stages:
            stage.notes.extend(notes)
    if distillation is None:
        return [start for _ in seeds]
    if conf.init is MotionInit.sample:
        starts = sample_motions(scene, distillation, conf, seeds)
    else:
        starts = [start for _ in seeds]
    pose = PoseParameters.of(starts, device)
    generators = stream_generators(seeds, "motion")
    optimise(
        pose,
        lambda: {"hmsd": distillation.loss(pose, generators)},
        {"hmsd": 1.0},
        conf.iterations,
        conf.learning_rate,
        stages,
    )
    return pose.motions(scene.fps)


def sample_motions(scene: Scene, distillation: ScoreDistillation, conf: HMSDConf, seeds: Sequence[int]) -> list[Motion]:
    """One motion a seed drawn from the prior, on this body, from the origin facing +Y.

    Raises:
        RunError: the prior's sample is not finite.
    """
    prior, shape = distillation.prior, (len(seeds), scene.frames, features.FEATURE_COUNT)

    def predict(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return distillation.predict_x0(x, t, conf.sample_guidance, conf.sample_rescale)

    sample = ddim_sample if conf.sampler is Sampler.ddim else ancestral_sample
    steps = None if conf.sample_steps is None else min(conf.sample_steps, prior.timesteps)
    generators = stream_generators(seeds, "sample")
    x0 = sample(predict, shape, prior.alphas_cumprod, generators, steps, prior.device)
    translation, orientation, body_pose = (part.cpu().numpy() for part in features.decode(prior.denormalise(x0)))
    translation = translation / distillation.leg_ratio + np.array([0, 0, distillation.sole_height], translation.dtype)
    if not all(np.isfinite(values).all() for values in (translation, orientation, body_pose)):
        raise RunError("the prior's sample is not finite; lower stage.motion.sample_guidance or use another prior")
    return [Motion(*parts, fps=scene.fps) for parts in zip(translation, orientation, body_pose, strict=True)]
