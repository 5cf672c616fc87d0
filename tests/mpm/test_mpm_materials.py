"""Materials in NumPy: what is allowed, energy and stress, and the return maps of those that flow."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpm_examples import EXAMPLES, deformations, rotations, stretched

from hoi.data import Material
from hoi.errors import InputError
from hoi.mpm.laws import LAWS
from hoi.mpm.materials import (
    check_material,
    elastic_energy_density,
    kirchhoff_stress,
    lame_parameters,
    p_wave_speed,
    return_map,
)
from hoi.mpm.tensors import rotation_of

PAPER = Material("paper", "fixed_corotated", 1e7, 0.45, 1000.0, 0.6, 0.5)
SOLIDS = [model for model in LAWS if model != "fluid"]
FLOWS = sorted(model for model, law in LAWS.items() if law.flows)
DT = 1e-3


def transposed(f: np.ndarray) -> np.ndarray:
    return np.swapaxes(f, -1, -2)


def hencky(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Trace (N,) and norm of the deviator (N,) of the Hencky strain."""
    strain = np.log(np.linalg.svd(f, compute_uv=False))
    trace = strain.sum(-1)
    return trace, np.linalg.norm(strain - trace[:, None] / 3, axis=-1)


def test_every_model_has_an_example() -> None:
    assert EXAMPLES.keys() == LAWS.keys()


