"""What moves the object: nothing, a straight line, or the MPM; and its re-simulation from the moment of contact."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hoi.config import Config, MPMConf, Spline
from hoi.data import Array, Contact, ObjectState, ObjectTrajectory, Scene, SceneObject
from hoi.errors import RunError
from hoi.mpm.collider import Collider
from hoi.mpm.state import centre_of_mass, initial_state, kick
from hoi.runner.progress import Stage

if TYPE_CHECKING:
    from hoi.mpm.phases import Tally


@dataclass(frozen=True)
class Advanced:
    """The object at the frames that a mover was asked for."""

    states: tuple[ObjectState, ...]
    energy: Array
    """Kinetic, elastic, potential [J], (K, 3)."""
    phase: tuple[str, ...]
    """What moved the object to each of the frames."""
    impulse: Array = field(default_factory=lambda: np.zeros(3))
    """What the collider gave the object [N s], shape (3,)."""
    pushed: tuple[float, float] | None = None
    """The first and last frame at which it gave any."""


SOON = 0.001
"""How long after the impulse the object's velocity is compared with V_post [s]."""


class Mover(Protocol):
    """Moves the object from its state at frame `start` to each of the frames `stops`; frames may be fractional."""

    def __call__(
        self,
        scene: Scene,
        state: ObjectState,
        start: float,
        stops: Sequence[float],
        stage: Stage,
        collider: Collider | None = None,
    ) -> Advanced:
        """`collider` is what pushes the object on the way; its times are those of the scene, frame 0 being 0 s."""
        ...


def mover(config: Config, device: str) -> Mover:
    """The configured mover. Taichi is imported when the MPM first runs, not before."""
    conf = config.stage.object
    if not isinstance(conf, MPMConf):
        return constant_velocity
    threads = config.threads or os.cpu_count() or 1
    return partial(_mpm, conf=conf, size=config.object.size, threads=threads, device=device)


def _mpm(
    scene: Scene,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | None = None,
    *,
    conf: MPMConf,
    size: float,
    threads: int,
    device: str,
) -> Advanced:
    from hoi.mpm.phases import Surroundings, Walk, lowest_frequency, reach_of
    from hoi.mpm.solver import Simulation
    from hoi.plan import NEVER_RIGID, cell_size

    thing, dx = scene.thing, cell_size(conf, size)
    planes = scene.planes
    times = (np.asarray(stops) - start) / scene.fps
    if collider is not None:
        collider = replace(collider, times=collider.times - start / scene.fps)

    def simulation(state: ObjectState, now: float) -> Simulation:
        return Simulation(
            state,
            thing.volumes,
            thing.materials,
            region=thing.region,
            dx=dx,
            dt=conf.dt,
            fraction=conf.limit_fraction,
            gravity=scene.gravity,
            planes=planes,
            collider=None if collider is None else replace(collider, times=collider.times - now),
            spline=conf.spline.value,
            precision=conf.precision.value,
            threads=threads,
            device="cuda" if device == "cuda" else "cpu",
        )

    width = 3 if conf.spline is Spline.quadratic else 4  # nodes of a stencil along an axis
    reaches = [reach_of(plane, dx, width) for plane in planes]
    whole = not any(material.model in NEVER_RIGID for material in thing.materials)
    walk = Walk(
        state,
        thing.masses,
        simulation,
        end=float(times[-1]),
        gravity=scene.gravity,
        surroundings=Surroundings(planes, reaches, collider, 0.5 * width * math.sqrt(3) * dx),
        size=thing.size,
        moment=dx**2 / (4 if width == 3 else 3),
        frequency=lowest_frequency(thing.particles, thing.masses, thing.materials) if whole else None,
        tolerance=conf.vibration_tolerance if conf.phases else None,
    )
    states, phases = [], []
    for time in times:
        try:
            reached, phase = walk.advance(float(time))
        except RunError as error:
            raise RunError(f"object at frame {start + walk.time * scene.fps:.2f}: {error}") from error
        states.append(reached)
        phases.append(phase)
        stage.advance()
    tally = walk.finish()
    _count(stage.numbers, tally)
    energy = [walk.simulation.energies(reached) for reached in states]
    pushed = None
    if tally.push_end > tally.push_start:
        pushed = start + tally.push_start * scene.fps, start + tally.push_end * scene.fps
    return Advanced(tuple(states), np.array(energy).reshape(-1, 3), tuple(phases), tally.collider_impulse, pushed)


def _count(numbers: dict[str, float], tally: "Tally") -> None:
    """Adds what a walk did and left out to the stage's report; a stage may walk more than once."""
    adds = {
        "steps": tally.steps,
        "steps_left_out": round(tally.steps_left_out),
        "phase_changes": tally.changes,
        **{f"seconds_{phase}": seconds for phase, seconds in tally.seconds.items()},
        "energy_left_out": tally.energy,
        "compile_seconds": tally.compile_seconds,
    }
    greatest = {"vibration_left_out": tally.vibration, "cfl": tally.cfl, "dt_most": tally.dt_most}
    numbers.update({name: numbers.get(name, 0.0) + value for name, value in adds.items()})
    numbers.update({name: max(numbers.get(name, 0.0), value) for name, value in greatest.items()})
    if tally.steps:
        numbers["dt_least"] = min(numbers.get("dt_least", math.inf), tally.dt_least)


