"""The object from the moment of contact on (paper, Contact Detection and Re-simulation)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoi.data import Contact, ObjectState, ObjectTrajectory, Push, Scene, SceneObject
from hoi.frames import at_frame
from hoi.method.contact import exchange
from hoi.method.object_motion import Advanced, Mover, at_rest, trajectory_of
from hoi.mpm.collider import Collider, Partner
from hoi.mpm.state import centre_of_mass, kick
from hoi.reports import Stage

SOON = 0.001
"""How long after the impulse the object's velocity is compared with V_post [s]."""


def resimulate(
    scene: Scene,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    contact: Contact,
    limb: float,
    flesh: float,
    move: Mover,
    stage: Stage,
) -> tuple[ObjectTrajectory, Contact, tuple[ObjectState, ...]]:
    """The object from t_c on, with what the impulse adds to its motion; what was before stays as in `free`.

    Args:
        limb: 1 / m_eff [1/kg]; 0 for a limb that nothing stops. flesh: see `hoi.method.contact.exchange`.

    Returns:
        the trajectory, the contact with the impulse, and the object's state at each frame, to start again from.
    """
    t_c = contact.frame
    state = _state_at(scene, free, states, t_c, move, stage)
    contact = exchange(contact, scene.thing, state, limb, flesh)
    struck = kick(
        state, contact.v_post - contact.v_object, contact.spin, centre_of_mass(state.positions, scene.thing.masses)
    )
    soon = t_c + SOON * scene.fps
    frames = [float(frame) for frame in range(scene.frames) if frame >= t_c]
    stops = sorted({soon, *frames})
    after = move(scene, struck, t_c, stops, stage)
    leaving = centre_of_mass(after.states[stops.index(soon)].velocities, scene.thing.masses) - contact.v_post
    stage.numbers["v_post_error"] = float(np.linalg.norm(leaving) / np.linalg.norm(contact.v_post))
    trajectory, states = _continued(scene.thing, free, states, after, [stops.index(frame) for frame in frames])
    return trajectory, contact, states


def push_by(
    scene: Scene,
    free: ObjectTrajectory,
    states: Sequence[ObjectState],
    contact: Contact,
    start: float,
    collider: Collider | Partner,
    move: Mover,
    stage: Stage,
) -> tuple[ObjectTrajectory, Contact, tuple[Push, ...], tuple[ObjectState, ...]]:
    """The object pushed by the collider from frame `start` on; before, it stays as in `free`.

    Returns:
        the trajectory, the contact with the impulse and the duration of the push that it began, all pushes, and the
        object's state at each frame, to start again from.
    """
    frames = [float(frame) for frame in range(scene.frames) if frame > start]
    state = _state_at(scene, free, states, start, move, stage)
    after = move(scene, state, start, frames, stage, collider)
    trajectory, states = _continued(scene.thing, free, states, after, range(len(frames)))
    if not after.pushes:
        stage.notes.append("the limb's capsules passed the object without touching it")
        return trajectory, contact, (), states
    given = sum(push.impulse for push in after.pushes)
    strike = min(after.pushes, key=lambda push: abs(push.start * scene.fps - contact.frame))
    first, last = strike.start * scene.fps, strike.end * scene.fps
    stage.numbers.update(
        impulse=float(np.linalg.norm(given)), pushes=len(after.pushes), pushed_from=first, pushed_until=last
    )
    v_post = at_frame(trajectory.com_velocity, float(np.ceil(last)))
    contact = replace(contact, impulse=strike.impulse, v_post=v_post, duration=strike.end - strike.start)
    return trajectory, contact, after.pushes, states


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
) -> tuple[ObjectTrajectory, tuple[ObjectState, ...]]:
    """`free` with its last frames replaced by the `chosen` states of `after`, and its states."""
    kept = len(states) - len(chosen)
    states = (*states[:kept], *(after.states[index] for index in chosen))
    trajectory = trajectory_of(
        thing,
        states,
        np.concatenate([free.energy[:kept], after.energy[list(chosen)]]),
        (*free.phase[:kept], *(after.phase[index] for index in chosen)),
    )
    return trajectory, states
