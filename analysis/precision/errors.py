"""How far one motion is from another, how fast an error falls, and what is worth its time. NumPy alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from hoi.data import Array

NEIGHBOURS = 20
"""Particles that a probe is interpolated from: the shell of 8 nearest and then some, so that the fit is never flat."""


@dataclass(frozen=True)
class Errors:
    """Relative L2 norms over the K times: sqrt(mean_k e_k^2)."""

    com: float
    """Distance of the centres of mass, in sizes of the object [-]."""
    orientation: float
    """Angle of the best-fit rotation from one to the other [rad]."""
    shape: float
    """RMS over the points once the best-fit rigid motion is taken out, in sizes [-]."""
    position: float
    """RMS over the points of all of it, in sizes [-]."""


def compare(points: Array, truth: Array, com: Array, com_truth: Array, size: float) -> Errors:
    """Errors of `points` against `truth`, the same M material points at the same K times.

    Args:
        points, truth: [m], shape (K, M, 3).
        com, com_truth: the bodies' centres of mass [m], shape (K, 3).
        size: largest extent of the object [m].
    """
    centred, centred_truth = (p - p.mean(axis=1, keepdims=True) for p in (points, truth))
    rotation = best_rotation(centred_truth, centred)
    rest = centred - centred_truth @ np.swapaxes(rotation, -1, -2)
    return Errors(
        com=_rms(np.linalg.norm(com - com_truth, axis=1)) / size,
        orientation=_rms(rotation_angle(rotation)),
        shape=_rms(np.linalg.norm(rest, axis=2)) / size,
        position=_rms(np.linalg.norm(points - truth, axis=2)) / size,
    )


def best_rotation(centred: Array, onto: Array) -> Array:
    """R (..., 3, 3) that minimises sum |R a_m - b_m|^2 over centred points a, b (..., M, 3) (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(np.swapaxes(onto, -1, -2) @ centred)
    flip = np.ones(u.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    return (u * flip[..., None, :]) @ vt


def rotation_angle(rotation: Array) -> Array:
    """Angle [rad] of rotations (..., 3, 3), exact to round-off also where it is tiny."""
    skew = rotation - np.swapaxes(rotation, -1, -2)
    sine = np.linalg.norm(np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1), axis=-1)
    return np.arctan2(sine, np.trace(rotation, axis1=-2, axis2=-1) - 1)


def probe_weights(particles: Array, probes: Array) -> csr_array:
    """Sparse weights W (M, P) with W @ particles = probes, and so for any affine motion; second order for others.

    Of all affine-exact weights of the nearest particles, those of moving least squares with a Gaussian of their reach.
    """
    distance, near = KDTree(particles).query(probes, min(NEIGHBOURS, len(particles)))
    reach = distance[:, -1:] / 2
    bell = np.exp(-((distance / reach) ** 2))
    basis = np.concatenate([np.ones((*near.shape, 1)), (particles[near] - probes[:, None]) / reach[..., None]], axis=2)
    moment = np.einsum("mn,mni,mnj->mij", bell, basis, basis)
    at_probe = np.linalg.solve(moment, np.eye(4)[:1].T)[..., 0]  # the basis at the probe is (1, 0, 0, 0)
    weights = bell * np.einsum("mni,mi->mn", basis, at_probe)
    rows = np.repeat(np.arange(len(probes)), weights.shape[1])
    return csr_array((weights.ravel(), (rows, np.ravel(near))), shape=(len(probes), len(particles)))


def observed_order(steps: Sequence[float] | Array, errors: Sequence[float] | Array) -> float:
    """Exponent p of error = C step^p by least squares in the logarithms; nan where an error is not positive."""
    steps, errors = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    if len(steps) < 2 or not (np.isfinite(errors).all() and (errors > 0).all()):
        return float("nan")
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def pareto_front(
    seconds: Sequence[float] | Array, errors: Sequence[float] | Array, gain: float = 0.0
) -> NDArray[np.bool_]:
    """Which of N runs no other beats in both time and error, shape (N,); a nan is never on the front.

    Args:
        gain: share by which the error of a slower run must be below that of the faster ones on the front.
    """
    seconds, errors = np.asarray(seconds, dtype=float), np.asarray(errors, dtype=float)
    front = np.zeros(len(seconds), dtype=bool)
    least = np.inf
    for index in np.lexsort((errors, seconds)):
        if errors[index] < (1 - gain) * least and np.isfinite(seconds[index]):
            front[index], least = True, errors[index]
    return front


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
