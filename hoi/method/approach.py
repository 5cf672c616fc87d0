"""Where and when the person starts, which way they face, and how fast they strike (paper, In-Scene Variations).

The motion prior knows nothing of it: its motions are the same wherever they begin. So the object's place decides,
exactly and before any optimisation, what attraction would otherwise have to tear out of the motion.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import roma
import torch
from scipy.interpolate import CubicHermiteSpline
from scipy.special import erf

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import rotation_from_6d, rotation_to_6d
from hoi.body.skeleton import CHAINS, chain_of
from hoi.body.skinning import joint_paths
from hoi.data import Act, Array, Motion, ObjectTrajectory, Scene, Target
from hoi.method.attraction import ENDS, carried_push, carried_strike, pushed_face
from hoi.method.push import depth_along, facing
from hoi.method.scene_representation import check_apart, is_apart

WAITING = 0.4
"""Vertical distance that a second of waiting, or of haste, is worth [m/s]."""
SOONEST = 0.25
"""Time before which no strike is moved [s]."""
BACK, BACK_STEP = 0.5, 0.02
"""How far, and in which steps, a person is moved back who would start inside the object [m]."""
NO_DIRECTION = 0.01
"""What is nearer to the origin than this lies in no direction [m]."""
STILL = 1e-3
"""Joints that move no farther than this strike nothing yet [m]."""
STRETCH = 0.9
"""Whoever stands still stands where a limb so much stretched ends at the object [-]."""
STRIKE = 0.15
"""Standard deviation of the time around t* in which a strike is faster or slower than the prior's [s]."""
SWING = 0.3
"""Time before and after t* in which a strike that is moved in time keeps its speed [s]."""


def approach(
    scene: Scene,
    motion: Motion,
    trajectory: ObjectTrajectory,
    target: Target,
    height: float | None = None,
    act: Act | None = None,
) -> tuple[Motion, Target]:
    """The motion, from where its strike ends at the object's surface, at a time when the object is at its height.

    Who begins with a limb farther out than the strike ends would begin inside the object: they stand as much farther
    back, and have that much farther to reach. A person who stands still (w/o MDM) faces the object, within reach of it.

    Args:
        height: at which an object that rises or falls is to be met [m]; None: where the strike ends by itself.
        act: of a timeline, in whose time the strike is moved; the other acts keep theirs. None: the whole motion is.

    Raises:
        InputError: the person would start inside the object `BACK` away from it.
    """
    meeting = target.meeting_frame(scene.frames)
    if height is None:
        height = float(joint_paths(scene.body, motion, frames=[meeting])[0, list(target.striking), 2].mean())
    if act is None:
        later = delay(height, trajectory.com[:, 2], meeting, scene.fps)
        motion = delayed(motion, later)
    else:
        later = delay_in(act, height, trajectory.com[:, 2], target, scene.fps)
        motion = retimed(motion, 0, target.frame, target.frame + later)
    target, meeting = replace(target, frame=target.frame + later), meeting + later
    if is_still(joint_paths(scene.body, motion)[:, list(target.striking)]):
        there = within_reach(scene, motion, trajectory, target)
    elif target.joints:
        there = squared(scene, motion, trajectory, target)
    else:
        there = placed(
            motion,
            lambda moved: joint_paths(scene.body, moved, frames=[meeting])[0, target.joint],
            lambda moved: carried_strike(scene, moved, trajectory, target)[meeting],
            trajectory.com[meeting],
        )
    away = (there.translation[0] - trajectory.com[0]) * [1.0, 1.0, 0.0]
    away = away / max(float(np.linalg.norm(away)), 1e-9)
    for back in np.arange(0.0, BACK, BACK_STEP):
        if is_apart(scene, moved := shifted(there, back * away)):
            break
    check_apart(scene, moved)
    return moved, target


