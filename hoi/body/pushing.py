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
        joints, self.parts = np.unique(owners, return_inverse=True)
        self._joints: list[int] = joints.tolist()
        self._bodies = np.array([person.parts.part[joint] for joint in self._joints])[self.parts]
        self._times_pushed = 0
        self._seen: tuple[int, float, Collider] | None = None
        self._refresh()

    def _refresh(self) -> None:
        person = self.person
        data = person.parts.data
        turns = data.xmat.reshape(-1, 3, 3)[self._bodies]
        self.ends = np.einsum("jab,jeb->jea", turns, self._local) + data.xpos[self._bodies][:, None]
        origin = np.zeros(3)
        self._jacobian = np.concatenate([person.parts.jacobian(joint, origin) for joint in self._joints])
        self.rates = person.rates
        self.twists: Array = (self._jacobian @ self.rates).reshape(-1, 6)

    def ease(self, parts: NDArray[np.intp]) -> Array:
        """W = J B J^T."""
        jacobian = self._of(parts)
        return np.einsum("in,jn->ij", np.einsum("in,nm->im", jacobian, self.person.mobility), jacobian)

    def _of(self, parts: NDArray[np.intp]) -> Array:
        """J of some parts, (6 K, nv)."""
        return self._jacobian.reshape(-1, 6, len(self.rates))[parts].reshape(-1, len(self.rates))

    def take(self, parts: NDArray[np.intp], wrenches: Array) -> None:
        self.rates = self.rates - self.person.mobility @ (wrenches.ravel() @ self._of(parts))
        self.twists = (self._jacobian @ self.rates).reshape(-1, 6)
        self._times_pushed += 1

    def advance(self, seconds: float) -> None:
        self.person.turn_to(self.rates)
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
