"""Points and line segments."""

import numpy as np

from hoi.data import Array


def segment_distances(points: Array, starts: Array, ends: Array) -> Array:
    """Distances [m], (N, C), of points (N, 3) to the segments from `starts` to `ends`, (C, 3)."""
    axes = ends - starts
    length_squared = np.maximum((axes**2).sum(axis=1), 1e-18)
    from_starts = points[:, None] - starts
    share = ((from_starts * axes).sum(axis=2) / length_squared).clip(0, 1)
    return np.linalg.norm(from_starts - share[..., None] * axes, axis=2)
