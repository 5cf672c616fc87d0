"""What is drawn beside the Gaussians: bones, arrows at the contacts, the trail of the object, planes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.body.skeleton import PARENTS
from hoi.body.skinning import joint_paths
from hoi.data import Array, Contact, Plane, Run

NORMAL_LENGTH = 0.3
"""Of the arrow along a contact's normal [m]."""
IMPULSE_LENGTH = 0.6
"""Of the arrow of the largest impulse [m]; others are in proportion."""
MOST_PARTICLES = 40_000
"""Drawn; of more, every second, third, ... one."""
SLOW, FAST = np.array([70, 110, 200.0]), np.array([230, 80, 30.0])
"""Colours of the trail at no speed and at the largest."""
REGIONS = np.array([[235, 140, 52], [70, 130, 210], [90, 170, 90], [200, 90, 160], [120, 120, 120]], np.uint8)
"""Colours of particles by the index of their material."""


@dataclass(frozen=True)
class Marks:
    """Marks of a run. What it has nothing for is None or empty."""

    joints: Array | None
    """[m], (T, 24, 3)."""
    contacts: tuple[Contact, ...]
    com: Array | None
    """Centre of mass of the object [m], (T, 3)."""
    speed: Array | None
    """Of it [m/s], (T,)."""
    particles: Array | None
    """Some of them, or all [m], (T, P, 3)."""
    particle_colours: NDArray[np.uint8] | None
    """(P, 3)."""
    planes: tuple[Plane, ...]


def marks_of(run: Run) -> Marks:
    """The marks of a run that has a scene."""
    scene, motion, trajectory, search = run.scene, run.state.motion, run.state.trajectory, run.state.contact
    assert scene is not None  # checked by `hoi.render.replay.replay`
    particles = colours = None
    if trajectory is not None:
        stride = -(-trajectory.positions.shape[1] // MOST_PARTICLES)
        particles = trajectory.positions[:, ::stride]
        region = scene.thing.region
        index = np.zeros(particles.shape[1], int) if region is None else region[::stride]
        colours = REGIONS[index % len(REGIONS)]
    return Marks(
        joints=None if motion is None else joint_paths(scene.body, motion),
        contacts=() if search is None else search.contacts,
        com=None if trajectory is None else trajectory.com.astype(np.float32),
        speed=None if trajectory is None else np.linalg.norm(trajectory.com_velocity, axis=1),
        particles=particles,
        particle_colours=colours,
        planes=scene.planes,
    )


def bones(joints: Array) -> Array:
    """Joints (24, 3) -> both ends of the 23 bones, (23, 2, 3)."""
    return np.stack([joints[list(PARENTS[1:])], joints[1:]], 1)


def normal_arrow(contact: Contact) -> Array:
    """Start and end [m], (2, 3)."""
    return np.stack([contact.point, contact.point + NORMAL_LENGTH * contact.normal])


def impulse_arrow(contact: Contact, largest: float) -> Array:
    """Start and end [m], (2, 3), where `largest` is the largest impulse of all that are compared [N s]."""
    return np.stack([contact.point, contact.point + IMPULSE_LENGTH / max(largest, 1e-12) * contact.impulse])


def largest_impulse(contacts: tuple[Contact, ...]) -> float:
    """[N s]; 0 where there is none."""
    return max((float(np.linalg.norm(contact.impulse)) for contact in contacts), default=0.0)


def trail(com: Array, frame: int) -> Array:
    """The path up to a frame, (T - 1, 2, 3): segments that are still to come have no length."""
    path = com[np.minimum(np.arange(len(com)), frame)]
    return np.stack([path[:-1], path[1:]], 1)


def trail_colours(speed: Array) -> NDArray[np.uint8]:
    """Of the ends of the segments by speed, (T - 1, 2, 3)."""
    share = (speed / max(float(speed.max(initial=0)), 1e-9))[:, None]
    colours = np.rint(SLOW + share * (FAST - SLOW)).astype(np.uint8)
    return np.stack([colours[:-1], colours[1:]], 1)


def is_level(plane: Plane) -> bool:
    """Whether the plane is a floor."""
    return float(plane.normal[2]) > 1 - 1e-9


def plane_axes(normal: Array) -> Array:
    """Two unit vectors in the plane and its normal, right-handed, as columns (3, 3)."""
    normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    aside = np.array([0.0, 0, 1]) if abs(normal[2]) < 0.9 else np.array([1.0, 0, 0])
    second = np.cross(normal, aside)
    second /= np.linalg.norm(second)
    return np.column_stack([np.cross(second, normal), second, normal])