def constant_velocity(
    scene: Scene,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | None = None,
) -> Advanced:
    """Straight lines: no gravity, no ground, no deformation, and nothing pushes (paper, w/o MPM)."""
    velocity = centre_of_mass(state.velocities, scene.thing.masses)
    states = []
    for stop in stops:
        moved = state.positions + velocity * (stop - start) / scene.fps
        states.append(replace(state, positions=moved, velocities=np.tile(velocity, (len(moved), 1))))
        stage.advance()
    energy = [_rigid_energy(scene, s) for s in states]
    return Advanced(tuple(states), np.array(energy).reshape(-1, 3), ("constant_velocity",) * len(states))


def at_rest(
    scene: Scene,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | None = None,
) -> Advanced:
    """Nothing happens: the object lies still."""
    stage.advance(len(stops))
    energy = np.array([_rigid_energy(scene, state) for _ in stops])
    return Advanced(tuple(state for _ in stops), energy, ("rest",) * len(stops))


def _rigid_energy(scene: Scene, state: ObjectState) -> tuple[float, float, float]:
    masses = scene.thing.masses
    kinetic = 0.5 * float(masses @ (state.velocities**2).sum(axis=1))
    potential = -float(masses @ (state.positions @ scene.gravity))
    return kinetic, 0.0, potential


def free_motion(scene: Scene, move: Mover, stage: Stage) -> tuple[ObjectTrajectory, tuple[ObjectState, ...]]:
    """The object alone, from t = 0 to T (paper, Object Motion Simulation); with its states, to start again from."""
    thing = scene.thing
    start = initial_state(thing.particles, thing.masses, thing.velocity, thing.angular_velocity)
    frames = move(scene, start, 0.0, range(scene.frames), stage)
    return trajectory_of(thing, frames.states, frames.energy, frames.phase), frames.states


def resimulate(
    scene: Scene,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    contact: Contact,
    move: Mover,
    stage: Stage,
) -> ObjectTrajectory:
    """The object from t_c on, its velocity changed by V_post - V_obj; what was before stays as in `free`."""
    t_c = contact.frame
    struck = kick(_state_at(scene, free, states, t_c, move, stage), contact.v_post - contact.v_object)
    soon = t_c + SOON * scene.fps
    frames = [float(frame) for frame in range(scene.frames) if frame >= t_c]
    stops = sorted({soon, *frames})
    after = move(scene, struck, t_c, stops, stage)
    leaving = centre_of_mass(after.states[stops.index(soon)].velocities, scene.thing.masses) - contact.v_post
    stage.numbers["v_post_error"] = float(np.linalg.norm(leaving) / np.linalg.norm(contact.v_post))
    return _continued(scene.thing, free, states, after, [stops.index(frame) for frame in frames])


def push(
    scene: Scene,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    contact: Contact,
    collider: Collider,
    move: Mover,
    stage: Stage,
) -> tuple[ObjectTrajectory, Contact]:
    """The object pushed by the collider from when that appears; before, it stays as in `free`.

    Returns:
        the trajectory, and the contact with the impulse and the duration that came of it.
    """
    start = float(collider.times[0]) * scene.fps
    frames = [float(frame) for frame in range(scene.frames) if frame > start]
    state = _state_at(scene, free, states, start, move, stage)
    after = move(scene, state, start, frames, stage, collider)
    first, last = after.pushed or (contact.frame, contact.frame)
    stage.numbers.update(impulse=float(np.linalg.norm(after.impulse)), pushed_from=first, pushed_until=last)
    if after.pushed is None:
        stage.notes.append("the limb's capsules passed the object without touching it")
    trajectory = _continued(scene.thing, free, states, after, range(len(frames)))
    return trajectory, replace(contact, impulse=after.impulse, duration=(last - first) / scene.fps)


def _state_at(
    scene: Scene, free: ObjectTrajectory, states: Sequence[ObjectState], frame: float, move: Mover, stage: Stage
) -> ObjectState:
    """The freely moving object at a fractional frame, from its state at the whole frame before."""
    first = int(frame)
    if frame <= first:
        return states[first]
    before = at_rest if free.phase[first] == "rest" else move
    return before(scene, states[first], first, [frame], stage).states[-1]


def _continued(
    thing: SceneObject,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    after: Advanced,
    chosen: Sequence[int],
) -> ObjectTrajectory:
    """`free` with its last frames replaced by the `chosen` states of `after`."""
    kept = len(states) - len(chosen)
    return trajectory_of(
        thing,
        (*states[:kept], *(after.states[index] for index in chosen)),
        np.concatenate([free.energy[:kept], after.energy[list(chosen)]]),
        (*free.phase[:kept], *(after.phase[index] for index in chosen)),
    )


def trajectory_of(
    thing: SceneObject, states: Sequence[ObjectState], energy: Array, phase: tuple[str, ...]
) -> ObjectTrajectory:
    """What is recorded of the states at whole frames. F is kept where the MPM computed it."""
    masses = thing.masses
    deformation = np.stack([s.deformation_gradient for s in states]).astype(np.float32)
    return ObjectTrajectory(
        positions=np.stack([s.positions for s in states]).astype(np.float32),
        com=np.stack([centre_of_mass(s.positions, masses) for s in states]),
        com_velocity=np.stack([centre_of_mass(s.velocities, masses) for s in states]),
        energy=np.asarray(energy),
        deformation_gradient=deformation if {"mpm", "flight"} & set(phase) else None,
        phase=phase,
    )
