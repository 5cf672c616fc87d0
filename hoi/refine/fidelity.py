"""How well limb and object meet: how deep the one is in the other, how much of it touches, how far it is off.

NumPy only, so that what reads records needs no torch. Distances are signed, positive outside the object, from
`hoi.refine.surface`; the skin is the Gaussians' means.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Contact, ObjectTrajectory, SceneObject
from hoi.frames import at_frame
from hoi.refine.surface import Surface, surface_of

SUBFRAMES = 6
"""Times in a frame at which limb and object are compared."""


@dataclass(frozen=True)
class Fidelity:
    """Of a contact, over the frames around it."""

    penetration: float
    """How deep any of the skin enters the object, at most over all frames asked for [m]; 0 or more, lower is better."""
    touching: float
    """Share of the striking joint's skin that is no farther from the surface than d_contact at t_c, in or out [-]; in
    [0, 1], higher is better."""
    gap: float
    """How far is the striking joint's skin off the object at t_c [m]; 0 where it touches or enters; lower is better."""
    closest: float
    """The least such distance over all frames asked for [m]; lower is better."""

    @property
    def miss(self) -> float:
        """How far the contact is from touch: what is inside at worst, and what is apart at t_c [m]."""
        return self.penetration + self.gap


def instants(first: float, last: float, also: Iterable[float] = ()) -> Array:
    """`SUBFRAMES` times a frame from `first` to `last`, and the frames `also`; in order, (F,)."""
    count = math.ceil((last - first) * SUBFRAMES) + 1
    return np.unique(np.concatenate([np.linspace(first, last, count), np.array(list(also), float)]))


def object_at(trajectory: ObjectTrajectory, push: Contact | None, fps: float, frame: float) -> Array:
    """The object's particles at a fractional frame [m], (P, 3): linear, but for the velocity's jump at the impulse.

    A push of a limb that is over within the frame is taken as one speed between the speeds before and after.
    """
    first = min(int(frame), len(trajectory.positions) - 2)
    before, after = trajectory.positions[first], trajectory.positions[first + 1]
    over = math.inf if push is None else push.frame + push.duration * fps
    if push is not None and first < push.frame and over < first + 1:
        velocity = trajectory.com_velocity / fps
        coming = before + (min(frame, push.frame) - first) * velocity[first]
        leaving = after - (first + 1 - max(frame, over)) * velocity[first + 1]
        if frame <= push.frame:
            return coming
        return leaving if frame >= over else coming + (frame - push.frame) / (over - push.frame) * (leaving - coming)
    return at_frame(trajectory.positions, frame)


def surfaces_near(
    thing: SceneObject,
    trajectory: ObjectTrajectory,
    push: Contact | None,
    fps: float,
    frames: Sequence[float] | Array,
    box: tuple[Array, Array],
) -> tuple[Surface, ...]:
    """The object's surface at each of the frames (F,), as far as it is near a box, its corners (3,) [m].

    Frames in which nothing of it has moved share one.
    """
    found: list[Surface] = []
    last: Array | None = None
    for frame in frames:
        particles = object_at(trajectory, push, fps, float(frame))
        if last is None or not np.array_equal(particles, last):
            found.append(surface_of(particles, len(thing.cloud), thing.volumes, thing.size, box))
            last = particles
        else:
            found.append(found[-1])
    return tuple(found)


def signed_distances(surfaces: Sequence[Surface], skin: Array) -> Array:
    """Of skin (F, M, 3) [m] to the object at each of F instants [m], (F, M); negative inside."""
    return np.stack([surface.distance(points)[0] for surface, points in zip(surfaces, skin, strict=True)])


def measure(signed: Array, striking: NDArray[np.bool_], at_contact: int, distance: float) -> Fidelity:
    """The fidelity of a contact.

    Args:
        signed: distances of the limb's skin to the object at F instants [m], (F, M). striking: which of the skin
            belongs to the striking joint, (M,). at_contact: which instant is t_c. distance: d_contact [m].
    """
    struck = signed[at_contact, striking]
    return Fidelity(
        penetration=max(0.0, -float(signed.min())),
        touching=float((np.abs(struck) <= distance).mean()),
        gap=max(0.0, float(struck.min())),
        closest=max(0.0, float(signed[:, striking].min())),
    )
