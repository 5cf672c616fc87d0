"""Fixed corotated elasticity: what PhysGaussian, and so the paper, calls jelly.

    psi = mu |F - R|^2 + lambda/2 (J - 1)^2
    tau = 2 mu (b - V) + lambda J (J - 1) I

Stomakhin et al. 2012, Energetically Consistent Invertible Elasticity. Stiffness: psi = mu (|F|^2 - 2 tr V + 3) +
lambda/2 (J - 1)^2. tr V is convex in F, and J linear in s with slope J t. So B_c = 2 mu B + max(0, lambda) J^2.
"""

import numpy as np

from hoi.data import Array
from hoi.mpm.law import LAM, MU, Elastic, Kernels, Law
from hoi.mpm.tensors import rotation_of, scaled, signed_svd, transposed


def energy_density(p: Elastic, f: Array, hardening: Array) -> Array:
    # |F - R|^2 = sum (sigma_i - 1)^2: the singular values suffice.
    sigma = signed_svd(f)[1]
    return p.mu * ((sigma - 1) ** 2).sum(-1) + p.lam / 2 * (sigma.prod(-1) - 1) ** 2


def kirchhoff_stress(p: Elastic, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    j = np.linalg.det(f)
    return 2 * p.mu * (f - rotation_of(f)) @ transposed(f) + scaled(p.lam * j * (j - 1))


def kernels() -> Kernels:
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import greatest, identity, left_stretch

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        b = f @ f.transpose()
        return 2.0 * p[MU] * (b - left_stretch(b, j, tolerance)) + p[LAM] * j * (j - 1.0) * identity()

    @ti.func
    def stiffness(f, j, p, hardening):
        return 2.0 * p[MU] * greatest(f @ f.transpose()) + ti.max(p[LAM], 0.0) * j * j

    return Kernels(stress, stiffness)


LAW = Law(energy_density, kirchhoff_stress, kernels, springs=True, order=1)
