"""Von Mises plasticity in Hencky strain: metal.

    elastic as `hoi.mpm.hencky`
    abs(2 mu e) <= sqrt(2/3) (yield_stress + hardening E a), else e shrinks to it, at constant volume

a, what is left behind by the flow, is the equivalent plastic strain, so that `hardening` of the material is the plastic
modulus as a share of Young's modulus. `yield_stress` is that of a bar that is pulled; sheared, it yields at
yield_stress / sqrt(3). The return map is that of Simo and Hughes 1998, Computational Inelasticity, box 3.1, in Hencky
strain, where it is exact for finite strain; with the overstress of Perzyna it is the viscoplastic one (ibid., section
2.7). Flowing only softens the body.
"""

import math
from typing import NamedTuple

import numpy as np

from hoi.data import Array, Material
from hoi.mpm.hencky import crushed, energy_density, flow, kirchhoff_stress, trial_strain
from hoi.mpm.law import MU, Kernels, Law, lame
from hoi.mpm.tensors import composed

YIELD_STRESS, PLASTIC_MODULUS, VISCOSITY = 2, 3, 4


class Parameters(NamedTuple):
    mu: float
    lam: float
    yield_stress: float
    """[Pa]."""
    plastic_modulus: float
    """[Pa]."""
    viscosity: float
    """[Pa s], 0 where the flow takes no time."""


def parameters(material: Material) -> Parameters:
    plastic_modulus = material.hardening * material.youngs_modulus
    return Parameters(*lame(material), material.yield_stress, plastic_modulus, material.viscosity)


def return_map(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    # The flow D_p dt = gamma e/|e| leaves the stress s = 2 mu (e - gamma e/|e|), which the bound exceeds by 2 eta D_p.
    u, vt, trace, deviator, size = trial_strain(trial)
    excess = 2 * p.mu * size - math.sqrt(2 / 3) * (p.yield_stress + p.plastic_modulus * hardening)
    gamma = np.maximum(excess, 0) / (2 * p.mu + 2 / 3 * p.plastic_modulus + 2 * p.viscosity / dt)
    deviator = deviator * (1 - gamma / np.maximum(size, 1e-300))[..., None]
    return composed(u, np.exp(trace[..., None] / 3 + deviator), vt), hardening + math.sqrt(2 / 3) * gamma


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import ROOT_2_3

    @ti.func
    def plastic(strain, deviator, size, h, p, dt):
        change = ti.Matrix.zero(float, 3, 3)
        excess = 2.0 * p[MU] * size - ROOT_2_3 * (p[YIELD_STRESS] + p[PLASTIC_MODULUS] * h)
        if excess > 0.0:
            gamma = excess / (2.0 * p[MU] + 2.0 / 3.0 * p[PLASTIC_MODULUS] + 2.0 * p[VISCOSITY] / dt)
            change = -gamma / size * deviator
            h += ROOT_2_3 * gamma
        return change, h

    return flow(plastic)


LAW = Law(
    energy_density, kirchhoff_stress, kernels, return_map, parameters, clamped=crushed,
    uses=frozenset({"yield_stress", "hardening"}), keeps_total=True, springs=True, order=3,
)  # fmt: skip
