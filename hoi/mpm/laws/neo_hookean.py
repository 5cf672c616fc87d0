"""Neo-Hookean elasticity: rubber, which stiffens without bound as J -> 0.

    psi = mu/2 (|F|^2 - 3 - 2 log J) + lambda/2 log^2 J
    tau = mu (b - I) + lambda log J I

Stiffness: a . Q a = mu n . b n + (mu + lambda (1 - log J)) t^2, as d^2 |F|^2 = 2 n . b n, d log J = t and
d^2 log J = -t^2. So B_c = mu B + max(0, mu + lambda (1 - log J)).
"""

import numpy as np

from hoi.data import Array
from hoi.mpm.law import LAM, MU, Elastic, Kernels, Law
from hoi.mpm.tensors import scaled, transposed


def energy_density(p: Elastic, f: Array, hardening: Array) -> Array:
    log_j = np.log(np.linalg.det(f))
    return p.mu / 2 * ((f**2).sum((-2, -1)) - 3 - 2 * log_j) + p.lam / 2 * log_j**2


def kirchhoff_stress(p: Elastic, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    log_j = np.log(np.linalg.det(f))
    return p.mu * (f @ transposed(f) - np.eye(3)) + scaled(p.lam * log_j)


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import greatest, identity

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        return p[MU] * (f @ f.transpose() - identity()) + p[LAM] * ti.log(j) * identity()

    @ti.func
    def stress_columns(f0, f1, f2, j, p):
        mu, pressure = p[MU], p[LAM] * ti.log(j) - p[MU]
        t0 = mu * (f0[0] * f0 + f1[0] * f1 + f2[0] * f2) + ti.Vector([pressure, 0.0, 0.0, 0.0])
        t1 = mu * (f0[1] * f0 + f1[1] * f1 + f2[1] * f2) + ti.Vector([0.0, pressure, 0.0, 0.0])
        t2 = mu * (f0[2] * f0 + f1[2] * f1 + f2[2] * f2) + ti.Vector([0.0, 0.0, pressure, 0.0])
        return t0, t1, t2

    @ti.func
    def stiffness(f, j, p, hardening):
        return p[MU] * greatest(f @ f.transpose()) + ti.max(p[MU] + p[LAM] * (1.0 - ti.log(j)), 0.0)

    return Kernels(stress, stiffness, stress_columns=stress_columns)


LAW = Law(energy_density, kirchhoff_stress, kernels, springs=True, order=2)
