"""Materials: their parameters, their constitutive models in NumPy float64 and the speed of their waves.

A model gives the Kirchhoff stress tau = J sigma [Pa] of the elastic deformation gradient F, and if it flows, a return
map from the trial F that a step leads to, to the one that the material can bear. With the Lame parameters mu, lambda,
J = det F, the polar decomposition F = R S = V R, b = F F^T, the Hencky strain eps = log V = log(b)/2, its deviator e:

| model | energy density psi(F) [J/m^3] | Kirchhoff stress tau [Pa] |
| --- | --- | --- |
| fixed_corotated | mu |F - R|^2 + lambda/2 (J - 1)^2 | 2 mu (b - V) + lambda J (J - 1) I |
| neo_hookean | mu/2 (|F|^2 - 3 - 2 log J) + lambda/2 log^2 J | mu (b - I) + lambda log J I |
| von_mises, viscoplastic, drucker_prager | mu |eps|^2 + lambda/2 tr(eps)^2 | 2 mu eps + lambda tr(eps) I |
| snow | h times that of fixed_corotated | h times that of fixed_corotated |
| fluid | K/g (J^(1-g)/(g-1) + J - g/(g-1)), g = 7 | -J p I + 2 eta J dev(sym C), p = K/g (J^-g - 1) |

All solids agree with linear elasticity for small strain. What is left behind by the flow is one number a particle,
`hardening`, 0 at first:

| model | return map | `hardening` |
| --- | --- | --- |
| von_mises | abs(2 mu e) <= sqrt(2/3) (yield_stress + hardening E a), else e shrinks to it, at constant volume | a |
| viscoplastic | the same, but the stress above the bound takes its time, which `viscosity` sets | a |
| drucker_prager | abs(e) + (3 lambda + 2 mu)/(2 mu) alpha tr(eps) <= 0, else e shrinks; no tension | volume gained |
| snow | singular values of F clamped to [1 - critical_compression, 1 + critical_stretch] | log J_P |
| fluid | F = J^(1/3) I, J >= 0.5 | - |

a is the equivalent plastic strain, so that `hardening` of these materials is the plastic modulus as a share of Young's
modulus. `yield_stress` is that of a bar that is pulled; sheared, it yields at yield_stress / sqrt(3). A viscoplastic
material sheared at the rate s bears yield_stress / sqrt(3) + viscosity s once it flows (Bingham). alpha is
sqrt(2/3) 2 sin(phi) / (3 - sin(phi)) for the friction angle phi. Snow hardens by h = exp(hardening (1 - J_P)), bounded
to [1/10, 10]: without a bound it is 22,000 for snow pressed to nothing, and the time step falls with its root. K of a
fluid is lambda.

fixed_corotated is what PhysGaussian, and so the paper, calls jelly (Stomakhin et al. 2012, Energetically Consistent
Invertible Elasticity); neo_hookean stiffens without bound as J -> 0. The return map of von Mises is that of Simo and
Hughes 1998, Computational Inelasticity, box 3.1, in Hencky strain, where it is exact for finite strain; with the
overstress of Perzyna it is the viscoplastic one (ibid., section 2.7). Sand is Klar et al. 2016, Drucker-Prager
Elastoplasticity for Sand Animation, with its volume correction: the volume that grains gained while apart is lost
again before they press. Snow is Stomakhin et al. 2013, A Material Point Method for Snow Simulation. The fluid is
Tampubolon et al. 2017, Multi-species Simulation of Porous Sand and Water Mixtures, with Newtonian viscosity.

A trial F with det F <= 0, or 1e-6, is beyond every stress. A solid that flows takes it as crushed flat: its singular
values are raised to 0.1. An elastic solid cannot, and its simulation has diverged.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from hoi.data import Array, Material
from hoi.errors import InputError

CRUSHED_VOLUME = 1e-6
"""det F at and below which a solid that flows is taken as crushed flat or turned inside out [-]."""
LEAST_STRETCH = 0.1
"""Its singular values are raised to this [-]."""
LEAST_VOLUME = 0.5
"""Least J of a fluid [-]: 18 K of pressure."""
MOST_HARDENED = math.log(10)
"""Largest magnitude of snow's exponent hardening (1 - J_P) [-]."""
GAMMA = 7
"""Exponent of Tait's equation [-]."""


class Parameters(NamedTuple):
    """The numbers of the constitutive models; those that a model does not use are 0."""

    mu: float
    """[Pa], 0 for a fluid."""
    lam: float
    """[Pa], the bulk modulus for a fluid."""
    yield_stress: float
    """[Pa]."""
    hardening: float
    """von_mises, viscoplastic: the plastic modulus [Pa]; snow: xi [-]."""
    viscosity: float
    """[Pa s]."""
    friction: float
    """alpha of Drucker and Prager [-]."""
    least_stretch: float
    """1 - critical_compression [-]."""
    most_stretch: float
    """1 + critical_stretch [-]."""


