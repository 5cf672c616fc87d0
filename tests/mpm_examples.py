"""One material of each constitutive model, and deformations to try them on."""

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.data import Material

_EXTRA = {
    "fixed_corotated": {},
    "neo_hookean": {},
    "von_mises": {"yield_stress": 3e3, "hardening": 0.1},
    "viscoplastic": {"yield_stress": 3e3, "viscosity": 30.0},
    "drucker_prager": {"friction_angle": 0.6},
    "snow": {"hardening": 10.0, "critical_compression": 0.025, "critical_stretch": 0.0075},
    "fluid": {"viscosity": 20.0},
}
EXAMPLES = {model: Material(model, model, 1e5, 0.3, 1000.0, 0.5, 0.5, **extra) for model, extra in _EXTRA.items()}
"""E = 1e5 Pa, nu = 0.3, rho = 1000 kg/m^3."""


def rotations(count: int, seed: int = 0) -> np.ndarray:
    """(count, 3, 3)."""
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()


def deformations(count: int, strain: float, seed: int = 0) -> np.ndarray:
    """Turned and strained, (count, 3, 3): det F > 0.05, singular values around 1 +- `strain`."""
    rng = np.random.default_rng(seed)
    f = rotations(20 * count, seed) @ (np.eye(3) + strain * rng.normal(size=(20 * count, 3, 3)))
    return f[np.linalg.det(f) > 0.05][:count]


def stretched(stretches: list[list[float]], seed: int = 0) -> np.ndarray:
    """U diag(stretches) V^T with random rotations U and V."""
    u, v = rotations(len(stretches), seed), rotations(len(stretches), seed + 1)
    return (u * np.array(stretches)[:, None]) @ v
