"""The constitutive models of `hoi.mpm.materials` in Taichi, with the bounds of their stiffness; formulas are there.

No model takes a singular value decomposition while it is elastic. fixed_corotated needs V alone, which is a polynomial
in b (Ting 1985, Determination of C^1/2, C^-1/2 and more general isotropic tensor functions of C). The Hencky strain is
atanh((b - I)(b + I)^-1), a power series that the theorem of Cayley and Hamilton reduces to three scalar recurrences;
only for stretches beyond 1.6 is b diagonalised. As F = V R, a return map to the strain eps* is F <- exp(eps* - eps) F.
Taichi's own SVD takes 2 to 4 times as long as a diagonalisation of b, and in float64 is exact to 1e-10 only.
"""

# Annotations of Taichi functions are values, not types, and what a Taichi expression is pyright cannot tell.
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false

import numpy as np
import taichi as ti
from taichi.lang import impl

from hoi.data import Material
from hoi.mpm import materials
from hoi.mpm.materials import CRUSHED_VOLUME, FLOWS, GAMMA, KEEPS_TOTAL, LEAST_STRETCH, LEAST_VOLUME, MOST_HARDENED

__all__ = ["FLOWS", "KEEPS_TOTAL", "PARAMETERS", "kirchhoff_stress", "parameters", "return_map", "stiffness"]

MU, LAM, YIELD_STRESS, HARDENING, VISCOSITY, FRICTION, LEAST, MOST = range(8)
"""Places of `hoi.mpm.materials.Parameters`."""
PARAMETERS = len(materials.Parameters._fields)
ROOT_2, ROOT_2_3 = 2**0.5, (2 / 3) ** 0.5


def parameters(material: Material) -> list[float]:
    """What the functions below take as `p`."""
    return list(materials.parameters(material))


def epsilon() -> float:
    """Of the float type that kernels are being compiled for."""
    return float(np.finfo(np.float64 if impl.get_runtime().default_fp == ti.f64 else np.float32).eps)


@ti.func
def identity():
    return ti.Matrix.identity(float, 3)


@ti.func
def times(a0, a1, a2, i1, i2, i3):
    """x (a0 x^2 + a1 x + a2) for a matrix x of invariants i1, i2, i3, as x^3 = i1 x^2 - i2 x + i3."""
    return a0 * i1 + a1, a2 - a0 * i2, a0 * i3


@ti.func
def polynomial(a0, a1, a2, x, square):
    """The matrix a0 x^2 + a1 x + a2."""
    return a0 * square + a1 * x + a2 * identity()


@ti.func
def invariants(x, square):
    """i1, i2, i3 of a symmetric x, whose square is given."""
    i1 = x.trace()
    return i1, 0.5 * (i1 * i1 - square.trace()), x.determinant()


@ti.func
def left_stretch(b, j, tolerance):
    """V = sqrt(b) for j = sqrt(det b) > 0.

    i1 = tr V is the largest root of (i1^2 - tr b)^2 / 4 = ii_b + 2 j i1. Newton's iteration comes down to it from its
    upper bound sqrt(3 tr b), which is exact without shear: 2 or 3 turns.
    """
    square = b @ b
    trace = b.trace()
    second = 0.5 * (trace * trace - square.trace())
    i1 = ti.sqrt(3.0 * trace)
    change = 1.0
    turns = 0
    while change > tolerance and turns < 40:
        rest = i1 * i1 - trace
        step = (0.25 * rest * rest - second - 2.0 * j * i1) / (i1 * rest - 2.0 * j)
        i1 -= step
        change = step * step / trace
        turns += 1
    i2 = 0.5 * (i1 * i1 - trace)
    return polynomial(-1.0, i1 * i1 - i2, i1 * j, b, square) / (i1 * i2 - j)


@ti.func
def rotation(a, b, off):
    """Cosine and sine of the turn that makes ((a, off), (off, b)) diagonal, and what it takes from a and gives to b."""
    difference, twice = b - a, 2.0 * off
    tangent = twice / (ti.abs(difference) + ti.sqrt(difference * difference + twice * twice) + 1e-30)
    if difference < 0.0:
        tangent = -tangent
    cosine = 1.0 / ti.sqrt(1.0 + tangent * tangent)
    return cosine, tangent * cosine, tangent * off


