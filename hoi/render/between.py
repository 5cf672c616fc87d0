"""A run between its frames, from what is recorded: poses by splines, flight exactly, deformation by its own rotation.

The object's centre follows the cubic through both frames' places and velocities, which is exact in flight. Where the
places do not fit the velocities something has struck it in between: it then goes on as before up to that moment and
as after it from there. Around its centre it turns at an even rate, and what is not rotation goes evenly from frame to
frame.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from hoi.data import Array, Motion, ObjectTrajectory, Scene, State

MISFIT = 0.02
"""Distance between where velocities lead and where the object is, over the way between two frames, that a blow explains
[-]."""

SUDDEN = 0.5
"""Change of velocity between two frames beside gravity's, over the faster of both, that is a blow [-]."""


def at_frames(scene: Scene, state: State, frames: Array, fps: float) -> tuple[Scene, State]:
    """Scene and state as if these fractional frames (F,), increasing and inside the run, were its frames, at `fps`.

    Of the object's particles the Gaussians are kept alone.
    """
    frames = np.asarray(frames, np.float64)
    motion = None if state.motion is None else _motion(state.motion, frames, fps)
    trajectory = None if state.trajectory is None else _trajectory(scene, state.trajectory, frames)
    search, target = state.contact, state.target
    if search is not None:
        contacts = tuple(replace(each, frame=_place(each.frame, frames)) for each in search.contacts)
        gap = search.smallest_gap_frame
        gap = _place(gap, frames) if np.isfinite(gap) else gap
        search = replace(search, contacts=contacts, smallest_gap_frame=gap)
    if target is not None:
        target = replace(target, frame=round(_place(target.frame, frames)))
    return replace(scene, frames=len(frames), fps=fps), State(motion, trajectory, target, search)


def frames_at(count: int, fps: float, wanted: float) -> Array:
    """The fractional frames that `count` frames at `fps` have when shown at a `wanted` rate; after the last it
    stays."""
    shown = max(1, round(count * wanted / fps))
    return np.minimum(np.arange(shown) * fps / wanted, count - 1)


def _place(frame: float, frames: Array) -> float:
    return float(np.interp(frame, frames, np.arange(len(frames))))


def _motion(motion: Motion, frames: Array, fps: float) -> Motion:
    count, known = len(motion), np.arange(len(motion))
    if count < 2:
        rows = np.zeros(len(frames), int)
        return Motion(motion.translation[rows], motion.orientation[rows], motion.body_pose[rows], fps)
    axes = motion.orientation.astype(np.float64).reshape(-1, 2, 3)
    first = axes[:, 0] / np.linalg.norm(axes[:, 0], axis=1, keepdims=True)
    second = axes[:, 1] - (axes[:, 1] * first).sum(1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    turns = Rotation.from_matrix(np.stack([first, second, np.cross(first, second)], 1))
    orientation = RotationSpline(known, turns)(frames).as_matrix()[:, :2].reshape(-1, 6)
    pose = np.stack(
        [
            RotationSpline(known, Rotation.from_rotvec(joint.astype(np.float64)))(frames).as_rotvec()
            for joint in motion.body_pose.transpose(1, 0, 2)
        ],
        1,
    )
    translation = CubicSpline(known, motion.translation.astype(np.float64))(frames)
    return Motion(*(part.astype(np.float32) for part in (translation, orientation, pose)), fps=fps)


def _trajectory(scene: Scene, trajectory: ObjectTrajectory, frames: Array) -> ObjectTrajectory:
    count = len(scene.thing.cloud)
    last = len(trajectory.com) - 1
    before = np.minimum(np.floor(frames).astype(int), max(last - 1, 0))
    shares = frames - before
    gradient = trajectory.deformation_gradient
    positions = np.empty((len(frames), count, 3), np.float32)
    com = np.empty((len(frames), 3))
    turned = None if gradient is None else np.empty((len(frames), count, 3, 3), np.float32)
    for row, (k, share) in enumerate(zip(before, shares, strict=True)):
        if share < 1e-9 or share > 1 - 1e-9 or last == 0:  # as recorded
            at = min(k + round(share), last)
            positions[row], com[row] = trajectory.positions[at, :count], trajectory.com[at]
            if turned is not None and gradient is not None:
                turned[row] = gradient[at, :count]
            continue
        com[row], moved = _centre(trajectory, k, share, 1 / scene.fps, scene.gravity)
        start, end = (trajectory.positions[at, :count].astype(np.float64) - trajectory.com[at] for at in (k, k + 1))
        turn = _turn(start, end)
        now = Rotation.from_rotvec(moved * turn.as_rotvec()).as_matrix()
        whole = turn.as_matrix()
        positions[row] = com[row] + (start + moved * (end @ whole - start)) @ now.T
        if turned is not None and gradient is not None:
            first, second = (gradient[at, :count].astype(np.float64) for at in (k, k + 1))
            turned[row] = now @ (first + moved * (whole.T @ second - first))
    velocity = np.stack([np.interp(frames, np.arange(last + 1), axis) for axis in trajectory.com_velocity.T], 1)
    energy = np.stack([np.interp(frames, np.arange(last + 1), axis) for axis in trajectory.energy.T], 1)
    phase = tuple(trajectory.phase[at] for at in np.rint(frames).astype(int)) if trajectory.phase else ()
    return ObjectTrajectory(positions, com, velocity, energy, turned, phase)


def _centre(trajectory: ObjectTrajectory, k: int, share: float, step: float, gravity: Array) -> tuple[Array, float]:
    """The centre of mass [m] at a share of the way from frame k to k + 1, and how far what surrounds it has got."""
    start, end = trajectory.com[k].astype(np.float64), trajectory.com[k + 1].astype(np.float64)
    first, second = (trajectory.com_velocity[at].astype(np.float64) * step for at in (k, k + 1))
    way, change = end - start, second - first
    off = np.linalg.norm(way - (first + second) / 2)
    fast = max(np.linalg.norm(way), np.linalg.norm(first), np.linalg.norm(second), 1e-4)
    if off <= MISFIT * fast and np.linalg.norm(change - gravity * step**2) <= SUDDEN * fast:
        s = share
        cubic = (2 * s**3 - 3 * s**2 + 1) * start + (s**3 - 2 * s**2 + s) * first
        return cubic + (3 * s**2 - 2 * s**3) * end + (s**3 - s**2) * second, share
    blow = float(np.clip((second - way) @ change / max(change @ change, 1e-12), 0.02, 0.98))
    gap = (end - second * (1 - blow)) - (start + first * blow)  # closed along both ways
    if share < blow:
        place = start + first * share + gap * (0.5 * share / blow)
    else:
        place = end - second * (1 - share) - gap * (0.5 * (1 - share) / (1 - blow))
    at_rest = np.linalg.norm(first) < 0.02 * np.linalg.norm(second)
    return place, float(np.clip((share - blow) / (1 - blow), 0, 1)) if at_rest else share


def _turn(start: Array, end: Array) -> Rotation:
    """The rotation that takes the points (N, 3) nearest to the others (Kabsch 1976)."""
    if len(start) < 3:
        return Rotation.identity()
    left, _, right = np.linalg.svd(end.T @ start)
    fix = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    return Rotation.from_matrix(left @ fix @ right)
