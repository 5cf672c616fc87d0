"""A moving obstacle in the grid: capsules that stand for the striking limb."""

from dataclasses import dataclass

from hoi.data import Array


@dataclass(frozen=True)
class Collider:
    """J capsules on K times, straight lines in between; before the first and after the last time there are none."""

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
