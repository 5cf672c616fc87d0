"""Blows and pushes of a person at their extremes: how heavy, fast, stiff and long they may be.

A leg swings at a block of jelly that floats before the foot. With an impulse, limb and block exchange it and both go
on; with a collider the person's capsules push the block through the grid. Each case is to stay finite, to give the
object what the person loses, and to make no energy of it; or to end in one line.
"""

import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hoi.body.capsules import Capsules, fit_capsules
from hoi.body.dynamics import Person
from hoi.body.people import load_person
from hoi.body.pushing import Pushing
from hoi.body.skeleton import CHAINS, JOINT_NAMES
from hoi.body.skinning import joint_paths, stand_motion
from hoi.data import Array, Body, Contact, GaussianCloud, Material, Motion, SceneObject
from hoi.errors import InputError, RunError
from hoi.method.contact import exchange, impulse
from hoi.mpm.solver import Simulation
from hoi.mpm.state import initial_state, kick

from .verdict import Verdict

FPS, GRAVITY, SIZE, ACROSS = 20.0, 9.81, 0.2, 4
"""Of the motion at the least [1/s]; of the person [m/s^2], the block floats; its edge [m], and particles along it."""
DX = SIZE / ACROSS
HIP, ANKLE, FOOT = (JOINT_NAMES.index(f"right_{name}") for name in ("hip", "ankle", "foot"))
CLEAR = 1e-4
"""From the foot to the block at first [m]."""
WIDEST = 1.0
"""The leg swings by no more than this from one frame to the next [rad]."""
MOST_STEPS, MOST_SECONDS = 3000, 20.0
"""Of the grid, and of all [s]; a case that takes more is cut short."""
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


@functools.cache
def _person() -> tuple[Body, Capsules]:
    body = load_person("woman", 8000, 0)
    legs = [joint for chain in ("right leg", "left leg", "trunk") for joint in CHAINS[chain]]
    return body, fit_capsules(body, legs)


def verdict_of(blow: Blow) -> Verdict:
    """Runs and judges one case in this process."""
    started = time.perf_counter()
    try:
        verdict = {"impulse": _struck, "collider": _pushed}[blow.answer](blow)
    except (RunError, InputError) as error:
        told = str(error)
        verdict = Verdict("stopped" if "\n" not in told else "failed", told)
    except Exception as error:  # whatever it is, the other cases are to be run
        verdict = Verdict("failed", f"{type(error).__name__}: {' '.join(str(error).split())}")
    return replace(verdict, seconds=time.perf_counter() - started)


def _swing(blow: Blow) -> tuple[Motion, float, Array]:
    """A leg that swings straight ahead from one frame to the next, the time half way, and the foot's place then."""
    body, _ = _person()
    still = joint_paths(body, stand_motion(body, 1, FPS))[0]
    length = float(np.linalg.norm(still[FOOT] - still[HIP]))
    fps = max(FPS, blow.speed / length / WIDEST)
    motion, middle = stand_motion(body, blow.frames, fps), blow.frames // 2
    turned = 0.5 * blow.speed / length / fps * np.where(np.arange(blow.frames) < middle, 1.0, -1.0)
    motion.body_pose[:, HIP - 1, 0] = turned
    return motion, (middle - 0.5) / fps, still[FOOT]


def _block(blow: Blow, ahead_of: Array) -> SceneObject:
    axis = ((np.arange(ACROSS) + 0.5) / ACROSS - 0.5) * SIZE
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points + ahead_of + [0, 0.5 * SIZE, 0]
    count = len(points)
    cloud = GaussianCloud(points, np.full((count, 3), 0.02), np.tile([1.0, 0, 0, 0], (count, 1)), np.ones(count),
                          np.zeros((count, 1, 3)))  # fmt: skip
    material = Material("jelly", "neo_hookean", blow.youngs_modulus, 0.3, blow.mass / SIZE**3, 0.5, 0.5)
    return SceneObject(
        "block", cloud, points, np.full(count, SIZE**3 / count), material, np.zeros(3), np.zeros(3), SIZE
    )


def _simulation(thing: SceneObject, state, partner: "_Counted | None" = None) -> Simulation:
    return Simulation(state, thing.volumes, thing.material, dx=DX, gravity=(0, 0, 0), planes=(), collider=partner)


def _person_at(blow: Blow, motion: Motion, start: float) -> Person:
    return Person(_person()[0], motion, start=start, gravity=GRAVITY, recovery=blow.recovery, one_piece=0.85)


