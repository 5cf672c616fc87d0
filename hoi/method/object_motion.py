"""The object alone (paper, Object Motion Simulation): what a mover is, and its walk from t = 0 to T."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hoi.data import Array, ObjectState, ObjectTrajectory, Plane, Push, Scene, SceneObject
from hoi.mpm.collider import Collider, Partner
from hoi.mpm.state import centre_of_mass, initial_state
from hoi.reports import Stage


@dataclass(frozen=True)
class Advanced:
    """The object at the frames that a mover was asked for."""

    states: tuple[ObjectState, ...]
    energy: Array
    """Kinetic, elastic, potential [J], (K, 3)."""
    phase: tuple[str, ...]
    """What moved the object to each of the frames."""
    pushes: tuple[Push, ...] = ()
    """What the collider gave the object, at times of the scene."""


@dataclass(frozen=True)
class World:
    """An object and what is around it: of a scene, what concerns the object."""

    thing: SceneObject
    frames: int
    """T."""
    fps: float
    gravity: Array
    """[m/s^2], shape (3,)."""
    planes: tuple[Plane, ...] = ()
    """What it cannot enter."""


class Mover(Protocol):
    """Moves the object from its state at frame `start` to each of the frames `stops`; frames may be fractional."""

    def __call__(
        self,
        scene: Scene | World,
        state: ObjectState,
        start: float,
        stops: Sequence[float],
        stage: Stage,
        collider: Collider | Partner | None = None,
    ) -> Advanced:
        """`collider` is what pushes the object on the way; its times are those of the scene, frame 0 being 0 s, and a
        partner is where it is at `start`."""
        ...


class JointMover(Protocol):
    """Moves several objects, which may hit, slide on and lie on each other."""

    def __call__(
        self,
        worlds: Sequence[World],
        states: Sequence[ObjectState],
        start: float,
        stops: Sequence[float],
        stage: Stage,
        colliders: Sequence[Collider | Partner | None] = (),
        held: Sequence[bool] = (),
    ) -> tuple[Advanced, ...]:
        """As a `Mover`, of each of N objects; all worlds have one rate and one gravity.

        The friction of a pair is the geometric mean of what their first materials have against the ground.

        Args:
            colliders: what pushes each, N of them; a partner pushes one object alone. (): nothing does.
            held: which of them lie still until something comes near. (): none.
        """
        ...


def joint_motion(
    worlds: Sequence[World], move: JointMover, stage: Stage, held: Sequence[bool] = ()
) -> tuple[tuple[ObjectTrajectory, tuple[ObjectState, ...]], ...]:
    """Several objects from t = 0 to T, as `free_motion` of each that may touch the others."""
    starts = [
        initial_state(world.thing.particles, world.thing.masses, world.thing.velocity, world.thing.angular_velocity)
        for world in worlds
    ]
    found = move(worlds, starts, 0.0, range(worlds[0].frames), stage, (), held)
    return tuple(
        (trajectory_of(world.thing, each.states, each.energy, each.phase), each.states)
        for world, each in zip(worlds, found, strict=True)
    )


def at_rest(
    scene: Scene | World,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | Partner | None = None,
) -> Advanced:
    """Nothing happens: the object lies still."""
    stage.advance(len(stops))
    energy = np.tile(rigid_energy(scene, state), (len(stops), 1))
    return Advanced((state,) * len(stops), energy, ("rest",) * len(stops))


def rigid_energy(scene: Scene | World, state: ObjectState) -> tuple[float, float, float]:
    """Kinetic, elastic and potential energy [J] of an object that does not deform."""
    masses = scene.thing.masses
    kinetic = 0.5 * float(masses @ (state.velocities**2).sum(axis=1))
    potential = -float(masses @ (state.positions @ scene.gravity))
    return kinetic, 0.0, potential


def free_motion(scene: Scene | World, move: Mover, stage: Stage) -> tuple[ObjectTrajectory, tuple[ObjectState, ...]]:
    """The object alone, from t = 0 to T (paper, Object Motion Simulation); with its states, to start again from."""
    thing = scene.thing
    start = initial_state(thing.particles, thing.masses, thing.velocity, thing.angular_velocity)
    frames = move(scene, start, 0.0, range(scene.frames), stage)
    return trajectory_of(thing, frames.states, frames.energy, frames.phase), frames.states


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
        deformation_gradient=deformation if {"mpm", "flight", "rolling"} & set(phase) else None,
        phase=phase,
    )
