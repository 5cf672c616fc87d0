"""When a person without joints first touches and pushes an object: by distance alone."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hoi.data import Array, Contact, ContactSearch
from hoi.frames import at_frame
from hoi.method.contact import impulse

Rows = NDArray[np.integer]

UNKNOWN = -1
"""In the place of j_c: a mesh has no joints."""
LEAST_TESTS = 4
"""Times in a step at which person and object are compared, when they are near each other."""


def find_contact(
    skin: Array, surface: Array, com: Array, fps: float, *, distance: float, mass: float, restitution: float
) -> ContactSearch:
    """The first moment at which a point of the skin is within `distance` of the object while it moves towards it.

    V_human is the mean velocity, over the last step, of the points that touch. V_obj is that of the centre of mass.
    V_post and the impulse are the formula's; how the object really goes on is in its trajectory.

    Args:
        skin: (T, M, 3) [m]. surface: (T, N, 3) [m]. com: (T, 3) [m]. mass: of the object [kg].
    """
    best = (np.inf, 0.0)
    contacts: list[Contact] = []
    touched = False
    for frame in _tests(skin, surface, distance):
        limb, thing = at_frame(skin, frame), at_frame(surface, frame)
        low, high = thing.min(axis=0) - distance, thing.max(axis=0) + distance
        near = np.flatnonzero(np.all((limb >= low) & (limb <= high), axis=1))
        rows = near if len(near) else np.arange(len(limb))
        apart, nearest = (np.asarray(found) for found in KDTree(thing).query(limb[rows]))
        if apart.min() < best[0]:
            best = (float(apart.min()), frame)
        touching = apart <= distance
        if touching.any():
            found = _contact(frame, skin, rows[touching], thing[nearest[touching]], com, fps, mass, restitution)
            contact = Contact(**found, gap=float(apart.min()))
            if contact.v_in > 0:
                return ContactSearch((*contacts, contact), best[0], best[1], UNKNOWN)
            if not touched:
                contacts.append(contact)
        touched = bool(touching.any())
    return ContactSearch(tuple(contacts), best[0], best[1], UNKNOWN)


def _contact(
    frame: float, skin: Array, rows: Rows, points: Array, com: Array, fps: float, mass: float, restitution: float
) -> dict:
    back = min(1.0, frame)
    v_human = v_object = np.zeros(3)
    if back > 0:
        v_human = ((at_frame(skin, frame) - at_frame(skin, frame - back))[rows] * (fps / back)).mean(axis=0)
        v_object = (at_frame(com, frame) - at_frame(com, frame - back)) * (fps / back)
    point = points.mean(axis=0)
    normal = at_frame(com, frame) - point
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    v_in, v_post = impulse(v_human, v_object, normal, restitution)
    return {
        "frame": frame, "joint": UNKNOWN, "fraction": len(rows) / skin.shape[1], "point": point, "normal": normal,
        "v_human": v_human, "v_object": v_object, "v_in": v_in, "v_post": v_post, "impulse": mass * (v_post - v_object),
        "v_formula": v_post,
    }  # fmt: skip


def _tests(skin: Array, surface: Array, distance: float) -> list[float]:
    """Frames, and times between those whose boxes come near each other, no point moving `distance` from one to the next
    (but for what is so fast that it would take long)."""
    boxes = [(points.min(axis=1), points.max(axis=1)) for points in (skin, surface)]
    times = [0.0]
    for frame in range(len(skin) - 1):
        (low, high), (other_low, other_high) = (
            (ends[0][frame : frame + 2].min(axis=0) - distance, ends[1][frame : frame + 2].max(axis=0) + distance)
            for ends in boxes
        )
        if np.all(low <= other_high) and np.all(other_low <= high):
            near = np.any(
                [np.all((skin[at] >= other_low) & (skin[at] <= other_high), axis=1) for at in (frame, frame + 1)],
                axis=0,
            )
            paths = [
                np.linalg.norm(skin[frame + 1] - skin[frame], axis=1)[near],
                np.linalg.norm(surface[frame + 1] - surface[frame], axis=1),
            ]
            way = sum(float(path.max(initial=0.0)) for path in paths)
            tests = int(np.clip(np.ceil(way / distance), LEAST_TESTS, 64))
            times += [frame + step / tests for step in range(1, tests)]
        times.append(float(frame + 1))
    return times


def centre_of_mass_path(vertices: Array, faces: Rows, areas: Array) -> Array:
    """Centroid of triangles that keep the mass they had, by their areas (F,), at the start: (T, V, 3) -> (T, 3)."""
    return np.einsum("tfci,f->ti", vertices[:, faces], areas / areas.sum()) / 3


def velocity(com: Array, fps: float, search: ContactSearch | None) -> Array:
    """Of the centre of mass by differences [m/s], (T, 3): central, but on its own side of the push next to it."""
    speed = np.gradient(com, axis=0) * fps
    push = search.push if search is not None else None
    if push is not None:
        before, after = int(push.frame), int(push.frame) + 1
        if before >= 1:
            speed[before] = (com[before] - com[before - 1]) * fps
        if after + 1 < len(com):
            speed[after] = (com[after + 1] - com[after]) * fps
    return speed
