"""The Taichi kernels against the NumPy reference, and bit against bit."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, shaken

from hoi.data import ObjectState
from hoi.mpm import reference
from hoi.mpm.materials import MODELS
from hoi.mpm.solver import simulate

FIELDS = ("positions", "velocities", "affine", "deformation_gradient")
GRAVITY = (0.0, 0.3, -9.81)


def difference(a: ObjectState, b: ObjectState) -> float:
    """Largest difference of any array, relative to its largest entry."""
    return max(np.abs(getattr(a, n) - getattr(b, n)).max() / np.abs(getattr(b, n)).max() for n in FIELDS)


def same_bits(a: ObjectState, b: ObjectState) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in FIELDS)


def test_weights_are_a_partition_of_unity() -> None:
    """sum_i w_ip = 1, sum_i w_ip (x_i - x_p) = 0, sum_i w_ip (x_i - x_p)(x_i - x_p)^T = dx^2/4 I."""
    x = np.random.default_rng(0).normal(size=(50, 3))
    _, w, offset = reference.stencil(x, DX)
    np.testing.assert_allclose(w.sum(axis=1), 1, atol=1e-14)
    assert w.min() >= 0
    np.testing.assert_allclose(np.einsum("pn,pni->pi", w, offset), 0, atol=1e-15)
    second = np.einsum("pn,pni,pnj->pij", w, offset, offset)
    np.testing.assert_allclose(second, np.broadcast_to(DX**2 / 4 * np.eye(3), second.shape), atol=1e-16)


@pytest.mark.parametrize(
    ("model", "precision", "threads", "tolerance"),
    [(model, "float64", 1, 1e-12) for model in MODELS]
    + [("fixed_corotated", "float64", 2, 1e-12)]
    + [(model, "float32", 1, 2e-5) for model in MODELS],
)
def test_kernel_equals_reference(model: str, precision: str, threads: int, tolerance: float) -> None:
    """30 steps of a shaken cloud that hits the ground and slides."""
    material = replace(RUBBER, model=model)
    start, volumes = shaken(material)
    # On the ground the solver leaves the initial velocities as they are, like the reference.
    expected = start
    for _ in range(30):
        expected = reference.step(expected, volumes, material, dx=DX, dt=2e-4, gravity=GRAVITY, ground=True)
    result = simulate(
        start, volumes, material, dx=DX, dt=2e-4, times=[30 * 2e-4], gravity=GRAVITY,
        precision=precision, threads=threads,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    assert result.steps == 30
    assert difference(result.final, expected) < tolerance


@pytest.mark.parametrize("threads", [1, 2])
def test_same_input_same_bits(threads: int) -> None:
    """Two runs agree bit for bit, with a window that has to follow the object."""
    start, volumes = shaken()
    runs = [
        simulate(start, volumes, RUBBER, dx=DX, dt=5e-4, times=[0.05, 0.1], gravity=(30.0, 0.0, -9.81), threads=threads)
        for _ in range(2)
    ]
    assert runs[0].refits > 3
    assert same_bits(runs[0].final, runs[1].final)
    np.testing.assert_array_equal(runs[0].energy, runs[1].energy)


def test_resumed_run_continues_bit_for_bit() -> None:
    start, volumes = shaken()
    whole = simulate(start, volumes, RUBBER, dx=DX, dt=5e-4, times=[0.02, 0.04])
    resumed = simulate(whole.states[0], volumes, RUBBER, dx=DX, dt=5e-4, times=[0.04 - 0.02])
    assert same_bits(resumed.final, whole.final)
