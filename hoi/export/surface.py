"""Triangles around a cloud of points, and what blends from the points to them. NumPy and SciPy only."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.body.people import vertex_normals
from hoi.data import Array

NEIGHBOURS = 8
"""Points that a vertex follows and takes its colour from."""
CELL, AROUND = 1.1, 5
"""Edge of a grid cell, in distances from a point to its fifth neighbour: with less the shell has holes."""
BLUR = 0.8
"""Standard deviation with which the solid is smoothed [cells]."""
SETTLING = 2
"""How often the vertices are moved onto the points."""

Faces = NDArray[np.int64]


def blend_weights(points: Array, queries: Array) -> tuple[NDArray[np.intp], Array]:
    """The nearest of points (N, 3) to queries (M, 3), and how much each counts: rows, and weights of sum 1, (M, k)."""
    count = min(NEIGHBOURS, len(points))
    apart, rows = KDTree(points).query(queries, k=count)
    apart, rows = apart.reshape(len(queries), count), rows.reshape(len(queries), count)
    width = np.maximum(apart[:, [-1]], 1e-12) / 2
    weights = np.exp((apart[:, :1] ** 2 - apart**2) / (2 * width**2))
    return rows, weights / weights.sum(1, keepdims=True)


def reconstruct(points: Array, inside: Array, finest: float) -> tuple[Array, Faces]:
    """The closed surface through points that lie on it.

    The cells with points in them are a shell, and with what that encloses a solid, be there a small hole in the shell;
    its surface net (Gibson 1998) is moved onto the points along its normals.

    Args:
        points: on the surface [m], (N, 3).
        inside: more points that belong to the solid [m], (M, 3).
        finest: least edge of a cell, in extents of the points.

    Returns:
        vertices (V, 3) [m] and faces (F, 3), counter-clockwise seen from outside; none where the points are too few.
    """
    if len(points) <= AROUND:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    spacing = float(np.median(KDTree(points).query(points, k=AROUND + 1)[0][:, AROUND]))
    extent = float(np.ptp(points, axis=0).max())
    cell = max(CELL * spacing, finest * extent, 1e-9)
    margin = 3
    low = points.min(axis=0) - margin * cell
    shape = np.ceil((points.max(axis=0) - low) / cell).astype(int) + margin + 1
    solid = np.zeros(shape, bool)
    for cloud in (points, inside):
        at = np.clip(((cloud - low) / cell).astype(int), 0, shape - 1)
        solid[tuple(at.T)] = True
    solid = ndimage.binary_closing(solid | _enclosed(solid), ndimage.generate_binary_structure(3, 2))
    solid = ndimage.binary_fill_holes(solid)
    vertices, faces = surface_net(ndimage.gaussian_filter(np.asarray(solid, np.float32), BLUR), 0.4)
    vertices = low + (vertices + 0.5) * cell
    for _ in range(SETTLING if len(faces) else 0):
        rows, weights = blend_weights(points, vertices)
        middle = np.einsum("vk,vkd->vd", weights, points[rows])
        normals = vertex_normals(vertices, faces)
        vertices = vertices + ((middle - vertices) * normals).sum(1, keepdims=True) * normals
    return vertices, faces


def _enclosed(shell: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells from which one comes to the shell along each axis either way."""
    enclosed = np.ones_like(shell)
    for axis in range(3):
        enclosed &= np.logical_or.accumulate(shell, axis)
        enclosed &= np.flip(np.logical_or.accumulate(np.flip(shell, axis), axis), axis)
    return enclosed


def surface_net(field: Array, level: float) -> tuple[Array, Faces]:
    """Vertices (V, 3) in cells and faces (F, 3) of the surface `field` (X, Y, Z) = level; outside is less."""
    high = field > level
    corners = np.stack(np.meshgrid(*[(0, 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    cells = tuple(n - 1 for n in field.shape)

    def corner(array: NDArray, offset: Array) -> NDArray:
        return array[tuple(slice(o, o + n) for o, n in zip(offset, cells, strict=True))]

    count = sum(corner(high, offset).astype(np.int8) for offset in corners)
    mixed = np.argwhere((count > 0) & (count < 8))
    number = np.full(cells, -1, np.int64)
    number[tuple(mixed.T)] = np.arange(len(mixed))
    values = np.stack([field[tuple((mixed + offset).T)] for offset in corners], -1).astype(np.float64) - level
    total, crossings = np.zeros((len(mixed), 3)), np.zeros(len(mixed))
    for a in range(8):
        for b in range(a + 1, 8):
            if np.abs(corners[a] - corners[b]).sum() != 1:
                continue
            crossed = (values[:, a] > 0) != (values[:, b] > 0)
            share = values[crossed, a] / (values[crossed, a] - values[crossed, b])
            total[crossed] += corners[a] + share[:, None] * (corners[b] - corners[a])
            crossings[crossed] += 1
    vertices = mixed + total / np.maximum(crossings, 1)[:, None]

    quads = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        first, second = (np.moveaxis(high, axis, 0)[s] for s in (slice(None, -1), slice(1, None)))
        for flipped, change in enumerate((first & ~second, second & ~first)):
            at = np.argwhere(np.moveaxis(change, 0, axis))
            at = at[((at > 0) | (np.arange(3) == axis)).all(1)]
            around = np.stack([number[tuple((at - o).T)] for o in (0 * u, u, u + v, v)], -1)
            quads.append(around[:, ::-1] if flipped else around)
    quad = np.concatenate(quads)
    return vertices, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
