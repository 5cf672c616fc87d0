"""Which joint should strike, when and where, and the loss that pulls it there (paper, Windowed Attraction Loss)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from hoi.body.footing import Footing, slide, stances, sunk
from hoi.body.skeleton import JOINT_COUNT, LIMBS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.data import Array, Body, Motion, ObjectTrajectory, Scene, State, Target
from hoi.frames import at_frame
from hoi.method.hmsd import ScoreDistillation, optimise, stream_generators
from hoi.method.pose import PoseParameters
from hoi.method.push import HANDS, Face, depth_along, face_of, held, palms, places, wrists
from hoi.reports import Stage

STRIKING = ("left_foot", "right_foot", "left_hand", "right_hand")
FASTER = 2.0
"""What strikes is so many times as fast as what swings with it."""
FPS = 20.0
"""Of the paper [1/s]."""
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


def striking_limb(joints: Array, named: Sequence[str] = ()) -> str:
    """The hand or foot of a motion that strikes: the fastest at its peak.

    Args:
        joints: world joint positions p_j(t) [m], (T, 24, 3).
        named: limbs that a sentence names; theirs is the part, of either side, unless another is `FASTER` than both.
    """
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1).max(axis=0, initial=0.0)
    peak = {limb: float(speed[list(LIMBS[limb])].max()) for limb in STRIKING}
    parts = {"foot" if set(LIMBS[limb]) & set(LIMBS["feet"]) else "hand" for limb in named}
    told = [limb for limb in STRIKING if limb.partition("_")[2] in parts]
    best = max(peak, key=lambda limb: peak[limb])
    if told and peak[best] < FASTER * max(peak[limb] for limb in told):
        best = max(told, key=lambda limb: peak[limb])
    return best


def window(frames: int, target: Target, sigma: float, half_width: float) -> Array:
    """g(t) = exp(-(t - t*)^2 / (2 sigma^2)), zero beyond `half_width` frames, (T,); 1 while a push is held."""
    offset = np.arange(frames) - target.frame
    offset = offset - np.clip(offset, 0, target.hold)
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
    way = np.array(target.way) if target.way else None
    return path + strike_offset(trajectory.com[meeting], object_means, limb_means, path, meeting, way)


def carried_push(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Array:
    """c(t) of each joint of a push, then of its hands' wrists [m], (K + W, T, 3).

    Their own paths, carried to their places on the face and through it together (see `hoi.method.push`), palms flat.
    """
    meeting, striking, body = target.meeting_frame(scene.frames), list(target.striking), scene.body
    joints = joint_paths(body, motion)
    paths = joints[:, striking].transpose(1, 0, 2)
    object_means = trajectory.positions[meeting, : len(scene.thing.cloud)]
    face = pushed_face(scene, motion, trajectory, target)
    goals = places(face, object_means, paths[:, meeting], body.rest_joints[striking])
    offsets = []
    for joint, path, goal in zip(striking, paths, goals, strict=True):
        own = limb_gaussians(body, joint)
        if joint in HANDS and len(own):  # the palm, the lower side of the T-pose's hand, without the thumb
            reach = float(np.quantile((body.rest_joints[joint] - body.cloud.means[own])[:, 1], 0.9))
        else:
            limb = posed_means(body, motion, frames=[meeting], subset=own)[0]
            reach = float(((limb - path[meeting]) @ face.direction).max(initial=0.0))
        offsets.append(goal - face.direction * reach - path[meeting])
    carried = held(paths + np.stack(offsets)[:, None], meeting, target.hold, face.direction)
    hands = [place for place, joint in enumerate(striking) if joint in HANDS]
    flat = palms(striking, body.rest_joints, face.direction)
    return np.concatenate([carried, carried[hands] + flat[:, None]])


def pushed_face(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Face:
    """The face that a push of several joints goes through."""
    meeting = target.meeting_frame(scene.frames)
    joints = joint_paths(scene.body, motion, frames=[meeting])[0]
    height = float(joints[list(target.striking), 2].mean())
    particles, com = trajectory.positions[meeting], trajectory.com[meeting]
    low, high = (float(bound) for bound in (particles[:, 2].min(), particles[:, 2].max()))
    return face_of(
        scene.thing,
        particles,
        com,
        joints[0],
        float(np.clip(height, 0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)),
    )


def strike_offset(
    com: Array, object_means: Array, limb_means: Array, path: Array, meeting: int, way: Array | None = None
) -> Array:
    """How far the strike lies from the object [m], (3,).

    Args:
        com: centre of mass at the meeting [m], (3,).
        object_means: the object's Gaussians at the meeting [m], (N, 3).
        limb_means: the joint's Gaussians at the meeting [m], (M, 3).
        path: p_j*(t) before stage 2 [m], (T, 3).
        meeting: the frame, see `hoi.data.Target.meeting_frame`.
        way: unit vector along which it is to push, (3,); None: along the strike.
    """
    joint = path[meeting]
    direction = way if way is not None else joint - path[max(meeting - 1, 0)]
    if np.linalg.norm(direction) < 1e-3:  # a still limb has no strike: come from where it is
        direction = com - joint
    direction = direction / np.linalg.norm(direction)
    slack = max(0.5 * float(np.ptp(object_means[:, 2])) - ENDS, 0.0)
    aim = com + np.array([0.0, 0.0, np.clip(joint[2] - com[2], -slack, slack)])
    depth = depth_along(object_means, aim, direction)
    reach = float(((limb_means - joint) @ direction).max())
    return aim - direction * (depth + reach) - joint


def pulled_joints(target: Target) -> tuple[int, ...]:
    """The joints that the attraction pulls: those that strike, and in a push the wrists too, so that palms lie flat."""
    return target.striking + (tuple(wrists(target.joints)) if target.joints else ())


def goal_paths(
    scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target, *, to_com: bool = False
) -> Array:
    """c(t) of each of the `pulled_joints` [m], (K, T, 3)."""
    if to_com:
        return np.broadcast_to(trajectory.com, (len(pulled_joints(target)), *trajectory.com.shape))
    if target.joints:
        return carried_push(scene, motion, trajectory, target)
    return carried_strike(scene, motion, trajectory, target)[None]


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
    """L_attr of each run, the mean over its striking joints, and lambda_attr, which grows until all have arrived.

    Args:
        states: with motion, trajectory and target.
        growth: of lambda_attr each iteration in which the joint is not yet where it should be at t* [-].
        sigma, half_width: of the window, in frames of the paper's rate, `FPS`.
        to_com: pull to the centre of mass, not to the object's surface.
    """
    goals, windows, targets = [], [], []
    for scene, state in zip(batch.scenes, states, strict=True):
        motion, trajectory, target = state.motion, state.trajectory, state.target
        assert motion is not None and trajectory is not None and target is not None
        goals.append(goal_paths(scene, motion, trajectory, target, to_com=to_com))
        stretch = scene.fps / FPS
        windows.append(window(scene.frames, target, sigma * stretch, half_width * stretch))
        targets.append(target)
    goal, near = (
        torch.as_tensor(np.stack(values), dtype=torch.float32, device=batch.device) for values in (goals, windows)
    )
    frames, device = batch.scenes[0].frames, batch.device
    runs = torch.arange(len(targets), device=device)
    pulled = torch.tensor([pulled_joints(target) for target in targets], device=device)  # (B, K)
    meeting = torch.tensor([target.meeting_frame(frames) for target in targets], device=device)
    pull = torch.full((len(targets),), weight, device=device)

    def attract(joints: Tensor) -> Tensor:
        paths = joints[runs[:, None], :, pulled]
        short = (paths.detach() - goal)[runs, :, meeting].norm(dim=-1).amax(dim=-1)
        pull[short > ARRIVED] *= growth
        return attraction_loss(paths, goal, near[:, None]).mean(dim=-1)

    return attract, pull


def coordinate(
    batch: Batch,
    states: Sequence[State],
    distillation: ScoreDistillation | None,
    attraction: Term | None,
    stages: Sequence[Stage],
    *,
    iterations: int,
    learning_rate: float,
    decay: float,
    lambda_hmsd: float,
    lambda_feet: float,
    stream: str = "coordinate",
) -> list[Motion]:
    """N_sync iterations of lambda_HMSD L_HMSD + lambda_attr L_attr + lambda_feet L_feet, of all runs as one batch.

    Without a prior only the other two act (w/o MDM), without attraction only L_HMSD (w/o Attraction). Each run's stage
    is told how far planted feet slide before and after [m] and, with attraction, the gap that is left (see
    `reach_gap`).

    Args:
        states: with the motion, the target and the object's free motion, that of all runs.
        attraction: lambda_attr and L_attr; None without.
        decay: see `hoi.method.hmsd.optimise`.
        stream: of random numbers.

    Raises:
        RunError: the motion is not finite.
    """
    motions = [state.motion for state in states if state.motion is not None]
    body, fps, device = batch.scenes[0].body, batch.scenes[0].fps, batch.device
    pose = distillation.pose(motions, device) if distillation else PoseParameters.of(motions, device, steps=False)
    terms: dict[str, Term] = {}
    if distillation is not None and lambda_hmsd > 0:
        generators = stream_generators(batch.seeds, stream)
        terms["hmsd"] = lambda _: distillation.loss(pose, generators), lambda_hmsd
    if attraction is not None:
        terms["attraction"] = attraction

    paths = [joint_paths(scene.body, motion) for scene, motion in zip(batch.scenes, motions, strict=True)]
    standing = joint_paths(body, stand_motion(body, 1, fps))[0, :, 2]
    planted = [stances(path, standing, fps) if distillation is not None else [] for path in paths]
    if lambda_feet > 0 and distillation is not None:
        footings = [Footing(path, feet, device) if feet else None for path, feet in zip(paths, planted, strict=True)]
        soles = torch.as_tensor(standing, dtype=torch.float32, device=device)

        def keep_feet(joints: Tensor) -> Tensor:
            each = zip(footings, joints, strict=True)
            moved = torch.stack([footing.loss(own) if footing else own.new_zeros(()) for footing, own in each])
            return moved + sunk(joints, soles)

        terms["feet"] = keep_feet, lambda_feet

    rest = torch.as_tensor(body.rest_joints, dtype=torch.float32, device=device)

    def losses() -> dict[str, Tensor]:
        places = pose.joints(rest)
        return {name: term(places) for name, (term, _) in terms.items()}

    weights = {name: weight for name, (_, weight) in terms.items()}
    optimise(pose, losses, weights, iterations, learning_rate, stages, decay)
    moved = pose.motions(fps)
    for run, (scene, state, stage) in enumerate(zip(batch.scenes, states, stages, strict=True)):
        stage.numbers["slide_before"] = slide(paths[run], planted[run])
        stage.numbers["slide_after"] = slide(joint_paths(scene.body, moved[run]), planted[run])
        if attraction is not None and state.trajectory is not None and state.target is not None:
            stage.numbers["reach_gap"] = reach_gap(scene, moved[run], state.trajectory, state.target)
    return moved


def reach_gap(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> float:
    """Smallest distance between the skin of j* and the object's surface in the step from t* to t* + 1 [m]; 0 inside.

    Of several joints that push together the farthest.
    """
    return max(_reach_gap(scene, motion, trajectory, target, joint) for joint in target.striking)


def _reach_gap(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target, joint: int) -> float:
    meeting = target.meeting_frame(scene.frames)
    frames = np.linspace(max(meeting - 1, 0), meeting, REACH_TESTS)
    gap = math.inf
    limbs = posed_means(scene.body, motion, frames=frames, subset=limb_gaussians(scene.body, joint))
    for frame, skin in zip(frames, limbs, strict=True):
        surface = at_frame(trajectory.positions[:, : len(scene.thing.cloud)], frame)
        com = at_frame(trajectory.com, frame)
        distance, nearest = KDTree(surface).query(skin)
        inside = ((skin - surface[nearest]) * (surface[nearest] - com)).sum(axis=1) < 0
        gap = min(gap, float(np.where(inside, 0.0, distance).min()))
    return gap
