"""Elasticity in the Hencky strain, and the flow of what is elastic so.

    psi = mu |eps|^2 + lambda/2 tr(eps)^2
    tau = 2 mu eps + lambda tr(eps) I

Stiffness: with eigenvalues tau_i of tau and x_ij = log(b_i/b_j), in their frame
a . Q a = lambda t^2 + 2 mu sum a_i^2 n_i^2 + sum_{i != j} g_ij (a_i^2 n_j^2 + a_i n_i a_j n_j) - t a . tau n,
g_ij = mu x_ij / (exp(x_ij) - 1). The mean of g_ij and g_ji is mu y coth(y) <= mu sqrt(1 + y^2) =: g, with y the
difference of the two strains, at most sqrt(2) |e|; half their difference is mu y. So the sums are at most
g (1 + t^2) + mu y. The last term is at most max(0, -least tau_i) + mu y / 4: for symmetric s >= 0 with eigenvalues
up to r, -t a . s n <= (|s n| - n . s n) / 2 <= r / 8. So
B_c = lambda + 2 mu sqrt(1 + y^2) + 5/4 mu y + max(0, -least tau_i). Flowing only softens it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array
from hoi.mpm.law import LAM, MU, Elastic, Kernels
from hoi.mpm.tensors import LEAST_STRETCH, composed, transposed, uncrushed_svd


def energy_density(p: Elastic, f: Array, hardening: Array) -> Array:
    """As `Law.energy_density`."""
    strain = np.log(np.linalg.svd(f, compute_uv=False))
    return p.mu * (strain**2).sum(-1) + p.lam / 2 * strain.sum(-1) ** 2


def kirchhoff_stress(p: Elastic, f: Array, velocity_gradient: Array, hardening: Array) -> Array:
    """As `Law.kirchhoff_stress`."""
    u, sigma, _ = np.linalg.svd(f)
    strain = np.log(sigma)
    return composed(u, 2 * p.mu * strain + p.lam * strain.sum(-1, keepdims=True), transposed(u))


def trial_strain(trial: Array) -> tuple[Array, Array, Array, Array, Array]:
    """U, V^T, the trace of the Hencky strain, its deviator and that one's norm."""
    u, sigma, vt = uncrushed_svd(trial)
    strain = np.log(sigma)
    trace = strain.sum(-1)
    deviator = strain - trace[..., None] / 3
    return u, vt, trace, deviator, np.linalg.norm(deviator, axis=-1)


def crushed(p: Elastic, f: Array, hardening: Array) -> NDArray[Any]:
    """As `Law.clamped`: a singular value has been raised to the least."""
    return np.linalg.svd(f, compute_uv=False).min(-1) <= LEAST_STRETCH * (1 + 1e-5)


def flow(plastic: Callable[..., Any]) -> Kernels:
    """The kernels of a law of this elasticity.

    Args:
        plastic: function of the kernel compiler, (eps, e, |e|, hardening, p, dt) -> (what the flow adds to eps,
            hardening).
    """
    from hoi.compute import ti
    from hoi.mpm.tensor_kernels import ROOT_2, ROOT_2_3, exponential, hencky_strain, identity, uncrushed

    @ti.func
    def stress(f, j, c, p, hardening, tolerance):
        strain = hencky_strain(f @ f.transpose())
        return 2.0 * p[MU] * strain + p[LAM] * strain.trace() * identity()

    @ti.func
    def stiffness(f, j, p, hardening):
        strain = hencky_strain(f @ f.transpose())
        mean = strain.trace() / 3.0
        size = (strain - mean * identity()).norm()
        y = ROOT_2 * size
        least = 3.0 * p[LAM] * mean + 2.0 * p[MU] * (mean - ROOT_2_3 * size)
        return p[LAM] + p[MU] * (2.0 * ti.sqrt(1.0 + y * y) + 1.25 * y) + ti.max(-least, 0.0)

    @ti.func
    def return_map(f_trial, hardening, p, dt):
        f = uncrushed(f_trial)
        strain = hencky_strain(f @ f.transpose())
        deviator = strain - strain.trace() / 3.0 * identity()
        change, h = plastic(strain, deviator, deviator.norm(), hardening, p, dt)
        if change.norm_sqr() > 0.0:
            f = exponential(change) @ f
        return f, h

    return Kernels(stress, stiffness, return_map)
