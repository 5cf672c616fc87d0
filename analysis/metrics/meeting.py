"""Person and object in space: how far apart, how deep in each other, at which times. Geometry alone, of any system.

The skin is all of the person's Gaussians; the object's surface comes from its particles (`hoi.refine.surface`). Looked
at are all whole frames, and `SUBFRAMES` times a frame where they first come together and at the recorded contact.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array, SceneObject
from hoi.frames import at_frame
from hoi.refine.fidelity import SUBFRAMES, object_at
from hoi.refine.surface import Surface, surface_of

from ..records import Record

REACH = 0.02
"""Skin farther than this from the box around the object is not looked at [m]."""
D_CONTACT = 0.01
"""What counts as touching where the config does not say, the paper's d_contact [m]."""
FINE = 2
"""Frame intervals that are looked at between frames: the first in which they meet, and the one of t_c or the second."""
RIGID = 0.004
"""An object whose particles are nowhere farther from where it would be, moved as one piece, has its shape [sizes]."""


@dataclass(frozen=True)
class Meeting:
    """What was seen at each of F times, in order."""

    frames: Array
    """(F,), fractional."""
    gap: Array
    """Of the skin to the object's surface [m], (F,): 0 where it touches or enters, inf where farther than `REACH`."""
    depth: Array
    """How deep the deepest skin is in the object [m], (F,); 0 outside."""
    joint: NDArray[np.intp]
    """Whose skin is nearest or deepest, (F,); -1 where unknown."""
    touching: NDArray[np.bool_]
    """Whether skin is no farther than d_contact, (F,)."""
    by_joint: NDArray[np.bool_]
    """Which joints' skin is, (F, 24); False where unknown."""
    skin: Array
    """Where that nearest or deepest skin is [m], (F, 3)."""

    @property
    def first(self) -> int | None:
        """Index of the first time at which they touch."""
        return int(self.touching.argmax()) if self.touching.any() else None


def d_contact(record: Record) -> float:
    """What counts as touching [m]."""
    return float(record.conf("stage", "contact", "distance", default=D_CONTACT))


@lru_cache(maxsize=2)
def meeting(record: Record) -> Meeting | None:
    """How person and object meet; None where one of them is missing."""
    run, skin = record.run, record.skin
    scene, trajectory = run.scene, run.state.trajectory
    if scene is None or trajectory is None or skin is None or not len(scene.thing.cloud):
        return None
    last = min(len(skin), len(trajectory.positions)) - 1
    if last < 1:
        return None
    push = run.state.contact.push if run.state.contact is not None else None
    joints, distance = record.skin_joints, d_contact(record)
    surface = trajectory.positions[:, : len(scene.thing.cloud)]
    low, high = surface.min(axis=1) - REACH, surface.max(axis=1) + REACH
    near, meet = _near(skin[: last + 1], joints, low, high)
    times = {float(frame) for frame in near}
    if push is not None and push.frame <= last:
        times.add(push.frame)
        meet = [*meet[:1], *({int(push.frame)} & set(meet[1:]))]
    times |= {first + step / SUBFRAMES for first in meet[:FINE] for step in range(SUBFRAMES + 1)}
    frames = np.array(sorted(times))

    count = len(frames)
    gap, depth, joint = np.full(count, math.inf), np.zeros(count), np.full(count, -1)
    nearest = np.full((count, 3), math.nan)
    by_joint, touching = np.zeros((count, JOINT_COUNT), bool), np.zeros(count, bool)
    shape = Shape(scene.thing)
    for index, frame in enumerate(frames):
        points, particles = at_frame(skin, frame), object_at(trajectory, push, scene.fps, float(frame))
        outside = particles[: len(scene.thing.cloud)]
        rows = _within(points, outside.min(axis=0) - REACH, outside.max(axis=0) + REACH)
        if not len(rows):
            continue
        signed = shape.distance(particles, points[rows])
        deepest = int(signed.argmin())
        gap[index], depth[index] = max(0.0, signed[deepest]), max(0.0, -signed[deepest])
        nearest[index] = points[rows[deepest]]
        touching[index] = signed[deepest] <= distance
        if joints is not None:
            joint[index] = joints[rows[deepest]]
            by_joint[index, joints[rows[signed <= distance]]] = True
    return Meeting(frames, gap, depth, joint, touching, by_joint, nearest)


