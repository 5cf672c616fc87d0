"""Moving obstacles in the grid: capsules that stand for the limbs of a person."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array


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


@dataclass(frozen=True)
class Push:
    """What a collider gave the object while they stayed in touch."""

    start: float
    end: float
    """[s]"""
    impulse: Array
    """[N s], (3,)."""


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
    ends: Array
    """Where the ends of the axes are now [m], (J, 2, 3)."""
    velocities: Array
    """... and how fast they move [m/s], (J, 2, 3)."""

    def meet(
        self, capsules: NDArray[np.intp], mass: Array, first: Array, second: Array, linear: Array, angular: Array
    ) -> None:
        """Sets `velocities` to those that all capsules have once some move as one with a cluster of nodes each.

        Args:
            capsules: which, (K,).
            mass: of the clusters [kg], (K,). first, second: their moments, (K, 3) and (K, 3, 3).
            linear, angular: their momenta, (K, 3). All about the world's origin.
        """
        ...

    def take(self, capsules: NDArray[np.intp], linear: Array, angular: Array) -> None:
        """Takes the opposite of what K capsules gave: impulses and angular impulses about the origin, (K, 3)."""
        ...

    def advance(self, seconds: float) -> None:
        """Goes on by itself; `ends` have moved with `velocities` since the last time, and are then put right."""
        ...

    def foreseen(self) -> Collider:
        """Where the capsules will be until the end if nothing is given to them any more; times from now on [s]."""
        ...
