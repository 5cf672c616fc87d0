"""Which joint should strike, when and where, and the loss that pulls it there (paper, Windowed Attraction Loss)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from hoi.body.footing import Footing, slide, stances, sunk
from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.data import Array, Body, Motion, ObjectTrajectory, Scene, State, Target
from hoi.frames import at_frame
from hoi.method.hmsd import PoseParameters, ScoreDistillation, optimise, stream_generators
from hoi.reports import Stage

if TYPE_CHECKING:
    from hoi.stages.contract import Attraction
    from hoi.stages.coordinate.default import Coordinate

ENDS = 0.2
"""No strike is aimed nearer to the upper and lower ends of an object than this [m]: balls are struck at the centre."""
ARRIVED = 0.015
"""While the joint is farther than this from its goal at t*, the attraction grows [m]."""
REACHED = 0.03
"""A joint whose skin comes this near has reached the object [m]."""
REACH_TESTS = 6
"""Times in a step at which limb and object are compared."""


@dataclass(frozen=True)
class Batch:
    """Runs that differ in seed and in the body's Gaussians alone, their persons optimised together."""

    scenes: Sequence[Scene]
    seeds: Sequence[int]
    device: str


Term = tuple[Callable[[Tensor], Tensor], float | Tensor]
"""A loss (B,) of the joints (B, T, 24, 3) [m], and its weight: a number or one a run, (B,)."""


def choose_target(joints: Array, candidates: Sequence[int] = range(JOINT_COUNT)) -> Target:
    """j*: the joint with the highest cumulative velocity; t*: the frame of its peak velocity.

    Args:
        joints: world joint positions p_j(t) [m], (T, 24, 3).
        candidates: the joints to choose from. The paper takes all; in a kick with a wide follow-through the free hand
            may travel further than the foot.
    """
    velocity = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    joint = max(candidates, key=lambda j: velocity[:, j].sum())
    return Target(joint, int(velocity[:, joint].argmax()), "velocity profile")


def window(frames: int, target: Target, sigma: float, half_width: int) -> Array:
    """g(t) = exp(-(t - t*)^2 / (2 sigma^2)), zero beyond `half_width` frames, (T,)."""
    offset = np.arange(frames) - target.frame
    return np.exp(-(offset**2) / (2 * sigma**2)) * (np.abs(offset) <= half_width)


def attraction_loss(positions: Tensor, goal: Tensor, weights: Tensor) -> Tensor:
    """L_attr = sum_t g(t) |p_j*(t) - c(t)|^2 / sum_t g(t) [m^2], (...).

    Args:
        positions: p_j*(t) [m], (..., T, 3).
        goal: c(t) [m], (..., T, 3).
        weights: g(t), (..., T).
    """
    return (weights * ((positions - goal) ** 2).sum(dim=-1)).sum(dim=-1) / weights.sum(dim=-1)


def limb_gaussians(body: Body, joint: int) -> NDArray[np.integer]:
    """Indices of the Gaussians whose dominant joint it is."""
    return np.flatnonzero(body.dominant_joints == joint)


