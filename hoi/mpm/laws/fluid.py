"""A weakly compressible fluid: water.

    psi = K/g (J^(1-g)/(g-1) + J - g/(g-1)) for J <= 1, else 0, g = 7
    tau = -J p I + 2 eta J dev(sym C), p = max(K/g (J^-g - 1), 0)
    F = J^(1/3) I, J >= 0.5

It bears no tension: drops come off a surface freely, and the volume gained there is lost again before they press.

K is lambda, eta the viscosity, C the velocity gradient. Tampubolon et al. 2017, Multi-species Simulation of Porous Sand
and Water Mixtures, with Newtonian viscosity. Stiffness: B_c = J^2 psi''(J) = K J^(1 - g). Viscosity limits the step
apart from this (`hoi.mpm.stability`).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Material
from hoi.mpm.law import LAM, Kernels, Law, lame
from hoi.mpm.tensors import scaled, transposed

LEAST_VOLUME = 0.5
"""Least J [-]: 18 K of pressure."""
GAMMA = 7
"""Exponent of Tait's equation [-]."""
VISCOSITY = 2


class Parameters(NamedTuple):
    mu: float
    """0: it bears no shear at rest."""
    lam: float
    """Bulk modulus [Pa]."""
    viscosity: float
    """[Pa s]."""


def parameters(material: Material) -> Parameters:
    return Parameters(0.0, lame(material).lam, material.viscosity)


def energy_density(p: Parameters, f: Array, hardening: Array) -> Array:
    j = np.minimum(np.linalg.det(f), 1.0)
    return p.lam / GAMMA * ((j ** (1 - GAMMA) - GAMMA) / (GAMMA - 1) + j)


def kirchhoff_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    j = np.linalg.det(f)
    rate = 0.5 * (velocity_gradient + transposed(velocity_gradient))
    rate = rate - scaled(np.trace(rate, axis1=-2, axis2=-1) / 3)
    return scaled(-j * p.lam / GAMMA * np.maximum(j**-GAMMA - 1.0, 0.0)) + 2 * p.viscosity * j[..., None, None] * rate


def return_map(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    return scaled(np.cbrt(np.maximum(np.linalg.det(trial), LEAST_VOLUME))), hardening


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import identity

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        inverse = 1.0 / j
        pressure = p[LAM] / GAMMA * ti.max(inverse**GAMMA - 1.0, 0.0)
        rate = c + c.transpose() - 2.0 / 3.0 * c.trace() * identity()
        return p[VISCOSITY] * j * rate - j * pressure * identity()

    @ti.func
    def stiffness(f, j, p, hardening):
        return p[LAM] * (1.0 / j) ** (GAMMA - 1)

    @ti.func
    def returned(f_trial, hardening, p, dt):
        j = ti.max(f_trial.determinant(), LEAST_VOLUME)
        root = ti.pow(j, 1.0 / 3.0)
        root -= (root * root * root - j) / (3.0 * root * root)  # pow is a digit off: at rest J would creep
        return root * identity(), hardening

    return Kernels(stress, stiffness, returned)


def clamped(p: Parameters, f: Array, hardening: Array) -> NDArray[Any]:
    return np.linalg.det(f) <= LEAST_VOLUME * (1 + 1e-5)


LAW = Law(
    energy_density, kirchhoff_stress, kernels, return_map, parameters, clamped=clamped,
    uses=frozenset({"viscosity"}), rigid=False, shears=False, seeps=True, viscous=True, order=7,
)  # fmt: skip
