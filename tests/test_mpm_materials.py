"""Elastic materials: energy, stress and wave speed, in NumPy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hoi.data import Material
from hoi.errors import InputError
from hoi.mpm.materials import (
    MODELS,
    check_material,
    elastic_energy_density,
    kirchhoff_stress,
    lame_parameters,
    p_wave_speed,
    rotation_of,
)

PAPER = Material("paper", "fixed_corotated", 1e7, 0.45, 1000.0, 0.6, 0.5)


def deformations(count: int = 20) -> np.ndarray:
    return np.eye(3) + 0.2 * np.random.default_rng(0).normal(size=(count, 3, 3))


@pytest.mark.parametrize("model", MODELS)
def test_stress_is_the_derivative_of_the_energy(model: str) -> None:
    """tau = (d psi / d F) F^T by central differences, relative error below 1e-7."""
    material, f, h = replace(PAPER, model=model), deformations(), 1e-6
    gradient = np.zeros_like(f)
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        gradient[:, i, j] = elastic_energy_density(material, f + step) - elastic_energy_density(material, f - step)
    expected = gradient / (2 * h) @ np.swapaxes(f, -1, -2)
    np.testing.assert_allclose(kirchhoff_stress(material, f), expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("model", MODELS)
def test_stress_turns_with_the_body(model: str) -> None:
    """psi(Q F) = psi(F) and tau(Q F) = Q tau(F) Q^T; isotropy: tau(F Q) = tau(F)."""
    material, f, q = replace(PAPER, model=model), deformations(), Rotation.random(20, rng=1).as_matrix()
    tau = kirchhoff_stress(material, f)
    scale = np.abs(tau).max()
    np.testing.assert_allclose(elastic_energy_density(material, q @ f), elastic_energy_density(material, f), rtol=1e-10)
    np.testing.assert_allclose(kirchhoff_stress(material, q @ f), q @ tau @ np.swapaxes(q, -1, -2), atol=1e-12 * scale)
    np.testing.assert_allclose(kirchhoff_stress(material, f @ q), tau, atol=1e-12 * scale)
    np.testing.assert_allclose(tau, np.swapaxes(tau, -1, -2), atol=1e-12 * scale)


@pytest.mark.parametrize("model", MODELS)
def test_small_strain_is_linear_elasticity(model: str) -> None:
    """tau -> 2 mu eps + lambda tr(eps) I, the error second order in the strain."""
    material = replace(PAPER, model=model)
    mu, lam = lame_parameters(material)
    gradient = np.random.default_rng(2).normal(size=(3, 3))
    strain = 0.5 * (gradient + gradient.T)
    linear = 2 * mu * strain + lam * np.trace(strain) * np.eye(3)
    errors = [np.abs(kirchhoff_stress(material, np.eye(3) + h * gradient) / h - linear).max() for h in (1e-3, 1e-4)]
    assert errors[1] < 0.11 * errors[0]
    assert errors[1] < 2e-3 * np.abs(linear).max()


def test_rotation_of_an_inverted_particle_is_a_rotation() -> None:
    """R is proper also where det F < 0, and is F itself for a rotation."""
    f = np.stack([np.diag([1.0, 1.2, -0.3]), Rotation.from_rotvec([0.3, -2, 1]).as_matrix()])
    r = rotation_of(f)
    np.testing.assert_allclose(np.linalg.det(r), 1)
    np.testing.assert_allclose(r[1], f[1], atol=1e-14)


def test_wave_speed_of_the_paper() -> None:
    """E = 1e7, nu = 0.45: 195 m/s at 1000 kg/m^3 and 436 m/s at 200 kg/m^3."""
    assert p_wave_speed(PAPER) == pytest.approx(194.7, abs=0.1)
    assert p_wave_speed(replace(PAPER, density=200.0)) == pytest.approx(435.4, abs=0.5)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("poisson_ratio", 0.5, r"poisson_ratio must lie in \(-1, 0.5\), got 0.5 \(incompressible; use at most 0.499\)"),
        ("poisson_ratio", 0.7, r"poisson_ratio must lie in \(-1, 0.5\), got 0.7"),
        ("poisson_ratio", -1.0, "poisson_ratio"),
        ("poisson_ratio", float("nan"), "poisson_ratio"),
        ("youngs_modulus", 0.0, "youngs_modulus must be positive"),
        ("youngs_modulus", -1e5, "youngs_modulus"),
        ("youngs_modulus", float("inf"), "youngs_modulus"),
        ("density", 0.0, "density"),
        ("density", float("nan"), "density"),
        ("ground_friction", -0.1, "ground_friction"),
        ("model", "jelly", "model must be one of fixed_corotated, neo_hookean, got 'jelly'"),
    ],
)
def test_impossible_materials_are_refused(field: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_material(replace(PAPER, **{field: value}))  # pyright: ignore[reportArgumentType]
