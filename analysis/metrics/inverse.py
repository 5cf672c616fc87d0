"""Inverse dynamics: what a recorded motion takes, by Newton's and Euler's laws, and how much of it the ground can give.

The person is the linked rigid parts of `hoi.body.mass`. A frame's momentum changes from the mean of the step before it
to that of the step after it. So a force is its mean over both steps, weighted by a hat that is 1 at the frame, and the
forces of all frames add up to the change of momentum, whatever happens between frames. NumPy and SciPy alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from hoi.body.mass import PART, Masses
from hoi.body.skeleton import JOINT_COUNT, PARENTS
from hoi.body.strength import FEET, LOW, SOLE_FRICTION
from hoi.data import Array, Body, Motion, Plane

from ..posing import joint_frames

HALF_FOOT = 0.1
"""How far beyond the ankles and toe joints that are down the ground pushes [m]."""
DIRECTIONS, AROUND = 12, 6
"""Edges of the pyramid in a friction cone, and places around each joint of a foot on which the ground pushes."""
EVENLY = 1e-3
"""How strongly the ground's forces spread over all places instead of the fewest [-]."""
STICKS = 1e3
"""In the place of the friction of a plane on which nothing slides [-]."""


@dataclass(frozen=True)
class Needed:
    """What each part needs at the frames 1 .. T - 2 beyond its weight; the part of a joint is what the joint moves."""

    force: Array
    """m (a - g) [N], (F, 24, 3)."""
    moment: Array
    """About the world's origin, its spin included [N m], (F, 24, 3)."""
    joints: Array
    """World positions [m], (F, 24, 3)."""
    feet: NDArray[np.bool_]
    """Which of FEET are on the ground at the frame or at one beside it, (F, 4)."""

    def torques(self, force: Array, moment: Array) -> Array:
        """Of each joint on all that hangs on it [N m], (F, 24, 3), when these act on the parts from outside."""
        force, moment = self.force - force, self.moment - moment
        for joint in range(JOINT_COUNT - 1, 0, -1):  # children come after their parents
            force[:, PARENTS[joint]] += force[:, joint]
            moment[:, PARENTS[joint]] += moment[:, joint]
        return moment - np.cross(self.joints, force)


def needed(body: Body, masses: Masses, motion: Motion, gravity: Array) -> Needed:
    """What a motion of three frames or more takes."""
    fps, rest = motion.fps, np.asarray(body.rest_joints, np.float64)
    turns, joints = joint_frames(body, motion)
    centres = joints + np.einsum("tkij,kj->tki", turns, masses.centre - rest)
    force = masses.mass[:, None] * (fps**2 * np.diff(centres, n=2, axis=0) - gravity)
    before, after = (Rotation.from_matrix(each.reshape(-1, 3, 3)) for each in (turns[:-1], turns[1:]))
    step = (after * before.inv()).as_rotvec()
    midway = (Rotation.from_rotvec(0.5 * step) * before).as_matrix().reshape(-1, JOINT_COUNT, 3, 3)
    own = np.einsum("tkji,tkj->tki", midway, fps * step.reshape(-1, JOINT_COUNT, 3))
    spin = fps * np.diff(np.einsum("tkij,kjl,tkl->tki", midway, masses.inertia, own), axis=0)
    low = joints[:, list(FEET), 2] < (rest[:, 1] - float(body.cloud.means[:, 1].min()))[list(FEET)] + LOW
    feet = low[:-2] | low[1:-1] | low[2:]
    return Needed(force, spin + np.cross(centres[1:-1], force), joints[1:-1], feet)


def acting(first: float, last: float, frames: int) -> Array:
    """How a push from one fractional frame to another, even over that time, spreads over the frames 1 .. T - 2."""

    def passed(at: Array) -> Array:
        """The integral of the hat up to there."""
        at = at.clip(-1, 1)
        return np.where(at < 0, 0.5 * (1 + at) ** 2, 1 - 0.5 * (1 - at) ** 2)

    whole = np.arange(1.0, frames - 1)
    if last - first < 1e-9:
        return (1 - abs(first - whole)).clip(min=0)
    return (passed(last - whole) - passed(first - whole)) / (last - first)


def cone(normal: Array, friction: float) -> Array:
    """Directions (DIRECTIONS, 3) of which friction's cone about a normal is made, each with a unit along it."""
    across = np.cross(normal, np.eye(3)[abs(normal).argmin()])
    across /= np.linalg.norm(across)
    angle = 2 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)[:, None]
    return normal + friction * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across))


def cone_of(plane: Plane) -> Array:
    """The same of a plane."""
    friction = {"slip": 0.0, "stick": STICKS}.get(plane.contact, plane.friction)
    return cone(plane.normal, friction)


def nearest(columns: Array, wanted: Array) -> Array:
    """Factors (K,), none negative, with which columns (N, K) come nearest to what is wanted (N,), evenly spread."""
    count = columns.shape[1]
    if not count:
        return np.zeros(0)
    return nnls(np.vstack([columns, EVENLY * np.eye(count)]), np.concatenate([wanted, np.zeros(count)]))[0]


def from_ground(needed: Needed, wrench: Array) -> tuple[Array, Array]:
    """What the ground under the feet gives of a wrench about the pelvis (F, 6) [N, N m]: as much as it can, in the
    sense of the smallest |force|^2 + |torque / 1 m|^2 that is left, pushing from z = 0 and by Coulomb's law.

    Returns:
        Force [N] and moment about the world's origin [N m] on each part, (F, 24, 3) each.
    """
    force, moment = np.zeros_like(needed.force), np.zeros_like(needed.force)
    angle = 2 * np.pi / AROUND * np.arange(AROUND)
    ring = HALF_FOOT * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    edges = cone(np.array([0.0, 0.0, 1.0]), SOLE_FRICTION)
    for frame, (joints, down) in enumerate(zip(needed.joints, needed.feet, strict=True)):
        feet = np.array(FEET)[down]
        places = (joints[feet] * [1, 1, 0])[:, None] + ring
        pushes = np.broadcast_to(edges, (len(feet), AROUND, DIRECTIONS, 3))
        turns = np.cross((places - joints[0])[:, :, None], pushes)
        columns = np.concatenate([pushes, turns], axis=-1).reshape(-1, 6).T
        given = nearest(columns, wrench[frame]).reshape(pushes.shape[:3])
        on_places = np.einsum("jak,jakx->jax", given, pushes)
        np.add.at(force[frame], PART[feet], on_places.sum(axis=1))
        np.add.at(moment[frame], PART[feet], np.cross(places, on_places).sum(axis=1))
    return force, moment
