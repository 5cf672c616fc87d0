"""Saint Venant and Kirchhoff's law: linear in the strain of Green, and too weak under pressure.

    psi = mu |E|^2 + lambda/2 tr(E)^2, E = (F^T F - I)/2
    tau = mu (b^2 - b) + lambda/2 (tr b - 3) b

Stiffness: a . Q a = 2 mu |D|^2 + lambda tr(D)^2 + n . tau n with D the symmetric part of F^T a (F^T n)^T, |D| <= B,
and n . tau n is at most mu (B^2 - B) + 3/2 lambda (B - 1) B for B >= 1.
"""

import numpy as np

from hoi.data import Array
from hoi.mpm.law import LAM, MU, Elastic, Kernels, Law
from hoi.mpm.tensors import transposed


def energy_density(p: Elastic, f: Array, hardening: Array) -> Array:
    strain = 0.5 * (transposed(f) @ f - np.eye(3))
    trace = np.trace(strain, axis1=-2, axis2=-1)
    return p.mu * (strain**2).sum((-2, -1)) + p.lam / 2 * trace**2


def kirchhoff_stress(p: Elastic, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    b = f @ transposed(f)
    trace = np.trace(b, axis1=-2, axis2=-1)[..., None, None]
    return p.mu * (b @ b - b) + p.lam / 2 * (trace - 3) * b


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import greatest

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        b = f @ f.transpose()
        return p[MU] * (b @ b - b) + 0.5 * p[LAM] * (b.trace() - 3.0) * b

    @ti.func
    def stiffness(f, j, p, hardening):
        most, lam = ti.max(greatest(f @ f.transpose()), 1.0), ti.max(p[LAM], 0.0)
        return (lam + 2.0 * p[MU]) * most * most + (p[MU] + 1.5 * lam) * (most - 1.0) * most

    return Kernels(stress, stiffness)


LAW = Law(energy_density, kirchhoff_stress, kernels)
