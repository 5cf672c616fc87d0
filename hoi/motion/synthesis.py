"""Stage 1: the person's motion from the sentence alone (paper, Agent Motion Synthesis)."""

from pathlib import Path

import numpy as np
import torch

from hoi.body.skinning import joint_paths, stand_motion
from hoi.config import HMSDConf, MotionInit
from hoi.data import Motion, Scene
from hoi.errors import RunError
from hoi.motion import features
from hoi.motion.diffusion import ancestral_sample, ddim_sample
from hoi.motion.distillation import PoseParameters, ScoreDistillation, leg_length, optimise
from hoi.motion.imports import read_motion
from hoi.motion.prior import load_prior
from hoi.progress import Stage
from hoi.streams import stream_seed


def load_distillation(scene: Scene, conf: HMSDConf, device: str, stand: bool = False) -> ScoreDistillation:
    """The motion prior, made ready for this scene's prompt and person, who may have to `stand` still."""
    prior = load_prior(Path(conf.checkpoint) if conf.checkpoint else None, device)
    body_leg = leg_length(torch.as_tensor(scene.body.rest_joints))
    standing = joint_paths(scene.body, stand_motion(scene.body, 1, scene.fps))
    return ScoreDistillation(
        prior=prior,
        text=prior.encode_text([scene.motion_prompt]),
        leg_ratio=float(leg_length(prior.rest_joints) / body_leg),
        sole_height=float(standing[0, :, 2].min()),
        guidance=conf.guidance,
        rescale=conf.guidance_rescale,
        t_min=conf.t_min,
        t_max=min(conf.t_max, prior.timesteps),
        stand=stand,
    )


def synthesise(
    scene: Scene, distillation: ScoreDistillation | None, conf: HMSDConf, seed: int, device: str, stage: Stage
) -> Motion:
    """N_init iterations of L_HMSD from a sample of the prior, from the standing pose or from a motion file.

    There need be no distillation where neither a sample nor an iteration is wanted (see `hoi.plan.uses_prior`).
    """
    start = stand_motion(scene.body, scene.frames, scene.fps)
    if conf.init is MotionInit.file:
        assert conf.path is not None  # checked by `validate`
        start, notes = read_motion(Path(conf.path), scene.body, scene.frames, scene.fps, conf.start_time, conf.up)
        stage.notes.extend(notes)
    if distillation is None:
        return start
    if conf.init is MotionInit.sample:
        start = sample_motion(scene, distillation, conf.sample_guidance, conf.sample_steps, seed)
    pose = PoseParameters.of(start, device)
    generator = torch.Generator().manual_seed(stream_seed(seed, "motion"))
    optimise(
        pose,
        lambda: {"hmsd": distillation.loss(pose, generator)},
        {"hmsd": 1.0},
        conf.iterations,
        conf.learning_rate,
        stage.iteration,
    )
    return pose.motion(scene.fps)


def sample_motion(
    scene: Scene, distillation: ScoreDistillation, guidance: float, steps: int | None, seed: int
) -> Motion:
    """One motion drawn from the prior, on this body, from the origin facing +Y.

    By DDIM in `steps` steps, or, where that is None, by ancestral sampling through all timesteps.

    Raises:
        RunError: the prior's sample is not finite.
    """
    generator = torch.Generator().manual_seed(stream_seed(seed, "sample"))
    prior, shape = distillation.prior, (1, scene.frames, features.FEATURE_COUNT)

    def predict(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return distillation.predict_x0(x, t, guidance, rescale=0.0)

    if steps is None:
        x0 = ancestral_sample(predict, shape, prior.alphas_cumprod, generator, prior.device)
    else:
        x0 = ddim_sample(predict, shape, prior.alphas_cumprod, generator, min(steps, prior.timesteps), prior.device)
    translation, orientation, body_pose = features.decode(prior.denormalise(x0)[0])
    lift = np.array([0.0, 0.0, distillation.sole_height], dtype=np.float32)
    motion = Motion(
        (translation / distillation.leg_ratio).cpu().numpy() + lift,
        orientation.cpu().numpy(),
        body_pose.cpu().numpy(),
        scene.fps,
    )
    if not all(np.isfinite(values).all() for values in (motion.translation, motion.orientation, motion.body_pose)):
        raise RunError("the prior's sample is not finite; lower stage.motion.sample_guidance or use another prior")
    return motion