@dataclass(frozen=True)
class ConstitutiveModel:
    """A law; the kernels hold the same under the same name. F is (..., 3, 3), `hardening` (...)."""

    energy_density: Callable[[Parameters, Array, Array], Array]
    """(p, F, hardening) -> psi [J/m^3], shape (...)."""
    kirchhoff_stress: Callable[[Parameters, Array, Array, Array], Array]
    """(p, F, velocity gradient [1/s] (..., 3, 3), hardening) -> tau [Pa], shape (..., 3, 3)."""
    return_map: Callable[[Parameters, Array, Array, float], tuple[Array, Array]] | None = None
    """(p, trial F, hardening, dt) -> (F, hardening); None: the model does not flow."""
    keeps_total: bool = False
    """Whether the body has a shape that it flows away from, so that its total F is tracked beside the elastic one."""
    uses: frozenset[str] = frozenset()
    """Fields of Material that it takes beside elasticity, density, restitution and ground friction."""


RULES: dict[str, tuple[Callable[[float], bool], str]] = {
    "yield_stress": (lambda value: 0 < value < math.inf, "positive and finite [Pa]"),
    "hardening": (lambda value: 0 <= value < math.inf, "0 or more"),
    "viscosity": (lambda value: 0 <= value < math.inf, "0 or more [Pa s]"),
    "friction_angle": (lambda value: 0 < value < math.pi / 2, "in (0, pi/2) [rad]"),
    "critical_compression": (lambda value: 0 < value < 1, "in (0, 1)"),
    "critical_stretch": (lambda value: 0 < value < math.inf, "positive"),
}
"""What a model that uses a field allows in it."""


def check_material(material: Material) -> None:
    """Raises InputError unless the material is one that can exist and that this solver knows."""
    if material.model not in MODELS:
        raise InputError(f"material.model must be one of {', '.join(MODELS)}, got {material.model!r}")
    _require_positive("material.youngs_modulus", material.youngs_modulus, "Pa")
    _require_positive("material.density", material.density, "kg/m^3")
    nu = material.poisson_ratio
    if not -1 < nu < 0.5:
        hint = " (incompressible; use at most 0.499)" if nu == 0.5 else ""
        raise InputError(f"material.poisson_ratio must lie in (-1, 0.5), got {nu:g}{hint}")
    if material.model == "fluid" and not nu > 0:
        raise InputError(f"material.poisson_ratio of a fluid must lie in (0, 0.5), got {nu:g}")
    if not 0 <= material.restitution <= 1:
        raise InputError(f"material.restitution must lie in [0, 1], got {material.restitution:g}")
    if not (math.isfinite(material.ground_friction) and material.ground_friction >= 0):
        raise InputError(f"material.ground_friction must be 0 or more, got {material.ground_friction:g}")
    uses = MODELS[material.model].uses
    neutral = {field.name: field.default for field in fields(Material)}
    for name, (allows, allowed) in RULES.items():
        value = getattr(material, name)
        if name in uses and not allows(value):
            raise InputError(f"material.{name} of {material.model} must be {allowed}, got {value:g}")
        if name not in uses and value != neutral[name]:
            takes = f"it takes {', '.join(sorted(uses))}" if uses else "it takes no more than elasticity"
            raise InputError(f"material.{name} is not used by {material.model} ({takes}), got {value:g}; leave it out")


def lame_parameters(material: Material) -> tuple[float, float]:
    """(mu, lambda) [Pa] from Young's modulus and Poisson's ratio; mu is 0 for a fluid, lambda its bulk modulus."""
    check_material(material)
    e, nu = material.youngs_modulus, material.poisson_ratio
    mu = 0.0 if material.model == "fluid" else e / (2 * (1 + nu))
    return mu, e * nu / ((1 + nu) * (1 - 2 * nu))


def parameters(material: Material) -> Parameters:
    """The numbers that the material's model works with."""
    mu, lam = lame_parameters(material)
    flows_by_stress = "yield_stress" in MODELS[material.model].uses
    sine = math.sin(material.friction_angle)
    return Parameters(
        mu=mu,
        lam=lam,
        yield_stress=material.yield_stress if flows_by_stress else 0.0,
        hardening=material.hardening * (material.youngs_modulus if flows_by_stress else 1.0),
        viscosity=material.viscosity,
        friction=math.sqrt(2 / 3) * 2 * sine / (3 - sine),
        least_stretch=1 - material.critical_compression,
        most_stretch=1 + material.critical_stretch,
    )


def p_wave_speed(material: Material) -> float:
    """c = sqrt((lambda + 2 mu) / rho) [m/s], the fastest wave of the unstrained material."""
    mu, lam = lame_parameters(material)
    return math.sqrt((lam + 2 * mu) / material.density)


