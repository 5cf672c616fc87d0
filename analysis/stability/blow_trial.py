"""Runs and judges one blow or push of a person."""

import functools
import math
import time
from dataclasses import replace

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

from .blows import ACROSS, ENERGY, MOMENTUM, Blow
from .verdict import Verdict

FPS, GRAVITY, SIZE = 20.0, 9.81, 0.2
"""Of the motion at the least [1/s]; of the person [m/s^2], the block floats; its edge [m]."""
DX = SIZE / ACROSS
HIP, ANKLE, FOOT = (JOINT_NAMES.index(f"right_{name}") for name in ("hip", "ankle", "foot"))
CLEAR = 1e-4
"""From the foot to the block at first [m]."""
WIDEST = 1.0
"""The leg swings by no more than this from one frame to the next [rad]."""
MOST_STEPS, MOST_SECONDS = 3000, 20.0
"""Of the grid, and of all [s]; a case that takes more is cut short."""


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
