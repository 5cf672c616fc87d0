"""Stage 2: the person meets the object (paper, Physically-Aware Interaction Synthesis)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.config import AttractionTarget, Config, HMSDConf, WindowedConf
from hoi.data import Array, Motion, ObjectTrajectory, Scene, Target
from hoi.method.approach import delay, delayed, placed, shifted
from hoi.method.attraction import attraction_loss, carried_strike, choose_target, meeting_frame, window
from hoi.method.footing import Footing, slide, stances, sunk
from hoi.method.hmsd import PoseParameters, ScoreDistillation, optimise, stream_generators
from hoi.method.scene import check_apart, is_apart
from hoi.plan import approaches, attracts
from hoi.runner.progress import Stage

REACHED = 0.03
"""A joint whose skin comes this near has reached the object [m]."""
ARRIVED = 0.015
"""While the joint is farther than this from its goal at t*, the attraction grows [m]."""
BACK, BACK_STEP = 0.5, 0.02
"""How far, and in which steps, a person is moved back who would start inside the object [m]."""
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
        trajectory.positions[meeting, : len(scene.thing.cloud)],
        posed_means(scene.body, motion, frames=[meeting], subset=limb_gaussians(scene, target.joint))[0],
        joint_paths(scene.body, motion)[:, target.joint],
        meeting,
    )


def meet(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, config: Config) -> tuple[Motion, Target]:
    """j* and t*, and the motion from where and when it has to start for its strike to meet the object."""
    target = find_target(scene, motion, config)
    return approach(scene, motion, trajectory, target) if approaches(config) else (motion, target)


def approach(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> tuple[Motion, Target]:
    """The motion, from where its strike ends at the object's surface, at a time when the object is at its height.

    Who begins with a limb farther out than the strike ends would begin inside the object: they stand as much farther
    back, and have that much farther to reach.

    Raises:
        InputError: the person would start inside the object `BACK` away from it.
    """
    meeting = meeting_frame(scene.frames, target)
    height = float(joint_paths(scene.body, motion, frames=[meeting])[0, target.joint, 2])
    later = delay(height, trajectory.com[:, 2], meeting)
    motion, target, meeting = delayed(motion, later), replace(target, frame=target.frame + later), meeting + later
    there = placed(
        motion,
        lambda moved: joint_paths(scene.body, moved, frames=[meeting])[0, target.joint],
        lambda moved: strike_goal(scene, moved, trajectory, target, AttractionTarget.surface)[meeting],
        trajectory.com[meeting],
    )
    away = (there.translation[0] - trajectory.com[0]) * [1.0, 1.0, 0.0]
    away = away / max(float(np.linalg.norm(away)), 1e-9)
    for back in np.arange(0.0, BACK, BACK_STEP):
        if is_apart(scene, moved := shifted(there, back * away)):
            break
    check_apart(scene, moved)
    return moved, target


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
            for path in (trajectory.positions[:, : len(scene.thing.cloud)], trajectory.com)
        )
        distance, nearest = KDTree(surface).query(skin)
        inside = ((skin - surface[nearest]) * (surface[nearest] - com)).sum(axis=1) < 0
        gap = min(gap, float(np.where(inside, 0.0, distance).min()))
    return gap


def coordinate(
    scenes: Sequence[Scene],
    motions: Sequence[Motion],
    trajectory: ObjectTrajectory,
    targets: Sequence[Target],
    distillation: ScoreDistillation | None,
    config: Config,
    seeds: Sequence[int],
    device: str,
    stages: Sequence[Stage],
) -> list[Motion]:
    """N_sync iterations of lambda_HMSD L_HMSD + lambda_attr L_attr + lambda_feet L_feet, of all runs as one batch.

    Without a prior only the other two act (w/o MDM), without attraction only L_HMSD (w/o Attraction). Each run's stage
    is told how far planted feet slide before and after [m] and, with attraction, the gap that is left (see
    `reach_gap`).

    Args:
        scenes, motions, targets, seeds, stages: one a run; the scenes differ in the body's Gaussians alone.
        trajectory: the object's free motion, that of all runs.

    Raises:
        RunError: the motion is not finite.
    """
    conf, attraction = config.stage.coordinate, config.stage.attraction
    pose = PoseParameters.of(motions, device, steps=distillation is not None)
    frames, fps = scenes[0].frames, scenes[0].fps

    def tensor(values: Sequence[Array]) -> Tensor:
        return torch.as_tensor(np.stack(values), dtype=torch.float32, device=device)

    terms: dict[str, Callable[[Tensor], Tensor]] = {}
    weights: dict[str, float | Tensor] = {}
    if distillation is not None and conf.lambda_hmsd > 0:
        generators = stream_generators(seeds, "coordinate")
        terms["hmsd"], weights["hmsd"] = lambda _: distillation.loss(pose, generators), conf.lambda_hmsd

    runs, joint = torch.arange(len(targets), device=device), torch.tensor([t.joint for t in targets], device=device)
    if isinstance(attraction, WindowedConf) and attracts(config):
        each, aim = zip(scenes, motions, targets, strict=True), attraction.target
        goal = tensor([strike_goal(scene, motion, trajectory, target, aim) for scene, motion, target in each])
        near = tensor([window(frames, target, attraction.sigma, attraction.half_width) for target in targets])
        meeting = torch.tensor([meeting_frame(frames, target) for target in targets], device=device)
        pull = torch.full((len(targets),), attraction.lambda_attr, device=device)

        def attract(joints: Tensor) -> Tensor:
            path = joints[runs, :, joint]
            short = (path.detach() - goal)[runs, meeting].norm(dim=-1)
            pull[short > ARRIVED] *= attraction.growth
            return attraction_loss(path, goal, near)

        terms["attraction"], weights["attraction"] = attract, pull

    paths = [joint_paths(scene.body, motion) for scene, motion in zip(scenes, motions, strict=True)]
    standing = joint_paths(scenes[0].body, stand_motion(scenes[0].body, 1, fps))[0, :, 2]
    planted = [stances(path, standing, fps) if distillation is not None else [] for path in paths]
    if conf.lambda_feet > 0 and distillation is not None:
        footings = [Footing(path, feet, device) if feet else None for path, feet in zip(paths, planted, strict=True)]
        soles = torch.as_tensor(standing, dtype=torch.float32, device=device)

        def keep_feet(joints: Tensor) -> Tensor:
            each = zip(footings, joints, strict=True)
            moved = torch.stack([footing.loss(own) if footing else own.new_zeros(()) for footing, own in each])
            return moved + sunk(joints, soles)

        terms["feet"], weights["feet"] = keep_feet, conf.lambda_feet

    rest = torch.as_tensor(scenes[0].body.rest_joints, dtype=torch.float32, device=device)

    def losses() -> dict[str, Tensor]:
        places = pose.joints(rest)
        return {name: term(places) for name, term in terms.items()}

    optimise(pose, losses, weights, conf.iterations, conf.learning_rate, stages, conf.decay)
    moved = pose.motions(fps)
    for run, (scene, stage) in enumerate(zip(scenes, stages, strict=True)):
        stage.numbers["slide_before"] = slide(paths[run], planted[run])
        stage.numbers["slide_after"] = slide(joint_paths(scene.body, moved[run]), planted[run])
        if attracts(config):
            stage.numbers["reach_gap"] = reach_gap(scene, moved[run], trajectory, targets[run])
    return moved
