"""Runs one case and keeps what is needed to judge it."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hoi.data import Array, ObjectState, Plane
from hoi.errors import InputError, RunError
from hoi.mpm.collider import Collider
from hoi.mpm.materials import p_wave_speed
from hoi.mpm.solver import Simulation
from hoi.mpm.stability import DEFAULT_FRACTION, time_step_limit
from hoi.mpm.state import angular_momentum, centre_of_mass, initial_state, kick, linear_momentum

from .cases import Case
from .outcome import Look, Outcome

MOST_STEPS = 20_000
"""A case that takes more is cut short: the grid is to be done in minutes."""
MOST_SECONDS = 60.0
"""Likewise [s]."""


def attempt(case: Case) -> Outcome:
    """Run the case to its end, or to whatever stops it."""
    started, trial = time.perf_counter(), None
    ended: dict[str, Any] = {}
    try:
        with np.errstate(invalid="ignore", divide="ignore"):  # what must be refused has inf and nan until then
            trial = _Trial(case)
        trial.run(until=time.perf_counter() + MOST_SECONDS)
    except InputError as error:
        stepped = trial is not None and trial.simulation.steps > 0
        ended = {"failure": f"refused after the first step: {error}"} if stepped else {"refusal": str(error)}
    except RunError as error:
        ended = {"stop": str(error)}
    except Exception as error:  # whatever it is, the other cases are to be run
        ended = {"failure": f"{type(error).__name__}: {' '.join(str(error).split())}"}
    outcome = Outcome(case, **ended, seconds=time.perf_counter() - started)
    if trial is None:
        return outcome
    return replace(outcome, looks=tuple(trial.looks), mass=trial.masses.sum(), steps=trial.steps, cfl=trial.cfl,
                   reached=trial.reached)  # fmt: skip


class _Trial:
    """A case on its way."""

    def __init__(self, case: Case) -> None:
        self.case, self.material, self.planes = case, case.material, case.solid_planes
        positions, self.volumes = SHAPES[case.shape](case)
        self.masses = self.volumes * case.density
        out = _free_direction(self.planes)
        half = 0.5 * float(np.median(self.volumes)) ** (1 / 3)
        positions = positions + _shift(positions, self.planes, out, case.gap * case.dx + half) * out
        self.spread = {"quadratic": 1 / 4, "cubic": 1 / 3}[case.spline]
        self.materials, self.region = self.material, None
        if case.other_stiffness:
            other = replace(self.material, youngs_modulus=case.other_stiffness * case.youngs_modulus)
            self.materials = [self.material, other]
            self.region = (positions[:, 0] > np.median(positions[:, 0])).astype(np.int32)
        self.gravity = np.array([0.0, 0.0, -case.gravity])
        self.direction = _direction(case.heading, out)
        state = initial_state(positions, self.masses, case.speed * self.direction,
                              case.spin * np.array([2, -3, 6]) / 7)  # fmt: skip
        self.collider, self.capsule_velocity = _capsule(case, positions) if case.collider else (None, np.zeros(3))

        self.start_speed = float(np.linalg.norm(state.velocities, axis=1).max())
        limit = time_step_limit(self.materials, case.dx, self.start_speed)
        if case.collider:
            self.duration = 0.75 * case.size / case.collider
        else:
            self.duration = case.duration or case.lasts * DEFAULT_FRACTION * limit
        self.dt = None if case.dt_share is None else case.dt_share * limit
        self.looks: list[Look] = []
        self.kick_work, self.offset, self.steps_before = 0.0, 0.0, 0
        self.cfl_before = 0.0
        self.simulation = self._simulation(state)
        self._look(state)

    @property
    def steps(self) -> int:
        return self.steps_before + self.simulation.steps

    @property
    def cfl(self) -> float:
        return max(self.cfl_before, self.simulation.cfl)

    @property
    def reached(self) -> float:
        return self.looks[-1].time / self.duration

    def run(self, until: float) -> None:
        """Advance frame by frame; stop early when that takes past `until` [s, perf_counter] or MOST_STEPS."""
        times = np.linspace(0, self.duration, self.case.frames + 1)[1:]
        for number, now in enumerate(times, start=1):
            self.simulation.advance(now - self.offset)
            self._look(self.simulation.state())
            if self.case.kick and number == (len(times) + 1) // 2:
                self._kick(now)
            if self.steps > MOST_STEPS or time.perf_counter() > until:
                break

    def _kick(self, now: float) -> None:
        """The impulse of a limb at `case.kick` wave speeds: every particle gains (1 + e) v_in along the heading."""
        speed = (1 + self.case.kick_restitution) * self.case.kick * p_wave_speed(self.material)
        before = self.simulation.state()
        after = kick(before, speed * self.direction)
        self.kick_work += float(self.simulation.energies(after).sum() - self.simulation.energies(before).sum())
        self.offset, self.steps_before, self.cfl_before = now, self.steps, self.cfl
        self.simulation = self._simulation(after)
        self._look(after)

    def _simulation(self, state: ObjectState) -> Simulation:
        return Simulation(
            state,
            self.volumes,
            self.materials,
            region=self.region,
            rebound=None if self.case.rebound == 1 else [self.case.rebound],
            dx=self.case.dx,
            dt=self.dt,
            gravity=self.gravity,
            planes=self.planes,
            collider=self.collider,
            spline=self.case.spline,
            precision=self.case.precision,
        )

    def _look(self, state: ObjectState) -> None:
        momentum = linear_momentum(state, self.masses)
        com, speeds = centre_of_mass(state.positions, self.masses), np.linalg.norm(state.velocities, axis=1)
        # A collider of constant velocity u does no more than u . J: seen from it, contact only dissipates.
        pushed = float(self.capsule_velocity @ self.simulation.collider_impulse) if self.collider else 0.0
        self.looks.append(
            Look(
                time=self.simulation.time + self.offset,
                energy=self.simulation.energies(state),
                work=self.kick_work + pushed,
                momentum=momentum,
                spin=angular_momentum(state, self.masses, self.case.dx, self.spread) - np.cross(com, momentum),
                gap=nearest(state.positions, self.planes),
                fastest=float(speeds.max()),
                motion=float(self.masses @ speeds),
            )
        )


def nearest(positions: Array, planes: tuple[Plane, ...]) -> float:
    """Smallest signed distance of any position (P, 3) from any plane [m]; negative inside."""
    return min((float(((positions - plane.point) @ plane.normal).min()) for plane in planes), default=np.inf)


def _free_direction(planes: tuple[Plane, ...]) -> Array:
    out = np.sum([plane.normal for plane in planes], axis=0) if planes else np.array([0.0, 0.0, 1.0])
    return out / np.linalg.norm(out)


def _shift(positions: Array, planes: tuple[Plane, ...], out: Array, gap: float) -> float:
    """How far along `out` to move the positions so that the nearest is `gap` from its plane [m]."""
    return max(((gap - nearest(positions, (plane,))) / float(out @ plane.normal) for plane in planes), default=0.0)


def _direction(heading: str, out: Array) -> Array:
    across = np.eye(3)[int(abs(out[0]) > 0.9)]
    along = across - (across @ out) * out
    along /= np.linalg.norm(along)
    return {"into": -out, "along": along, "slant": (along - out) / np.sqrt(2), "out": out}[heading]


def _capsule(case: Case, positions: Array) -> tuple[Collider, Array]:
    """A capsule that comes from one side or from above and stops, that is vanishes, half way through; its velocity."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    middle = (low + high) / 2
    radius, axis, start = case.size / 4, np.array([0.0, case.size, 0.0]), middle.copy()
    if case.collider_side == "side":
        velocity = case.collider * np.array([1.0, 0, 0])
        start[0] = low[0] - radius - 0.5 * case.dx
    else:
        velocity = case.collider * np.array([0, 0, -1.0])
        start[2] = high[2] + radius + 0.5 * case.dx
    ends = 0.5 * case.size / case.collider
    centres = np.stack([start, start + ends * velocity])[:, None]
    return Collider(np.array([0.0, ends]), centres - axis, centres + axis, np.array([radius]), 0.4), velocity