def rotation_of(deformation_gradient: Array) -> Array:
    """R of the polar decomposition F = R S, shape (..., 3, 3); det R = 1 also where F is inverted."""
    u, _, vt = _signed_svd(deformation_gradient)
    return u @ vt


def elastic_energy_density(material: Material, deformation_gradient: Array, hardening: Array | float = 0.0) -> Array:
    """psi(F) [J/m^3] of each elastic F, shape (...); `hardening` as in the state, shape (...)."""
    hardening = np.broadcast_to(hardening, deformation_gradient.shape[:-2])
    return MODELS[material.model].energy_density(parameters(material), deformation_gradient, hardening)


def kirchhoff_stress(
    material: Material,
    deformation_gradient: Array,
    velocity_gradient: Array | float = 0.0,
    hardening: Array | float = 0.0,
) -> Array:
    """tau [Pa] of each elastic F, shape (..., 3, 3), symmetric; the velocity gradient [1/s] counts in fluids alone."""
    velocity_gradient = np.broadcast_to(velocity_gradient, deformation_gradient.shape)
    hardening = np.broadcast_to(hardening, deformation_gradient.shape[:-2])
    model = MODELS[material.model]
    return model.kirchhoff_stress(parameters(material), deformation_gradient, velocity_gradient, hardening)


def return_map(material: Material, trial: Array, hardening: Array | float, dt: float) -> tuple[Array, Array]:
    """The elastic F (..., 3, 3) and `hardening` (...) that a step of `dt` [s] to the trial F (..., 3, 3) ends with."""
    hardening = np.broadcast_to(hardening, trial.shape[:-2])
    law = MODELS[material.model].return_map
    return (trial, hardening) if law is None else law(parameters(material), trial, hardening, dt)


def _require_positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive and finite [{unit}], got {value:g}")


def _signed_svd(f: Array) -> tuple[Array, Array, Array]:
    """U, sigma, V^T with rotations U and V; the last and smallest singular value has the sign of det F."""
    u, sigma, vt = np.linalg.svd(f)
    last = [1.0, 1.0, -1.0]
    mirrored_u, mirrored_v = np.linalg.det(u) < 0, np.linalg.det(vt) < 0
    u = np.where(mirrored_u[..., None, None], u * last, u)
    vt = np.where(mirrored_v[..., None, None], vt * np.reshape(last, (3, 1)), vt)
    return u, np.where((mirrored_u != mirrored_v)[..., None], sigma * last, sigma), vt


def _uncrushed_svd(f: Array) -> tuple[Array, Array, Array]:
    """The same, sigma raised to LEAST_STRETCH where F is crushed."""
    u, sigma, vt = _signed_svd(f)
    crushed = sigma.prod(-1, keepdims=True) <= CRUSHED_VOLUME
    return u, np.where(crushed, np.maximum(sigma, LEAST_STRETCH), sigma), vt


def _compose(u: Array, sigma: Array, vt: Array) -> Array:
    """U diag(sigma) V^T."""
    return (u * sigma[..., None, :]) @ vt


def _scaled(scalars: Array) -> Array:
    """scalars (...) times I."""
    return np.asarray(scalars)[..., None, None] * np.eye(3)


def _fixed_corotated_energy(p: Parameters, f: Array, hardening: Array) -> Array:
    # |F - R|^2 = sum (sigma_i - 1)^2: the singular values suffice.
    sigma = _signed_svd(f)[1]
    return p.mu * ((sigma - 1) ** 2).sum(-1) + p.lam / 2 * (sigma.prod(-1) - 1) ** 2


def _fixed_corotated_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    j = np.linalg.det(f)
    return 2 * p.mu * (f - rotation_of(f)) @ np.swapaxes(f, -1, -2) + _scaled(p.lam * j * (j - 1))


def _neo_hookean_energy(p: Parameters, f: Array, hardening: Array) -> Array:
    log_j = np.log(np.linalg.det(f))
    return p.mu / 2 * ((f**2).sum((-2, -1)) - 3 - 2 * log_j) + p.lam / 2 * log_j**2


def _neo_hookean_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    log_j = np.log(np.linalg.det(f))
    return p.mu * (f @ np.swapaxes(f, -1, -2) - np.eye(3)) + _scaled(p.lam * log_j)


def _hencky_energy(p: Parameters, f: Array, hardening: Array) -> Array:
    strain = np.log(np.linalg.svd(f, compute_uv=False))
    return p.mu * (strain**2).sum(-1) + p.lam / 2 * strain.sum(-1) ** 2


def _hencky_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    u, sigma, _ = np.linalg.svd(f)
    strain = np.log(sigma)
    return _compose(u, 2 * p.mu * strain + p.lam * strain.sum(-1, keepdims=True), np.swapaxes(u, -1, -2))


