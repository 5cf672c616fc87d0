"""Judges what was measured of a case.

Energy. E = kinetic + elastic + potential less the work W that kick and collider did may only fall. Its rise is the most
that it has climbed from any earlier least, over the energy at stake: what the body had at the start in motion and
strain, W, what it fell through, and what falling through one cell is worth (the ground is no sharper than that).

Momentum. While no plane can have been touched, P(t) = P(0) + M g t and the angular momentum about the centre of mass
stays; both against the largest sum of m |v| so far (times the body's size for the angular one).

Penetration. The deepest particle beyond the deepest at the start, in cells.

Stopping. An elastic law stores so much energy in a body that is crushed flat, and no more: fixed_corotated mu +
lambda/2 a volume, which is what a body at its own wave speed brings along; neo_hookean as much as J can be told from 0
with. A case that brings more may end in a RunError that says it has diverged, which is then its proper end; any other
may not, and a model that flows never. A case with a fixed step may end in one that says that the limit has fallen
below it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hoi.mpm.materials import lame_parameters

from .cases import Case
from .outcome import Look, Outcome

ENERGY_RISE = 0.05
ENERGY_RISE_OF_SNOW = 0.25
"""Its law is not dissipative: clamping the stretch across a pressed body makes J smaller, and so lambda/2 (J - 1)^2
greater."""
ENERGY_RISE_OF_ONE_STENCIL = 0.15
"""Symplectic Euler lets the energy of a mode of frequency w breathe by w dt/2 to either side. A body within one stencil
has only the fastest mode, with w dt about 0.5; any other has next to nothing in it."""
MOMENTUM_DRIFT = {"float32": 1e-4, "float64": 1e-10}
PENETRATION = {"quadratic": 1.5, "cubic": 2.0}
"""Deeper in the ground a particle touches solid nodes alone [cells]."""
MOST_CFL = 1.15
"""Cells that the fastest signal, and so any particle, may cross in a step; the window of the grid has two to spare."""
REACH = 3.0
"""Cells from a plane beyond which a particle cannot feel it."""

FAULTS = {
    "energy_rise": "energy rose by {:.2g} of what is at stake",
    "momentum_drift": "momentum drifted by {:.2g}",
    "spin_drift": "angular momentum drifted by {:.2g}",
    "penetration": "{:.2g} cells deeper in the ground than at the start",
    "cfl": "a signal crossed {:.2g} cells in a step",
}
"""What is said of a number that is too large."""

LEAST_J = {"float32": 1e-6, "float64": 1e-14}
"""About where det F of a body in any direction is lost in round-off [-]."""

Status = Literal["held", "refused", "stopped", "failed", "not run"]


@dataclass(frozen=True)
class Verdict:
    """One row of the result, less the case's parameters; numbers are NaN where they do not apply."""

    verdict: Status
    reason: str = ""
    energy_rise: float = np.nan
    """Of the energy at stake [-]."""
    momentum_drift: float = np.nan
    """[-]"""
    spin_drift: float = np.nan
    """[-]"""
    penetration: float = np.nan
    """[cells]"""
    cfl: float = np.nan
    """Largest (c + |v|) dt / dx [-]."""
    reached: float = 0.0
    """Share of the case's time that was followed."""
    steps: int = 0
    seconds: float = 0.0

    @property
    def good(self) -> bool:
        return self.verdict in ("held", "refused", "stopped")


def limits(case: Case) -> dict[str, float]:
    """The most that each number of a verdict may be."""
    drift = MOMENTUM_DRIFT[case.precision]
    within_a_stencil = case.shape in ("needle", "coincident", "point") or case.particles <= 10
    rise = ENERGY_RISE_OF_ONE_STENCIL if within_a_stencil else ENERGY_RISE
    rise = ENERGY_RISE_OF_SNOW if case.model == "snow" else rise
    return {"energy_rise": rise, "momentum_drift": drift, "spin_drift": drift,
            "penetration": PENETRATION[case.spline], "cfl": MOST_CFL}  # fmt: skip


def judge(outcome: Outcome) -> Verdict:
    """Whether the case held, and why not."""
    numbers = Verdict("held", cfl=outcome.cfl, reached=outcome.reached, steps=outcome.steps, seconds=outcome.seconds)
    if outcome.looks:
        momentum, spin = momentum_drift(outcome)
        numbers = replace(numbers, energy_rise=energy_rise(outcome), momentum_drift=momentum, spin_drift=spin,
                          penetration=penetration(outcome))  # fmt: skip
    reason = _fault(outcome, numbers)
    if reason is not None:
        return replace(numbers, verdict="stopped" if _duly_stopped(outcome) else "failed", reason=reason)
    return replace(numbers, verdict="held" if outcome.refusal is None else "refused", reason=outcome.refusal or "")


