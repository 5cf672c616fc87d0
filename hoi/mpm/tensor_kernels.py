"""Tensors in the kernels: what the laws' functions there have in common.

No law takes a singular value decomposition while it is elastic. Fixed corotated needs V alone, which is a polynomial in
b (Ting 1985, Determination of C^1/2, C^-1/2 and more general isotropic tensor functions of C). The Hencky strain is
atanh((b - I)(b + I)^-1), a power series that the theorem of Cayley and Hamilton reduces to three scalar recurrences;
only for stretches beyond 1.6 is b diagonalised. As F = V R, a return map to the strain eps* is F <- exp(eps* - eps) F.
Taichi's own SVD takes 2 to 4 times as long as a diagonalisation of b, and in float64 is exact to 1e-10 only.
"""

import numpy as np

from hoi.compute import default_float, ti
from hoi.mpm.tensors import CRUSHED_VOLUME, LEAST_STRETCH

ROOT_2, ROOT_2_3 = 2**0.5, (2 / 3) ** 0.5


def epsilon() -> float:
    """Of the float type that kernels are being compiled for."""
    return float(np.finfo(default_float()).eps)


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
    """F, turned right side out where crushed: U diag(sigma) V^T, rotations U and V, sigma raised to LEAST_STRETCH."""
    if f.determinant() <= CRUSHED_VOLUME:
        u, sigma, v = ti.svd(f)
        for i in ti.static(range(3)):
            sigma[i, i] = ti.max(sigma[i, i], LEAST_STRETCH)
        f = u @ sigma @ v.transpose()
    return f


@ti.func
def greatest(b):
    """An upper bound of the eigenvalues of a symmetric b, exact without shear and when two agree in the right way."""
    mean = b.trace() / 3.0
    return mean + ROOT_2_3 * (b - mean * identity()).norm()
