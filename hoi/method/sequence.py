"""The strikes after the first (paper: attraction and re-simulation "naturally extend to multiple sequential contacts").

The order of computing is the order of time: once a strike's contacts are answered, the object's changed trajectory says
where and when the next one can be. What has been until then stays as it is, and the person goes on from there.
"""

from dataclasses import replace

import numpy as np
import roma
import torch

from hoi.body.kinematics import rotation_from_6d, rotation_to_6d
from hoi.body.skinning import joint_paths
from hoi.data import Act, Array, ContactSearch, Motion, ObjectTrajectory, Scene, Target
from hoi.method.approach import NO_DIRECTION, SOONEST, delay_in, is_still, retimed
from hoi.method.attraction import carried_strike

PACE = 1.5
"""How fast people go to where the next strike has to be, without counting it as far away [m/s]."""
FASTEST = 3.0
"""How fast they go there at most, on average: what they cannot reach they miss [m/s]."""
HASTE = 1.5
"""How many times as fast as it was a motion comes to its next strike at most [-]."""
SETTLING = 0.3
"""In how long a motion goes over from what it was to what it becomes [s]."""
MOST_CONTACTS = 32
"""Contacts that are answered in one scene at most."""
MOST_AIMS = 3
"""How often a strike is aimed, where something else touches the object before it."""
NEAR = 0.25
"""What is nearer to a person than this lies in no direction [m]."""


def placed_next(
    scene: Scene, motion: Motion, trajectory: ObjectTrajectory, target: Target, act: Act, since: int, moves: bool
) -> tuple[Motion, Target]:
    """The motion, from frame `since` on, with its next strike at a time at which the object can be met, and there.

    Args:
        target: j* and t* of the motion as it is.
        act: in whose time the strike is to be.
        moves: whether the person may go and turn there; else they stay where they are.
    """
    fps, frames = scene.fps, scene.frames
    struck = joint_paths(scene.body, motion, frames=[target.meeting_frame(frames)])[0, target.joint]
    there = np.arange(frames) / fps - since / fps - SOONEST  # time to get there
    far = np.linalg.norm(trajectory.com[:, :2] - struck[:2], axis=-1) - PACE * there
    in_time = (there > 0) & (np.arange(frames) - since >= (target.meeting_frame(frames) - since) / HASTE)
    far = np.where(in_time, np.maximum(far, 0.0), np.inf)
    later = delay_in(act, float(struck[2]), trajectory.com[:, 2], target, fps, far)
    motion, target = (
        retimed(motion, since, target.frame, target.frame + later),
        replace(target, frame=target.frame + later),
    )
    meeting = target.meeting_frame(frames)
    if not moves or meeting <= since or is_still(joint_paths(scene.body, motion)[:, [target.joint]]):
        return motion, target
    for _ in range(2):  # the way that the strike comes from decides where it ends
        motion = bent(
            motion, since, meeting, angle_to(scene, motion, trajectory.com[meeting], target, since), np.zeros(3)
        )
        goal = carried_strike(scene, motion, trajectory, target)[meeting]
        now = joint_paths(scene.body, motion, frames=[meeting])[0, target.joint]
        way = (goal - now) * [1.0, 1.0, 0.0]
        share = FASTEST * (meeting - since) / fps / max(float(np.linalg.norm(way)), 1e-9)
        motion = bent(motion, since, meeting, 0.0, way * min(share, 1.0))
    return motion, target


def angle_to(scene: Scene, motion: Motion, com: Array, target: Target, since: int) -> float:
    """About Z, by which the way from the pelvis at `since` to the striking joint at t* points to the object, at most a
    quarter turn either way [rad]."""
    start = np.asarray(motion.translation[since], dtype=np.float64)
    joint = joint_paths(scene.body, motion, frames=[target.meeting_frame(scene.frames)])[0, target.joint]
    ways = [(point - start)[:2] for point in (com, joint)]
    if min(float(np.linalg.norm(way)) for way in ways) < max(NEAR, NO_DIRECTION):
        return 0.0
    wanted, now = (float(np.arctan2(way[1], way[0])) for way in ways)
    return float(np.clip((wanted - now + np.pi) % (2 * np.pi) - np.pi, -np.pi / 2, np.pi / 2))