def carried_strike(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Array:
    """The joint's own strike, carried to where the limb's skin meets the object: c(t) [m], (T, 3).

    The paper's goal, the centre of mass, asks the limb to be inside the object, and to be there for the whole window,
    which stops the strike. This goal meets the object's nearest point along the strike and keeps the swing; and what is
    tall is struck at the strike's own height, as far as it reaches up and down (see `ENDS`).

    Args:
        motion: before stage 2.
    """
    meeting = target.meeting_frame(scene.frames)
    path = joint_paths(scene.body, motion)[:, target.joint]
    object_means = trajectory.positions[meeting, : len(scene.thing.cloud)]
    limb = limb_gaussians(scene.body, target.joint)
    limb_means = posed_means(scene.body, motion, frames=[meeting], subset=limb)[0]
    return path + strike_offset(trajectory.com[meeting], object_means, limb_means, path, meeting)


def strike_offset(com: Array, object_means: Array, limb_means: Array, path: Array, meeting: int) -> Array:
    """How far the strike lies from the object [m], (3,).

    Args:
        com: centre of mass at the meeting [m], (3,).
        object_means: the object's Gaussians at the meeting [m], (N, 3).
        limb_means: the joint's Gaussians at the meeting [m], (M, 3).
        path: p_j*(t) before stage 2 [m], (T, 3).
        meeting: the frame, see `hoi.data.Target.meeting_frame`.
    """
    joint = path[meeting]
    direction = joint - path[max(meeting - 1, 0)]
    if np.linalg.norm(direction) < 1e-3:  # a still limb has no strike: come from where it is
        direction = com - joint
    direction = direction / np.linalg.norm(direction)
    slack = max(0.5 * float(np.ptp(object_means[:, 2])) - ENDS, 0.0)
    aim = com + np.array([0.0, 0.0, np.clip(joint[2] - com[2], -slack, slack)])
    from_aim = object_means - aim
    along = -from_aim @ direction
    aside = np.linalg.norm(from_aim + along[:, None] * direction, axis=1)
    near_axis = aside <= max(np.quantile(aside, 0.05), 1e-6)
    depth = float(along[near_axis].max())
    reach = float(((limb_means - joint) @ direction).max())
    return aim - direction * (depth + reach) - joint


def windowed_attraction(
    batch: Batch,
    states: Sequence[State],
    weight: float,
    growth: float,
    sigma: float,
    half_width: int,
    *,
    to_com: bool,
) -> Term:
    """L_attr of each run, and lambda_attr, which grows until the joint arrives.

    Args:
        states: with motion, trajectory and target.
        growth: of lambda_attr each iteration in which the joint is not yet where it should be at t* [-].
        sigma, half_width: of the window [frames].
        to_com: pull to the centre of mass, not to the object's surface.
    """
    goals, windows, targets = [], [], []
    for scene, state in zip(batch.scenes, states, strict=True):
        motion, trajectory, target = state.motion, state.trajectory, state.target
        assert motion is not None and trajectory is not None and target is not None
        goals.append(trajectory.com if to_com else carried_strike(scene, motion, trajectory, target))
        windows.append(window(scene.frames, target, sigma, half_width))
        targets.append(target)
    goal, near = (
        torch.as_tensor(np.stack(values), dtype=torch.float32, device=batch.device) for values in (goals, windows)
    )
    frames, device = batch.scenes[0].frames, batch.device
    runs, joint = torch.arange(len(targets), device=device), torch.tensor([t.joint for t in targets], device=device)
    meeting = torch.tensor([target.meeting_frame(frames) for target in targets], device=device)
    pull = torch.full((len(targets),), weight, device=device)

    def attract(joints: Tensor) -> Tensor:
        path = joints[runs, :, joint]
        short = (path.detach() - goal)[runs, meeting].norm(dim=-1)
        pull[short > ARRIVED] *= growth
        return attraction_loss(path, goal, near)

    return attract, pull


def coordinate(
    batch: Batch,
    states: Sequence[State],
    distillation: ScoreDistillation | None,
    attraction: "Attraction | None",
    settings: "Coordinate",
    stages: Sequence[Stage],
) -> list[Motion]:
    """N_sync iterations of lambda_HMSD L_HMSD + lambda_attr L_attr + lambda_feet L_feet, of all runs as one batch.

    Without a prior only the other two act (w/o MDM), without attraction only L_HMSD (w/o Attraction). Each run's stage
    is told how far planted feet slide before and after [m] and, with attraction, the gap that is left (see
    `reach_gap`).

    Args:
        states: with the motion, the target and the object's free motion, that of all runs.

    Raises:
        RunError: the motion is not finite.
    """
    motions = [state.motion for state in states if state.motion is not None]
    body, fps, device = batch.scenes[0].body, batch.scenes[0].fps, batch.device
    pose = PoseParameters.of(motions, device, steps=distillation is not None)
    terms: dict[str, Term] = {}
    if distillation is not None and settings.lambda_hmsd > 0:
        generators = stream_generators(batch.seeds, "coordinate")
        terms["hmsd"] = lambda _: distillation.loss(pose, generators), settings.lambda_hmsd
    if attraction is not None:
        terms["attraction"] = attraction.term(batch, states)

    paths = [joint_paths(scene.body, motion) for scene, motion in zip(batch.scenes, motions, strict=True)]
    standing = joint_paths(body, stand_motion(body, 1, fps))[0, :, 2]
    planted = [stances(path, standing, fps) if distillation is not None else [] for path in paths]
    if settings.lambda_feet > 0 and distillation is not None:
        footings = [Footing(path, feet, device) if feet else None for path, feet in zip(paths, planted, strict=True)]
        soles = torch.as_tensor(standing, dtype=torch.float32, device=device)

        def keep_feet(joints: Tensor) -> Tensor:
            each = zip(footings, joints, strict=True)
            moved = torch.stack([footing.loss(own) if footing else own.new_zeros(()) for footing, own in each])
            return moved + sunk(joints, soles)

        terms["feet"] = keep_feet, settings.lambda_feet

    rest = torch.as_tensor(body.rest_joints, dtype=torch.float32, device=device)

    def losses() -> dict[str, Tensor]:
        places = pose.joints(rest)
        return {name: term(places) for name, (term, _) in terms.items()}

    weights = {name: weight for name, (_, weight) in terms.items()}
    optimise(pose, losses, weights, settings.iterations, settings.learning_rate, stages, settings.decay)
    moved = pose.motions(fps)
    for run, (scene, state, stage) in enumerate(zip(batch.scenes, states, stages, strict=True)):
        stage.numbers["slide_before"] = slide(paths[run], planted[run])
        stage.numbers["slide_after"] = slide(joint_paths(scene.body, moved[run]), planted[run])
        if attraction is not None and state.trajectory is not None and state.target is not None:
            stage.numbers["reach_gap"] = reach_gap(scene, moved[run], state.trajectory, state.target)
    return moved


def reach_gap(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> float:
    """Smallest distance between the skin of j* and the object's surface in the step from t* to t* + 1 [m]; 0 inside."""
    meeting = target.meeting_frame(scene.frames)
    frames = np.linspace(max(meeting - 1, 0), meeting, REACH_TESTS)
    gap = math.inf
    limbs = posed_means(scene.body, motion, frames=frames, subset=limb_gaussians(scene.body, target.joint))
    for frame, skin in zip(frames, limbs, strict=True):
        surface = at_frame(trajectory.positions[:, : len(scene.thing.cloud)], frame)
        com = at_frame(trajectory.com, frame)
        distance, nearest = KDTree(surface).query(skin)
        inside = ((skin - surface[nearest]) * (surface[nearest] - com)).sum(axis=1) < 0
        gap = min(gap, float(np.where(inside, 0.0, distance).min()))
    return gap
