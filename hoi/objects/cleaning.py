"""What a captured cloud needs before it can be simulated: no padding, no haze, no floaters, no background, no giants.

A Gaussian is judged by its own size and by the spacing around it, and counts by the area that it shows, so that a few
large Gaussians of a plain face weigh as much as the thousands of a detailed one. Lengths are relative to the cloud
itself, in whatever units the file has. Each function returns the cloud and one line on each thing that it did.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import areas, rotation_matrices, select

MIN_OPACITY = 0.05
"""Fainter Gaussians are haze; they would be simulated as if they were matter."""
SOLID = 0.3
"""Fainter ones than this hold nothing together: they belong to what solid Gaussians they touch."""
FAINTER = 0.7
"""In a thing that is see-through all over, those fainter than this share of its usual opacity."""
PADDING = 8
"""So many Gaussians that are alike in everything are padding; fewer are clones, of which one stays with the opacity of
all."""
REACH = 2.0
"""Standard deviations, along the line between two Gaussians, within which they touch."""
GRASP = 0.05
"""A faint Gaussian belongs to nothing that is farther than this share of the extent."""
NEIGHBOURS = 6
FAR = 3.0
"""Gaussians too small to touch any other join up to this many times the lesser spacing of the two, and of the cloud."""
PIECE = 0.01
"""Share of the main piece's area from which another piece belongs to the object..."""
NEAR, FEW = 1.5, 20
"""...if it is no farther from it than this many of its extents, and so many Gaussians or more."""
SEAM, CRUMB = 0.02, 1e-3
"""A piece as close as this share of the extent belongs to it already with this share of the area."""
SURROUNDING = 2.5
"""What has another piece inside and is this many times as wide, without touching it, is that one's background."""
MAX_SCALE = 0.25
"""Of the extent; wider standard deviations are cut to it."""
_OUTLINE = 20_000  # points of a piece that tell how far another is
_BLOCK = 1 << 19  # pairs looked at in one go
_COARSE = 4.0  # sizes of the median one from which Gaussians also look for neighbours of their own kind
_FAINT_PIECE = 0.1  # share of the most numerous piece from which one inside another counts


def clean(cloud: GaussianCloud) -> tuple[GaussianCloud, list[str]]:
    """Remove padding, haze, floaters and background, cut giants to size.

    Raises:
        InputError: nothing solid is left, or all Gaussians are in one place.
    """
    cloud, notes = without_duplicates(cloud)
    total = areas(cloud).sum()
    visible = cloud.opacities >= MIN_OPACITY
    if not visible.all():
        share = areas(cloud)[~visible].sum() / max(total, 1e-300)
        notes.append(
            f"removed {np.count_nonzero(~visible)} Gaussians fainter than {MIN_OPACITY:g}, {share:.1%} of the area"
        )
    cloud = _keep(cloud, visible)
    if not np.ptp(cloud.means, axis=0).any():
        raise InputError(f"all {len(cloud)} visible Gaussians are in one place; an object has an extent")
    attached = _of_the_object(cloud)
    if not attached.all():
        gone = areas(cloud)[~attached].sum() / areas(cloud).sum()
        notes.append(f"removed {np.count_nonzero(~attached)} floating Gaussians, {gone:.1%} of the area")
    cloud = _keep(cloud, attached)
    limit = MAX_SCALE * np.ptp(cloud.means, axis=0).max()
    giants = np.count_nonzero(cloud.scales.max(1) > limit)
    if giants:
        notes.append(f"shrank {giants} Gaussians wider than {MAX_SCALE:.0%} of the object")
        cloud = replace(cloud, scales=np.minimum(cloud.scales, np.float32(limit)))
    return cloud, notes


def without_duplicates(cloud: GaussianCloud) -> tuple[GaussianCloud, list[str]]:
    """Drop padding, and one of each group of clones is left.

    Raises:
        InputError: there is nothing else.
    """
    columns = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities[:, None], cloud.sh.reshape(len(cloud), -1))
    mark = np.zeros(len(cloud), np.uint64)  # rows alike have the same; unlike ones all but surely (64 bits) do not
    for column in np.concatenate([column.T for column in columns]):
        mark = (mark ^ (column + np.float32(0)).view(np.uint32)) * np.uint64(0x9E3779B97F4A7C15)  # -0 is 0
        mark ^= mark >> np.uint64(29)
    _, first, group, counts = np.unique(mark, return_index=True, return_inverse=True, return_counts=True)
    if counts.max() == 1:
        return cloud, []
    padding, clones = counts >= PADDING, (counts > 1) & (counts < PADDING)
    notes = []
    if padding.any():
        notes.append(f"dropped {counts[padding].sum()} Gaussians that repeat {np.count_nonzero(padding)}: padding")
    if clones.any():
        notes.append(f"merged {counts[clones].sum()} Gaussians that are clones into {np.count_nonzero(clones)}")
    kept = np.sort(first[~padding])
    if len(kept) == 0:
        raise InputError(f"all {len(cloud)} Gaussians repeat {len(counts)}: padding, and no object")
    opacities = 1 - (1 - cloud.opacities[kept]) ** counts[group[kept]].astype(np.float32)
    return replace(select(cloud, kept), opacities=opacities.astype(np.float32)), notes


def _keep(cloud: GaussianCloud, mask: NDArray[np.bool_]) -> GaussianCloud:
    if np.count_nonzero(mask) < 2:
        raise InputError("no solid object is left in the cloud once haze and floaters are removed; is it one object?")
    return select(cloud, mask)


