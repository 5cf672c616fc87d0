"""Small bodies for the tests of the MPM."""

import numpy as np

from hoi.data import Material, ObjectState
from hoi.mpm.state import initial_state

RUBBER = Material("rubber", "fixed_corotated", 1e5, 0.3, 1000.0, 0.6, 0.4)
DX = 0.05


def block(size: tuple[float, float, float], spacing: float, lowest: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions (P, 3) of a regular block whose bottom is at z = `lowest`, and volumes (P,)."""
    axes = [(np.arange(round(s / spacing)) + 0.5) * spacing for s in size]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    x[:, 2] += lowest
    return x, np.full(len(x), spacing**3)


def shaken(material: Material = RUBBER, count: int = 150) -> tuple[ObjectState, np.ndarray]:
    """A random cloud near the ground with random velocities, spin and strain, and its volumes."""
    rng = np.random.default_rng(0)
    x, volumes = rng.random((count, 3)) * 0.2, 2e-5 + 2e-5 * rng.random(count)
    state = initial_state(x, volumes * material.density, [1, 0.3, -1], [3, 10, -5])
    return ObjectState(
        state.positions,
        state.velocities + 0.1 * rng.normal(size=(count, 3)),
        state.affine + rng.normal(size=(count, 3, 3)),
        state.deformation_gradient + 0.1 * rng.normal(size=(count, 3, 3)),
    ), volumes
