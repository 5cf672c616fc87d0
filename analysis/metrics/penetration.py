"""What is where something else is: person in object, object in ground and walls, feet in the ground."""

from functools import reduce

import numpy as np

from hoi.body.skeleton import LIMBS
from hoi.data import Array, Plane
from hoi.frames import at_frame
from hoi.refine.fidelity import object_at

from ..posing import joint_frames
from ..records import Record, Undefined
from .contact import push_of
from .hulls import hulls_of
from .meeting import meeting
from .metric import NAN

FEET = LIMBS["feet"]
LITRE = 1e-3
SPACING = 0.008
"""Edge of the cubes that a foot is made of, for its volume [m]."""


def person_object_depth(record: Record) -> float:
    """How deep the person's skin enters the object's surface, at most over the run: at whole frames, and six times a
    frame where they first meet and around t_c."""
    met = meeting(record)
    return NAN if met is None else float(met.depth.max(initial=0.0))


def person_object_volume(record: Record) -> float:
    """Volume of the object that is inside the person, mean over the run, at the times of the depth: rest volumes of the
    particles within the convex hulls of the joints' skin."""
    scene, motion, trajectory, met = record.scene, record.motion, record.trajectory, meeting(record)
    if met is None:
        return NAN
    hulls = hulls_of(scene.body, tuple(np.flatnonzero(met.by_joint.any(axis=0)).tolist()))
    rotations, positions = joint_frames(scene.body, motion)
    push, total = push_of(record), 0.0
    for frame, span in zip(met.frames[met.touching], _spans(met.frames)[met.touching], strict=True):
        particles = object_at(trajectory, push, scene.fps, float(frame))
        inside = np.zeros(len(particles), bool)
        for hull in hulls:  # between frames the blend of two poses, as the skin is
            turn, place = at_frame(rotations[:, hull.joint], frame), at_frame(positions[:, hull.joint], frame)
            rest = scene.body.rest_joints[hull.joint]
            corners = (hull.corners() - rest) @ turn.T + place
            near = np.all((particles >= corners.min(axis=0)) & (particles <= corners.max(axis=0)), axis=1)
            inside[near] |= hull.contains((particles[near] - place) @ np.linalg.inv(turn).T + rest)
        total += span * float(scene.thing.volumes[inside].sum())
    return total / min(len(trajectory.positions), len(motion)) / LITRE


def _spans(frames: Array) -> Array:
    """How many frames each time stands for, (F,): half of the way to its neighbours, a frame where they are farther."""
    steps = np.concatenate([[1.0], np.minimum(np.diff(frames), 1.0), [1.0]])
    return 0.5 * (steps[:-1] + steps[1:])


def object_ground_depth(record: Record) -> float:
    """How deep any particle of the object is behind the ground or a wall, at most over the frames."""
    return max(0.0, -float(_object_heights(record).min()))


def object_ground_volume(record: Record) -> float:
    """Volume of the object behind the ground or a wall, mean over the frames: rest volumes of the particles there."""
    return float(((_object_heights(record) < 0) @ record.scene.thing.volumes).mean()) / LITRE


def feet_ground_depth(record: Record) -> float:
    """How deep the skin of the feet is in the ground, at most over the frames; all of the skin where nothing says which
    of it belongs to the feet."""
    ground, skin, joints = ground_of(record), record.skin, record.skin_joints
    if skin is None:
        return NAN
    feet = skin if joints is None else skin[:, np.isin(joints, FEET)]
    return NAN if feet.shape[1] == 0 else max(0.0, -float(height_above(ground, feet).min()))


def feet_ground_volume(record: Record) -> float:
    """Volume of the feet in the ground, mean over the frames: the convex hulls of their joints' skin, in cubes of
    8 mm."""
    body, motion, ground = record.scene.body, record.motion, ground_of(record)
    rotations, positions = joint_frames(body, motion)
    hulls, count = hulls_of(body, FEET), 0
    if not hulls:
        return NAN
    for hull in hulls:
        away = hull.lattice(SPACING) - body.rest_joints[hull.joint]
        # The height of x = R away + p over the plane is (R^T n) . away + (p - point) . n.
        normals = rotations[:, hull.joint].transpose(0, 2, 1) @ ground.normal
        offsets = (positions[:, hull.joint] - ground.point) @ ground.normal
        count += int((normals @ away.T + offsets[:, None] < 0).sum())
    return count * SPACING**3 / len(motion) / LITRE


def height_above(plane: Plane, points: Array) -> Array:
    """Signed distance of points (..., 3) [m] from a plane, positive on its free side."""
    return (points - plane.point.astype(np.float32)) @ plane.normal.astype(np.float32)


def ground_of(record: Record) -> Plane:
    """The ground: the first plane, where it faces up; else undefined."""
    planes = record.scene.planes
    if not planes or planes[0].normal[2] <= 0.5:
        raise Undefined
    return planes[0]


def _object_heights(record: Record) -> Array:
    """Of all particles over the nearest plane [m], (T, P); undefined without object or planes."""
    scene, positions = record.scene, record.trajectory.positions
    if not scene.planes or not len(scene.thing.particles):
        raise Undefined
    return reduce(np.minimum, (height_above(plane, positions) for plane in scene.planes))
