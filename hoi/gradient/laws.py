"""What a small change of an elastic stress is worth: the laws' functions, taken backwards.

Given T, the derivative of a number with respect to tau(F), each gives those with respect to F and to the law's own
numbers. tau is symmetric, so that of T only the symmetric part counts. With b = F F^T = V^2, F = V R and cof F = J F^-T

    neo-Hookean      F' = 2 mu T F + lambda tr T / J cof F
    fixed corotated  F' = 2 mu (2 T F - (T - W) R) + lambda (2 J - 1) tr T cof F

W is skew with V W + W V = V T - T V, that is with the axial vector (tr V I - V)^-1 axl(V T - T V): then
(T - W) V^-1 / 2 solves X V + V X = T, as the derivative of V = sqrt(b) asks for. It takes no singular values, and is
exact where they coincide.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from collections.abc import Callable
from typing import Any, NamedTuple

from hoi.compute import ti
from hoi.mpm.damping import LEAST_ENERGY
from hoi.mpm.law import LAM, MU
from hoi.mpm.tensor_kernels import identity, left_stretch


@ti.func
def symmetric(t):
    return 0.5 * (t + t.transpose())


@ti.func
def double_dot(a, b):
    """a : b."""
    total = 0.0
    for i, j in ti.static(ti.ndrange(3, 3)):
        total += a[i, j] * b[i, j]
    return total


@ti.func
def cofactor(f, j):
    """dJ/dF."""
    return j * f.inverse().transpose()


@ti.func
def neo_hookean(f, j, p, tolerance):
    b = f @ f.transpose()
    return p[MU] * (b - identity()) + p[LAM] * ti.log(j) * identity(), b


@ti.func
def neo_hookean_backwards(t, f, j, b, p):
    s, trace = symmetric(t), t.trace()
    back = 2.0 * p[MU] * (s @ f) + p[LAM] * trace / j * cofactor(f, j)
    return back, double_dot(s, b - identity()), ti.log(j) * trace


@ti.func
def fixed_corotated(f, j, p, tolerance):
    b = f @ f.transpose()
    v = left_stretch(b, j, tolerance)
    return 2.0 * p[MU] * (b - v) + p[LAM] * j * (j - 1.0) * identity(), v


@ti.func
def fixed_corotated_backwards(t, f, j, v, p):
    s, trace = symmetric(t), t.trace()
    rotation = v.inverse() @ f
    turn = v @ s - s @ v
    axial = ti.Vector([turn[2, 1], turn[0, 2], turn[1, 0]])
    w = (v.trace() * identity() - v).inverse() @ axial
    skew = ti.Matrix([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    back = 2.0 * p[MU] * (2.0 * (s @ f) - (s - skew) @ rotation)
    back = back + p[LAM] * (2.0 * j - 1.0) * trace * cofactor(f, j)
    return back, 2.0 * double_dot(s, f @ f.transpose() - v), j * (j - 1.0) * trace


class Backwards(NamedTuple):
    """Of a law, for the kernels."""

    stress: Callable[..., Any]
    """(F, J, p, tolerance) -> tau [Pa], and what `backwards` takes of the way there."""
    backwards: Callable[..., Any]
    """(T, F, J, what `stress` gave, p) -> derivatives with respect to F, mu and lambda."""


BACKWARDS = {
    "fixed_corotated": Backwards(fixed_corotated, fixed_corotated_backwards),
    "neo_hookean": Backwards(neo_hookean, neo_hookean_backwards),
}
"""By the name of the law."""


@ti.func
def played_backwards(s, given, kept, f, j, p, least, steepness, play):
    """Of `hoi.mpm.kernels.played`, which gave the factor `s`; `given` and `kept` are the derivatives with respect to s
    and to the play kept. Those with respect to F, mu, lambda, s_min, k and the play before.

    Where s meets a bound the play has a kink, and this is the derivative on the side where the step was.
    """
    b = f @ f.transpose() - identity()
    sheared, stretch = double_dot(b, b), ti.max(p[LAM], 0.0)
    psi = 0.25 * p[MU] * sheared + 0.5 * stretch * (j - 1.0) ** 2
    floor = LEAST_ENERGY * p[MU]
    log = ti.log(1.0 + psi / floor)
    free = 1.0 - play + steepness * log
    on_level, on_play, on_least = kept, 0.0, 0.0
    on_factor = given - kept
    if free < least:
        on_least = on_factor
    elif free <= 1.0:
        on_level, on_play = kept + on_factor, -on_factor
    on_psi = on_level * steepness / (floor + psi)
    back = on_psi * (p[MU] * (b @ f) + stretch * (j - 1.0) * cofactor(f, j))
    on_mu = on_psi * (0.25 * sheared - psi / p[MU])
    on_lam = 0.0
    if p[LAM] > 0.0:
        on_lam = 0.5 * on_psi * (j - 1.0) ** 2
    return back, on_mu, on_lam, on_least, on_level * log, on_play