@ti.func
def turned(x, y, cosine, sine):
    return cosine * x - sine * y, sine * x + cosine * y


@ti.func
def eigenvectors(b):
    """Eigenvalues of a symmetric b, in no order, and their eigenvectors, by cyclic Jacobi rotations."""
    x, y, z = b[0, 0], b[1, 1], b[2, 2]
    xy, xz, yz = b[0, 1], b[0, 2], b[1, 2]
    u, v, w = ti.Vector([1.0, 0.0, 0.0]), ti.Vector([0.0, 1.0, 0.0]), ti.Vector([0.0, 0.0, 1.0])
    least = (ti.static(epsilon()) * (x + y + z)) ** 2
    sweeps = 0
    while xy * xy + xz * xz + yz * yz > least and sweeps < 10:
        cosine, sine, shift = rotation(x, y, xy)
        x, y, xy = x - shift, y + shift, 0.0
        xz, yz = turned(xz, yz, cosine, sine)
        u, v = turned(u, v, cosine, sine)
        cosine, sine, shift = rotation(x, z, xz)
        x, z, xz = x - shift, z + shift, 0.0
        xy, yz = turned(xy, yz, cosine, sine)
        u, w = turned(u, w, cosine, sine)
        cosine, sine, shift = rotation(y, z, yz)
        y, z, yz = y - shift, z + shift, 0.0
        xy, xz = turned(xy, xz, cosine, sine)
        v, w = turned(v, w, cosine, sine)
        sweeps += 1
    return x, y, z, u, v, w


@ti.func
def spectral(x, y, z, u, v, w):
    """The symmetric matrix of these eigenvalues and eigenvectors."""
    return x * u.outer_product(u) + y * v.outer_product(v) + z * w.outer_product(w)


@ti.func
def half_log(value):
    return 0.5 * ti.log(ti.max(value, 1e-30))


@ti.func
def hencky_strain(b):
    """log(b) / 2, singular b excepted."""
    x = identity() - 2.0 * (b + identity()).inverse()
    square = x @ x
    size = square.trace()
    strain = x
    if size < 0.1:
        i1, i2, i3 = invariants(x, square)
        p0, p1, p2 = 0.0, 1.0, 0.0
        t0, t1, t2 = 0.0, 1.0, 0.0
        bound = size
        order = 1.0
        while bound > ti.static(epsilon() ** 2):
            p0, p1, p2 = times(p0, p1, p2, i1, i2, i3)
            p0, p1, p2 = times(p0, p1, p2, i1, i2, i3)
            order += 2.0
            t0 += p0 / order
            t1 += p1 / order
            t2 += p2 / order
            bound *= size
        strain = polynomial(t0, t1, t2, x, square)
    else:
        x1, y1, z1, u, v, w = eigenvectors(b)
        strain = spectral(half_log(x1), half_log(y1), half_log(z1), u, v, w)
    return strain


@ti.func
def exponential(x):
    """exp of a symmetric x: Taylor's series of x / 2^n, |x| / 2^n < 1/2, squared n times."""
    size = x.norm_sqr()
    halvings = 0
    while size > 0.25 and halvings < 10:
        size *= 0.25
        halvings += 1
    scaled = 0.5**halvings * x
    square = scaled @ scaled
    i1, i2, i3 = invariants(scaled, square)
    p0, p1, p2 = 0.0, 1.0, 0.0
    t0, t1, t2 = 0.0, 1.0, 1.0
    bound = size
    order = 1.0
    while bound > ti.static(epsilon() ** 2):
        order += 1.0
        p0, p1, p2 = times(p0 / order, p1 / order, p2 / order, i1, i2, i3)
        t0 += p0
        t1 += p1
        t2 += p2
        bound *= size / (order * order)
    result = polynomial(t0, t1, t2, scaled, square)
    for _ in range(halvings):
        result = result @ result
    return result


@ti.func
def uncrushed(f):
    """F turned right side out: as U diag(sigma) V^T with rotations U, V and sigma raised to LEAST_STRETCH."""
    u, sigma, v = ti.svd(f)
    for i in ti.static(range(3)):
        sigma[i, i] = ti.max(sigma[i, i], LEAST_STRETCH)
    return u @ sigma @ v.transpose()


