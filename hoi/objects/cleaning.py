"""What a captured cloud needs before it can be simulated: no haze, no floaters, no giants, not too many.

Each function returns the cloud and one line on what it did, or none. Lengths are judged relative to the cloud itself,
in whatever units the file has.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import select

MIN_OPACITY = 0.05
"""Fainter Gaussians are haze; they would be simulated as if they were matter."""
_NEIGHBOURS = 8
_FAR = 6.0  # times the median distance to the neighbours
_VOXELS = 40  # across the cloud, to find loose pieces
_PIECE = 0.05  # share of the largest piece below which another is a floater
_MAX_SCALE = 0.04  # of the extent


def clean(cloud: GaussianCloud) -> tuple[GaussianCloud, list[str]]:
    """Remove haze and floaters, clamp giants.

    Raises:
        InputError: nothing solid is left.
    """
    notes: list[str] = []
    visible = cloud.opacities >= MIN_OPACITY
    if not visible.all():
        notes.append(f"removed {np.count_nonzero(~visible)} Gaussians fainter than {MIN_OPACITY:g}")
    cloud = _keep(cloud, visible)
    near = _near_others(cloud.means.astype(np.float64))
    cloud_near = _keep(cloud, near)
    attached = _in_large_pieces(cloud_near.means.astype(np.float64))
    floaters = len(cloud) - np.count_nonzero(attached)
    if floaters:
        notes.append(f"removed {floaters} floating Gaussians")
    cloud = _keep(cloud_near, attached)
    limit = _MAX_SCALE * np.ptp(cloud.means, axis=0).max()
    giants = np.count_nonzero(cloud.scales.max(1) > limit)
    if giants:
        notes.append(f"shrank {giants} Gaussians wider than {_MAX_SCALE:.0%} of the object")
        scales = np.minimum(cloud.scales, limit)
        cloud = replace(cloud, scales=scales)
    return cloud, notes


def thin(cloud: GaussianCloud, count: int, seed: int = 0) -> tuple[GaussianCloud, list[str]]:
    """At most `count` Gaussians, drawn without replacement with odds of their opacity, widened to cover as much."""
    if len(cloud) <= count:
        return cloud, []
    odds = cloud.opacities.astype(np.float64) / cloud.opacities.sum(dtype=np.float64)
    rows = np.sort(np.random.default_rng(seed).choice(len(cloud), count, replace=False, p=odds))
    widening = np.sqrt(len(cloud) / count)
    kept = select(cloud, rows)
    scales = (kept.scales * widening).astype(np.float32)
    note = f"thinned {len(cloud)} Gaussians to {count} by opacity, widened {widening:.2f} times"
    return replace(kept, scales=scales), [note]


def _keep(cloud: GaussianCloud, mask: NDArray[np.bool_]) -> GaussianCloud:
    if np.count_nonzero(mask) < 2:
        raise InputError("no solid object is left in the cloud once haze and floaters are removed; is it one object?")
    return select(cloud, mask)


def _near_others(means: Array) -> NDArray[np.bool_]:
    """Not far from its nearest neighbours, compared with the other Gaussians."""
    if len(means) <= _NEIGHBOURS:
        return np.ones(len(means), bool)
    distance = KDTree(means).query(means, _NEIGHBOURS + 1)[0][:, 1:].mean(1)
    return distance <= _FAR * max(float(np.median(distance)), 1e-12)


def _in_large_pieces(means: Array) -> NDArray[np.bool_]:
    """In a connected piece that is not small beside the largest."""
    lower, upper = np.percentile(means, (1, 99), axis=0)
    edge = max(float((upper - lower).max()) / _VOXELS, 1e-12)
    cells = np.clip((means - lower) / edge, -_VOXELS, 2 * _VOXELS).astype(int) + _VOXELS + 1
    occupied = np.zeros(np.full(3, 3 * _VOXELS + 3), bool)
    occupied[tuple(cells.T)] = True
    pieces = np.zeros(occupied.shape, np.int32)
    ndimage.label(occupied, np.ones((3, 3, 3)), output=pieces)
    piece = pieces[tuple(cells.T)]
    counts = np.bincount(piece)
    return counts[piece] >= _PIECE * counts.max()
