"""The Taichi kernels against the NumPy reference, and bit against bit."""

from dataclasses import replace

import mpm_reference as reference
import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, block, shaken

from hoi.data import Material, ObjectState, Plane
from hoi.mpm.laws import LAWS
from hoi.mpm.materials import p_wave_speed
from hoi.mpm.solver import ground_plane, simulate
from hoi.mpm.state import initial_state

FIELDS = ("positions", "velocities", "affine", "deformation_gradient")
GRAVITY = (0.0, 0.3, -9.81)
ELASTIC = ("fixed_corotated", "neo_hookean")
FLOWING = {
    "von_mises": Material("metal", "von_mises", 1e5, 0.3, 1000.0, 0.2, 0.4, yield_stress=1e3, hardening=1e3),
    "viscoplastic": Material("clay", "viscoplastic", 1e5, 0.3, 1000.0, 0.2, 0.4, yield_stress=1e3, viscosity=10.0),
    "drucker_prager": Material("sand", "drucker_prager", 1e5, 0.3, 1000.0, 0.2, 0.4, friction_angle=0.5),
    "snow": Material("snow", "snow", 1e5, 0.2, 400.0, 0.2, 0.4, hardening=10.0, critical_compression=0.025,
                     critical_stretch=0.0075),
    "fluid": Material("water", "fluid", 1e5, 0.3, 1000.0, 0.2, 0.4, viscosity=1.0),
}  # fmt: skip


def difference(a: ObjectState, b: ObjectState) -> float:
    """Largest difference of any array, relative to its largest entry."""
    return max(np.abs(getattr(a, n) - getattr(b, n)).max() / np.abs(getattr(b, n)).max() for n in FIELDS)


def same_bits(a: ObjectState, b: ObjectState) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in FIELDS)


@pytest.mark.parametrize(("spline", "spread"), [("quadratic", 1 / 4), ("cubic", 1 / 3)])
def test_weights_are_a_partition_of_unity(spline: str, spread: float) -> None:
    """sum_i w_ip = 1, sum_i w_ip (x_i - x_p) = 0, sum_i w_ip (x_i - x_p)(x_i - x_p)^T = D I."""
    x = np.random.default_rng(0).normal(size=(50, 3))
    _, w, offset = reference.stencil(x, DX, spline)
    np.testing.assert_allclose(w.sum(axis=1), 1, atol=1e-14)
    assert w.min() >= 0
    np.testing.assert_allclose(np.einsum("pn,pni->pi", w, offset), 0, atol=1e-15)
    second = np.einsum("pn,pni,pnj->pij", w, offset, offset)
    np.testing.assert_allclose(second, np.broadcast_to(spread * DX**2 * np.eye(3), second.shape), atol=1e-16)


SLOPE = Plane(np.array([0.1, 0.0, 0.0]), np.array([0.6, 0.0, 0.8]), "coulomb", 0.3)
WALLS = (ground_plane(0.4), SLOPE, replace(SLOPE, point=np.array([0.05, 0.02, 0.0]), contact="slip"))


@pytest.mark.parametrize(
    ("model", "precision", "threads", "spline", "tolerance"),
    [(model, "float64", 1, "quadratic", 1e-12) for model in ELASTIC]
    + [("fixed_corotated", "float64", 2, "quadratic", 1e-12), ("neo_hookean", "float64", 1, "cubic", 1e-12)]
    + [(model, "float32", 1, "quadratic", 2e-5) for model in ELASTIC],
)
def test_kernel_equals_reference(model: str, precision: str, threads: int, spline: str, tolerance: float) -> None:
    """30 steps of a shaken cloud that hits the ground and a slope and slides."""
    material = replace(RUBBER, model=model)
    start, volumes = shaken(material)
    expected = start
    for _ in range(30):
        expected = reference.step(
            expected, volumes, material, dx=DX, dt=2e-4, gravity=GRAVITY, planes=WALLS, spline=spline
        )
    result = simulate(
        start, volumes, material, dx=DX, dt=2e-4, times=[30 * 2e-4], gravity=GRAVITY, planes=WALLS,
        precision=precision, threads=threads, spline=spline,
    )  # fmt: skip
    assert result.steps == 30
    assert difference(result.final, expected) < tolerance


@pytest.mark.parametrize("model", [model for model, law in LAWS.items() if law.flows])
def test_flowing_kernel_equals_reference(model: str) -> None:
    """20 steps in float64 of each material that flows, thrown onto the ground hard enough to flow."""
    material = FLOWING[model]
    x, volumes = block((0.15, 0.15, 0.1), DX / 2)
    start = initial_state(x, volumes * material.density, [1, 0.3, -3], [3, 10, -5])
    expected = start
    for _ in range(20):
        expected = reference.step(
            expected, volumes, material, dx=DX, dt=2e-4, gravity=GRAVITY, planes=[ground_plane(0.4)]
        )
    result = simulate(start, volumes, material, dx=DX, dt=2e-4, times=[20 * 2e-4], gravity=GRAVITY, precision="float64")
    assert difference(result.final, expected) < 1e-9
    for name in ("elastic", "hardening"):
        if (own := getattr(result.final, name)) is not None:
            np.testing.assert_allclose(own, getattr(expected, name), atol=1e-9)


def test_regions_are_their_own_materials() -> None:
    """Two blocks far apart in one simulation move as each does alone."""
    soft = replace(RUBBER, model="neo_hookean", youngs_modulus=5e4, density=300.0)
    x, volumes = block((0.15, 0.15, 0.1), DX / 2)
    far = x + np.array([40 * DX, 0, 0])
    both = np.concatenate([x, far])
    region = np.repeat([0, 1], len(x))
    options = {"dx": DX, "dt": 2e-4, "times": [0.01], "precision": "float64", "planes": [ground_plane(0.4)]}
    start = initial_state(both, np.ones(len(both)), [0, 0, -2])
    result = simulate(start, np.tile(volumes, 2), (RUBBER, soft), region=region, **options)
    energy = np.zeros(3)
    for index, (material, alone) in enumerate(((RUBBER, x), (soft, far))):
        single = simulate(initial_state(alone, volumes, [0, 0, -2]), volumes, material, **options)
        np.testing.assert_allclose(result.final.positions[region == index], single.final.positions, atol=1e-10)
        energy += single.energy[0]
    np.testing.assert_allclose(result.energy[0], energy, rtol=1e-9)


def test_step_follows_need() -> None:
    """The chosen step halves, about, when the body moves at the speed of its waves, and a fixed one is kept."""
    x, volumes = block((0.15, 0.15, 0.1), DX / 2, lowest=1.0)
    wave_speed = p_wave_speed(RUBBER)
    options = {"dx": DX, "times": [0.01], "gravity": (0, 0, 0)}
    slow, fast = (
        simulate(initial_state(x, volumes, [speed, 0, 0]), volumes, RUBBER, **options).dt_most
        for speed in (0.0, wave_speed)
    )
    assert fast / slow == pytest.approx(0.5, rel=0.1)
    fixed = simulate(initial_state(x, volumes, [0, 0, 0]), volumes, RUBBER, dt=1e-4, **options)
    assert [fixed.dt_least, fixed.dt_most] == pytest.approx([1e-4, 1e-4])


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
