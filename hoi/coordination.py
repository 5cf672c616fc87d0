"""Stage 2: the person meets the object (paper, Physically-Aware Interaction Synthesis)."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from hoi.attraction import attraction_loss, carried_strike, choose_target, meeting_frame, window
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths, posed_means
from hoi.config import AttractionTarget, Config, HMSDConf, WindowedConf
from hoi.data import Array, Motion, ObjectTrajectory, Scene, Target
from hoi.motion.distillation import PoseParameters, ScoreDistillation, optimise
from hoi.progress import Stage
from hoi.streams import stream_seed


def find_target(scene: Scene, motion: Motion, config: Config) -> Target:
    """j* and t* from the motion's velocity profile, or from the scene where no prior moved the person (w/o MDM)."""
    if not isinstance(config.stage.motion, HMSDConf):
        return Target(JOINT_NAMES.index(config.scene.contact_joint), config.scene.contact_frame, "scene")
    limb = config.scene.striking_limb
    return choose_target(joint_paths(scene.body, motion), LIMBS[limb] if limb else range(JOINT_COUNT))


def strike_goal(
    scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target, conf: WindowedConf
) -> Array:
    """c(t): where L_attr pulls the joint [m], (T, 3)."""
    com = trajectory.com
    if conf.target is AttractionTarget.com:
        return com
    meeting = meeting_frame(scene.frames, target)
    limb = np.flatnonzero(scene.body.skinning_weights.argmax(axis=1) == target.joint)
    return carried_strike(
        com[meeting],
        trajectory.positions[meeting, : len(scene.object.cloud)],
        posed_means(scene.body, motion, frames=np.array([float(meeting)]), subset=limb)[0],
        joint_paths(scene.body, motion)[:, target.joint],
        meeting,
    )


def coordinate(
    scene: Scene,
    motion: Motion,
    trajectory: ObjectTrajectory,
    target: Target,
    distillation: ScoreDistillation | None,
    config: Config,
    device: str,
    stage: Stage,
) -> Motion:
    """N_sync iterations of lambda_HMSD L_HMSD + lambda_attr L_attr.

    Without a prior only L_attr acts (w/o MDM), without attraction only L_HMSD (w/o Attraction).
    """
    conf, attraction = config.stage.coordinate, config.stage.attraction
    pose = PoseParameters.of(motion, device, steps=distillation is not None)
    terms: dict[str, Callable[[], Tensor]] = {}
    weights: dict[str, float] = {}
    if distillation is not None and conf.lambda_hmsd > 0:
        generator = torch.Generator().manual_seed(stream_seed(config.seed, "coordinate"))
        terms["hmsd"], weights["hmsd"] = lambda: distillation.loss(pose, generator), conf.lambda_hmsd
    if isinstance(attraction, WindowedConf) and attraction.lambda_attr > 0:

        def tensor(values: Array) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32, device=device)

        goal = tensor(strike_goal(scene, motion, trajectory, target, attraction))
        near = tensor(window(scene.frames, target, attraction.sigma, attraction.half_width))
        rest = tensor(scene.body.rest_joints)
        terms["attraction"] = lambda: attraction_loss(pose.joints(rest)[:, target.joint], goal, near)
        weights["attraction"] = attraction.lambda_attr
    optimise(
        pose,
        lambda: {name: term() for name, term in terms.items()},
        weights,
        conf.iterations,
        conf.learning_rate,
        stage.iteration,
    )
    return pose.motion(scene.fps)