def _trial_strain(trial: Array) -> tuple[Array, Array, Array, Array, Array]:
    """U, V^T, the trace of the Hencky strain, its deviator and that one's norm."""
    u, sigma, vt = _uncrushed_svd(trial)
    strain = np.log(sigma)
    trace = strain.sum(-1)
    deviator = strain - trace[..., None] / 3
    return u, vt, trace, deviator, np.linalg.norm(deviator, axis=-1)


def _von_mises_return(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    # The flow D_p dt = gamma e/|e| leaves the stress s = 2 mu (e - gamma e/|e|), which the bound exceeds by 2 eta D_p.
    u, vt, trace, deviator, size = _trial_strain(trial)
    excess = 2 * p.mu * size - math.sqrt(2 / 3) * (p.yield_stress + p.hardening * hardening)
    gamma = np.maximum(excess, 0) / (2 * p.mu + 2 / 3 * p.hardening + 2 * p.viscosity / dt)
    deviator = deviator * (1 - gamma / np.maximum(size, 1e-300))[..., None]
    return _compose(u, np.exp(trace[..., None] / 3 + deviator), vt), hardening + math.sqrt(2 / 3) * gamma


def _drucker_prager_return(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    u, vt, trace, deviator, size = _trial_strain(trial)
    trace = trace + hardening
    apart = trace >= 0
    gamma = np.maximum(size + (3 * p.lam + 2 * p.mu) / (2 * p.mu) * p.friction * np.minimum(trace, 0), 0)
    deviator = deviator * (1 - gamma / np.maximum(size, 1e-300))[..., None]
    strain = np.where(apart[..., None], 0, trace[..., None] / 3 + deviator)
    return _compose(u, np.exp(strain), vt), np.where(apart, trace, 0)


def _hardened(p: Parameters, hardening: Array) -> Array:
    return np.exp(np.clip(-p.hardening * np.expm1(hardening), -MOST_HARDENED, MOST_HARDENED))


def _snow_energy(p: Parameters, f: Array, hardening: Array) -> Array:
    return _hardened(p, hardening) * _fixed_corotated_energy(p, f, hardening)


def _snow_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    return _hardened(p, hardening)[..., None, None] * _fixed_corotated_stress(p, f, velocity_gradient, hardening)


def _snow_return(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    u, sigma, vt = _uncrushed_svd(trial)
    clamped = np.clip(sigma, p.least_stretch, p.most_stretch)
    return _compose(u, clamped, vt), hardening + np.log(sigma / clamped).sum(-1)


def _fluid_energy(p: Parameters, f: Array, hardening: Array) -> Array:
    j = np.linalg.det(f)
    return p.lam / GAMMA * ((j ** (1 - GAMMA) - GAMMA) / (GAMMA - 1) + j)


def _fluid_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    j = np.linalg.det(f)
    rate = 0.5 * (velocity_gradient + np.swapaxes(velocity_gradient, -1, -2))
    rate = rate - _scaled(np.trace(rate, axis1=-2, axis2=-1) / 3)
    return _scaled(-j * p.lam / GAMMA * (j**-GAMMA - 1.0)) + 2 * p.viscosity * j[..., None, None] * rate


def _fluid_return(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    return _scaled(np.cbrt(np.maximum(np.linalg.det(trial), LEAST_VOLUME))), hardening


_BY_STRESS = frozenset({"yield_stress", "hardening"})
_SNOW = frozenset({"hardening", "critical_compression", "critical_stretch"})
MODELS = {
    "fixed_corotated": ConstitutiveModel(_fixed_corotated_energy, _fixed_corotated_stress),
    "neo_hookean": ConstitutiveModel(_neo_hookean_energy, _neo_hookean_stress),
    "von_mises": ConstitutiveModel(_hencky_energy, _hencky_stress, _von_mises_return, True, _BY_STRESS),
    "viscoplastic": ConstitutiveModel(
        _hencky_energy, _hencky_stress, _von_mises_return, True, _BY_STRESS | {"viscosity"}
    ),
    "drucker_prager": ConstitutiveModel(
        _hencky_energy, _hencky_stress, _drucker_prager_return, False, frozenset({"friction_angle"})
    ),
    "snow": ConstitutiveModel(_snow_energy, _snow_stress, _snow_return, True, _SNOW),
    "fluid": ConstitutiveModel(_fluid_energy, _fluid_stress, _fluid_return, False, frozenset({"viscosity"})),
}
FLOWS = frozenset(name for name, model in MODELS.items() if model.return_map is not None)
"""Models that need a return map."""
KEEPS_TOTAL = frozenset(name for name, model in MODELS.items() if model.keeps_total)
"""Those of them whose total F is tracked beside the elastic one."""
