"""What is kept of a case that was run, to judge it by."""

from dataclasses import dataclass

from hoi.data import Array

from .cases import Case


@dataclass(frozen=True)
class Look:
    """What is measured of one state."""

    time: float
    """[s]"""
    energy: Array
    """Kinetic, elastic, potential [J], shape (3,)."""
    work: float
    """The most that kick and collider can have done so far [J]."""
    momentum: Array
    """[N s], shape (3,)."""
    spin: Array
    """Angular momentum about the centre of mass [N m s], shape (3,)."""
    gap: float
    """From the nearest particle to the planes, negative inside [m]; inf without planes."""
    fastest: float
    """[m/s]"""
    motion: float
    """Sum of m |v| [N s]."""


@dataclass(frozen=True)
class Outcome:
    """How one case went."""

    case: Case
    looks: tuple[Look, ...] = ()
    mass: float = 0.0
    refusal: str | None = None
    """The InputError raised before the first step."""
    stop: str | None = None
    """The RunError that ended it."""
    failure: str | None = None
    """Whatever else was raised."""
    steps: int = 0
    cfl: float = 0.0
    """Largest (c + |v|) dt / dx met [-]."""
    reached: float = 0.0
    """Share of its time that the case was followed for."""
    seconds: float = 0.0
    """Wall clock, compiling included."""
