"""Gaussians that are drawn and not simulated: carried by the particles nearest to them at rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hoi.data import Array, SceneObject

NEIGHBOURS = 4


@dataclass(frozen=True)
class Carried:
    """x(t) = sum_k w_k (x_k(t) + F_k(t) a_k), F(t) = sum_k w_k F_k(t): exact where F is the same all over."""

    rows: NDArray[np.intp]
    """The particles that carry each Gaussian, (N, K)."""
    weights: Array
    """w, of sum 1, (N, K)."""
    arms: Array
    """a: from each of them to the Gaussian at rest [m], (N, K, 3)."""

    def moved(self, positions: Array, gradients: Array | None) -> tuple[Array, Array | None]:
        """Means (N, 3) [m] and F (N, 3, 3) for the particles' (P, 3) and (P, 3, 3); without F they are only shifted."""
        means = np.einsum("nk,nkd->nd", self.weights, positions[self.rows])
        if gradients is None:
            return means + np.einsum("nk,nkd->nd", self.weights, self.arms), None
        about = gradients[self.rows]
        means += np.einsum("nk,nkij,nkj->ni", self.weights, about, self.arms, optimize=True)
        return means, np.einsum("nk,nkij->nij", self.weights, about)


def carried_by(thing: SceneObject) -> Carried | None:
    """How the drawn Gaussians hang on the particles of the surface; None where those are drawn themselves."""
    if thing.drawn is None:
        return None
    surface = thing.particles[: len(thing.cloud)].astype(np.float64)
    count = min(NEIGHBOURS, len(surface))
    found = KDTree(surface).query(thing.drawn.means, count, workers=-1)
    apart, rows = (np.asarray(each).reshape(len(thing.drawn), count) for each in found)
    width = np.maximum(apart[:, [-1]], 1e-12) / 2
    weights = np.exp((apart[:, :1] ** 2 - apart**2) / (2 * width**2))
    weights /= weights.sum(1, keepdims=True)
    arms = thing.drawn.means[:, None].astype(np.float64) - surface[rows]
    return Carried(rows, weights.astype(np.float32), arms.astype(np.float32))
