"""The object's surface at an instant, from its particles alone: a signed distance for limbs that touch or enter it.

The surface is where the Gaussians are: their means, averaged over small cells (a captured cloud is several layers
thick), with the normal of the neighbouring means, and between these an implicit moving-least-squares surface (Kolluri
2008). Which side is out, and which Gaussians are no surface at all, the solid says: the particles' rest volumes spread
on a grid. So balls, boxes, dented balls and captured clouds are all alike. NumPy only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.data import Array

NEIGHBOURS = 12
"""Points of the surface that say where it is."""
BLUR = 1.5
"""Standard deviation with which the solid is spread [cells]."""
BURIED = 0.85
"""Gaussians with more solid than this around them are not on the surface."""
EMPTY, SOLID = 0.05, 0.95
"""With less or more solid around it than this, a point is outside or inside whatever the nearest normals say."""
DEEP, LEAST = 2.0, 0.3
"""So many cells behind a surface there is so much solid at least, in the corner of a box too: or it is too thin."""
FINEST = 1 / 150
"""Least distance between points of the surface, in sizes of the object: a finer cloud costs time and tells no more."""


@dataclass(frozen=True)
class Surface:
    """Made by `surface_of`."""

    points: Array
    """(S, 3) [m]."""
    normals: Array
    """Unit, outwards, (S, 3)."""
    thin: NDArray[np.bool_]
    """Where there is no inside: leaves, cloth, twigs, (S,)."""
    spacing: float
    """Between the points [m]."""
    _tree: KDTree
    _solid: "_Solid"

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance [m], positive outside, (M,), and its gradient (M, 3), of points (M, 3) [m].

        Exact for a plane; of a smooth surface its curvature times the spacing squared is left over. Outside of a sharp
        edge it is up to 30% short. What is too thin to have an inside has a distance alone.
        """
        points = np.asarray(points, np.float64)
        apart, rows = self._tree.query(points, k=min(NEIGHBOURS, len(self.points)))
        apart, rows = apart.reshape(len(points), -1), rows.reshape(len(points), -1)
        away = points[:, None] - self.points[rows]
        normals = self.normals[rows]
        heights = (away * normals).sum(-1)
        weights = np.exp((apart[:, :1] ** 2 - apart**2) / self.spacing**2)
        weights /= weights.sum(-1, keepdims=True)
        signed = (weights * heights).sum(-1)
        leaning = weights * (heights - signed[:, None]) * (-2 / self.spacing**2)
        gradient = (weights[..., None] * normals + leaning[..., None] * away).sum(1)
        solid = self._solid.at(points)
        outside, inside = self.thin[rows[:, 0]] | (solid < EMPTY), (solid > SOLID) & (signed > 0)
        for certain, sign in ((outside, 1.0), (inside & ~outside, -1.0)):
            signed[certain] = sign * apart[certain, 0]
            gradient[certain] = sign * away[certain, 0] / np.maximum(apart[certain, :1], 1e-12)
        return signed, gradient


def surface_of(particles: Array, gaussians: int, volumes: Array, size: float, near: tuple[Array, Array]) -> Surface:
    """The surface of an object in some pose.

    Args:
        particles: all of the object's [m], (P, 3); the first `gaussians` are its Gaussians' means.
        volumes: rest volumes [m^3], (P,).
        size: of the object at rest [m].
        near: corners of the box whose points will be asked for [m]; what is farther from it than half the size is left
            out, unless that is all there is.
    """
    low, high = near[0] - size / 2, near[1] + size / 2
    inside = np.all((particles >= low) & (particles <= high), axis=1)
    rows = np.flatnonzero(inside[:gaussians])
    if len(rows) == 0:
        rows, inside = np.arange(gaussians), np.ones(len(particles), bool)
    solid = _solid(particles[inside].astype(np.float64), volumes[inside], gaussians, volumes)
    means = particles[rows].astype(np.float64)
    exposed = solid.at(means) <= BURIED
    means = means[exposed] if exposed.any() else means
    between = KDTree(means).query(means, k=min(2, len(means)))[0].reshape(len(means), -1)[:, -1]
    edge = max(1.5 * float(np.median(between)), FINEST * size)
    points = _averaged(means, edge)
    normals = _normals(points, solid)
    thin = solid.at(points - DEEP * solid.cell * normals) < LEAST
    return Surface(points, normals, thin, edge, KDTree(points), solid)


@dataclass(frozen=True)
class _Solid:
    """Share of the space around a point that is solid."""

    share: Array
    low: Array
    cell: float

    def _cells(self, points: Array) -> Array:
        return ((points - self.low) / self.cell - 0.5).T

    def at(self, points: Array) -> Array:
        return ndimage.map_coordinates(self.share, self._cells(points), order=1, mode="nearest")

    def outward(self, points: Array) -> Array:
        """Direction in which it becomes less, (N, 3), not normalised."""
        steps = self.cell * np.eye(3)
        return np.stack([self.at(points - step) - self.at(points + step) for step in steps], -1)


def _solid(particles: Array, volumes: Array, gaussians: int, all_volumes: Array) -> _Solid:
    filling = all_volumes[gaussians:]
    cell = float(np.median(filling if len(filling) else all_volumes)) ** (1 / 3)
    margin = 4 * BLUR * cell
    low = particles.min(axis=0) - margin
    counts = np.ceil((particles.max(axis=0) + margin - low) / cell).astype(int)
    share = np.zeros(counts)
    np.add.at(share, tuple(((particles - low) / cell).astype(int).T), volumes / cell**3)
    return _Solid(ndimage.gaussian_filter(share, BLUR, mode="constant"), low, cell)


def _averaged(points: Array, edge: float) -> Array:
    """One point, the mean, for each cell of that edge with points (N, 3) in it."""
    cells = np.floor((points - points.min(axis=0)) / edge).astype(np.int64)
    _, owner, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    return np.stack([np.bincount(owner, points[:, axis]) for axis in range(3)], -1) / counts[:, None]


def _normals(points: Array, solid: _Solid) -> Array:
    """Of the plane through the neighbours; where they lie in no plane, away from the solid."""
    outward = solid.outward(points)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    if len(points) < NEIGHBOURS:
        return outward
    neighbours = points[KDTree(points).query(points, k=NEIGHBOURS)[1]]
    spread = neighbours - neighbours.mean(axis=1, keepdims=True)
    size, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    normals = axes[:, :, 0]
    along = (normals * outward).sum(1)
    flat = (size[:, 0] < 0.25 * size[:, 1]) & (np.abs(along) > 0.3)
    return np.where(flat[:, None], normals * np.sign(along)[:, None], outward)
