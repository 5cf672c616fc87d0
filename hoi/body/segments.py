"""Points and line segments."""

import numpy as np

from hoi.data import Array


def segment_distances(points: Array, starts: Array, ends: Array) -> Array:
    """Distances [m], (N, C), of points (N, 3) to the segments from `starts` to `ends`, (C, 3)."""
    _, away = nearest_on_segment(points[:, None], starts, ends)
    return np.linalg.norm(away, axis=2)


def nearest_on_segment(points: Array, starts: Array, ends: Array) -> tuple[Array, Array]:
    """Where on segments the points nearest to `points` lie, from 0 to 1, (...), and the ways from there, (..., 3)."""
    axes, from_starts = ends - starts, points - starts
    length_squared = np.maximum((axes**2).sum(axis=-1), 1e-18)
    share = ((from_starts * axes).sum(axis=-1) / length_squared).clip(0, 1)
    return share, from_starts - share[..., None] * axes