def bent(motion: Motion, since: int, until: int, angle: float, offset: Array) -> Motion:
    """The motion turned about Z by `angle` [rad] and moved by `offset` [m], bit by bit from one frame to the other, as
    smoothly as a limb moves (minimum jerk); before as it was, after turned and moved as a whole."""
    share = _minimum_jerk((np.arange(len(motion)) - since) / max(until - since, 1))
    turns = roma.rotvec_to_rotmat(torch.as_tensor(np.array([0.0, 0.0, angle]) * share[:, None]))
    steps = np.diff(np.asarray(motion.translation, dtype=np.float64), axis=0)
    middle = 0.5 * (share[1:] + share[:-1])
    across = roma.rotvec_to_rotmat(torch.as_tensor(np.array([0.0, 0.0, angle]) * middle[:, None])).numpy()
    steps = np.einsum("tij,tj->ti", across, steps)
    path = np.concatenate([motion.translation[:1], motion.translation[:1] + steps.cumsum(axis=0)])
    root = turns @ rotation_from_6d(torch.as_tensor(motion.orientation, dtype=torch.float64))
    return replace(
        motion,
        translation=(path + share[:, None] * offset).astype(motion.translation.dtype),
        orientation=rotation_to_6d(root).numpy().astype(motion.orientation.dtype),
    )


def joined(before: Motion, after: Motion, since: int) -> Motion:
    """The one motion up to frame `since`, the other from `SETTLING` later on, in between a smooth way over."""
    share = _minimum_jerk((np.arange(len(before)) - since) / (SETTLING * before.fps))
    weight = torch.as_tensor(share)
    starts, ends = (
        [
            roma.rotmat_to_unitquat(rotation_from_6d(torch.as_tensor(motion.orientation, dtype=torch.float64))),
            roma.rotvec_to_unitquat(torch.as_tensor(motion.body_pose, dtype=torch.float64)),
        ]
        for motion in (before, after)
    )
    roots, poses = (_between(one, other, weight) for one, other in zip(starts, ends, strict=True))
    r = before.translation + share[:, None] * (after.translation - before.translation)
    made = replace(
        before,
        translation=r.astype(before.translation.dtype),
        orientation=rotation_to_6d(roma.unitquat_to_rotmat(roots)).numpy().astype(before.orientation.dtype),
        body_pose=roma.unitquat_to_rotvec(poses).numpy().astype(before.body_pose.dtype),
    )
    for name in ("translation", "orientation", "body_pose"):  # to the bit
        getattr(made, name)[: since + 1] = getattr(before, name)[: since + 1]
    return made


def _between(start: torch.Tensor, end: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """Unit quaternions (T, ..., 4) along the shorter arc from start to end, by (T,)."""
    turn = roma.unitquat_to_rotvec(roma.quat_product(roma.quat_conjugation(start), end))
    part = share.reshape(-1, *(1,) * (turn.ndim - 1)) * turn
    return roma.quat_product(start, roma.rotvec_to_unitquat(part))


def _minimum_jerk(share: Array) -> Array:
    """From 0 to 1 as `share` does, with velocity and acceleration 0 at both ends (Flash and Hogan 1985)."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def merged(earlier: ContactSearch | None, found: ContactSearch) -> ContactSearch:
    """All contacts of two searches, the earlier one first; its smallest gap is that of the whole motion then."""
    if earlier is None:
        return found
    begins = min((push.start for push in found.pushes), default=np.inf)
    before = tuple(push for push in earlier.pushes if push.start < begins)
    return replace(earlier, contacts=earlier.contacts + found.contacts, pushes=before + found.pushes)
