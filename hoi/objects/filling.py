"""Interior particles and particle volumes, so that mass is density times volume wherever the Gaussians are.

Space is cut into cells of edge `spacing`. Each solid cell's volume is shared by the surface particles in it; a solid
cell without any gets one particle at its centre. So density stays even where surface Gaussians crowd, and the volumes
sum to the solid's. (PhysGaussian shares dx^3 likewise, but counts cells that are only partly solid in full.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.objects.solidity import solid_of

MAX_CELLS = 8_000_000
_SAMPLES = 3  # a side of a cell, to measure how much of it is solid


@dataclass(frozen=True)
class Filling:
    """What makes a surface a body."""

    interior: Array
    """Particles to add to the surface's [m], (M, 3)."""
    volumes: Array
    """Of the surface's N particles, then of the interior's [m^3], (N + M,)."""
    enclosed: float
    """Share of the volume that lies inside a closed surface [-]; the rest are sheets."""


def fill_mesh(surface: Array, vertices: Array, faces: NDArray[np.integer], spacing: float) -> Filling:
    """Fill a closed mesh.

    Args:
        surface: particles on the surface [m], (N, 3).
        vertices, faces: closed mesh [m], triangles outward.
        spacing: distance between interior particles [m], about half a cell of the simulation's grid.

    Raises:
        InputError: the spacing is too coarse for the mesh to hold one cell, or too fine for memory.
    """
    lower, counts = _lattice(vertices.min(0), vertices.max(0), spacing)
    fine = [low + spacing / _SAMPLES * (np.arange(n * _SAMPLES) + 0.5) for low, n in zip(lower, counts, strict=True)]
    inside = _inside_mesh(vertices, faces, fine)
    nx, ny, nz = counts
    solid = inside.reshape(nx, _SAMPLES, ny, _SAMPLES, nz, _SAMPLES).mean((1, 3, 5))
    interior, volumes = _share(surface, solid, lower, spacing)
    corners = vertices[faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return Filling(interior, volumes * (volume / volumes.sum()), enclosed=1.0)


def fill_cloud(cloud: GaussianCloud, spacing: float) -> Filling:
    """Fill a captured cloud with what `hoi.objects.solidity` finds solid, whatever the spacing.

    Args:
        cloud: the surface [m].
        spacing: edge of a cell [m].

    Raises:
        InputError: the spacing is too fine for memory.
    """
    solid = solid_of(cloud)
    size = solid.cell * np.array(solid.share.shape)
    lower, counts = _lattice(solid.lower, solid.lower + size, spacing)
    samples = max(2, math.ceil(spacing / solid.cell))
    fine = [low + spacing / samples * (np.arange(n * samples) + 0.5) for low, n in zip(lower, counts, strict=True)]
    shares = np.empty(counts)
    for row in range(counts[0]):  # a layer of cells after the other spares memory
        layer = fine[0][row * samples : (row + 1) * samples]
        within = solid.at(np.stack(np.meshgrid(layer, *fine[1:], indexing="ij"), -1))
        shares[row] = within.reshape(samples, counts[1], samples, counts[2], samples).mean((0, 2, 4))
    means = cloud.means.astype(np.float64)
    interior, volumes = _share(means, shares, lower, spacing, sheets=True)
    return Filling(interior, volumes * (solid.volume / volumes.sum()), enclosed=solid.enclosed)


def _lattice(lower: Array, upper: Array, spacing: float) -> tuple[Array, NDArray[np.int64]]:
    """Lowest corner (3,) and cell counts (3,) of a lattice centred on a box."""
    counts = np.maximum(1, np.ceil((upper - lower) / spacing - 1e-9))
    if counts.prod() > MAX_CELLS:
        raise InputError(
            f"spacing {spacing:g} m: {counts.prod():.2g} cells to fill the object; at most {MAX_CELLS}, take it coarser"
        )
    return (lower + upper - counts * spacing) / 2, counts.astype(np.int64)


def _share(points: Array, solid: Array, lower: Array, spacing: float, sheets: bool = False) -> tuple[Array, Array]:
    """Share the cells' volumes among points.

    Cells less than half solid, and the points in them, join the nearest cell that is more so: no particle is so light
    that the simulation would fling it away.

    Args:
        points: (N, 3) [m].
        solid: solid fraction of each cell (nx, ny, nz).
        sheets: whether a cell less than half solid that holds a point and touches none that is more so counts as one:
            what is thinner than a cell keeps its mass.

    Returns:
        Centres of the cells without a point (M, 3) and the volumes of the N points and of these [m^3], (N + M,).
    """
    main, thin = solid >= 0.5, (solid > 0) & (solid < 0.5)
    if sheets:
        places = ((points - lower) / spacing).astype(int)
        holding = np.zeros_like(main)
        holding[tuple(places[((places >= 0) & (places < solid.shape)).all(1)].T)] = True
        alone = thin & holding & ~np.asarray(ndimage.binary_dilation(main, np.ones((3, 3, 3))), bool)
        main, thin = main | alone, thin & ~alone
    if not main.any():
        raise InputError(f"spacing {spacing:g} m: coarser than the object is thick; take it finer")
    centres, thin_centres = (lower + spacing * (np.argwhere(cells) + 0.5) for cells in (main, thin))
    tree = KDTree(centres)
    cell_volumes = spacing**3 * solid[main]
    np.add.at(cell_volumes, tree.query(thin_centres)[1], spacing**3 * solid[thin])
    owner = tree.query(points)[1]
    occupants = np.bincount(owner, minlength=len(centres))
    empty = occupants == 0
    return centres[empty], np.concatenate([(cell_volumes / np.maximum(occupants, 1))[owner], cell_volumes[empty]])


def _inside_mesh(vertices: Array, faces: NDArray[np.integer], axes: Sequence[Array]) -> NDArray[np.bool_]:
    """Which points of the lattice x * y * z lie inside a closed mesh: winding number along +z, (nx, ny, nz)."""
    x, y, z = axes
    step = x[1] - x[0]
    x, y = x + 1.37e-5 * step, y + 2.91e-5 * step  # no column through an edge, where two triangles would both count
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    low, high = np.minimum.reduce([a, b, c]), np.maximum.reduce([a, b, c])
    i0, i1 = np.searchsorted(x, low[:, 0]), np.searchsorted(x, high[:, 0])
    j0, j1 = np.searchsorted(y, low[:, 1]), np.searchsorted(y, high[:, 1])
    columns = (i1 - i0) * (j1 - j0)
    face = np.repeat(np.arange(len(faces)), columns)
    within = np.arange(len(face)) - np.repeat(np.cumsum(columns) - columns, columns)
    i, j = i0[face] + within // (j1 - j0)[face], j0[face] + within % (j1 - j0)[face]

    a, ab, ac = a[face], (b - a)[face], (c - a)[face]
    px, py = x[i] - a[:, 0], y[j] - a[:, 1]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):  # upright triangles: never hit
        u = (px * ac[:, 1] - py * ac[:, 0]) / area
        v = (ab[:, 0] * py - ab[:, 1] * px) / area
        hit = (u >= 0) & (v >= 0) & (u + v <= 1)
    height = a[hit, 2] + u[hit] * ab[hit, 2] + v[hit] * ac[hit, 2]
    winding = np.zeros((len(x), len(y), len(z) + 1), np.int32)
    np.add.at(winding, (i[hit], j[hit], np.searchsorted(z, height)), np.where(area[hit] < 0, 1, -1))
    return winding.cumsum(2)[:, :, :-1] > 0