def squared(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Motion:
    """The motion turned square to the face that its push goes through, and moved along the ground to meet it."""
    meeting = target.meeting_frame(scene.frames)
    for _ in range(2):  # from the side the face is seen aslant; from where the first pass leads to, straight
        way = pushed_face(scene, motion, trajectory, target).direction
        ahead = facing(joint_paths(scene.body, motion, frames=[meeting])[0])
        motion = turned(motion, float(np.arctan2(way[1], way[0]) - np.arctan2(ahead[1], ahead[0])))
        goals = carried_push(scene, motion, trajectory, target)[: len(target.striking), meeting]
        now = joint_paths(scene.body, motion, frames=[meeting])[0, list(target.striking)]
        motion = shifted(motion, (goals - now).mean(axis=0) * [1.0, 1.0, 0.0])
    return motion


def is_still(paths: Array) -> bool:
    """Whether joints (T, K, 3) [m] stay where they are."""
    return float(np.ptp(paths, axis=0).max()) < STILL


def within_reach(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target) -> Motion:
    """The still motion turned to face the object, and moved along the ground to where its limbs, stretched, reach it.

    The limb begins at its chain's first joint (shoulder, hip), which comes to stand straight before the middle of what
    it is to touch.
    """
    meeting, striking = target.meeting_frame(scene.frames), list(target.striking)
    com, body = trajectory.com[meeting], scene.body
    means = trajectory.positions[meeting, : len(scene.thing.cloud)]
    if np.linalg.norm(com[:2]) > NO_DIRECTION:
        ahead = facing(joint_paths(body, motion, frames=[meeting])[0])
        motion = turned(motion, float(np.arctan2(com[1], com[0]) - np.arctan2(ahead[1], ahead[0])))
    way = facing(joint_paths(body, motion, frames=[meeting])[0])
    joints = joint_paths(body, motion, frames=[meeting])[0]
    chains = [CHAINS[chain_of(joint)] for joint in striking]
    limbs = [chain[: chain.index(joint) + 1] for chain, joint in zip(chains, striking, strict=True)]
    root = joints[[limb[0] for limb in limbs]].mean(axis=0)
    slack = max(0.5 * float(np.ptp(means[:, 2])) - ENDS, 0.0)
    height = float(joints[striking, 2].mean())
    aim = com + np.array([0.0, 0.0, np.clip(height - com[2], -slack, slack)])
    surface = aim - way * depth_along(means, aim, way)
    length = min(np.linalg.norm(np.diff(body.rest_joints[list(limb)], axis=0), axis=1).sum() for limb in limbs)
    level = math.sqrt(max((STRETCH * float(length)) ** 2 - float(surface[2] - root[2]) ** 2, 0.0))
    return shifted(motion, (surface - way * level - root) * [1.0, 1.0, 0.0])


def hastened(motion: Motion, target: Target, tempo: float) -> Motion:
    """The motion with its strike `tempo` times as fast at t*, on the same path; away from the strike as fast as it was.

    Frame t shows what was at t + (tempo - 1) s sqrt(pi/2) erf((t - c) / (sqrt(2) s)), c the middle of the fastest step
    and s `STRIKE`: at t* as before, earlier and later moved by less than 1.3 s of |tempo - 1|, the ends held.
    """
    spread, middle = STRIKE * motion.fps, target.frame + 0.5
    frames = np.arange(len(motion), dtype=float)
    ahead = (tempo - 1) * spread * math.sqrt(math.pi / 2) * erf((frames - middle) / (math.sqrt(2) * spread))
    return interpolate_motion(motion, np.clip(frames + ahead, 0, len(motion) - 1))


def turned(motion: Motion, angle: float) -> Motion:
    """The motion about the world's Z axis by `angle`."""
    about_z = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, angle], dtype=torch.float64))
    root = rotation_from_6d(torch.as_tensor(motion.orientation, dtype=torch.float64))
    return replace(
        motion,
        translation=(motion.translation @ about_z.T.numpy()).astype(motion.translation.dtype),
        orientation=rotation_to_6d(about_z @ root).numpy().astype(motion.orientation.dtype),
    )


