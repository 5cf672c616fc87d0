"""Solids that lose energy: a hysteresis of the stress, so that a body rebounds with its restitution at any speed.

The stress is s tau(F), and s in [s_min, 1] is a play operator on psi, the elastic energy density: while the body is
loaded s climbs, by k for each factor e of psi, until it is 1; while it is unloaded it falls until it is s_min:

    ds = k d log(psi + psi_0),   s_min <= s <= 1,   psi = mu/4 |b - I|^2 + lambda/2 (J - 1)^2

This psi is that of every law for small strain, and grows with it for large strain. Between its bounds s is a function
of it, so that the body is elastic there, with the energy int s dpsi; at its upper bound it loses some, and nowhere it
gains any. No time is in it: the loss does not depend on how fast, large and stiff a body is, as the loss factor of
rubber hardly does over decades of frequency. A Kelvin-Voigt viscosity that sends a football back with e = 0.6 would
need steps 15 times shorter at 16 cells across, and another value for each speed.

A spring loaded to psi_m and let go gives back the share e^2 = 1 - k (1 - exp((s_min - 1) / k)) of its energy, which
gives k for a restitution e, with s_min = e^2 / 2: a body comes back to its shape, the more slowly the less it bounces.

The tangent is stiffer by k tau tau / psi, at most 2 k times the elastic one. Explicit steps stay stable well above what
that bound allows, as the play is stiff in one direction of strain and only until s meets a bound: measured on a ball of
16 cells across that lands, steps of the elastic limit are stable for e of 0.6 and 0.4 (k = 1.6 and 5), and those for a
tangent of 5 times the elastic one for e of 0.2 (k = 24). `Damping.stiffening`, 1 + k / 4, is above all of these.
"""

import math
from dataclasses import dataclass

import numpy as np

from hoi.data import Array, Material
from hoi.mpm.laws import LAWS

LEAST_ENERGY = 1e-10
"""psi_0 over mu [-]: strains below 1e-5 lose nothing."""

STIFFENING = 0.25
"""What each k adds to the stiffness that the time step allows for [-]."""
LEAST_REBOUND = 0.2
"""A solid that springs back does so with this at least: less needs ever shorter steps, as 1 / e [-]."""

TAIL = 0.025


@dataclass(frozen=True)
class Damping:
    """Of one material."""

    least: float = 1.0
    """s_min [-]."""
    steepness: float = 0.0
    """k [-], 0 for an elastic material."""

    @property
    def stiffening(self) -> float:
        """The tangent over the elastic one that the time step is to allow for [-]."""
        return 1 + STIFFENING * self.steepness


def damping(restitution: float) -> Damping:
    """What lets a spring send a mass back at the share `restitution` of its speed [-]; 1 is elastic."""
    if restitution >= 1:
        return Damping()
    least = restitution**2 / 2

    low, high = 1e-6, 1e8
    while high > low * (1 + 1e-12):  # what is given back falls from 1 to `least` as k falls
        k = math.sqrt(low * high)
        low, high = (low, k) if 1 + k * math.expm1((least - 1) / k) < restitution**2 else (k, high)
    return Damping(least, low)


def strain_energy(f: Array, mu: float, lam: float) -> Array:
    """psi [J/m^3] of F (..., 3, 3), shape (...)."""
    strain = f @ np.swapaxes(f, -1, -2) - np.eye(3)
    return mu / 4 * (strain**2).sum((-2, -1)) + max(lam, 0.0) / 2 * (np.linalg.det(f) - 1) ** 2


def played(damping: Damping, psi: Array, floor: float, play: Array) -> tuple[Array, Array]:
    """s and the play 1 - s + k log(1 + psi / psi_0) of the play, of which 0 is where an unstrained body begins."""
    level = damping.steepness * np.log1p(psi / floor)
    s = np.clip(1 - play + level, damping.least, 1)
    return s, 1 - s + level


def recoverable(damping: Damping, psi: Array, floor: float, play: Array) -> Array:
    """The share of psi that unloading gives back [-]: of kinetic energy and this, the sum never grows."""
    if not damping.steepness:
        return np.ones_like(psi)
    s, _ = played(damping, psi, floor, play)
    k, y = damping.steepness, psi + floor
    turn = np.maximum(y * np.exp((damping.least - s) / k), floor)  # from there on s is s_min
    above = s * (y - turn) - k * (y - turn - turn * np.log(y / turn))
    return (damping.least * (turn - floor) + above) / np.maximum(psi, 1e-300)


def rebound_of(material: Material, cells: float) -> float:
    """The share of its speed that the material's own loss is to leave a body of `cells` across in a bounce [-].

    From `LEAST_REBOUND` to 1: more than the grid leaves it (`grid_rebound`) it cannot have. What a spring does not
    know, that a body leaves the ground while a part of it still comes back, takes `TAIL` (1 - e) more (measured). 1 for
    a law of which the flow takes the energy (`Law.springs`).
    """
    if not LAWS[material.model].springs:
        return 1.0
    share = material.restitution / grid_rebound(cells)
    return min(max(share + TAIL * (1 - share), LEAST_REBOUND), 1.0)


def grid_rebound(cells: float) -> float:
    """With which restitution an elastic ball of `cells` across leaves the ground [-]: the loss of APIC's transfers.

    Fitted to drops of the football from 1 m: 0.958, 0.983, 0.989 at 8, 16, 24 cells across; e of 4 cells and less is
    taken as that of 4.
    """
    cells = max(cells, 4.0)
    return 1 - 0.24 / cells - 0.8 / cells**2