def _block(case: Case) -> tuple[Array, Array]:
    side = max(round(case.particles ** (1 / 3)), 1)
    return _lattice((side, side, side), case.size / side)


def _lattice(counts: tuple[int, int, int], spacing: float) -> tuple[Array, Array]:
    axes = [(np.arange(count) + 0.5) * spacing for count in counts]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return positions, np.full(len(positions), spacing**3)


def _ball(case: Case) -> tuple[Array, Array]:
    positions, volumes = _block(replace(case, particles=round(case.particles * 6 / np.pi)))
    inside = np.linalg.norm(positions - case.size / 2, axis=1) < case.size / 2
    return positions[inside], volumes[inside]


def _plate(case: Case) -> tuple[Array, Array]:
    side = round(case.particles**0.5)
    return _lattice((side, side, 1), case.size / side)


def _needle(case: Case) -> tuple[Array, Array]:
    return _lattice((case.particles, 1, 1), case.size / case.particles)


def _cloud(case: Case) -> tuple[Array, Array]:
    """Random places, and volumes that differ a hundredfold."""
    random = np.random.default_rng(0)
    shares = 10 ** random.uniform(-2, 0, case.particles)
    return random.random((case.particles, 3)) * case.size, shares / shares.sum() * case.size**3


def _coincident(case: Case) -> tuple[Array, Array]:
    return np.zeros((case.particles, 3)), np.full(case.particles, case.size**3 / case.particles)


def _point(case: Case) -> tuple[Array, Array]:
    return np.zeros((1, 3)), np.full(1, (case.dx / 2) ** 3)


SHAPES: dict[str, Callable[[Case], tuple[Array, Array]]] = {
    "block": _block, "ball": _ball, "plate": _plate, "needle": _needle, "cloud": _cloud, "coincident": _coincident,
    "point": _point,
}  # fmt: skip
"""Positions (P, 3) [m] and rest volumes (P,) [m^3] of each shape; plate and needle are one particle thick."""
