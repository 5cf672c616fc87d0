"""Snow: fixed corotated, but its singular values break, and it hardens by being pressed.

    psi, tau = h times those of `hoi.mpm.laws.fixed_corotated`, and so its stiffness
    singular values of F clamped to [1 - critical_compression, 1 + critical_stretch]

log J_P is left behind by the flow. h = exp(hardening (1 - J_P)), bounded to [1/10, 10]: without a bound it is 22,000
for snow pressed to nothing, and the time step falls with its root. Stomakhin et al. 2013, A Material Point Method for
Snow Simulation.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Material
from hoi.mpm.law import Kernels, Law, lame
from hoi.mpm.laws import fixed_corotated
from hoi.mpm.tensors import composed, uncrushed_svd

MOST_HARDENED = math.log(10)
"""Largest magnitude of the exponent hardening (1 - J_P) [-]."""
XI, LEAST, MOST = 2, 3, 4


class Parameters(NamedTuple):
    mu: float
    lam: float
    xi: float
    """`hardening` of the material [-]."""
    least_stretch: float
    """1 - critical_compression [-]."""
    most_stretch: float
    """1 + critical_stretch [-]."""


def parameters(material: Material) -> Parameters:
    least, most = 1 - material.critical_compression, 1 + material.critical_stretch
    return Parameters(*lame(material), material.hardening, least, most)


def hardened(p: Parameters, hardening: Array) -> Array:
    """h, the factor on the stiffness."""
    return np.exp(np.clip(-p.xi * np.expm1(hardening), -MOST_HARDENED, MOST_HARDENED))


def energy_density(p: Parameters, f: Array, hardening: Array) -> Array:
    return hardened(p, hardening) * fixed_corotated.energy_density(p, f, hardening)


def kirchhoff_stress(p: Parameters, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    unhardened = fixed_corotated.kirchhoff_stress(p, f, velocity_gradient, hardening)
    return hardened(p, hardening)[..., None, None] * unhardened


def return_map(p: Parameters, trial: Array, hardening: Array, dt: float) -> tuple[Array, Array]:
    u, sigma, vt = uncrushed_svd(trial)
    clamped = np.clip(sigma, p.least_stretch, p.most_stretch)
    return composed(u, clamped, vt), hardening + np.log(sigma / clamped).sum(-1)


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import eigenvectors, identity, spectral, uncrushed

    unhardened = fixed_corotated.kernels()

    @ti.func
    def factor(p, hardening):
        exponent = p[XI] * (1.0 - ti.exp(hardening))
        return ti.exp(ti.min(ti.max(exponent, -MOST_HARDENED), MOST_HARDENED))

    @ti.func
    def clamping(square, p):
        """What brings a singular value, whose square is given, to where snow can bear it."""
        stretch = ti.sqrt(ti.max(square, 1e-30))
        return ti.min(ti.max(stretch, p[LEAST]), p[MOST]) / stretch

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        return unhardened.stress(f, j, c, p, hardening, tolerance) * factor(p, hardening)

    @ti.func
    def stiffness(f, j, p, hardening):
        return unhardened.stiffness(f, j, p, hardening) * factor(p, hardening)

    @ti.func
    def returned(f_trial, hardening, p, dt):
        f, h = uncrushed(f_trial), hardening
        b = f @ f.transpose()
        strain = b - identity()
        safe = 1.0 - ti.max(p[LEAST], 2.0 - p[MOST]) ** 2  # no square of a singular value within is out of bounds
        if (strain @ strain).trace() > safe * safe:
            x, y, z, u, v, w = eigenvectors(b)
            rx, ry, rz = clamping(x, p), clamping(y, p), clamping(z, p)
            f = spectral(rx, ry, rz, u, v, w) @ f
            h -= ti.log(rx * ry * rz)
        return f, h

    return Kernels(stress, stiffness, returned)


def clamped(p: Parameters, f: Array, hardening: Array) -> NDArray[Any]:
    return abs(p.xi * np.expm1(hardening)) >= MOST_HARDENED


LAW = Law(
    energy_density, kirchhoff_stress, kernels, return_map, parameters, clamped=clamped,
    uses=frozenset({"hardening", "critical_compression", "critical_stretch"}), keeps_total=True, rigid=False, order=6,
)  # fmt: skip
