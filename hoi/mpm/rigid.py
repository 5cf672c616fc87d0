"""Motion of a body as one piece: fitted to an MPM state, and carried exactly through free flight.

Angular momentum and inertia count what APIC carries in each particle's stencil (Jiang et al. 2015): with the second
moment D of the spline's weights, sum m_p (r_p x v_p + D axl(C_p)) and sum m_p (|r_p|^2 I - r_p r_p^T + 2 D I).
The transfers of the MPM conserve just these sums.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DOP853
from scipy.spatial import ConvexHull, QhullError

from hoi.data import Array, ObjectState

TOLERANCE = 1e-11
"""Error of a step of the rotation's integration; over a thousand turns of a lopsided body the energy stays to 1e-11."""


@dataclass(frozen=True)
class RigidMotion:
    """A rigid body at one instant, in the world frame."""

    mass: float
    """M [kg]."""
    com: Array
    """Centre of mass [m], shape (3,)."""
    velocity: Array
    """V of the centre of mass [m/s], shape (3,)."""
    angular_momentum: Array
    """L about the centre of mass [N m s], shape (3,)."""
    inertia: Array
    """About the centre of mass [kg m^2], shape (3, 3)."""

    @property
    def angular_velocity(self) -> Array:
        """w = inertia^-1 L [rad/s], shape (3,)."""
        return np.linalg.solve(self.inertia, self.angular_momentum)


def fit(state: ObjectState, masses: Array, moment: float) -> RigidMotion:
    """The rigid motion with the linear and angular momentum of `state`: of all, the one nearest to it in energy.

    Args:
        state: the MPM state.
        masses: particle masses [kg], shape (P,).
        moment: D, the second moment of the spline's weights [m^2].
    """
    masses = np.asarray(masses, dtype=np.float64)
    mass = float(masses.sum())
    x, v, c = (np.asarray(a, dtype=np.float64) for a in (state.positions, state.velocities, state.affine))
    com, velocity = masses @ x / mass, masses @ v / mass
    r = x - com
    weighted = masses[:, None] * r
    mean = np.tensordot(masses, c, axes=1)
    axial = np.array([mean[2, 1] - mean[1, 2], mean[0, 2] - mean[2, 0], mean[1, 0] - mean[0, 1]])
    spread = weighted.T @ r
    return RigidMotion(
        mass=mass,
        com=com,
        velocity=velocity,
        angular_momentum=np.cross(weighted, v - velocity).sum(axis=0) + moment * axial,
        inertia=(np.trace(spread) + 2 * moment * mass) * np.eye(3) - spread,
    )


def vibration_energy(state: ObjectState, masses: Array, moment: float, motion: RigidMotion) -> float:
    """Kinetic energy of `state` relative to the rigid `motion` fitted to it [J]."""
    spin = cross_matrix(motion.angular_velocity)
    v = state.velocities - motion.velocity - (state.positions - motion.com) @ spin.T
    c = state.affine - spin
    return 0.5 * float(np.asarray(masses) @ ((v**2).sum(-1) + moment * (c**2).sum((-2, -1))))


def hull(points: Array) -> Array:
    """The vertices of the convex hull of points (P, 3); all points where they have no volume."""
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat, or fewer than four
        return points


def air_drag(points: Array, mass: float, air_density: float, coefficient: float) -> float:
    """k = rho C_d A / (2 m) [1/m]: k |v|^2 is how the air slows a body of these points [m], (P, 3).

    A is a quarter of its convex hull's surface, the mean silhouette of a convex body (Cauchy).
    """
    try:
        area = ConvexHull(points).area / 4
    except (QhullError, ValueError):  # flat, or fewer than four
        return 0.0
    return air_density * coefficient * area / (2 * mass)


class _Path:
    """The solution of y' = f(t, y) from 0 on, integrated with DOP853 as far as it is asked for."""

    def __init__(self, rate: Callable[[float, Array], Array], start: Array) -> None:
        self._solver = DOP853(rate, 0.0, start, np.inf, rtol=TOLERANCE, atol=TOLERANCE)
        self._ends, self._pieces = [0.0], []

    def __call__(self, time: float) -> Array:
        while self._ends[-1] < time:
            self._solver.step()
            self._pieces.append(self._solver.dense_output())
            self._ends.append(self._solver.t)
        return self._pieces[bisect_left(self._ends, time) - 1](time)


