"""Stage 2: the person meets the object (paper, Physically-Aware Interaction Synthesis)."""

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from hoi.approach import placed
from hoi.attraction import attraction_loss, carried_strike, choose_target, meeting_frame, window
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.config import AttractionTarget, Config, HMSDConf, WindowedConf
from hoi.data import Array, Motion, ObjectTrajectory, Scene, Target
from hoi.footing import Footing, slide, stances
from hoi.motion.distillation import PoseParameters, ScoreDistillation, optimise
from hoi.plan import approaches, attracts
from hoi.progress import Stage
from hoi.scene import check_apart
from hoi.streams import stream_seed

REACHED = 0.03
"""A joint whose skin comes this near has reached the object [m]."""
ARRIVED = 0.015
"""While the joint is farther than this from its goal at t*, the attraction grows [m]."""
REACH_TESTS = 6
"""Times in a step at which limb and object are compared."""


def find_target(scene: Scene, motion: Motion, config: Config) -> Target:
    """j* and t* from the motion's velocity profile, or from the scene where no prior moved the person (w/o MDM)."""
    if not isinstance(config.stage.motion, HMSDConf):
        return Target(JOINT_NAMES.index(config.scene.contact_joint), config.scene.contact_frame, "scene")
    limb = config.scene.striking_limb
    return choose_target(joint_paths(scene.body, motion), LIMBS[limb] if limb else range(JOINT_COUNT))


def limb_gaussians(scene: Scene, joint: int) -> NDArray[np.integer]:
    """Indices of the Gaussians whose dominant joint it is."""
    return np.flatnonzero(scene.body.skinning_weights.argmax(axis=1) == joint)


def strike_goal(
    scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target, aim: AttractionTarget
) -> Array:
    """c(t): where L_attr pulls the joint [m], (T, 3)."""
    com = trajectory.com
    if aim is AttractionTarget.com:
        return com
    meeting = meeting_frame(scene.frames, target)
    return carried_strike(
        com[meeting],
        trajectory.positions[meeting, : len(scene.object.cloud)],
        posed_means(scene.body, motion, frames=[meeting], subset=limb_gaussians(scene, target.joint))[0],
        joint_paths(scene.body, motion)[:, target.joint],
        meeting,
    )


def approach(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Motion:
    """The motion, from where its strike ends at the object's surface."""
    meeting = meeting_frame(scene.frames, target)
    return placed(
        motion,
        lambda moved: joint_paths(scene.body, moved, frames=[meeting])[0, target.joint],
        lambda moved: strike_goal(scene, moved, trajectory, target, AttractionTarget.surface)[meeting],
        trajectory.com[meeting],
    )


def reach_gap(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> float:
    """Smallest distance between the skin of j* and the object's surface in the step from t* to t* + 1 [m]; 0 inside."""
    meeting = meeting_frame(scene.frames, target)
    frames = np.linspace(max(meeting - 1, 0), meeting, REACH_TESTS)
    gap = math.inf
    limbs = posed_means(scene.body, motion, frames=frames, subset=limb_gaussians(scene, target.joint))
    for frame, skin in zip(frames, limbs, strict=True):
        before, share = int(frame), frame % 1
        after = min(before + 1, scene.frames - 1)
        surface, com = (
            (1 - share) * path[before] + share * path[after]
            for path in (trajectory.positions[:, : len(scene.object.cloud)], trajectory.com)
        )
        distance, nearest = KDTree(surface).query(skin)
        inside = ((skin - surface[nearest]) * (surface[nearest] - com)).sum(axis=1) < 0
        gap = min(gap, float(np.where(inside, 0.0, distance).min()))
    return gap


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
    """N_sync iterations of lambda_HMSD L_HMSD + lambda_attr L_attr + lambda_feet L_feet.

    Without a prior only the other two act (w/o MDM), without attraction only L_HMSD (w/o Attraction). `stage` is told
    how far planted feet slide before and after [m] and, with attraction, the gap that is left (see `reach_gap`).

    Raises:
        InputError: placed as the object asks, the person would start inside it.
        RunError: the motion is not finite.
    """
    conf, attraction = config.stage.coordinate, config.stage.attraction
    if approaches(config):
        motion = approach(scene, motion, trajectory, target)
        check_apart(scene, motion)
    pose = PoseParameters.of(motion, device, steps=distillation is not None)

    def tensor(values: Array) -> Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=device)

    rest = tensor(scene.body.rest_joints)
    terms: dict[str, Callable[[Tensor], Tensor]] = {}
    weights: dict[str, float] = {}
    if distillation is not None and conf.lambda_hmsd > 0:
        generator = torch.Generator().manual_seed(stream_seed(config.seed, "coordinate"))
        terms["hmsd"], weights["hmsd"] = lambda _: distillation.loss(pose, generator), conf.lambda_hmsd
    if isinstance(attraction, WindowedConf) and attracts(config):
        goal = tensor(strike_goal(scene, motion, trajectory, target, attraction.target))
        near = tensor(window(scene.frames, target, attraction.sigma, attraction.half_width))
        terms["attraction"] = lambda joints: attraction_loss(joints[:, target.joint], goal, near)
        weights["attraction"] = attraction.lambda_attr
    joints = joint_paths(scene.body, motion)
    standing = joint_paths(scene.body, stand_motion(scene.body, 1, scene.fps))[0, :, 2]
    planted = stances(joints, standing, scene.fps) if distillation is not None else []
    if planted and conf.lambda_feet > 0:
        footing = Footing(joints, planted, device)
        terms["feet"], weights["feet"] = footing.loss, conf.lambda_feet

    meeting = meeting_frame(scene.frames, target)

    def losses() -> dict[str, Tensor]:
        places = pose.joints(rest)
        if "attraction" in terms and isinstance(attraction, WindowedConf):
            short = float((places[meeting, target.joint].detach() - goal[meeting]).norm())
            if short > ARRIVED:
                weights["attraction"] *= attraction.growth
        return {name: term(places) for name, term in terms.items()}

    optimise(pose, losses, weights, conf.iterations, conf.learning_rate, stage.iteration, conf.decay)
    moved = pose.motion(scene.fps)
    stage.numbers["slide_before"] = slide(joints, planted)
    stage.numbers["slide_after"] = slide(joint_paths(scene.body, moved), planted)
    if attracts(config):
        stage.numbers["reach_gap"] = reach_gap(scene, moved, trajectory, target)
    return moved
