"""Fewer Gaussians that look like all of them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud
from hoi.gaussians import areas, colours, covariances, select

AROUND = 4
"""Neighbours whose mean distance is the local gap."""
COLOUR = 1.5
"""A difference of 1 in colour separates two Gaussians like this many gaps."""
SPREAD = 3.0
"""Times the variance of a group's means: an even patch of variance d^2 / 12 becomes one Gaussian of about d / 2, which
blends with its neighbours at distance d."""
OPAQUE = 0.99


def thin(cloud: GaussianCloud, count: int, seed: int = 0) -> tuple[GaussianCloud, list[str]]:
    """At most `count` Gaussians, and a line on it.

    As many are drawn, evenly over what is seen (opacity times area), and every other joins the one that is nearest in
    place and colour: mean, covariance and colour are those of the group, its opacity what keeps the shown area. No long
    axis grows beyond the gap to the neighbours that are left.
    """
    if len(cloud) <= count:
        return cloud, []
    means, weights, sigma = cloud.means.astype(np.float64), np.maximum(areas(cloud), 1e-300), covariances(cloud)
    drawn = _drawn(means, weights, count, seed)
    unit = COLOUR * np.median(_gap(means[drawn]))
    places = np.concatenate([means, unit * np.clip(colours(cloud), 0, 1)], 1)
    group = KDTree(places[drawn]).query(places, workers=-1)[1]

    def mean(values: Array) -> Array:
        columns = values.reshape(len(means), -1).T
        summed = np.stack([np.bincount(group, weights * column, len(drawn)) for column in columns], 1)
        return (summed / total[:, None]).reshape(len(drawn), *values.shape[1:])

    total = np.bincount(group, weights, len(drawn))
    centres = mean(means)
    away = means - centres[group]
    merged = mean(sigma + SPREAD * away[:, :, None] * away[:, None, :])
    variances, axes = np.linalg.eigh(merged)
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    longest = np.zeros(len(drawn))
    np.maximum.at(longest, group, cloud.scales.max(1))
    scales = np.minimum(np.sqrt(np.maximum(variances, 0)), np.maximum(longest, _gap(centres))[:, None])
    shown = total / np.maximum(np.pi * scales[:, 1] * scales[:, 2], 1e-300)
    single = np.bincount(group, minlength=len(drawn)) == 1
    opacities = np.where(single, cloud.opacities[drawn], np.minimum(shown, OPAQUE))
    thinned = GaussianCloud(
        means=centres.astype(np.float32),
        quaternions=Rotation.from_matrix(axes).as_quat(scalar_first=True).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=opacities.astype(np.float32),
        sh=mean(cloud.sh).astype(np.float32),
    )
    return thinned, [f"thinned {len(cloud)} Gaussians to {len(drawn)} by what is seen of them"]


def sample(cloud: GaussianCloud, count: int, seed: int = 0) -> tuple[GaussianCloud, list[str]]:
    """At most `count` of Gaussians that are all alike, as those of the built-in objects are: drawn, and all widened."""
    if len(cloud) <= count:
        return cloud, []
    odds = cloud.opacities.astype(np.float64) / cloud.opacities.sum(dtype=np.float64)
    rows = np.sort(np.random.default_rng(seed).choice(len(cloud), count, replace=False, p=odds))
    widening = np.sqrt(len(cloud) / count)
    kept = select(cloud, rows)
    note = f"thinned {len(cloud)} Gaussians to {count}, widened {widening:.2f} times"
    return replace(kept, scales=(kept.scales * widening).astype(np.float32)), [note]


def _drawn(means: Array, weights: Array, count: int, seed: int) -> NDArray[np.intp]:
    """Rows in equal steps of weight along a curve that fills space (Morton order), so that they lie evenly; what
    weighs more than a step is drawn once."""
    order = np.argsort(_morton(means), kind="stable")
    inclusion = np.minimum(1.0, weights[order] * _factor(weights, count))
    steps = np.cumsum(inclusion) + np.random.default_rng(seed).uniform()
    taken = np.floor(steps) > np.floor(np.concatenate([[steps[0] - inclusion[0]], steps[:-1]]))
    return np.sort(order[taken])[:count]


def even(means: Array, count: int, seed: int = 0) -> NDArray[np.intp]:
    """At most `count` rows of points (N, 3), evenly spread."""
    return np.arange(len(means)) if len(means) <= count else _drawn(means, np.ones(len(means)), count, seed)


def _factor(weights: Array, count: int) -> float:
    """f with sum(min(1, f w)) = count."""
    falling = np.sort(weights)[::-1]
    rest = np.cumsum(falling[::-1])[::-1]
    factors = (count - np.arange(count)) / rest[:count]
    return float(factors[np.argmax(factors * falling[:count] <= 1)])


def _morton(means: Array) -> NDArray[np.uint64]:
    low, extent = means.min(0), np.ptp(means, axis=0).max()
    bits = np.floor((means - low) / max(extent, 1e-300) * (2**20 - 1)).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for bit in range(20):
        for axis in range(3):
            code |= ((bits[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


def _gap(means: Array) -> Array:
    count = min(AROUND, len(means) - 1)
    if count < 1:
        return np.zeros(len(means))
    return KDTree(means).query(means, count + 1, workers=-1)[0][:, 1:].mean(1)
