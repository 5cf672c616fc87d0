"""Hertz's theory of a ball that bounces off a rigid plane (Johnson, Contact Mechanics, section 11.4).

The force is 4/3 E* sqrt(R) delta^(3/2) with E* = E / (1 - nu^2): quasi-static, small strain, no friction.
"""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from hoi.data import Array


def contact_time(mass: float, radius: float, effective: float, speed: float) -> float:
    """How long a ball of modulus E* = E / (1 - nu^2) touches a rigid plane [s]."""
    return 2.87 * (mass**2 / (radius * effective**2 * speed)) ** 0.2


def _unit_bounce() -> tuple[float, Callable[[Array], Array]]:
    """x'' = -x^(3/2), x(0) = 0, x'(0) = 1: how long x > 0, and (x, x') at given times."""

    def back(_: float, y: Array) -> float:
        return y[0]

    back.terminal, back.direction = True, -1  # type: ignore[attr-defined]
    done = solve_ivp(lambda _, y: [y[1], -(max(y[0], 0.0) ** 1.5)], (0, 5), (0, 1), rtol=1e-10, atol=1e-12,
                     dense_output=True, events=back)  # fmt: skip
    return float(done.t_events[0][0]), done.sol


def hertz_share(level: float) -> float:
    """Share of Hertz's contact time that passes between the speeds -level v and level v [-]."""
    lasts, path = _unit_bounce()
    times = np.linspace(0, lasts, 4001)
    speed = -path(times)[1]
    return float((np.interp(level, speed, times) - np.interp(-level, speed, times)) / lasts)


def hertz_path(times: Array, duration: float, compression: float, v: float) -> Array:
    """Height of the ball's centre against its first touch at time 0 [m]: in, along Hertz's force, and out again."""
    lasts, path = _unit_bounce()
    x = path(np.clip(times / duration, 0, 1) * lasts)[0]
    deepest = path(np.array([lasts / 2]))[0, 0]
    outside = np.minimum(times, 0) * -v + np.maximum(times - duration, 0) * v
    return outside - compression * x / deepest
