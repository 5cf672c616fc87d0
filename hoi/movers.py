"""What moves the object: nothing, a straight line, or the MPM; and its re-simulation from the moment of contact."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hoi.config import Config, MPMConf
from hoi.data import Array, Contact, ObjectState, ObjectTrajectory, Scene, SceneObject
from hoi.mpm.state import centre_of_mass, initial_state, kick
from hoi.progress import Stage


@dataclass(frozen=True)
class Advanced:
    """The object at the frames that a mover was asked for."""

    states: tuple[ObjectState, ...]
    energy: Array
    """Kinetic, elastic, potential [J], (K, 3)."""
    phase: str


SOON = 0.001
"""How long after the impulse the object's velocity is compared with V_post [s]."""

Mover = Callable[[Scene, ObjectState, float, Sequence[float], Stage], Advanced]
"""(scene, state at frame `start`, start, frames to stop at, stage) -> `Advanced`. Frames may be fractional."""


def mover(config: Config, device: str) -> Mover:
    """The configured mover. Taichi is imported when the MPM first runs, not before."""
    conf = config.stage.object
    if not isinstance(conf, MPMConf):
        return constant_velocity

    def mpm(scene: Scene, state: ObjectState, start: float, stops: Sequence[float], stage: Stage) -> Advanced:
        return _mpm(scene, state, start, stops, stage, conf, config.object.size, device)

    return mpm


def _mpm(
    scene: Scene,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    conf: MPMConf,
    size: float,
    device: str,
) -> Advanced:
    from hoi.mpm.solver import simulate
    from hoi.mpm.stability import choose_time_step
    from hoi.plan import cell_size

    material = scene.object.material
    dx = cell_size(conf, size)
    fall = float(np.linalg.norm(scene.gravity)) * (stops[-1] - start) / scene.fps
    speed = float(np.hypot(np.linalg.norm(state.velocities, axis=1).max(), fall))
    dt = choose_time_step(material, dx, speed, dt=conf.dt, fraction=conf.limit_fraction)
    result = simulate(
        state,
        scene.object.volumes,
        material,
        dx=dx,
        dt=dt,
        times=(np.asarray(stops) - start) / scene.fps,
        gravity=scene.gravity,
        precision=conf.precision.value,
        device="cuda" if device == "cuda" else "cpu",
        on_time=stage.advance,
    )
    stage.numbers.update(steps=stage.numbers.get("steps", 0) + result.steps, dt=dt, cfl=result.cfl)
    stage.numbers["compile_seconds"] = stage.numbers.get("compile_seconds", 0.0) + result.compile_seconds
    return Advanced(result.states, result.energy, "mpm")


def constant_velocity(scene: Scene, state: ObjectState, start: float, stops: Sequence[float], stage: Stage) -> Advanced:
    """Straight lines: no gravity, no ground, no deformation (paper, w/o MPM)."""
    velocity = centre_of_mass(state.velocities, scene.object.masses)
    states = []
    for stop in stops:
        moved = state.positions + velocity * (stop - start) / scene.fps
        states.append(replace(state, positions=moved, velocities=np.tile(velocity, (len(moved), 1))))
        stage.advance()
    energy = [_rigid_energy(scene, s) for s in states]
    return Advanced(tuple(states), np.array(energy).reshape(-1, 3), "constant_velocity")


def at_rest(scene: Scene, state: ObjectState, start: float, stops: Sequence[float], stage: Stage) -> Advanced:
    """Nothing happens: the object lies still."""
    stage.advance(len(stops))
    return Advanced(tuple(state for _ in stops), np.array([_rigid_energy(scene, state) for _ in stops]), "rest")


def _rigid_energy(scene: Scene, state: ObjectState) -> tuple[float, float, float]:
    masses = scene.object.masses
    kinetic = 0.5 * float(masses @ (state.velocities**2).sum(axis=1))
    potential = -float(masses @ (state.positions @ scene.gravity))
    return kinetic, 0.0, potential


def free_motion(scene: Scene, move: Mover, stage: Stage) -> tuple[ObjectTrajectory, tuple[ObjectState, ...]]:
    """The object alone, from t = 0 to T (paper, Object Motion Simulation); with its states, to start again from."""
    thing = scene.object
    start = initial_state(thing.particles, thing.masses, thing.velocity, thing.angular_velocity)
    frames = move(scene, start, 0.0, range(scene.frames), stage)
    return trajectory_of(thing, frames.states, frames.energy, (frames.phase,) * scene.frames), frames.states


def resimulate(
    scene: Scene,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    contact: Contact,
    move: Mover,
    stage: Stage,
) -> ObjectTrajectory:
    """The object from t_c on, its velocity changed by V_post - V_obj; what was before stays as in `free`."""
    t_c, first = contact.frame, int(contact.frame)
    at_contact = states[first]
    if t_c > first:
        before = at_rest if free.phase[first] == "rest" else move
        at_contact = before(scene, at_contact, first, [t_c], stage).states[-1]
    struck = kick(at_contact, contact.v_post - contact.v_object)
    stops = [float(frame) for frame in range(scene.frames) if frame >= t_c]
    kept = scene.frames - len(stops)
    soon = move(scene, struck, t_c, [t_c + SOON * scene.fps], stage).states[-1]
    leaving = centre_of_mass(soon.velocities, scene.object.masses) - contact.v_post
    stage.numbers["v_post_error"] = float(np.linalg.norm(leaving) / np.linalg.norm(contact.v_post))
    after = move(scene, struck, t_c, stops, stage)
    return trajectory_of(
        scene.object,
        (*states[:kept], *after.states),
        np.concatenate([free.energy[:kept], after.energy]),
        (*free.phase[:kept], *(after.phase for _ in stops)),
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
        deformation_gradient=deformation if "mpm" in phase else None,
        phase=phase,
    )
