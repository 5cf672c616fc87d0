"""Materials: what is allowed in one, and what its law makes of it in NumPy float64; the laws are in `hoi.mpm.laws`."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Material
from hoi.errors import InputError
from hoi.mpm.laws import LAWS

RULES: dict[str, tuple[Callable[[float], bool], str]] = {
    "yield_stress": (lambda value: 0 < value < math.inf, "positive and finite [Pa]"),
    "hardening": (lambda value: 0 <= value < math.inf, "0 or more"),
    "viscosity": (lambda value: 0 <= value < math.inf, "0 or more [Pa s]"),
    "friction_angle": (lambda value: 0 < value < math.pi / 2, "in (0, pi/2) [rad]"),
    "critical_compression": (lambda value: 0 < value < 1, "in (0, 1)"),
    "critical_stretch": (lambda value: 0 < value < math.inf, "positive"),
}
"""What a law that uses a field allows in it."""


def check_material(material: Material) -> None:
    """Raises InputError unless the material is one that can exist and that this solver knows."""
    if material.model not in LAWS:
        raise InputError(f"material.model must be one of {', '.join(LAWS)}, got {material.model!r}")
    _require_positive("material.youngs_modulus", material.youngs_modulus, "Pa")
    _require_positive("material.density", material.density, "kg/m^3")
    nu = material.poisson_ratio
    if not -1 < nu < 0.5:
        hint = " (incompressible; use at most 0.499)" if nu == 0.5 else ""
        raise InputError(f"material.poisson_ratio must lie in (-1, 0.5), got {nu:g}{hint}")
    if not LAWS[material.model].shears and not nu > 0:
        raise InputError(f"material.poisson_ratio of a fluid must lie in (0, 0.5), got {nu:g}")
    if not 0 <= material.restitution <= 1:
        raise InputError(f"material.restitution must lie in [0, 1], got {material.restitution:g}")
    if not (math.isfinite(material.ground_friction) and material.ground_friction >= 0):
        raise InputError(f"material.ground_friction must be 0 or more, got {material.ground_friction:g}")
    uses = LAWS[material.model].uses
    neutral = {field.name: field.default for field in fields(Material)}
    for name, (allows, allowed) in RULES.items():
        value = getattr(material, name)
        if name in uses and not allows(value):
            raise InputError(f"material.{name} of {material.model} must be {allowed}, got {value:g}")
        if name not in uses and value != neutral[name]:
            takes = f"it takes {', '.join(sorted(uses))}" if uses else "it takes no more than elasticity"
            raise InputError(f"material.{name} is not used by {material.model} ({takes}), got {value:g}; leave it out")


def parameters(material: Material) -> Any:
    """The numbers that the material's law works with, checked."""
    check_material(material)
    return LAWS[material.model].parameters(material)


def lame_parameters(material: Material) -> tuple[float, float]:
    """(mu, lambda) [Pa] from Young's modulus and Poisson's ratio; mu is 0 for a fluid, lambda its bulk modulus."""
    p = parameters(material)
    return p.mu, p.lam


def p_wave_speed(material: Material) -> float:
    """c = sqrt((lambda + 2 mu) / rho) [m/s], the fastest wave of the unstrained material."""
    mu, lam = lame_parameters(material)
    return math.sqrt((lam + 2 * mu) / material.density)


def elastic_energy_density(material: Material, deformation_gradient: Array, hardening: Array | float = 0.0) -> Array:
    """psi(F) [J/m^3] of each elastic F, shape (...); `hardening` as in the state, shape (...)."""
    hardening = np.broadcast_to(hardening, deformation_gradient.shape[:-2])
    return LAWS[material.model].energy_density(parameters(material), deformation_gradient, hardening)


def kirchhoff_stress(
    material: Material,
    deformation_gradient: Array,
    velocity_gradient: Array | float = 0.0,
    hardening: Array | float = 0.0,
) -> Array:
    """tau [Pa] of each elastic F, shape (..., 3, 3), symmetric; the velocity gradient [1/s] counts in fluids alone."""
    velocity_gradient = np.broadcast_to(velocity_gradient, deformation_gradient.shape)
    hardening = np.broadcast_to(hardening, deformation_gradient.shape[:-2])
    law = LAWS[material.model]
    return law.kirchhoff_stress(parameters(material), deformation_gradient, velocity_gradient, hardening)


def clamped(material: Material, deformation_gradient: Array, hardening: Array | float = 0.0) -> NDArray[Any]:
    """Which particles are at a bound of the method's: a fluid's least J, crushed solids, the bounds of snow."""
    hardening = np.broadcast_to(hardening, deformation_gradient.shape[:-2])
    law = LAWS[material.model].clamped
    if law is None:
        return np.zeros(hardening.shape, dtype=bool)
    return law(parameters(material), deformation_gradient, hardening)


def return_map(material: Material, trial: Array, hardening: Array | float, dt: float) -> tuple[Array, Array]:
    """The elastic F (..., 3, 3) and `hardening` (...) that a step of `dt` [s] to the trial F (..., 3, 3) ends with."""
    hardening = np.broadcast_to(hardening, trial.shape[:-2])
    law = LAWS[material.model].return_map
    return (trial, hardening) if law is None else law(parameters(material), trial, hardening, dt)


def _require_positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive and finite [{unit}], got {value:g}")
