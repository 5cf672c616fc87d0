"""Moving obstacles in the grid: capsules that stand for the limbs of a person."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Push


@dataclass(frozen=True)
class Collider:
    """J capsules on K times, straight lines in between, which nothing stops; before the first and after the last time
    there are none."""

    times: Array
    """Increasing, from the start of the simulation [s], shape (K,)."""
    starts: Array
    """One end of each axis [m], shape (K, J, 3)."""
    ends: Array
    """The other end [m], shape (K, J, 3)."""
    radii: Array
    """[m], shape (J,)."""
    friction: float
    """Coulomb coefficient against the object [-]."""


PAUSE = 0.02
"""Pushes further apart in time are two [s]."""


def joined(pushes: Iterable[Push], offset: float = 0.0) -> list[Push]:
    """Pushes in the order of time, `offset` [s] later, those that hardly pause taken as one."""
    found: list[Push] = []
    for push in pushes:
        push = Push(push.start + offset, push.end + offset, push.impulse)
        if found and push.start - found[-1].end <= PAUSE:
            push = Push(found[-1].start, push.end, found.pop().impulse + push.impulse)
        found.append(push)
    return found


class Partner(Protocol):
    """J capsules carried by something that takes the opposite of what they give, see `hoi.mpm.coupling`."""

    radii: Array
    """[m], (J,)."""
    friction: float
    """Coulomb coefficient against the object [-]."""
    parts: NDArray[np.intp]
    """The rigid part that carries each, (J,)."""
    ends: Array
    """Where the ends of the axes are now [m], (J, 2, 3)."""
    twists: Array
    """How each part moves now: its velocity at the world's origin [m/s] and its turning [rad/s], (P, 6)."""

    def ease(self, parts: NDArray[np.intp]) -> Array:
        """W (6 K, 6 K) of K parts, symmetric: wrenches p on them, impulses and angular impulses about the world's
        origin, change their twists by W p."""
        ...

    def take(self, parts: NDArray[np.intp], wrenches: Array) -> None:
        """Takes the opposite of the wrenches (K, 6) that capsules on K parts gave."""
        ...

    def advance(self, seconds: float) -> None:
        """Goes on by itself."""
        ...

    def foreseen(self) -> Collider:
        """Where the capsules will be until the end if nothing is given to them any more; times from now on [s]."""
        ...
