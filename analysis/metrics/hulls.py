"""The person as a solid: around each joint's skin its convex hull, carried by the joint."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from hoi.data import Array, Body

FEWEST = 12
"""Gaussians that a hull is made from; with fewer the joint has none."""


@dataclass(frozen=True)
class Hull:
    """The hull of one joint's skin, in the body's rest frame."""

    joint: int
    planes: Array
    """Inside is planes[:, :3] @ x + planes[:, 3] <= 0, (H, 4)."""
    low: Array
    high: Array
    """Corners of its box [m], (3,)."""

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Which of the points (M, 3), in the rest frame, are inside, (M,)."""
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        rows = np.flatnonzero(inside)
        inside[rows] = np.all(points[rows] @ self.planes[:, :3].T + self.planes[:, 3] <= 0, axis=1)
        return inside

    def corners(self) -> Array:
        """Of its box [m], (8, 3)."""
        return np.stack(np.meshgrid(*zip(self.low, self.high, strict=True), indexing="ij"), -1).reshape(-1, 3)

    def lattice(self, spacing: float) -> Array:
        """Points inside, a cube of edge `spacing` each [m], (M, 3)."""
        axes = [np.arange(low + spacing / 2, high, spacing) for low, high in zip(self.low, self.high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        return points[self.contains(points)]


def hull_of(joint: int, points: Array) -> Hull | None:
    """The hull of the points (M, 3) of a joint; None where they are few or flat."""
    if len(points) < FEWEST:
        return None
    try:
        hull = ConvexHull(np.asarray(points, np.float64))
    except QhullError:
        return None
    return Hull(joint, np.unique(hull.equations, axis=0), hull.min_bound, hull.max_bound)


def hulls_of(body: Body, joints: tuple[int, ...]) -> list[Hull]:
    """Those of the joints that have one."""
    dominant = body.dominant_joints
    hulls = (hull_of(joint, body.cloud.means[dominant == joint]) for joint in joints)
    return [hull for hull in hulls if hull is not None]