@ti.func
def hardened(p, hardening):
    """Factor on the stiffness of snow."""
    exponent = p[HARDENING] * (1.0 - ti.exp(hardening))
    return ti.exp(ti.min(ti.max(exponent, -MOST_HARDENED), MOST_HARDENED))


@ti.func
def clamping(square, p):
    """What brings a singular value, whose square is given, to where snow can bear it."""
    stretch = ti.sqrt(ti.max(square, 1e-30))
    return ti.min(ti.max(stretch, p[LEAST]), p[MOST]) / stretch


@ti.func
def kirchhoff_stress(model: ti.template(), f, j, c, p, hardening, tolerance):
    """tau [Pa] of the model of that name.

    Args:
        model: compile-time string.
        f: elastic F, 3x3.
        j: its determinant, > 0.
        c: velocity gradient [1/s], 3x3; counts in fluids.
        p: `parameters` of the material.
        hardening: of the particle.
        tolerance: machine epsilon.
    """
    b = f @ f.transpose()
    tau = ti.Matrix.zero(float, 3, 3)
    if ti.static(model in ("fixed_corotated", "snow")):
        tau = 2.0 * p[MU] * (b - left_stretch(b, j, tolerance)) + p[LAM] * j * (j - 1.0) * identity()
        if ti.static(model == "snow"):
            tau *= hardened(p, hardening)
    elif ti.static(model == "neo_hookean"):
        tau = p[MU] * (b - identity()) + p[LAM] * ti.log(j) * identity()
    elif ti.static(model in ("von_mises", "viscoplastic", "drucker_prager")):
        strain = hencky_strain(b)
        tau = 2.0 * p[MU] * strain + p[LAM] * strain.trace() * identity()
    elif ti.static(model == "fluid"):
        inverse = 1.0 / j
        pressure = p[LAM] / GAMMA * (inverse**GAMMA - 1.0)
        tau = p[VISCOSITY] * j * (c + c.transpose() - 2.0 / 3.0 * c.trace() * identity()) - j * pressure * identity()
    else:
        ti.static_assert(False, "no kernel for this model")
    return tau


@ti.func
def return_map(model: ti.template(), f_trial, hardening, p, dt):
    """The elastic F and the hardening after a step of dt [s] whose elastic F would be `f_trial`."""
    f, h = f_trial, hardening
    if ti.static(model == "fluid"):
        j = ti.max(f.determinant(), LEAST_VOLUME)
        root = ti.pow(j, 1.0 / 3.0)
        root -= (root * root * root - j) / (3.0 * root * root)  # pow is a digit off: at rest J would creep
        f = root * identity()
    elif ti.static(model in FLOWS):
        if f.determinant() <= CRUSHED_VOLUME:
            f = uncrushed(f)
        b = f @ f.transpose()
        if ti.static(model == "snow"):
            strain = b - identity()
            safe = 1.0 - ti.max(p[LEAST], 2.0 - p[MOST]) ** 2  # no square of a singular value within is out of bounds
            if (strain @ strain).trace() > safe * safe:
                x, y, z, u, v, w = eigenvectors(b)
                rx, ry, rz = clamping(x, p), clamping(y, p), clamping(z, p)
                f = spectral(rx, ry, rz, u, v, w) @ f
                h -= ti.log(rx * ry * rz)
        else:
            strain = hencky_strain(b)
            trace = strain.trace()
            deviator = strain - trace / 3.0 * identity()
            size = deviator.norm()
            change = ti.Matrix.zero(float, 3, 3)
            if ti.static(model == "drucker_prager"):
                trace += h
                if trace >= 0.0:
                    change = -1.0 * strain
                    h = trace
                else:
                    gamma = size + (3.0 * p[LAM] + 2.0 * p[MU]) / (2.0 * p[MU]) * p[FRICTION] * trace
                    change = h / 3.0 * identity() - ti.max(gamma, 0.0) / ti.max(size, 1e-30) * deviator
                    h = 0.0
            else:
                excess = 2.0 * p[MU] * size - ROOT_2_3 * (p[YIELD_STRESS] + p[HARDENING] * h)
                if excess > 0.0:
                    gamma = excess / (2.0 * p[MU] + 2.0 / 3.0 * p[HARDENING] + 2.0 * p[VISCOSITY] / dt)
                    change = -gamma / size * deviator
                    h += ROOT_2_3 * gamma
            if change.norm_sqr() > 0.0:
                f = exponential(change) @ f
    return f, h


