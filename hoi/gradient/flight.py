"""Free flight backwards, in closed form but for the rotation of a body with unequal inertia, and for the air.

`hoi.mpm.rigid`: the rigid motion is fitted to the state (com, V, L, I), and carries each arm r and F by R(t). For a
small turn theta of R, with J = R I^-1 R^T and w = J L,

    w changes by   theta x w + J (L x theta) + R d(I^-1) R^T L + J dL
    theta' =       J (L x theta) + R d(I^-1) R^T L + J dL,   theta(0) = 0

so that the derivative l with respect to theta obeys l' = L x (J l) backwards in time, along the R of the flight.
"""

import numpy as np
from scipy.integrate import solve_ivp

from hoi.data import Array, ObjectState, Plane
from hoi.gradient.backwards import Cotangent, axial
from hoi.mpm import rigid

TOLERANCE = 1e-10
"""Of the integration."""


def flight_backwards(
    flight: rigid.Flight, state: ObjectState, masses: Array, moment: float, time: float, after: Cotangent
) -> tuple[Cotangent, Array, float]:
    """The derivatives with respect to the state at the start of a flight, gravity, and how long it lasts.

    Args:
        flight: from the rigid motion fitted to `state`.
        masses: [kg], (P,). moment: D [m^2].
        time: how long it lasts [s].
        after: the derivative with respect to the state that it leads to.
    """
    motion, g = flight.motion, flight.gravity
    count, total, momentum = len(masses), motion.mass, motion.angular_momentum
    inverse = np.linalg.inv(motion.inertia)
    zero, zeros = np.zeros((count, 3)), np.zeros((count, 3, 3))
    on_y = zero if after.positions is None else after.positions
    on_u = zero if after.velocities is None else after.velocities
    on_c = zeros if after.affine is None else after.affine
    on_f = zeros if after.deformation_gradient is None else after.deformation_gradient

    turn, w = flight.rotation(time), flight.angular_velocity(time)
    j = turn @ inverse @ turn.T
    r, v = state.positions - motion.com, state.velocities - motion.velocity
    arms, f = r @ turn.T, turn @ state.deformation_gradient

    on_com = on_y.sum(axis=0)
    on_velocity, on_gravity = _along_the_path(flight, on_com, on_u.sum(axis=0), time)
    on_arms = on_y + np.cross(on_u, w)
    on_w = np.cross(arms, on_u).sum(axis=0) + axial(on_c.sum(axis=0))
    on_turn = np.cross(arms, on_arms).sum(axis=0) + axial(np.einsum("pik,pjk->ij", on_f, f))
    on_turn = on_turn + np.cross(w, on_w) - np.cross(momentum, j @ on_w)
    on_momentum = j @ on_w
    on_inverse = np.outer(turn.T @ on_w, turn.T @ momentum)

    changing, speed = j @ np.cross(momentum, w), flight.velocity(time)
    slowing = g - flight.drag * np.linalg.norm(speed) * speed
    on_time = (
        float((on_y * (speed + np.cross(w, arms))).sum())
        + float((on_u * (slowing + np.cross(changing, arms) + np.cross(w, np.cross(w, arms)))).sum())
        + float(axial(on_c.sum(axis=0)) @ changing)
        + float((on_f * (rigid.cross_matrix(w) @ f)).sum())
    )
    added, added_inverse = _through_the_turn(flight, inverse, on_turn, time)
    on_momentum = on_momentum + added
    on_inverse = on_inverse + added_inverse

    on_inertia = -inverse @ (0.5 * (on_inverse + on_inverse.T)) @ inverse
    on_spread = np.trace(on_inertia) * np.eye(3) - on_inertia
    m = np.asarray(masses, dtype=np.float64)[:, None]
    on_r = on_arms @ turn + m * (2 * r @ on_spread + np.cross(v, on_momentum))
    on_v = m * np.cross(on_momentum, r)
    before = Cotangent(
        positions=on_r + m / total * (on_com - on_r.sum(axis=0)),
        velocities=on_v + m / total * (on_velocity - on_v.sum(axis=0)),
        affine=moment * m[..., None] * rigid.cross_matrix(on_momentum),
        deformation_gradient=turn.T @ on_f,
        play=after.play,
    )
    return before, on_gravity, on_time


