"""From the config to the fixed scene: a person, an object, their places and units."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from hoi.body.skeleton import PARENTS
from hoi.config import Config, HumanConf, HumanKind, MPMConf, ObjectKind, PlaneContact, SceneConf
from hoi.data import Array, Body, Motion, Plane, Scene, SceneObject
from hoi.errors import InputError, under
from hoi.plan import approaches, cell_size, materials_of

PARTICLES_PER_CELL = 4
"""Particles of the object's interior in a grid cell; its Gaussians come on top near the surface."""
FILLING_ACROSS = 24
"""Filling resolution where no grid decides it: particles across the object."""
PLANE_TOLERANCE = 1e-4
"""How deep a particle may lie in the ground or a wall at the start [m]."""


def build_scene(config: Config) -> Scene:
    """Load the person and the object and place them.

    Raises:
        InputError: a broken file, a region without particles, or an object in the ground, a wall or the person.
    """
    conf = config.scene
    planes = planes_of(conf, config.material.ground_friction)
    scene = Scene(
        name=conf.name,
        body=load_body(config.human, config.seed),
        object=load_object(config),
        motion_prompt=conf.motion_prompt,
        frames=conf.frames,
        fps=conf.fps,
        gravity=np.array(conf.gravity),
        planes=tuple(planes.values()),
    )
    check_clear(scene.thing, planes)
    if not approaches(config):
        check_apart(scene)
    return scene


def load_body(conf: HumanConf, seed: int) -> Body:
    if conf.kind is HumanKind.builtin:
        from hoi.body.people import load_person

        return load_person(conf.person or conf.name, conf.gaussians, seed)
    assert conf.path is not None  # checked by `validate`
    if conf.kind is HumanKind.smpl:
        from hoi.importers.smpl import load_smpl

        outfit = conf.person or "man"
        return load_smpl(Path(conf.path), conf.betas, conf.gaussians, seed, outfit, conf.pose_correctives)
    from hoi.body.avatar import load_avatar

    return load_avatar(Path(conf.path), Path(conf.skinning) if conf.skinning else None)


def planes_of(conf: SceneConf, ground_friction: float) -> dict[str, Plane]:
    """What the object cannot enter, by the name that a message can call it: the ground first."""
    planes = {"the ground": Plane(np.zeros(3), np.array([0.0, 0, 1]), friction=ground_friction)} if conf.ground else {}
    for index, wall in enumerate(conf.planes or []):
        normal = np.array(wall.normal)
        friction = ground_friction if wall.friction is None else wall.friction
        planes[f"scene.planes.{index}"] = Plane(
            point=np.array(wall.point),
            normal=normal / np.linalg.norm(normal),
            contact=wall.contact.value,
            friction=friction if wall.contact is PlaneContact.coulomb else 0.0,
        )
    return planes


def load_object(config: Config) -> SceneObject:
    from hoi.objects.load import load_builtin, load_file, place
    from hoi.objects.regions import Region, region_of

    conf, mover, placement = config.object, config.stage.object, config.scene.placement
    dx = cell_size(mover, conf.size) if isinstance(mover, MPMConf) else conf.size / (FILLING_ACROSS / 2)
    spacing = dx / PARTICLES_PER_CELL ** (1 / 3)
    if conf.kind is ObjectKind.builtin:
        loaded = load_builtin(conf.shape or conf.name, spacing, conf.size, conf.max_gaussians)
    else:
        assert conf.path is not None  # checked by `validate`
        loaded = load_file(Path(conf.path), conf.size, conf.up, spacing, conf.max_gaussians)
    material, *others = materials_of(config)
    placed = place(
        loaded,
        material,
        position=placement.position,
        yaw=placement.yaw,
        orientation=placement.orientation,
        velocity=placement.velocity,
        angular_velocity=placement.angular_velocity,
    )
    boxes = [region.box for region in conf.regions]
    regions = [Region(np.array(b.centre), np.array(b.half_size), m) for b, m in zip(boxes, others, strict=True)]
    with under("object"):
        region = region_of(loaded.particles, loaded.size, regions)
    return replace(placed, other_materials=tuple(others), region=region)


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
            raise InputError(f"scene.placement: {thing.name} would start {depth:.3g} m deep in {name}; {remedy}")


def check_apart(scene: Scene, motion: Motion | None = None) -> None:
    """Refuse an object inside the person at t = 0 (see `is_apart`).

    Raises:
        InputError: it is.
    """
    if not is_apart(scene, motion):
        centre = scene.thing.cloud.means.mean(axis=0)[:2].round(3).tolist()
        raise InputError(f"scene.placement: the object at {centre} is inside the person at t = 0; move it away")


def is_apart(scene: Scene, motion: Motion | None = None) -> bool:
    """Whether no particle of the object is inside the person, who starts as in `motion` or stands at the origin.

    A point is inside where it is nearer to the bones than the skin next to it is.
    """
    from scipy.spatial import KDTree

    from hoi.body.skinning import joint_paths, posed_means, stand_motion

    start = motion or stand_motion(scene.body, 1, scene.fps)
    skin = posed_means(scene.body, start, frames=[0])[0]
    joints = joint_paths(scene.body, start, frames=[0])[0]
    particles = scene.thing.particles
    near = np.all((particles >= skin.min(axis=0)) & (particles <= skin.max(axis=0)), axis=1)
    particles = particles[near]
    if len(particles) == 0:
        return True
    gap, nearest = KDTree(skin).query(particles)
    inside = _bone_distance(particles, joints) < _bone_distance(skin[nearest], joints)
    return not bool((inside & (gap < 0.2)).any())


def _bone_distance(points: Array, joints: Array) -> Array:
    """Distance of points (N, 3) to the nearest bone of joints (24, 3) [m], (N,)."""
    starts, ends = joints[list(PARENTS[1:])], joints[1:]
    along = ends - starts
    share = ((points[:, None] - starts) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    closest = starts + np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(points[:, None] - closest, axis=-1).min(axis=1)