def _of_the_object(cloud: GaussianCloud) -> NDArray[np.bool_]:
    """Which Gaussians belong to the main piece or to those near it that have a body; the rest floats."""
    means, area = cloud.means.astype(np.float64), areas(cloud)
    solid = cloud.opacities >= min(SOLID, FAINTER * _shown_half(cloud.opacities, area))
    piece = _pieces(cloud, means, solid)
    count = int(piece.max()) + 1
    members, weights = np.bincount(piece[solid], minlength=count), np.bincount(piece, area, minlength=count)
    main = _main_piece(means, piece, members)
    inside = np.flatnonzero(piece == main)
    low, high = means[inside].min(0), means[inside].max(0)
    extent = (high - low).max()
    tree = KDTree(means[inside[:: -(-len(inside) // _OUTLINE)]])
    kept = np.zeros(count, bool)
    kept[main] = True
    for other in np.flatnonzero((weights >= CRUMB * weights[main]) & (members > 0) & ~kept):
        places = means[piece == other]
        gap = tree.query(places)[0].min()
        around = ((places.min(0) < (low + high) / 2) & (places.max(0) > (low + high) / 2)).all()
        if around and np.ptp(places, axis=0).max() > SURROUNDING * extent and gap > SEAM * extent:
            continue
        body = weights[other] >= PIECE * weights[main] and members[other] >= FEW
        kept[other] = gap <= (NEAR if body else SEAM) * extent
    return kept[piece]


def _shown_half(opacities: Array, area: Array) -> float:
    """The opacity that half of the area has at least; the largest count no more than a few of the usual size."""
    order = np.argsort(opacities)
    shown = np.cumsum(np.minimum(area, 4 * np.median(area))[order])
    return float(opacities[order[np.searchsorted(shown, shown[-1] / 2)]])


def _main_piece(means: Array, piece: NDArray[np.intp], members: NDArray[np.intp]) -> int:
    """The piece with the most solid Gaussians; what hangs free inside it, if it is far wider, is the object instead."""
    main = int(members.argmax())
    centre = (means[piece == main].min(0) + means[piece == main].max(0)) / 2
    half = np.ptp(means[piece == main], axis=0) / 2
    tree = KDTree(means[piece == main][:: -(-int(members[main]) // _OUTLINE)])
    for other in np.argsort(-members, kind="stable"):
        if other == main or members[other] < max(_FAINT_PIECE * members[main], NEIGHBOURS):
            continue
        low, high = means[piece == other].min(0), means[piece == other].max(0)
        within = (np.abs((low + high) / 2 - centre) < half / 2).all() and (
            (low > centre - half) & (high < centre + half)
        ).all()
        gap = tree.query(means[piece == other])[0].min()
        if within.all() and 2 * half.max() > SURROUNDING * (high - low).max() and gap > (high - low).max() / 4:
            return int(other)
    return main


def _pieces(cloud: GaussianCloud, means: Array, solid: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Connected piece of each Gaussian, (N,). Two touch where their bodies do; those that touch no other are a
    lattice of points, and touch where they are as close as the rest of it. Faint ones touch the nearest solid one."""
    axes = rotation_matrices(cloud)
    sizes = cloud.scales.astype(np.float64)
    rows = np.flatnonzero(solid)
    spacing = np.zeros(len(means))
    pairs, near = _neighbours(means, rows)
    spacing[rows] = near
    typical = float(np.median(near))
    mean_size = sizes.max(1)
    coarse = rows[mean_size[rows] > _COARSE * np.median(mean_size[rows])]
    more, _ = _neighbours(means, coarse)
    haze = np.flatnonzero(~solid)
    if len(haze) and len(rows):
        width = np.subtract(*np.percentile(means[rows], (95, 5), axis=0)).max()
        apart, nearest = KDTree(means[rows]).query(means[haze], distance_upper_bound=GRASP * width, workers=-1)
        more = np.concatenate([more, np.column_stack([haze, rows[nearest % len(rows)]])[np.isfinite(apart)]])
    pairs = np.concatenate([pairs, more])
    apart, touching = np.zeros(len(pairs)), np.zeros(len(pairs), bool)
    for start in range(0, len(pairs), _BLOCK):
        block = slice(start, start + _BLOCK)
        first, second = pairs[block].T
        way = means[second] - means[first]
        apart[block] = np.linalg.norm(way, axis=1)
        way /= np.maximum(apart[block], 1e-300)[:, None]
        touching[block] = apart[block] <= sum(_reach(axes, sizes, row, way) for row in (first, second))
    first, second = pairs.T
    loose = solid.copy()
    loose[pairs[touching & solid[first] & solid[second]]] = False
    if loose.sum() > solid.sum() / 2:  # a cloud of points
        loose = solid
    lattice = FAR * np.minimum(np.minimum(spacing[first], spacing[second]), typical)
    touching |= (apart <= lattice) & loose[first] & loose[second]
    edges = coo_array((np.ones(np.count_nonzero(touching), bool), pairs[touching].T), shape=(len(means),) * 2)
    return connected_components(edges, directed=False)[1]


def _neighbours(means: Array, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array]:
    """Pairs (K, 2) of each of `rows` with those nearest to it among them, and its mean distance to them (n,)."""
    count = min(NEIGHBOURS, len(rows) - 1)
    if count < 1:
        return np.zeros((0, 2), np.intp), np.zeros(len(rows))
    apart, found = map(np.asarray, KDTree(means[rows]).query(means[rows], count + 1, workers=-1))
    return np.column_stack([np.repeat(rows, count), rows[found[:, 1:]].reshape(-1)]), apart[:, 1:].mean(1)


def _reach(axes: Array, sizes: Array, rows: NDArray[np.intp], direction: Array) -> Array:
    """How far the bodies of `rows` reach along unit vectors (K, 3): `REACH` standard deviations, (K,)."""
    along = np.einsum("kji,kj->ki", axes[rows], direction)
    return REACH * np.sqrt(((along * sizes[rows]) ** 2).sum(1))