def shifted(motion: Motion, offset: Array) -> Motion:
    """The motion moved by `offset` [m], (3,)."""
    return replace(motion, translation=motion.translation + np.asarray(offset, dtype=motion.translation.dtype))


def delayed(motion: Motion, frames: int) -> Motion:
    """The motion so many frames later, the first pose held until then; earlier, the last one held, if negative."""
    rows = np.clip(np.arange(len(motion)) - frames, 0, len(motion) - 1)
    return replace(
        motion,
        translation=motion.translation[rows],
        orientation=motion.orientation[rows],
        body_pose=motion.body_pose[rows],
    )


def delay(height: float, heights: Array, meeting: int, fps: float) -> int:
    """By how many frames a strike at `height` [m] should come later to meet an object that rises or falls.

    Args:
        heights: of the object's centre of mass, (T,) [m].
        meeting: the frame at which the strike would meet it now.
    """
    frames = np.arange(len(heights))
    cost = np.abs(heights - height) + (WAITING / fps) * np.abs(frames - meeting)
    cost[: min(round(SOONEST * fps), len(heights) - 1)] = np.inf
    return int(cost.argmin()) - meeting


def delay_in(act: Act, height: float, heights: Array, target: Target, fps: float, far: Array | None = None) -> int:
    """As `delay`, for a strike that belongs in the time of its act, or at the act's own t*.

    Args:
        heights: of the object's centre of mass, (T,) [m].
        far: what more each meeting costs, (T,) [m].
    """
    if math.isfinite(act.at):
        return min(round(act.at * fps), len(heights) - 2) - target.frame
    frames, meeting = np.arange(len(heights)), target.meeting_frame(len(heights))
    cost = np.abs(heights - height) + (WAITING / fps) * np.abs(frames - meeting) + (0.0 if far is None else far)
    first = max(round(act.start * fps), round(SOONEST * fps))
    cost[: first + 1], cost[min(round(act.end * fps), len(heights) - 1) + 1 :] = np.inf, np.inf
    return int(cost.argmin()) - meeting if np.isfinite(cost).any() else 0


def retimed(motion: Motion, since: int, frame: int, to: int) -> Motion:
    """The motion with what was at `frame` at `to`: slower or faster from frame `since` until then, and from then to its
    end; the strike itself, within `SWING`, as fast as it was."""
    if to == frame:
        return motion
    last = len(motion) - 1
    swing = min(SWING * motion.fps, 0.5 * min(frame - since, to - since), 0.5 * (last - max(frame, to)))
    if swing <= 0:
        return motion
    before, after = (np.array([since, at - swing, at + swing, last], dtype=float) for at in (frame, to))
    rates = np.diff(before) / np.diff(after)
    slopes = np.minimum(1.0, 3 * np.minimum([*rates, 1.0], [1.0, *rates]))  # never backwards (Fritsch and Carlson 1980)
    frames = np.arange(last + 1.0)
    shown = np.where(frames > since, CubicHermiteSpline(after, before, slopes)(np.maximum(frames, since)), frames)
    return interpolate_motion(motion, shown.clip(0, last))


def placed(
    motion: Motion, joint_at_meeting: Callable[[Motion], Array], goal_of: Callable[[Motion], Array], com: Array
) -> Motion:
    """The motion turned and moved along the ground such that its strike ends where it should.

    It is turned about the origin until the strike ends in the direction of the object, then moved along the ground.
    The start so lies near the straight line through the origin and the object.

    Args:
        joint_at_meeting: p_j* of a motion when the strike meets the object [m], (3,).
        goal_of: where that joint should then be [m], (3,); it depends on the way the strike comes.
        com: the object's centre of mass then [m], (3,).
    """
    struck = joint_at_meeting(motion)
    if min(np.linalg.norm(com[:2]), np.linalg.norm(struck[:2])) > NO_DIRECTION:
        motion = turned(motion, float(np.arctan2(com[1], com[0]) - np.arctan2(struck[1], struck[0])))
    offset = goal_of(motion) - joint_at_meeting(motion)
    return shifted(motion, offset * [1.0, 1.0, 0.0])