@ti.func
def greatest(b):
    """An upper bound of the eigenvalues of a symmetric b, exact without shear and when two agree in the right way."""
    mean = b.trace() / 3.0
    return mean + ROOT_2_3 * (b - mean * identity()).norm()


@ti.func
def stiffness(model: ti.template(), f, j, p, hardening):
    """M [Pa], an upper bound of rho_0 c^2 for every wave in the deformed state; lambda + 2 mu at rest for nu >= 0.

    It is the bound B_c below and the norm of tau: where a body is so strained that its stress is not small beside B_c,
    the grid is stiffer than the material, as forces change with where in its cell a particle is. Measured, the norm of
    tau is enough to make up for that (`hoi.mpm.stability`).

    c is in present lengths: rho_0 c^2 is the greatest eigenvalue of Q with a . Q a = d^2/ds^2 psi((I + s a n^T) F)
    at s = 0, over unit normals n. With t = a . n and the eigenvalues of b at most B:

    neo_hookean: a . Q a = mu n . b n + (mu + lambda (1 - log J)) t^2, as d^2 |F|^2 = 2 n . b n, d log J = t and
    d^2 log J = -t^2. So B_c = mu B + max(0, mu + lambda (1 - log J)).
    fixed_corotated: psi = mu (|F|^2 - 2 tr V + 3) + lambda/2 (J - 1)^2. tr V is convex in F, and J linear in s with
    slope J t. So B_c = 2 mu B + max(0, lambda) J^2. Snow: h times that.
    Hencky: with eigenvalues tau_i of tau and x_ij = log(b_i/b_j), in their frame
    a . Q a = lambda t^2 + 2 mu sum a_i^2 n_i^2 + sum_{i != j} g_ij (a_i^2 n_j^2 + a_i n_i a_j n_j) - t a . tau n,
    g_ij = mu x_ij / (exp(x_ij) - 1). The mean of g_ij and g_ji is mu y coth(y) <= mu sqrt(1 + y^2) =: g, with y the
    difference of the two strains, at most sqrt(2) |e|; half their difference is mu y. So the sums are at most
    g (1 + t^2) + mu y. The last term is at most max(0, -least tau_i) + mu y / 4: for symmetric s >= 0 with eigenvalues
    up to r, -t a . s n <= (|s n| - n . s n) / 2 <= r / 8. So
    B_c = lambda + 2 mu sqrt(1 + y^2) + 5/4 mu y + max(0, -least tau_i). Flowing only softens it.
    fluid: B_c = J^2 psi''(J) = K J^(1 - g). Viscosity limits the step apart from this (`hoi.mpm.stability`).
    """
    m = 0.0
    if ti.static(model == "fluid"):
        m = p[LAM] * (1.0 / j) ** (GAMMA - 1)
    else:
        b = f @ f.transpose()
        if ti.static(model in ("fixed_corotated", "snow")):
            m = 2.0 * p[MU] * greatest(b) + ti.max(p[LAM], 0.0) * j * j
            if ti.static(model == "snow"):
                m *= hardened(p, hardening)
        elif ti.static(model == "neo_hookean"):
            m = p[MU] * greatest(b) + ti.max(p[MU] + p[LAM] * (1.0 - ti.log(j)), 0.0)
        else:
            strain = hencky_strain(b)
            mean = strain.trace() / 3.0
            size = (strain - mean * identity()).norm()
            y = ROOT_2 * size
            least = 3.0 * p[LAM] * mean + 2.0 * p[MU] * (mean - ROOT_2_3 * size)
            m = p[LAM] + p[MU] * (2.0 * ti.sqrt(1.0 + y * y) + 1.25 * y) + ti.max(-least, 0.0)
    at_rest = ti.Matrix.zero(float, 3, 3)
    return m + kirchhoff_stress(model, f, j, at_rest, p, hardening, ti.static(epsilon())).norm()
