"""Tensors in NumPy: what the laws have in common there. F is (..., 3, 3).

A trial F with det F <= 0, or 1e-6, is beyond every stress. A solid that flows takes it as crushed flat: its singular
values are raised to 0.1. An elastic solid cannot, and its simulation has diverged.
"""

import numpy as np

from hoi.data import Array

CRUSHED_VOLUME = 1e-6
"""det F at and below which a solid that flows is taken as crushed flat or turned inside out [-]."""
LEAST_STRETCH = 0.1
"""Its singular values are raised to this [-]."""


def transposed(f: Array) -> Array:
    """F^T."""
    return np.swapaxes(f, -1, -2)


def rotation_of(deformation_gradient: Array) -> Array:
    """R of the polar decomposition F = R S, shape (..., 3, 3); det R = 1 also where F is inverted."""
    u, _, vt = signed_svd(deformation_gradient)
    return u @ vt


def signed_svd(f: Array) -> tuple[Array, Array, Array]:
    """U, sigma, V^T with rotations U and V; the last and smallest singular value has the sign of det F."""
    u, sigma, vt = np.linalg.svd(f)
    last = [1.0, 1.0, -1.0]
    mirrored_u, mirrored_v = np.linalg.det(u) < 0, np.linalg.det(vt) < 0
    u = np.where(mirrored_u[..., None, None], u * last, u)
    vt = np.where(mirrored_v[..., None, None], vt * np.reshape(last, (3, 1)), vt)
    return u, np.where((mirrored_u != mirrored_v)[..., None], sigma * last, sigma), vt


def uncrushed_svd(f: Array) -> tuple[Array, Array, Array]:
    """The same, sigma raised to LEAST_STRETCH where F is crushed."""
    u, sigma, vt = signed_svd(f)
    crushed = sigma.prod(-1, keepdims=True) <= CRUSHED_VOLUME
    return u, np.where(crushed, np.maximum(sigma, LEAST_STRETCH), sigma), vt


def composed(u: Array, sigma: Array, vt: Array) -> Array:
    """U diag(sigma) V^T."""
    return (u * sigma[..., None, :]) @ vt


def scaled(scalars: Array) -> Array:
    """scalars (...) times I."""
    return np.asarray(scalars)[..., None, None] * np.eye(3)