def _fault(outcome: Outcome, numbers: Verdict) -> str | None:
    """What is wrong with it, if anything; the gravest first."""
    case = outcome.case
    if outcome.failure is not None:
        return outcome.failure
    if outcome.stop is not None:
        return outcome.stop
    if outcome.refusal is not None:
        if case.must == "run":
            return f"refused: {outcome.refusal}"
        return "refused in more than one line" if "\n" in outcome.refusal else None
    if case.must == "refuse":
        return "ran where it should have been refused"
    finite = all(np.isfinite([*look.energy, *look.momentum, *look.spin, look.motion]).all() for look in outcome.looks)
    if not finite:
        return "a state is not finite"
    for name, most in limits(case).items():
        value = getattr(numbers, name)
        if value > most:
            return f"{FAULTS[name].format(value)} (at most {most:g})"
    return None


def _duly_stopped(outcome: Outcome) -> bool:
    """Whether it ended in a RunError of the kind that the case may end in."""
    stop = outcome.stop
    if stop is None or "\n" in stop:
        return False
    fell = "above the limit" in stop and outcome.case.dt_share is not None
    return fell or ("diverged" in stop and crushing(outcome.case) > 1)


def crushing(case: Case) -> float:
    """Energy a volume that the case brings along, over what its law can store [-]; above 1 it may diverge."""
    mu, lam = lame_parameters(case.material)
    fastest = case.speed + case.collider + case.spin * case.size * np.sqrt(3) / 2
    fastest += (1 + case.kick_restitution) * case.kick * np.sqrt((lam + 2 * mu) / case.density)
    fall = max(case.gap, 0.0) * case.dx + case.size / 2
    brought = case.density * (0.5 * fastest**2 + case.gravity * fall)
    least = np.log(LEAST_J[case.precision])
    stored = {"fixed_corotated": mu + lam / 2, "neo_hookean": -mu * (0.5 + least) + lam / 2 * least**2}
    return brought / stored.get(case.model, np.inf)


def energy_rise(outcome: Outcome) -> float:
    """Largest rise of E - W over its least so far, in shares of the energy at stake [-]."""
    energy = np.array([look.energy for look in outcome.looks])
    work = np.array([look.work for look in outcome.looks])
    left = energy.sum(axis=1) - work
    rise = (left - np.minimum.accumulate(left)).max()
    fallen = energy[0, 2] - energy[:, 2].min()
    cell = outcome.mass * outcome.case.gravity * outcome.case.dx
    stake = energy[0, :2].sum() + work.max() + fallen + cell
    return _ratio(rise, stake)


def momentum_drift(outcome: Outcome) -> tuple[float, float]:
    """Largest drift of linear momentum and of spin while no plane can have been touched [-]; NaN if no such time."""
    case, free = outcome.case, _untouched(outcome)
    if len(free) < 2 or case.collider or case.kick:
        return np.nan, np.nan
    fall = np.array([0.0, 0.0, -case.gravity]) * outcome.mass
    momentum = np.array([look.momentum - fall * look.time for look in free])
    spin = np.array([look.spin for look in free])
    scale = max(look.motion for look in free)
    drifts = (np.linalg.norm(values - values[0], axis=1).max() for values in (momentum, spin / case.size))
    linear, angular = (_ratio(float(drift), scale) for drift in drifts)
    return linear, angular


def _untouched(outcome: Outcome) -> list[Look]:
    """The looks before any plane can have been touched, between looks included."""
    free: list[Look] = []
    for look in outcome.looks:
        way = (look.time - free[-1].time) * max(look.fastest, free[-1].fastest) if free else 0.0
        if look.gap < REACH * outcome.case.dx + way:
            break
        free.append(look)
    return free


def penetration(outcome: Outcome) -> float:
    """How much deeper than at the start a particle was found in a plane [cells]; NaN without planes."""
    gaps = np.array([look.gap for look in outcome.looks])
    if np.isinf(gaps[0]):
        return np.nan
    return float((min(gaps[0], 0.0) - gaps.min()) / outcome.case.dx)


def _ratio(value: float, scale: float) -> float:
    return value / scale if scale > 0 else (0.0 if value == 0 else np.inf)


def shares(case: Case, verdict: Verdict) -> list[float]:
    """How much of each limit the case took [-], without the CFL number, of which every run uses its part."""
    taken = [getattr(verdict, name) / most for name, most in limits(case).items() if name != "cfl"]
    return [max(share, 0.0) for share in taken if not np.isnan(share)]
