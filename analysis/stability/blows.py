"""Blows and pushes of a person at their extremes: how heavy, fast, stiff and long they may be.

A leg swings at a block of jelly that floats before the foot. With an impulse, limb and block exchange it and both go
on; with a collider the person's capsules push the block through the grid. Each case is to stay finite, to give the
object what the person loses, and to make no energy of it; or to end in one line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from .verdict import Verdict

ACROSS = 4
"""Particles along an edge of the block."""
MOMENTUM, ENERGY = 1e-4, 0.02
"""What may come from nowhere, of what is given and of what is at stake [-]."""


@dataclass(frozen=True)
class Blow:
    """One case."""

    answer: Literal["impulse", "collider"]
    mass: float = 1.0
    """Of the object [kg]."""
    speed: float = 5.0
    """Of the foot [m/s]."""
    youngs_modulus: float = 1e5
    """Of the object [Pa]."""
    recovery: float = 0.3
    """Of the person, as `stage.contact.recovery`: 1e9 makes joints limp, 1e-3 rigid [s]."""
    frames: int = 8
    """T"""
    id: str = ""
    family: str = ""
    must: Literal["run", "refuse"] = "run"
    particles: int = ACROSS**3

    @property
    def compile_key(self) -> tuple[str, str, str]:
        """See `Case.compile_key`."""
        return "float32", "a person", self.answer


def shares_of(verdict: Verdict) -> list[float]:
    """How much of each limit a case took [-], see `analysis.stability.verdict.shares`."""
    taken = (verdict.energy_rise / ENERGY, verdict.momentum_drift / MOMENTUM)
    return [max(share, 0.0) for share in taken if not math.isnan(share)]


def _grid() -> list[Blow]:
    """The cases."""
    masses, speeds, moduli = (1e-3, 0.1, 10.0, 1e4), (0.0, 2.0, 10.0, 50.0), (1e3, 1e6, 1e9)
    joints = {"limp": 1e9, "joints": 0.3, "rigid": 1e-3}
    cases = []

    def add(family: str, label: str, blow: Blow) -> None:
        cases.append(replace(blow, id=f"{family}/{label}", family=family))

    for answer in ("impulse", "collider"):
        for kind, recovery in joints.items():
            for mass in masses:
                for speed in speeds:
                    for modulus in moduli if answer == "collider" else moduli[1:2]:
                        blow = Blow(answer, mass, speed, modulus, recovery)
                        stiff = f"E{_short(modulus)} " if answer == "collider" else ""
                        add(f"person_{answer}", f"{kind}/{stiff}m{_short(mass)}/v{_short(speed)}", blow)
        for frames in (40, 400):
            for speed in (2.0, 50.0):
                add("person_long", f"{answer}/T{frames} v{_short(speed)}", Blow(answer, speed=speed, frames=frames))
    for modulus in moduli[::2]:
        for mass in masses:
            label = f"E{_short(modulus)}/m{_short(mass)}"
            add("person_impulse_stiffness", label, Blow("impulse", mass, 10.0, modulus))
    return cases


def _short(number: float) -> str:
    return f"{number:g}" if number < 1e4 else f"{number:.0e}".replace("e+0", "e")


BLOWS: dict[str, Blow] = {blow.id: blow for blow in _grid()}
"""All of them by id."""


def quick(every: int = 29) -> Sequence[Blow]:
    """Some of them."""
    return list(BLOWS.values())[::every]