class Flight:
    """Free flight from one state on: the centre of mass on its parabola, the body turning without torque.

    With `drag` k the air slows it, v' = g - k |v| v, k = rho C_d A / (2 m) [1/m], integrated to `TOLERANCE`.

    L stays as it is, and the rotation R since the start obeys R' = [w]_x R with w = R I0^-1 R^T L. It is computed as
    R = exp([L]_x t / i) S, which leaves S' = [S (I0^-1 - 1/i) S^T L]_x S. With the middle principal inertia for i, S
    does not move at all where the three are equal, and slowly where they nearly are; it is integrated as a quaternion
    with DOP853, as far as it is asked for.
    """

    def __init__(self, motion: RigidMotion, gravity: ArrayLike, drag: float = 0.0) -> None:
        self.motion, self.drag = motion, drag
        self.gravity: Array = np.asarray(gravity, dtype=np.float64)
        moments, axes = np.linalg.eigh(motion.inertia)
        self._axes = axes * np.linalg.det(axes)  # right-handed
        self.fastest = float(np.linalg.norm(motion.angular_momentum) / moments[0])
        """Bound of |w| for all times [rad/s]."""
        self._inverse = (self._axes / moments) @ self._axes.T
        self._mean = motion.angular_momentum / moments[1]
        self._rest = (1 / moments[0] - 1 / moments[1], 1 / moments[2] - 1 / moments[1])
        self._in_axes = tuple((motion.angular_momentum @ self._axes).tolist())
        self._turned = _Path(self._turn, np.array([1.0, 0, 0, 0]))
        self._slowed = _Path(self._slow, np.concatenate([np.zeros(3), motion.velocity]))

    def com(self, time: float) -> Array:
        """Centre of mass [m], shape (3,)."""
        if self.drag and time > 0:
            return self.motion.com + self._slowed(time)[:3]
        return self.motion.com + time * self.motion.velocity + 0.5 * time**2 * self.gravity

    def velocity(self, time: float) -> Array:
        """Of the centre of mass [m/s], shape (3,)."""
        if self.drag and time > 0:
            return self._slowed(time)[3:]
        return self.motion.velocity + time * self.gravity

    def rotation(self, time: float) -> Array:
        """R from the start to `time` >= 0 [s], shape (3, 3)."""
        turned = rotation_by(self._mean * time)
        if time == 0 or not any(self._rest):
            return turned
        q = self._turned(time)
        return turned @ self._axes @ _matrix(q / np.linalg.norm(q)) @ self._axes.T

    def angular_velocity(self, time: float) -> Array:
        """w [rad/s], world frame, shape (3,)."""
        r = self.rotation(time)
        return r @ (self._inverse @ (self.motion.angular_momentum @ r))

    def unsteadiness(self, time: float) -> float:
        """Bound of the air's part of the acceleration from a time on [m/s^2].

        The air holds a rising body back and only helps a falling one; no later speed is above this and a fall's.
        """
        if not self.drag:
            return 0.0
        velocity = self.velocity(time)
        return max(self.drag * float(velocity @ velocity), float(np.linalg.norm(self.gravity)))

    def _slow(self, _: float, state: Array) -> Array:
        """Of the way and the velocity (6,)."""
        velocity = state[3:]
        return np.concatenate([velocity, self.gravity - self.drag * np.linalg.norm(velocity) * velocity])

    def _turn(self, _: float, q: Array) -> Array:
        """dq/dt of S in the principal axes: half of q times the body's own rates, of which the middle one is zero."""
        w, x, y, z = q.tolist()
        l1, l2, l3 = self._in_axes
        norm = w * w + x * x + y * y + z * z
        first = (w * w + x * x - y * y - z * z) * l1 + 2 * (x * y + w * z) * l2 + 2 * (x * z - w * y) * l3
        third = 2 * (x * z + w * y) * l1 + 2 * (y * z - w * x) * l2 + (w * w - x * x - y * y + z * z) * l3
        first *= self._rest[0] / norm
        third *= self._rest[1] / norm
        return 0.5 * np.array([-x * first - z * third, w * first + y * third, z * first - x * third,
                               w * third - y * first])  # fmt: skip


class Path(Protocol):
    """A rigid motion from one state on; times count from there [s]."""

    motion: RigidMotion
    """Where it starts."""
    gravity: Array
    """Its steady acceleration [m/s^2], shape (3,)."""
    fastest: float
    """Bound of |w| for all times [rad/s]."""

    def com(self, time: float, /) -> Array:
        """Centre of mass [m], shape (3,)."""
        ...

    def velocity(self, time: float, /) -> Array:
        """Of the centre of mass [m/s], shape (3,)."""
        ...

    def rotation(self, time: float, /) -> Array:
        """R from the start on, shape (3, 3)."""
        ...

    def angular_velocity(self, time: float, /) -> Array:
        """w [rad/s], world frame, shape (3,)."""
        ...

    def unsteadiness(self, time: float, /) -> float:
        """Bound of how far the acceleration is from `gravity` from a time on [m/s^2]."""
        ...


def carry(path: Path, state: ObjectState, time: float) -> ObjectState:
    """The state at the start of a path carried along for `time` [s]: its strain goes with it, frozen."""
    r, com = path.rotation(time), path.com(time)
    spin = cross_matrix(path.angular_velocity(time))
    arms = (state.positions - path.motion.com) @ r.T
    return replace(
        state,
        positions=com + arms,
        velocities=path.velocity(time) + arms @ spin.T,
        affine=np.tile(spin, (len(arms), 1, 1)),
        deformation_gradient=r @ state.deformation_gradient,
        elastic=None if state.elastic is None else r @ state.elastic,
    )


def cross_matrix(w: Array) -> Array:
    """[w]_x, shape (3, 3)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def turning(angular_velocity: Callable[[float], Array]) -> Callable[[float], Array]:
    """R(t) with R' = [w(t)]_x R and R(0) = I, for t >= 0."""

    def rate(time: float, q: Array) -> Array:
        spin = angular_velocity(time)
        return 0.5 * np.array([-spin @ q[1:], *(q[0] * spin + np.cross(spin, q[1:]))])

    path = _Path(rate, np.array([1.0, 0, 0, 0]))

    def rotation(time: float) -> Array:
        q = path(time) if time > 0 else np.array([1.0, 0, 0, 0])
        return _matrix(q / np.linalg.norm(q))

    return rotation


def rotation_by(vector: Array) -> Array:
    """exp([vector]_x): about its direction by its length [rad], shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    half = 0.5 * angle
    return _matrix(np.array([np.cos(half), *(0.5 * np.sinc(half / np.pi) * vector)]))


def _matrix(q: Array) -> Array:
    """Rotation matrix of a unit quaternion wxyz."""
    w, x, y, z = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