class Shape:
    """The object's surface: as it first was while the object only moves as one piece, else as it is near the points."""

    def __init__(self, thing: SceneObject) -> None:
        self._thing = thing
        self._from: Array | None = None
        self._surface: Surface | None = None

    def distance(self, particles: Array, points: Array) -> Array:
        """Signed distances [m], positive outside, (M,), of points (M, 3) from the object with particles at (P, 3)."""
        if self._from is None or self._surface is None:
            self._from, self._surface = particles, self._surface_of(particles, particles)
        rotation, offset = rigid_motion(self._from, particles)
        moved = self._from @ rotation.T + offset
        if np.abs(moved - particles).max() <= RIGID * self._thing.size:
            return self._surface.distance((points - offset) @ rotation)[0]
        return self._surface_of(particles, points).distance(points)[0]

    def _surface_of(self, particles: Array, near: Array) -> Surface:
        box = near.min(axis=0), near.max(axis=0)
        return surface_of(particles, len(self._thing.cloud), self._thing.volumes, self._thing.size, box)


def rigid_motion(first: Array, second: Array) -> tuple[Array, Array]:
    """Rotation R (3, 3) and offset b (3,) [m] with second ~ R first + b, least squares (Kabsch), of points (P, 3)."""
    centres = first.mean(axis=0, dtype=np.float64), second.mean(axis=0, dtype=np.float64)
    u, _, vt = np.linalg.svd((second - centres[1]).T @ (first - centres[0]))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn, centres[1] - turn @ centres[0]


def _near(skin: Array, joints: NDArray[np.intp] | None, low: Array, high: Array) -> tuple[list[int], list[int]]:
    """Whole frames with a limb's box in the object's box (corners (T, 3)), and the intervals in which skin sweeps into
    it."""
    order = np.arange(skin.shape[1]) if joints is None else np.argsort(joints, kind="stable")
    starts = np.array([0]) if joints is None else np.unique(joints[order], return_index=True)[1]
    sorted_skin = skin[:, order]
    bottom = np.minimum.reduceat(sorted_skin, starts, axis=1)  # (T, joints with skin, 3)
    top = np.maximum.reduceat(sorted_skin, starts, axis=1)
    count = len(skin)
    near = np.all((top > low[:count, None]) & (bottom < high[:count, None]), axis=-1).any(axis=1)
    object_low = np.minimum(low[: count - 1], low[1:count])
    object_high = np.maximum(high[: count - 1], high[1:count])
    swept_low, swept_high = np.minimum(bottom[:-1], bottom[1:]), np.maximum(top[:-1], top[1:])
    sweeps = np.all((swept_high > object_low[:, None]) & (swept_low < object_high[:, None]), axis=-1).any(axis=1)
    met: list[int] = []
    for frame in np.flatnonzero(sweeps).tolist():
        both = skin[frame], skin[frame + 1]
        hits = (np.maximum(*both) > object_low[frame]) & (np.minimum(*both) < object_high[frame])
        if np.all(hits, axis=1).any():
            met.append(frame)
    return np.flatnonzero(near).tolist(), met


def _within(points: Array, low: Array, high: Array) -> NDArray[np.intp]:
    """Rows of the points (N, 3) that are in a box."""
    rows = np.flatnonzero((points[:, 0] > low[0]) & (points[:, 0] < high[0]))
    for axis in (1, 2):
        values = points[rows, axis]
        rows = rows[(values > low[axis]) & (values < high[axis])]
    return rows