def _struck(blow: Blow) -> Verdict:
    """The impulse, and what comes after."""
    motion, time_c, foot = _swing(blow)
    person = _person_at(blow, motion, time_c)
    ahead = np.array([0.0, 1.0, 0.0])
    at = foot + 0.1 * ahead
    thing = _block(blow, at)
    state = initial_state(thing.particles, thing.masses, thing.velocity)
    speed, nothing = person.velocity(FOOT, at), np.zeros(3)
    v_in, formula = impulse(speed, nothing, ahead, thing.material.restitution)
    contact = Contact(time_c, FOOT, 1.0, at, ahead, speed, nothing, v_in, nothing, nothing, 0.0, v_formula=formula)
    contact = exchange(contact, thing, state, person.inverse_mass(FOOT, at, ahead), 0.7)
    rates, before, inertia = person.rates, person.kinetic_energy(), person.parts.inertia()
    person.push(FOOT, at, -contact.impulse)
    lost, spent = (inertia @ (rates - person.rates))[:3], before - person.kinetic_energy()
    after = kick(state, contact.v_post, contact.spin, thing.particles.mean(axis=0))
    run = _simulation(thing, after)
    gained = float(run.energies(after).sum())
    drift, rise = _drift(lost, contact.impulse), (gained - spent) / max(before, 1e-12)
    run.advance(min(200 * run.time_step(), person.end - time_c))
    run.state()
    return _judged(blow, drift, rise, run, person)


class _Counted(Pushing):
    """Counts what contacts take from the person: momentum [N s] and energy [J]."""

    def __init__(self, person: Person, capsules: Capsules) -> None:
        self.lost, self.spent = np.zeros(3), 0.0
        super().__init__(person, capsules, capsules.radii, 0.5)

    def take(self, parts: NDArray[np.intp], wrenches: Array) -> None:
        before, inertia = self.rates, self.person.parts.inertia()
        super().take(parts, wrenches)
        self.lost = self.lost + (inertia @ (before - self.rates))[:3]
        self.spent += 0.5 * float(before @ inertia @ before - self.rates @ inertia @ self.rates)


def _pushed(blow: Blow) -> Verdict:
    """The push, over the swing."""
    motion, time_c, _ = _swing(blow)
    person = _person_at(blow, motion, time_c - 0.5 / motion.fps)
    partner = _Counted(person, _person()[1])
    ends = partner.ends[np.isin(_person()[1].joints, [ANKLE, FOOT])].reshape(-1, 3)
    radii = np.repeat(partner.radii[np.isin(_person()[1].joints, [ANKLE, FOOT])], 2)
    tip = (ends[:, 1] + radii).argmax()
    # One particle of the block's face lies just before the foremost point of the foot.
    half = 0.5 * SIZE / ACROSS
    thing = _block(blow, ends[tip] + [half, radii[tip] - half + CLEAR, half])
    state = initial_state(thing.particles, thing.masses, thing.velocity)
    run, stake = _simulation(thing, state, partner), person.kinetic_energy()
    until, by = 1.5 / motion.fps, time.perf_counter() + MOST_SECONDS
    rise = 0.0
    while run.time < until and run.steps < MOST_STEPS and time.perf_counter() < by:
        run.advance(min(run.time + 20 * run.time_step(), until))
        stake = max(stake, person.kinetic_energy())
        rise = max(rise, (float(run.energies(run.state()).sum()) - partner.spent) / max(stake, 1e-12))
    return _judged(blow, _drift(partner.lost, run.collider_impulse), rise, run, person)


def _drift(lost: Array, given: Array) -> float:
    size = float(np.linalg.norm(given))
    return float(np.linalg.norm(lost - given)) / size if size > 0 else 0.0


def _judged(blow: Blow, drift: float, rise: float, run: Simulation, person: Person) -> Verdict:
    """The person goes on to the end of its motion; then what was found."""
    numbers = Verdict("held", energy_rise=rise, momentum_drift=drift, cfl=run.cfl, reached=1.0, steps=run.steps)
    person.advance(max(person.end - person.time, 0.0))
    if not (np.isfinite(person.q).all() and np.isfinite(person.rates).all() and math.isfinite(person.work)):
        return replace(numbers, verdict="failed", reason="the person is not finite")
    for name, value, most in (("momentum from nowhere", drift, MOMENTUM), ("energy from nowhere", rise, ENERGY)):
        if not value <= most:
            return replace(numbers, verdict="failed", reason=f"{name}: {value:.2g} of what is at stake")
    return numbers


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
