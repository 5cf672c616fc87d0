"""Drucker-Prager plasticity in Hencky strain: sand.

    elastic as `hoi.mpm.hencky`
    abs(e) + (3 lambda + 2 mu)/(2 mu) alpha tr(eps) <= 0, else e shrinks; no tension

alpha is sqrt(2)/3 sin(phi) for the friction angle phi, so that sqrt(J_2) = sin(phi) p: as strong as Mohr and Coulomb's
material in plane strain and in simple shear at constant volume, which is how heaps slide and columns spread (Chen and
Mizuno 1990, Nonlinear Analysis in Soil Mechanics). The cone through the corners of triaxial compression, usual in
computer graphics, is 1.4 times as strong there: grains of 33 degrees then stand as if of 50. Klar et al. 2016,
Drucker-Prager Elastoplasticity for Sand Animation, with its volume correction: the volume that grains gained while
apart, which is what is left behind by the flow, is lost again before they press.
"""

import math
from typing import NamedTuple

import numpy as np

from hoi.data import Array, Material
from hoi.mpm.hencky import crushed, energy_density, flow, kirchhoff_stress, trial_strain
from hoi.mpm.law import LAM, MU, Kernels, Law, lame
from hoi.mpm.tensors import composed

FRICTION = 2


class Parameters(NamedTuple):
    mu: float
    lam: float
    friction: float
    """alpha [-]."""


def parameters(material: Material) -> Parameters:
    sine = math.sin(material.friction_angle)
    return Parameters(*lame(material), friction=math.sqrt(2) / 3 * sine)


def return_map(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    u, vt, trace, deviator, size = trial_strain(trial)
    trace = trace + hardening
    apart = trace >= 0
    gamma = np.maximum(size + (3 * p.lam + 2 * p.mu) / (2 * p.mu) * p.friction * np.minimum(trace, 0), 0)
    deviator = deviator * (1 - gamma / np.maximum(size, 1e-300))[..., None]
    strain = np.where(apart[..., None], 0, trace[..., None] / 3 + deviator)
    return composed(u, np.exp(strain), vt), np.where(apart, trace, 0)


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import identity

    @ti.func
    def plastic(strain, deviator, size, h, p, dt):
        change = ti.Matrix.zero(float, 3, 3)
        trace = strain.trace() + h
        if trace >= 0.0:
            change = -1.0 * strain
            h = trace
        else:
            gamma = size + (3.0 * p[LAM] + 2.0 * p[MU]) / (2.0 * p[MU]) * p[FRICTION] * trace
            change = h / 3.0 * identity() - ti.max(gamma, 0.0) / ti.max(size, 1e-30) * deviator
            h = 0.0
        return change, h

    return flow(plastic)


LAW = Law(
    energy_density, kirchhoff_stress, kernels, return_map, parameters, clamped=crushed,
    uses=frozenset({"friction_angle"}), rigid=False, seeps=True, order=5,
)  # fmt: skip
