"""A person whose limbs, as capsules in the MPM, take the opposite of what they give the object."""

import numpy as np
from numpy.typing import NDArray

from hoi.body.capsules import Capsules
from hoi.body.dynamics import Person
from hoi.body.mass import PART
from hoi.data import Array
from hoi.mpm.collider import Collider

AHEAD = 0.005
"""Apart in time are the places that are foreseen [s]."""


class Pushing:
    """A person as a partner of the MPM, see `hoi.mpm.collider.Partner`.

    Args:
        capsules: J of them, in the person's rest frame. radii: at least as thick as those [m], (J,).
        friction: Coulomb coefficient between limbs and object [-].
    """

    def __init__(self, person: Person, capsules: Capsules, radii: Array, friction: float) -> None:
        self.person, self.radii, self.friction = person, radii, friction
        owners = PART[capsules.joints]
        rest = np.asarray(person.body.rest_joints, np.float64)
        self._local = np.stack([capsules.starts, capsules.ends], axis=1) - rest[owners][:, None]
        self._joints, self._part = np.unique(owners, return_inverse=True)
        self._bodies = [person.parts.part[joint] for joint in self._joints]
        self.given = np.zeros(3)
        """What the object got so far [N s], (3,)."""
        self._times_pushed = 0
        self._seen: tuple[int, float, Collider] | None = None
        self._refresh()

    def _refresh(self) -> None:
        data = self.person.parts.data
        bodies = np.array(self._bodies)[self._part]
        turns = data.xmat.reshape(-1, 3, 3)[bodies]
        self.ends = np.einsum("jab,jeb->jea", turns, self._local) + data.xpos[bodies][:, None]
        self._jacobian: Array | None = None
        self._rates = self.person.rates
        self._move(self._twists(self._rates))

    def _twists(self, rates: Array) -> Array:
        """Velocity at the world's origin and turning of each part with capsules, (P, 6)."""
        if self._jacobian is None:
            origin = np.zeros(3)
            self._jacobian = np.stack([self.person.parts.jacobian(joint, origin) for joint in self._joints])
        return self._jacobian @ rates

    def _move(self, twists: Array) -> None:
        linear, turning = twists[self._part, :3], twists[self._part, 3:]
        self.velocities = linear[:, None] + np.cross(turning[:, None], self.ends)

    def meet(
        self, capsules: NDArray[np.intp], mass: Array, first: Array, second: Array, linear: Array, angular: Array
    ) -> None:
        """Predicts t' = t + W (h - G t'), the twists of the parts that move as one with clusters of nodes.

        t = J q' are theirs before, W = J B J^T is how easily they are moved, h is the momentum of the clusters, and
        G t' what that is once they move along.
        """
        parts = self._part[capsules]
        met = np.unique(parts[mass > 0])
        before = self._twists(self._rates)
        assert self._jacobian is not None
        inertia, momentum = np.zeros((len(met), 6, 6)), np.zeros((len(met), 6))
        for k, part in enumerate(met):
            own = parts == part
            m, f, s = mass[own].sum(), first[own].sum(axis=0), second[own].sum(axis=0)
            cross = np.array([[0, -f[2], f[1]], [f[2], 0, -f[0]], [-f[1], f[0], 0]])
            inertia[k] = np.block([[m * np.eye(3), -cross], [cross, np.trace(s) * np.eye(3) - s]])
            momentum[k] = np.concatenate([linear[own].sum(axis=0), angular[own].sum(axis=0)])
        jacobian = self._jacobian[met].reshape(-1, len(self._rates))
        spread = self.person.mobility @ jacobian.T
        ease, along = jacobian @ spread, np.zeros((6 * len(met), 6 * len(met)))
        for k in range(len(met)):
            along[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = inertia[k]
        h = momentum.ravel()
        after = np.linalg.solve(np.eye(len(h)) + ease @ along, before[met].ravel() + ease @ h)
        self._move(self._twists(self._rates + spread @ (h - along @ after)))

    def take(self, capsules: NDArray[np.intp], linear: Array, angular: Array) -> None:
        self._twists(self._rates)
        assert self._jacobian is not None
        wrenches = np.concatenate([linear, angular], axis=1)
        generalised = np.einsum("kin,ki->n", self._jacobian[self._part[capsules]], wrenches)
        self._rates = self._rates - self.person.mobility @ generalised
        self.given = self.given + linear.sum(axis=0)
        self._times_pushed += 1
        self._move(self._twists(self._rates))

    def advance(self, seconds: float) -> None:
        self.person.turn_to(self._rates)
        self.person.advance(seconds)
        self._refresh()

    def foreseen(self) -> Collider:
        """Where the capsules will be until the end if nothing is given to them any more; times from now on [s]."""
        now = self.person.time
        if self._seen is None or self._seen[0] != self._times_pushed:
            ghost = Pushing.__new__(Pushing)
            ghost.__dict__.update(self.__dict__)
            ghost.person = self.person.twin()
            ends, times = [ghost.ends], [now]
            while ghost.person.time < self.person.end - 1e-9:
                ghost.advance(min(AHEAD, self.person.end - ghost.person.time))
                ends.append(ghost.ends)
                times.append(ghost.person.time)
            if len(times) == 1:
                ends, times = [*ends, *ends], [now, now + AHEAD]
            path = np.stack(ends)
            self._seen = self._times_pushed, now, Collider(
                np.array(times), path[:, :, 0], path[:, :, 1], self.radii, self.friction
            )  # fmt: skip
        _, _, seen = self._seen
        return Collider(seen.times - now, seen.starts, seen.ends, seen.radii, seen.friction)
