"""A ball on level ground: it slides until friction has made it roll, then rolls on, slowed by the air alone.

The rigid sphere of textbooks: friction mu g slows the sliding contact and turns the ball, so that without air the slip
u = v + w x (-R n) falls by mu g (1 + M R^2 / I) a second, in its own direction, to zero: a solid ball that is kicked
without spin rolls on at 5/7 of its speed. From then on the air's k |v|^2 slows it, less by the share that its turning
takes. The spin about the normal stays.
"""

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial import ConvexHull, QhullError

from hoi.data import Array, Plane
from hoi.mpm.rigid import RigidMotion, turning

ROUND = 0.01
"""Shares by which the radii of a ball, and its moments of inertia, may differ [-]."""
LEAST_SLIP = 1e-6
"""Speed of the contact from which on it rolls [m/s]."""
LONGEST = 100.0
"""It is not followed for longer [s]."""
LEVEL = 1e-9
"""Sine of the greatest slope that counts for none."""


def is_ball(positions: Array, masses: Array) -> bool:
    """Whether the hull of particles (P, 3) lies between two spheres about their centre, and they turn alike."""
    arms = positions - masses @ positions / masses.sum()
    moments = np.linalg.eigvalsh((masses[:, None] * arms).T @ arms)
    try:
        hull = ConvexHull(arms)
    except (QhullError, ValueError):  # flat, or fewer than four
        return False
    largest, least = np.linalg.norm(arms[hull.vertices], axis=1).max(), -hull.equations[:, 3].max()
    return bool(least >= (1 - ROUND) * largest and moments[0] >= (1 - ROUND) * moments[2])


def bears(plane: Plane, gravity: Array) -> bool:
    """Whether a ball lies on the plane without being driven along it."""
    down = float(np.linalg.norm(gravity))
    return bool(down > 0 and np.linalg.norm(gravity + down * plane.normal) <= LEVEL * down)


class Rolling:
    """A ball's motion on a plane that bears it, from one state on; its height stays.

    Args:
        motion: where it starts; a velocity along the normal is left out.
        plane: what it lies on. Where it sticks, the ball rolls at once, its angular momentum about the contact kept.
        gravity: against the plane's normal [m/s^2], shape (3,).
        drag: k of `hoi.mpm.rigid.Flight` [1/m].
        moment: D of the MPM, which friction does not turn [m^2]; see `hoi.mpm.rigid`.
    """

    def __init__(
        self, motion: RigidMotion, plane: Plane, gravity: Array, drag: float = 0.0, moment: float = 0.0
    ) -> None:
        self.motion, normal = motion, plane.normal
        self.gravity: Array = np.zeros(3)  # the plane bears it
        radius = float((motion.com - plane.point) @ normal)
        inertia = float(np.trace(motion.inertia)) / 3 - 2 * moment * motion.mass
        share = 1 / (1 + motion.mass * radius**2 / inertia)  # of the slip that v gives up; w R gives up the rest
        friction = {"coulomb": plane.friction, "slip": 0.0, "stick": math.inf}[plane.contact]
        slowing = friction * float(np.linalg.norm(gravity))

        def slip_of(state: Array) -> Array:
            return state[3:6] - radius * np.cross(state[6:], normal)

        def rubbed(state: Array, change: Array) -> Array:
            """What friction does to (x, v, w) while it changes v so."""
            return np.concatenate([np.zeros(3), change, (share - 1) / (share * radius) * np.cross(normal, change)])

        def rate(_: float, state: Array) -> Array:
            velocity, slip = state[3:6], slip_of(state)
            air = np.concatenate([velocity, -drag * np.linalg.norm(velocity) * velocity, np.zeros(3)])
            return air + rubbed(state, -slowing * slip / np.linalg.norm(slip))

        def rolls(_: float, state: Array) -> float:
            return float(np.linalg.norm(slip_of(state))) - LEAST_SLIP

        rolls.terminal = True  # of scipy
        velocity = motion.velocity - (motion.velocity @ normal) * normal
        state = np.concatenate([motion.com, velocity, motion.angular_velocity])
        self._sliding, self._slides_for = None, 0.0
        if 0 < slowing < math.inf and rolls(0.0, state) > 0:
            found = solve_ivp(
                rate, (0, LONGEST), state, "DOP853", events=rolls, dense_output=True, rtol=1e-10, atol=1e-12
            )
            self._sliding, self._slides_for, state = found.sol, float(found.t[-1]), found.y[:, -1]
        if slowing:
            state = state + rubbed(state, -share * slip_of(state))
        self._after, self._drag = state, drag * (1 - share if slowing else 1)
        spins = [motion.angular_velocity, state[6:], *([] if self._sliding is None else found.y[6:].T)]
        self.fastest = max(float(np.linalg.norm(spin)) for spin in spins)
        """Bound of |w| for all times [rad/s]."""
        speed = float(np.linalg.norm(velocity))
        self._unsteadiness = (slowing if self._sliding else 0.0) + drag * speed**2
        self._rolls, self._normal = slowing > 0, normal
        self.rotation = turning(self.angular_velocity)
        """R from the start to a time >= 0 [s], shape (3, 3)."""

    def com(self, time: float) -> Array:
        """Centre of mass [m], shape (3,)."""
        if self._sliding is not None and time < self._slides_for:
            return self._sliding(time)[:3]
        rolled = time - self._slides_for
        rate = self._drag * float(np.linalg.norm(self._after[3:6]))
        return self._after[:3] + self._after[3:6] * (math.log1p(rate * rolled) / rate if rate else rolled)

    def velocity(self, time: float) -> Array:
        """Of the centre of mass [m/s], shape (3,)."""
        if self._sliding is not None and time < self._slides_for:
            return self._sliding(time)[3:6]
        return self._after[3:6] * self._slowed(time)

    def angular_velocity(self, time: float) -> Array:
        """w [rad/s], world frame, shape (3,)."""
        if self._sliding is not None and time < self._slides_for:
            return self._sliding(time)[6:]
        along = (self._after[6:] @ self._normal) * self._normal
        turning = self._after[6:] - along
        return along + turning * (self._slowed(time) if self._rolls else 1.0)

    def unsteadiness(self, _: float) -> float:
        """Bound of its acceleration from a time on [m/s^2]."""
        return self._unsteadiness

    def _slowed(self, time: float) -> float:
        """The share of its speed that the air has left it since it rolls: v' = -k |v| v."""
        speed = float(np.linalg.norm(self._after[3:6]))
        return 1 / (1 + self._drag * speed * (time - self._slides_for))
