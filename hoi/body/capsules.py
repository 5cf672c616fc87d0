"""Capsules that stand for parts of a body: fitted to the Gaussians of each joint once, then carried by the joint."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.optimize import least_squares

from hoi.body.segments import nearest_on_segment, segment_distances
from hoi.data import Array, Body

TOLERANCE = 0.015
"""How far a Gaussian may lie from the capsules' surface to count as covered [m]."""
COVERAGE = 0.9
"""A joint is given one more capsule while less than this share of its Gaussians is covered."""
MOST = 3
"""Capsules a joint."""
NOISE = 0.005
"""Residual beyond which a Gaussian pulls on the fit no more than linearly [m]."""
LOSS = {"loss": "soft_l1", "f_scale": NOISE, "max_nfev": 60}
"""Of the fit, and how long it may take."""
ROUNDS = 5
"""Of sharing the Gaussians out to several capsules and fitting those again."""
FEWEST = 12
"""Gaussians a capsule is fitted to."""
ENOUGH = 400
"""Gaussians of a joint that the fit looks at."""


@dataclass(frozen=True)
class Capsules:
    """C capsules in the body's rest frame (T-pose), each bound to one joint."""

    joints: NDArray[np.intp]
    """(C,)."""
    starts: Array
    """One end of each axis [m], shape (C, 3)."""
    ends: Array
    """The other end [m], shape (C, 3)."""
    radii: Array
    """[m], shape (C,)."""


def surface_distance(points: Array, starts: Array, ends: Array, radii: Array) -> Array:
    """Signed distances [m], (N,), of points (N, 3) to the surface of a union of capsules; negative inside."""
    return (segment_distances(points, starts, ends) - radii).min(axis=1)


def fit_capsule(points: Array) -> tuple[Array, Array, float]:
    """The capsule whose surface passes nearest to most of `points`.

    Least squares of the distances to the surface under a soft L1 loss, so that a few far points hardly count, from
    each of the three principal axes. A patch of surface alone would ask for a huge capsule, so that the axis stays
    within the points' principal box and the radius within its thinnest half (5th to 95th percentile).

    Args:
        points: (N, 3) [m], of a surface.

    Returns:
        start (3,), end (3,) and radius of the capsule [m].
    """
    centre = np.median(points, axis=0)
    _, axes = np.linalg.eigh(np.cov((points - centre).T))
    local = (points - centre) @ axes
    low, high = np.percentile(local, (5, 95), axis=0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-3)
    thickest = half.min()
    bounds = np.concatenate([low, low, [0.0]]) - 1e-6, np.concatenate([high, high, [1.1 * thickest]]) + 1e-6

    def residuals(p: Array) -> Array:
        return segment_distances(local, p[None, :3], p[None, 3:6])[:, 0] - p[6]

    def slopes(p: Array) -> Array:
        share, away = nearest_on_segment(local, p[:3], p[3:6])
        out = away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None]
        return np.hstack([(share - 1)[:, None] * out, -share[:, None] * out, np.full((len(local), 1), -1.0)])

    fits = []
    for axis, extent in enumerate(half):
        reach = np.zeros(3)
        reach[axis] = max(extent - thickest, 0.1 * extent)
        first = np.concatenate([middle - reach, middle + reach, [thickest]])
        fits.append(least_squares(residuals, first, jac=slopes, bounds=bounds, **LOSS))  # pyright: ignore
    best = min(fits, key=lambda fit: fit.cost).x
    return axes @ best[:3] + centre, axes @ best[3:6] + centre, float(best[6])


def fit_union(points: Array) -> tuple[Array, Array, Array]:
    """As few capsules as cover a surface, at most `MOST`, else those that cover the most of it.

    Several share the points by k-means first, are fitted, and share them anew by the nearest surface, in turns.

    Args:
        points: (N, 3) [m], N at least `FEWEST`.

    Returns:
        starts (C, 3), ends (C, 3) and radii (C,) [m].
    """
    best, best_coverage = None, -1.0
    for count in range(1, MOST + 1):
        owner = kmeans2(points, _spread(points, count), minit="matrix")[1]
        for _ in range(ROUNDS if count > 1 else 1):
            shares = [points[owner == i] for i in range(count)]
            fits = [fit_capsule(share) for share in shares if len(share) >= FEWEST]
            if not fits:
                break
            starts, ends, radii = (np.array(part) for part in zip(*fits, strict=True))
            owner = np.abs(segment_distances(points, starts, ends) - radii).argmin(axis=1)
            covered = float((np.abs(surface_distance(points, starts, ends, radii)) <= TOLERANCE).mean())
            if covered > best_coverage:
                best, best_coverage = (starts, ends, radii), covered
        if best_coverage >= COVERAGE:
            break
    assert best is not None
    return best


def _spread(points: Array, count: int) -> Array:
    """`count` of the points, each the farthest from those before it, the first from the middle: (count, 3)."""
    chosen = np.empty((0, 3))
    apart = np.linalg.norm(points - points.mean(axis=0), axis=1)
    for _ in range(count):
        chosen = np.vstack([chosen, points[apart.argmax()]])
        apart = np.linalg.norm(points[:, None] - chosen, axis=2).min(axis=1)
    return chosen


def fit_capsules(body: Body, joints: Iterable[int]) -> Capsules:
    """Capsules for the Gaussians of each of `joints`: i belongs to argmax_k w_ik. Joints with hardly any get none."""
    owners, fits = [], []
    for joint in joints:
        points = np.asarray(body.cloud.means[body.dominant_joints == joint], np.float64)
        if len(points) < FEWEST:
            continue
        fits.append(fit_union(points[:: max(len(points) // ENOUGH, 1)]))
        owners += [joint] * len(fits[-1][2])
    if not fits:
        return Capsules(np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return Capsules(np.array(owners, np.intp), *(np.concatenate(part) for part in zip(*fits, strict=True)))


def carry(capsules: Capsules, rest_joints: Array, rotations: Array, positions: Array) -> tuple[Array, Array]:
    """Starts and ends in the world [m], (F, C, 3): x = R_k (x_rest - J_k) + p_k with each capsule's joint k.

    Args:
        rest_joints: J_k [m], (24, 3).
        rotations: R_k, (F, 24, 3, 3). positions: p_k [m], (F, 24, 3); see `hoi.body.skinning.joint_frames`.
    """
    joint = capsules.joints

    def world(points: Array) -> Array:
        return np.einsum("fcij,cj->fci", rotations[:, joint], points - rest_joints[joint]) + positions[:, joint]

    return world(capsules.starts), world(capsules.ends)
