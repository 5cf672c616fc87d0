"""Elastic materials: parameters, constitutive models in NumPy and the speed of their waves.

With the Lame parameters mu, lambda and J = det F, R the rotation of the polar decomposition F = R S:

| model | energy density psi(F) [J/m^3] | Kirchhoff stress tau = (d psi / d F) F^T [Pa] |
| --- | --- | --- |
| fixed_corotated | mu |F - R|^2 + lambda/2 (J - 1)^2 | 2 mu (F - R) F^T + lambda J (J - 1) I |
| neo_hookean | mu/2 (|F|^2 - 3 - 2 log J) + lambda/2 log^2 J | mu (F F^T - I) + lambda log J I |

Both agree with linear elasticity for small strain. fixed_corotated is what PhysGaussian, and so the paper, calls jelly
(Stomakhin et al. 2012, Energetically Consistent Invertible Elasticity); neo_hookean stiffens without bound as J -> 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hoi.data import Array, Material
from hoi.errors import InputError


@dataclass(frozen=True)
class ConstitutiveModel:
    """A hyperelastic law; the kernels hold the same stress under the same name."""

    energy_density: Callable[[Array, float, float], Array]
    """(F (..., 3, 3), mu, lambda) -> psi [J/m^3], shape (...)."""
    kirchhoff_stress: Callable[[Array, float, float], Array]
    """(F (..., 3, 3), mu, lambda) -> tau [Pa], shape (..., 3, 3)."""


def check_material(material: Material) -> None:
    """Raises InputError unless the material is one that an elastic solid can have and that this solver knows."""
    if material.model not in MODELS:
        raise InputError(f"material.model must be one of {', '.join(MODELS)}, got {material.model!r}")
    _require_positive("material.youngs_modulus", material.youngs_modulus, "Pa")
    _require_positive("material.density", material.density, "kg/m^3")
    nu = material.poisson_ratio
    if not -1 < nu < 0.5:
        hint = " (incompressible; use at most 0.499)" if nu == 0.5 else ""
        raise InputError(f"material.poisson_ratio must lie in (-1, 0.5), got {nu:g}{hint}")
    if not (math.isfinite(material.ground_friction) and material.ground_friction >= 0):
        raise InputError(f"material.ground_friction must be 0 or more, got {material.ground_friction:g}")


def lame_parameters(material: Material) -> tuple[float, float]:
    """(mu, lambda) [Pa] from Young's modulus and Poisson's ratio."""
    check_material(material)
    e, nu = material.youngs_modulus, material.poisson_ratio
    return e / (2 * (1 + nu)), e * nu / ((1 + nu) * (1 - 2 * nu))


def p_wave_speed(material: Material) -> float:
    """c = sqrt((lambda + 2 mu) / rho) [m/s], the fastest wave of the unstrained material."""
    mu, lam = lame_parameters(material)
    return math.sqrt((lam + 2 * mu) / material.density)


def rotation_of(deformation_gradient: Array) -> Array:
    """R of the polar decomposition F = R S, shape (..., 3, 3); det R = 1 also where F is inverted."""
    u, _, vt = np.linalg.svd(deformation_gradient)
    u = u * np.stack([np.ones_like(s := np.sign(np.linalg.det(u @ vt))), np.ones_like(s), s], axis=-1)[..., None, :]
    return u @ vt


def elastic_energy_density(material: Material, deformation_gradient: Array) -> Array:
    """psi(F) [J/m^3] of each F, shape (...)."""
    return MODELS[material.model].energy_density(deformation_gradient, *lame_parameters(material))


def kirchhoff_stress(material: Material, deformation_gradient: Array) -> Array:
    """tau(F) [Pa] of each F, shape (..., 3, 3), symmetric."""
    return MODELS[material.model].kirchhoff_stress(deformation_gradient, *lame_parameters(material))


def _require_positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive and finite [{unit}], got {value:g}")


def _fixed_corotated_energy(f: Array, mu: float, lam: float) -> Array:
    # |F - R|^2 = sum (sigma_i - 1)^2: the singular values suffice, the smallest taking the sign of J.
    j = np.linalg.det(f)
    sigma = np.linalg.svd(f, compute_uv=False)
    sigma[..., 2] = np.copysign(sigma[..., 2], j)
    return mu * ((sigma - 1) ** 2).sum(-1) + lam / 2 * (j - 1) ** 2


def _fixed_corotated_stress(f: Array, mu: float, lam: float) -> Array:
    j = np.linalg.det(f)[..., None, None]
    return 2 * mu * (f - rotation_of(f)) @ np.swapaxes(f, -1, -2) + lam * j * (j - 1) * np.eye(3)


def _neo_hookean_energy(f: Array, mu: float, lam: float) -> Array:
    log_j = np.log(np.linalg.det(f))
    return mu / 2 * ((f**2).sum((-2, -1)) - 3 - 2 * log_j) + lam / 2 * log_j**2


def _neo_hookean_stress(f: Array, mu: float, lam: float) -> Array:
    log_j = np.log(np.linalg.det(f))[..., None, None]
    return mu * (f @ np.swapaxes(f, -1, -2) - np.eye(3)) + lam * log_j * np.eye(3)


MODELS = {
    "fixed_corotated": ConstitutiveModel(_fixed_corotated_energy, _fixed_corotated_stress),
    "neo_hookean": ConstitutiveModel(_neo_hookean_energy, _neo_hookean_stress),
}