def landing_time(
    flight: rigid.Flight, state: ObjectState, plane: Plane, reach: float, around: float
) -> tuple[float, int]:
    """When the first particle comes within `reach` of a plane [m], near the time `around` [s], and which one it is.

    Newton's iteration on the height of the lowest particle, which the event rule then differentiates:
    dt = -dh / h', see `landing_backwards`.
    """
    r = state.positions - flight.motion.com
    time, lowest = around, 0
    for _ in range(50):
        arms = r @ flight.rotation(time).T
        heights = (arms + flight.com(time) - plane.point) @ plane.normal - reach
        lowest = int(heights.argmin())
        rate = (flight.velocity(time) + np.cross(flight.angular_velocity(time), arms[lowest])) @ plane.normal
        time -= (step := float(heights[lowest] / rate))
        if abs(step) < 1e-14 * max(time, 1.0):
            break
    return time, lowest


def landing_backwards(
    flight: rigid.Flight, state: ObjectState, masses: Array, moment: float, time: float, after: Cotangent,
    plane: Plane, lowest: int, later: float,
) -> tuple[Cotangent, Array]:  # fmt: skip
    """`flight_backwards` of a flight that ends when a particle reaches a plane: the time of that is differentiated too.

    Args:
        later: what it is worth that what comes after lasts longer; with a fixed end, it lasts the shorter the later.
        plane, lowest: which particle meets what, see `landing_time`.
    """
    _, _, longer = flight_backwards(flight, state, masses, moment, time, after)
    arm = flight.rotation(time) @ (state.positions[lowest] - flight.motion.com)
    rate = (flight.velocity(time) + np.cross(flight.angular_velocity(time), arm)) @ plane.normal
    positions = np.zeros_like(state.positions) if after.positions is None else after.positions.copy()
    positions[lowest] -= (longer - later) / rate * plane.normal
    with_event = Cotangent(positions, after.velocities, after.affine, after.deformation_gradient, after.play)
    before, gravity, _ = flight_backwards(flight, state, masses, moment, time, with_event)
    return before, gravity


def _along_the_path(flight: rigid.Flight, on_com: Array, on_end: Array, time: float) -> tuple[Array, Array]:
    """What the centre's place and velocity at the end owe to its velocity at the start, and to gravity."""
    if not flight.drag or time == 0 or not (on_com.any() or on_end.any()):
        return time * on_com + on_end, 0.5 * time**2 * on_com + time * on_end

    def rate(at: float, y: Array) -> Array:
        v, worth = flight.velocity(max(at, 0.0)), y[:3]
        speed = max(float(np.linalg.norm(v)), 1e-300)
        slowed = flight.drag * (speed * worth + (v @ worth) / speed * v)
        return np.concatenate([slowed - on_com, -worth])

    scale = float(np.abs([on_com, on_end]).max())
    start = np.concatenate([on_end, np.zeros(3)])
    end = solve_ivp(rate, (time, 0.0), start, "DOP853", rtol=TOLERANCE, atol=TOLERANCE * scale).y[:, -1]
    return end[:3], end[3:]


def _through_the_turn(flight: rigid.Flight, inverse: Array, on_turn: Array, time: float) -> tuple[Array, Array]:
    """What the final turn owes to L (3,) and to I^-1 (3, 3)."""
    momentum = flight.motion.angular_momentum

    def rate(at: float, y: Array) -> Array:
        turn, worth = flight.rotation(max(at, 0.0)), y[:3]
        j = turn @ inverse @ turn.T
        pulled = j @ worth
        inner = np.outer(turn.T @ worth, turn.T @ momentum)
        return np.concatenate([np.cross(momentum, pulled), -pulled, -inner.ravel()])

    if time == 0 or not on_turn.any():
        return np.zeros(3), np.zeros((3, 3))
    start = np.concatenate([on_turn, np.zeros(12)])
    scale = float(np.abs(on_turn).max())
    end = solve_ivp(rate, (time, 0.0), start, "DOP853", rtol=TOLERANCE, atol=TOLERANCE * scale).y[:, -1]
    return end[3:6], end[6:].reshape(3, 3)