@pytest.mark.parametrize("model", LAWS)
def test_stress_is_the_derivative_of_the_energy(model: str) -> None:
    """tau = (d psi / d F) F^T by central differences, relative error below 1e-7."""
    material, f, h = EXAMPLES[model], deformations(20, 0.2), 1e-6
    hardening = np.linspace(-0.1, 0.1, len(f))
    gradient = np.zeros_like(f)
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        forward, back = (elastic_energy_density(material, f + sign * step, hardening) for sign in (1, -1))
        gradient[:, i, j] = (forward - back) / (2 * h)
    expected = gradient @ transposed(f)
    tau = kirchhoff_stress(material, f, hardening=hardening)
    np.testing.assert_allclose(tau, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("model", LAWS)
def test_stress_turns_with_the_body(model: str) -> None:
    """psi(Q F) = psi(F), tau(Q F, Q C Q^T) = Q tau(F, C) Q^T; isotropy: tau(F Q) = tau(F); tau is symmetric."""
    material, f, q = EXAMPLES[model], deformations(20, 0.2), rotations(20, seed=1)
    c = np.random.default_rng(0).normal(size=f.shape)
    tau = kirchhoff_stress(material, f, c)
    scale = np.abs(tau).max()
    np.testing.assert_allclose(elastic_energy_density(material, q @ f), elastic_energy_density(material, f), rtol=1e-9)
    turned = kirchhoff_stress(material, q @ f, q @ c @ transposed(q))
    np.testing.assert_allclose(turned, q @ tau @ transposed(q), atol=1e-12 * scale)
    np.testing.assert_allclose(kirchhoff_stress(material, f @ q, c), tau, atol=1e-12 * scale)
    np.testing.assert_allclose(tau, transposed(tau), atol=1e-12 * scale)


@pytest.mark.parametrize("model", SOLIDS)
def test_small_strain_is_linear_elasticity(model: str) -> None:
    """tau -> 2 mu eps + lambda tr(eps) I, the error second order in the strain."""
    material = EXAMPLES[model]
    mu, lam = lame_parameters(material)
    gradient = np.random.default_rng(2).normal(size=(3, 3))
    strain = 0.5 * (gradient + gradient.T)
    linear = 2 * mu * strain + lam * np.trace(strain) * np.eye(3)
    errors = [np.abs(kirchhoff_stress(material, np.eye(3) + h * gradient) / h - linear).max() for h in (1e-3, 1e-4)]
    assert errors[1] < 0.11 * errors[0]
    assert errors[1] < 2e-3 * np.abs(linear).max()


def test_rotation_of_an_inverted_particle_is_a_rotation() -> None:
    """R is proper also where det F < 0, and is F itself for a rotation."""
    turn = rotations(1)[0]
    r = rotation_of(np.stack([np.diag([1.0, 1.2, -0.3]), turn]))
    np.testing.assert_allclose(np.linalg.det(r), 1)
    np.testing.assert_allclose(r[1], turn, atol=1e-14)


@pytest.mark.parametrize("model", FLOWS)
def test_return_is_idempotent(model: str) -> None:
    """What has been returned stays. The rate-independent limit: a viscous material goes on relaxing."""
    material = replace(EXAMPLES[model], viscosity=0.0)
    f, hardening = return_map(material, deformations(200, 0.1), 0.0, DT)
    again, hardening_again = return_map(material, f, hardening, DT)
    np.testing.assert_allclose(again, f, atol=1e-13)
    np.testing.assert_allclose(hardening_again, hardening, atol=1e-13)


@pytest.mark.parametrize("model", FLOWS)
def test_return_turns_with_the_body(model: str) -> None:
    """F_E(Q1 F Q2) = Q1 F_E(F) Q2."""
    material, f = EXAMPLES[model], deformations(50, 0.1)
    before, after = rotations(50, seed=3), rotations(50, seed=4)
    expected, hardening = return_map(material, f, 0.01, DT)
    turned, hardening_turned = return_map(material, before @ f @ after, 0.01, DT)
    if model != "fluid":
        expected = before @ expected @ after
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    np.testing.assert_allclose(hardening_turned, hardening, atol=1e-12)


@pytest.mark.parametrize("model", ["von_mises", "viscoplastic", "drucker_prager"])
def test_flow_never_gives_energy(model: str) -> None:
    """psi(F_E) <= psi(trial F), and less where it flows. (Snow's published model has no such law.)"""
    material, f = EXAMPLES[model], deformations(500, 0.1)
    returned, hardening = return_map(material, f, 0.0, DT)
    before, after = elastic_energy_density(material, f), elastic_energy_density(material, returned)
    flowed = np.abs(returned - f).max((-2, -1)) > 1e-12
    assert flowed.sum() > 100
    assert (after <= before * (1 + 1e-12)).all()
    assert (after[flowed] < before[flowed]).all()
    assert (hardening >= 0).all()


@pytest.mark.parametrize("hardening", [0.0, 0.1])
def test_von_mises_lands_on_its_yield_surface(hardening: float) -> None:
    """|2 mu e| = sqrt(2/3) (yield_stress + hardening E a) where it flowed, the volume kept; elastic below."""
    material = replace(EXAMPLES["von_mises"], hardening=hardening)
    mu, _ = lame_parameters(material)
    f = np.concatenate([deformations(100, 0.1), deformations(100, 1e-3)])
    returned, plastic = return_map(material, f, 0.0, DT)
    bound = math.sqrt(2 / 3) * (material.yield_stress + hardening * material.youngs_modulus * plastic)
    stress = 2 * mu * hencky(returned)[1]
    flowed = plastic > 0
    assert 50 < flowed.sum() <= 100
    np.testing.assert_allclose(stress[flowed], bound[flowed], rtol=1e-10)
    assert (stress[~flowed] <= bound[~flowed]).all()
    np.testing.assert_allclose(returned[~flowed], f[~flowed], atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(returned), np.linalg.det(f), rtol=1e-12)


def sheared(material: Material, rate: float, until: float, dt: float) -> np.ndarray:
    """Kirchhoff shear stress [Pa] after each step of a simple shear at `rate` [1/s]."""
    c = np.zeros((1, 3, 3))
    c[0, 0, 1] = rate
    f, hardening, stress = np.eye(3)[None], np.zeros(1), []
    for _ in range(round(until / rate / dt)):
        f, hardening = return_map(material, f + dt * c @ f, hardening, dt)
        stress.append(kirchhoff_stress(material, f)[0, 0, 1])
    return np.array(stress)


def test_simple_shear_of_metal_saturates() -> None:
    """Elastic with mu at first, then constant at yield_stress / sqrt(3)."""
    material = replace(EXAMPLES["von_mises"], hardening=0.0, yield_stress=1e3)
    stress = sheared(material, 1.0, until=1.0, dt=1e-3)
    mu, _ = lame_parameters(material)
    assert stress[9] == pytest.approx(mu * 0.01, rel=1e-3)
    assert stress[-1] == pytest.approx(material.yield_stress / math.sqrt(3), rel=1e-3)
    assert np.ptp(stress[-500:]) < 1e-6 * stress[-1]


@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_simple_shear_of_clay_is_binghams(rate: float) -> None:
    """yield_stress / sqrt(3) + viscosity rate, once it flows."""
    material = EXAMPLES["viscoplastic"]
    stress = sheared(material, rate, until=1.0, dt=1e-3 / rate)
    assert stress[-1] == pytest.approx(material.yield_stress / math.sqrt(3) + material.viscosity * rate, rel=2e-3)


def test_clay_without_viscosity_is_metal() -> None:
    f = deformations(50, 0.1)
    clay, metal = replace(EXAMPLES["viscoplastic"], viscosity=0.0), replace(EXAMPLES["von_mises"], hardening=0.0)
    for a, b in zip(return_map(clay, f, 0.0, DT), return_map(metal, f, 0.0, DT), strict=True):
        np.testing.assert_array_equal(a, b)


def test_sand_bears_no_tension_and_its_friction_no_more() -> None:
    """Expanded: F is a rotation. Else on or in the cone, the volume kept.

    In plane strain at constant volume the cone is Mohr-Coulomb's sigma_1 / sigma_3 = (1 + sin phi) / (1 - sin phi).
    """
    material = EXAMPLES["drucker_prager"]
    mu, lam = lame_parameters(material)
    sine = math.sin(material.friction_angle)
    alpha = math.sqrt(2) / 3 * sine
    f = deformations(500, 0.1)
    trace, _ = hencky(f)
    returned, gained = return_map(material, f, 0.0, DT)
    new_trace, size = hencky(returned)
    apart = trace >= 0
    assert 100 < apart.sum() < 400
    np.testing.assert_allclose(kirchhoff_stress(material, returned[apart]), 0, atol=1e-9)
    np.testing.assert_allclose(gained, np.where(apart, trace, 0), atol=1e-12)
    np.testing.assert_allclose(new_trace[~apart], trace[~apart], atol=1e-12)
    assert (size + (3 * lam + 2 * mu) / (2 * mu) * alpha * new_trace <= 1e-12).all()
    assert np.linalg.eigvalsh(kirchhoff_stress(material, returned)).max() <= 1e-6 * material.youngs_modulus

    pressed, _ = return_map(material, np.diag(np.exp([0.2, -0.1, -0.4]))[None], 0.0, DT)
    principal = -np.linalg.eigvalsh(kirchhoff_stress(material, pressed)[0])
    assert principal[0] / principal[2] == pytest.approx((1 + sine) / (1 - sine), rel=1e-9)


def test_sand_loses_the_volume_it_gained_before_it_presses() -> None:
    """Apart by 5 % of volume, then pressed by 3 %: free of stress. Pressed by 3 % more: as by 1 % from the start."""
    material = EXAMPLES["drucker_prager"]
    f, hardening = return_map(material, math.exp(0.05 / 3) * np.eye(3)[None], 0.0, DT)
    f, hardening = return_map(material, math.exp(-0.03 / 3) * f, hardening, DT)
    np.testing.assert_allclose(kirchhoff_stress(material, f), 0, atol=1e-9)
    assert hardening == pytest.approx(0.02)
    f, hardening = return_map(material, math.exp(-0.03 / 3) * f, hardening, DT)
    np.testing.assert_allclose(f, math.exp(-0.01 / 3) * np.eye(3)[None], atol=1e-12)
    assert hardening == 0


def test_snow_keeps_its_singular_values_and_hardens() -> None:
    """Clamped; det F_E J_P = det F; pressing hardens, pulling softens, neither by more than ten times."""
    material = EXAMPLES["snow"]
    f = np.concatenate([deformations(100, 0.1), deformations(50, 1e-3)])
    returned, log_jp = return_map(material, f, 0.0, DT)
    sigma = np.linalg.svd(returned, compute_uv=False)
    assert sigma.min() >= 1 - 0.025 - 1e-12 and sigma.max() <= 1 + 0.0075 + 1e-12
    np.testing.assert_allclose(np.linalg.det(returned) * np.exp(log_jp), np.linalg.det(f), rtol=1e-12)
    np.testing.assert_allclose(returned[100:], f[100:], atol=1e-13)
    weak, strain = kirchhoff_stress(material, np.eye(3) * 1.001), np.eye(3) * 1.001
    factor = [kirchhoff_stress(material, strain, hardening=h)[0, 0] / weak[0, 0] for h in (-0.05, 0.05, -50, 50)]
    expected = [math.exp(10 * (1 - math.exp(-0.05))), math.exp(10 * (1 - math.exp(0.05))), 10, 0.1]
    np.testing.assert_allclose(factor, expected, rtol=1e-9)


def test_fluid_keeps_its_volume_alone() -> None:
    """At rest no shear stress whatever the shear; moving, the viscous one; pressure by Tait's equation."""
    material = EXAMPLES["fluid"]
    _, bulk = lame_parameters(material)
    f, _ = return_map(material, deformations(50, 0.1), 0.0, DT)
    j = np.linalg.det(deformations(50, 0.1))
    np.testing.assert_allclose(np.linalg.det(f), np.maximum(j, 0.5), rtol=1e-12)
    at_rest = kirchhoff_stress(material, f)
    pressure = np.maximum(bulk / 7 * (np.linalg.det(f) ** -7.0 - 1), 0)  # it bears no tension
    assert (j > 1.02).any()
    np.testing.assert_allclose(at_rest, -(np.linalg.det(f) * pressure)[:, None, None] * np.eye(3), atol=1e-8 * bulk)
    c = np.zeros((50, 3, 3))
    c[:, 0, 1] = 3.0
    shear = (kirchhoff_stress(material, f, c) - at_rest) / np.linalg.det(f)[:, None, None]
    np.testing.assert_allclose(shear[:, 0, 1], material.viscosity * 3.0, rtol=1e-9)
    np.testing.assert_allclose(np.trace(shear, axis1=1, axis2=2), 0, atol=1e-9)


@pytest.mark.parametrize("model", FLOWS)
def test_what_is_inside_out_is_turned_right(model: str) -> None:
    """det F <= 0, also exactly: the return has det F > 0 and finite stress."""
    f = stretched([[1.1, 0.9, -0.5], [1.2, 1.0, 0.0], [1.0, 1e-9, -1e-9], [1.3, -1.2, 1.1]])
    returned, hardening = return_map(EXAMPLES[model], f, 0.0, DT)
    assert (np.linalg.det(returned) > 0).all() and np.isfinite(hardening).all()
    assert np.isfinite(kirchhoff_stress(EXAMPLES[model], returned, hardening=hardening)).all()


def test_wave_speed() -> None:
    """E = 1e7, nu = 0.45: 195 m/s at 1000 kg/m^3 and 436 m/s at 200 kg/m^3. A fluid: sqrt(lambda / rho)."""
    assert p_wave_speed(PAPER) == pytest.approx(194.7, abs=0.1)
    assert p_wave_speed(replace(PAPER, density=200.0)) == pytest.approx(435.4, abs=0.5)
    assert p_wave_speed(EXAMPLES["fluid"]) == pytest.approx(math.sqrt(1e5 * 0.3 / (1.3 * 0.4) / 1000))


@pytest.mark.parametrize(
    ("model", "field", "value", "message"),
    [
        ("neo_hookean", "poisson_ratio", 0.5, r"lie in \(-1, 0.5\), got 0.5 \(incompressible; use at most 0.499\)"),
        ("neo_hookean", "poisson_ratio", 0.7, r"poisson_ratio must lie in \(-1, 0.5\), got 0.7"),
        ("neo_hookean", "poisson_ratio", -1.0, "poisson_ratio"),
        ("neo_hookean", "poisson_ratio", float("nan"), "poisson_ratio"),
        ("fluid", "poisson_ratio", 0.0, r"material.poisson_ratio of a fluid must lie in \(0, 0.5\), got 0"),
        ("neo_hookean", "youngs_modulus", 0.0, "youngs_modulus must be positive"),
        ("neo_hookean", "youngs_modulus", -1e5, "youngs_modulus"),
        ("neo_hookean", "youngs_modulus", float("inf"), "youngs_modulus"),
        ("neo_hookean", "density", 0.0, "density"),
        ("neo_hookean", "density", float("nan"), "density"),
        ("neo_hookean", "restitution", 1.1, r"material.restitution must lie in \[0, 1\], got 1.1"),
        ("neo_hookean", "restitution", float("nan"), "restitution"),
        ("neo_hookean", "ground_friction", -0.1, "ground_friction"),
        ("neo_hookean", "model", "jelly", "model must be one of fixed_corotated, neo_hookean, .*, got 'jelly'"),
        (
            "von_mises",
            "yield_stress",
            float("inf"),
            "yield_stress of von_mises must be positive and .*, got inf",
        ),
        ("von_mises", "yield_stress", 0.0, "yield_stress"),
        ("von_mises", "hardening", -0.1, "material.hardening of von_mises must be 0 or more, got -0.1"),
        ("von_mises", "viscosity", 1.0, "viscosity is not used by von_mises .it takes hardening, yield_stress., got 1"),
        ("neo_hookean", "yield_stress", 1e3, "material.yield_stress is not used by neo_hookean"),
        ("viscoplastic", "viscosity", -1.0, "material.viscosity of viscoplastic must be 0 or more"),
        ("fluid", "viscosity", float("nan"), "material.viscosity of fluid must be 0 or more"),
        ("drucker_prager", "friction_angle", 0.0, r"friction_angle of drucker_prager must be in \(0, pi/2\) \[rad\]"),
        ("drucker_prager", "friction_angle", 33.0, r"friction_angle .* \[rad\], got 33"),
        ("snow", "critical_compression", 1.0, r"critical_compression of snow must be in \(0, 1\), got 1"),
        ("snow", "critical_stretch", 0.0, "critical_stretch of snow must be positive, got 0"),
        ("snow", "hardening", float("nan"), "hardening"),
    ],
)
def test_impossible_materials_are_refused(model: str, field: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        check_material(replace(EXAMPLES[model], **{field: value}))  # pyright: ignore[reportArgumentType]
    assert "\n" not in str(error.value)
