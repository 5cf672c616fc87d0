"""Which part of space a captured surface makes solid, on a lattice of its own: no grid of a simulation enters.

Surface points are closed to a wall; what a flood from outside cannot reach is hollow; solid is what lies nearer to the
hollow than to the outside, so that of the wall, however thick the capture made it, the inner half counts. What holds no
hollow, like a leaf, is a sheet of a set thickness.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.data import Array, GaussianCloud
from hoi.gaussians import rotation_matrices

CELLS = 96
"""Of the lattice, across the object."""
OPENING = 0.07
"""Of the extent: narrower openings in a capture are taken for holes in its surface, not in the thing."""
THICKNESS = 0.02
"""Of the extent: what a surface that encloses nothing is taken for."""
OPAQUE = 0.3
"""Fainter Gaussians bound no solid, unless all are as faint."""
BODY = 1.2
"""Standard deviations that a Gaussian covers: half the way to a neighbour that it blends with."""
AROUND = 4
"""Neighbours whose mean distance is the gap that is closed between Gaussians."""
FINEST = 12
"""Points from the middle of a Gaussian to its rim, at most."""
_BLOCK = 1 << 20


@dataclass(frozen=True)
class Solid:
    share: Array
    """Of each cell that is solid, in [0, 1], (nx, ny, nz)."""
    lower: Array
    """Lowest corner of the lattice [m], (3,)."""
    cell: float
    """Edge of a cell [m]."""
    enclosed: float
    """Share of the volume that lies inside a closed surface [-]; the rest are sheets."""

    @property
    def volume(self) -> float:
        """[m^3]"""
        return float(self.share.sum(dtype=np.float64)) * self.cell**3

    def at(self, points: Array) -> Array:
        """Solid share at points (..., 3) [m], interpolated."""
        places = np.moveaxis((points - self.lower) / self.cell - 0.5, -1, 0)
        return ndimage.map_coordinates(self.share, places, order=1, mode="constant")


def solid_of(cloud: GaussianCloud) -> Solid:
    """The solid that a captured surface [m] bounds."""
    means = cloud.means.astype(np.float64)
    extent = float(np.ptp(means, axis=0).max())
    cell = extent / CELLS
    near, wide = _openings(cloud, extent)
    lower = means.min(0) - (wide + 4 * cell)
    counts = np.ceil((means.max(0) - lower) / cell + wide / cell + 4).astype(int)
    surface = _covered(cloud, lower, cell, counts)

    apart = _distance(surface) * cell
    outside = _flooded(apart > near)
    hollow = (apart > near) & ~outside
    if wide > near:
        far = _flooded(apart > wide)
        sealed = (apart > wide) & ~far  # hollow once wider openings are closed too
        if (sealed & outside).sum() > 0.05 * max(sealed.sum(), 1):
            leaked = outside & (_distance(sealed) < _distance(far))
            hollow, outside = hollow | leaked, outside & ~leaked
    to_outside = _distance(outside) * cell
    wall = np.zeros(counts)
    half = 0.0
    if hollow.any():
        to_hollow = _distance(hollow) * cell
        closed = np.clip((to_outside - to_hollow) / (2 * cell) + 0.5, 0, 1)
        middle = np.abs(to_outside - to_hollow) < cell
        half = max(0.0, float(np.median(to_outside[middle])) - cell / 2 - near) if middle.any() else 0.0
    else:
        to_hollow, closed = np.full(counts, np.inf), wall
    # Parts too thin for a hollow of their own: within the closed wall, less the half of it that lies outside.
    depth = to_outside - cell / 2 - near - half
    own = BODY * float(np.median(cloud.scales.min(1)))  # how deep a sheet of these Gaussians looks
    core = depth > max(THICKNESS * extent / 2, own + cell) - cell / 2
    thin = (to_hollow > 2 * near + 4 * half + 2 * cell) & (_distance(core) * cell < THICKNESS * extent + 2 * cell)
    closed = np.maximum(closed, np.where(thin, np.clip(depth / cell + 0.5, 0, 1), 0))
    sheets = _sheets(surface, closed, lower, cell, extent, near + half + 2 * cell)
    share = np.maximum(closed, sheets)
    total = float(share.sum())
    return Solid(share, lower, cell, float((share * (closed >= sheets)).sum() / max(total, 1e-300)))


def _openings(cloud: GaussianCloud, extent: float) -> tuple[float, float]:
    """Radii by which the surface is closed [m]: between its Gaussians, and over holes in a capture."""
    means = cloud.means.astype(np.float64)
    if len(means) < 2:
        return 0.02 * extent, OPENING / 2 * extent
    apart = np.asarray(KDTree(means).query(means, min(AROUND, len(means) - 1) + 1, workers=-1)[0])[:, 1:].mean(1)
    gap = float(np.percentile(apart - BODY * np.sort(cloud.scales, 1)[:, 1], 90))
    near = min(max(1.2 * extent / CELLS, gap), 0.1 * extent)
    return near, max(2 * near, OPENING / 2 * extent)


def _covered(cloud: GaussianCloud, lower: Array, cell: float, counts: NDArray[np.int_]) -> NDArray[np.bool_]:
    """The cells that the middle of an opaque Gaussian covers."""
    opaque = np.flatnonzero(cloud.opacities >= min(OPAQUE, float(np.median(cloud.opacities))))
    axes = rotation_matrices(cloud) * cloud.scales[:, None, :].astype(np.float64)
    steps = np.ceil(BODY * cloud.scales / cell - 0.5).clip(0, FINEST).astype(int)
    covered = np.zeros(counts, bool)
    kinds, kind = np.unique(steps[opaque], axis=0, return_inverse=True)
    for number, step in enumerate(kinds):
        rows = opaque[kind.reshape(-1) == number]
        grid = np.stack(np.meshgrid(*(np.arange(-n, n + 1) / max(n, 1) for n in step), indexing="ij"), -1).reshape(
            -1, 3
        )
        within = BODY * grid[(grid**2).sum(1) <= 1]
        for some in np.array_split(rows, max(1, len(rows) * len(within) // _BLOCK)):
            points = cloud.means[some, None].astype(np.float64) + np.einsum("nij,kj->nki", axes[some], within)
            places = ((points - lower) / cell).astype(int).reshape(-1, 3)
            covered[tuple(places[((places >= 1) & (places < counts - 1)).all(1)].T)] = True
    return covered


def _flooded(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What of the free cells a flood from the border reaches."""
    return free & ~np.asarray(ndimage.binary_fill_holes(~free), bool)


def _distance(cells: NDArray[np.bool_]) -> Array:
    """From each cell to the nearest of `cells`, in cells; infinite where there are none."""
    if not cells.any():
        return np.full(cells.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~cells))


def _sheets(surface: NDArray[np.bool_], closed: Array, lower: Array, cell: float, extent: float, reach: float) -> Array:
    """Share of each cell that lies within a sheet about surface that bounds no solid nearby."""
    share = np.zeros_like(closed)
    bare = surface & (_distance(closed > 0.5) * cell > reach)
    if bare.any():
        share = np.clip((THICKNESS * extent / 2 - _distance(bare) * cell) / cell + 0.5, 0, 1)
    return share
