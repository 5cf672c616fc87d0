"""Person and object as Gaussians in one scene (paper, Scene Representation), apart from each other and from walls.

The Gaussians themselves are `hoi.data.GaussianCloud`; the person bound to SMPL's joints is `hoi.data.Body`, posed by
`hoi.body.skinning`; the object, whose Gaussians are MPM particles, is `hoi.data.SceneObject`, made in `hoi.objects`.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import KDTree

from hoi.body.segments import segment_distances
from hoi.body.skeleton import PARENTS
from hoi.body.skinning import joint_paths, posed_means, stand_motion
from hoi.data import Motion, Plane, Scene, SceneObject
from hoi.errors import InputError

PLANE_TOLERANCE = 1e-4
"""How deep a particle may lie in the ground or a wall at the start [m]."""


def check_clear(thing: SceneObject, planes: Mapping[str, Plane]) -> None:
    """Refuse an object that starts in the ground or in a wall.

    Raises:
        InputError: names the plane and how deep the object lies in it.
    """
    for name, plane in planes.items():
        depth = -float(((thing.particles - plane.point) @ plane.normal).min())
        if depth > PLANE_TOLERANCE:
            remedy = (
                "raise z by that, or leave z empty to set it down on the ground"
                if name == "the ground"
                else f"move it by that along the normal {plane.normal.round(3).tolist()}"
            )
            raise InputError(f"placement: {thing.name} would start {depth:.3g} m deep in {name}; {remedy}")


def check_apart(scene: Scene, motion: Motion | None = None) -> None:
    """Refuse an object inside the person at t = 0 (see `is_apart`).

    Raises:
        InputError: it is.
    """
    if not is_apart(scene, motion):
        centre = scene.thing.cloud.means.mean(axis=0)[:2].round(3).tolist()
        raise InputError(f"placement: the object at {centre} is inside the person at t = 0; move it away")


def is_apart(scene: Scene, motion: Motion | None = None) -> bool:
    """Whether no particle of the object is inside the person, who starts as in `motion` or stands at the origin.

    A point is inside where it is nearer to the bones than the skin next to it is.
    """
    start = motion or stand_motion(scene.body, 1, scene.fps)
    skin = posed_means(scene.body, start, frames=[0])[0]
    joints = joint_paths(scene.body, start, frames=[0])[0]
    particles = scene.thing.particles
    near = np.all((particles >= skin.min(axis=0)) & (particles <= skin.max(axis=0)), axis=1)
    particles = particles[near]
    if len(particles) == 0:
        return True
    gap, nearest = KDTree(skin).query(particles)
    bones = joints[list(PARENTS[1:])], joints[1:]
    to_bones, of_skin = (segment_distances(points, *bones).min(axis=1) for points in (particles, skin[nearest]))
    return not bool(((to_bones < of_skin) & (gap < 0.2)).any())
