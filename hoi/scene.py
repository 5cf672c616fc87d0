"""From the config to the fixed scene: a person, an object, their places and units."""

from pathlib import Path

import numpy as np

from hoi.body.skeleton import PARENTS
from hoi.config import Config, HumanConf, HumanKind, MPMConf, ObjectKind
from hoi.data import Array, Body, Material, Scene, SceneObject
from hoi.errors import InputError
from hoi.plan import cell_size, material_of

PARTICLES_PER_CELL = 4
"""Particles of the object's interior in a grid cell; its Gaussians come on top near the surface."""
FILLING_ACROSS = 24
"""Filling resolution where no grid decides it: particles across the object."""


def build_scene(config: Config) -> Scene:
    """Load the person and the object and place them.

    Raises:
        InputError: a broken file, or an object under the ground or inside the person.
    """
    conf = config.scene
    scene = Scene(
        name=conf.name,
        body=load_body(config.human, config.seed),
        object=load_object(config, material_of(config.material)),
        motion_prompt=conf.motion_prompt,
        frames=conf.frames,
        fps=conf.fps,
        gravity=np.array(conf.gravity),
    )
    check_apart(scene)
    return scene


def load_body(conf: HumanConf, seed: int) -> Body:
    if conf.kind is HumanKind.builtin:
        from hoi.body.people import load_person

        return load_person(conf.person or conf.name, conf.gaussians, seed)
    from hoi.body.avatar import load_avatar

    assert conf.path is not None  # checked by `validate`
    return load_avatar(Path(conf.path), Path(conf.skinning) if conf.skinning else None)


def load_object(config: Config, material: Material) -> SceneObject:
    from hoi.objects.load import load_builtin, load_file, place

    conf, mover, placement = config.object, config.stage.object, config.scene.placement
    dx = cell_size(mover, conf.size) if isinstance(mover, MPMConf) else conf.size / (FILLING_ACROSS / 2)
    spacing = dx / PARTICLES_PER_CELL ** (1 / 3)
    if conf.kind is ObjectKind.builtin:
        loaded = load_builtin(conf.shape or conf.name, spacing, conf.size, conf.max_gaussians)
    else:
        assert conf.path is not None  # checked by `validate`
        loaded = load_file(Path(conf.path), conf.size, conf.up, spacing, conf.max_gaussians)
    return place(
        loaded,
        material,
        position=placement.position,
        yaw=placement.yaw,
        velocity=placement.velocity,
        angular_velocity=placement.angular_velocity,
    )


def check_apart(scene: Scene) -> None:
    """Refuse an object inside the person, who stands at the origin at t = 0.

    A point is inside where it is nearer to the bones than the skin next to it is.

    Raises:
        InputError: a particle of the object lies inside the person.
    """
    from scipy.spatial import KDTree

    from hoi.body.skinning import joint_paths, posed_means, stand_motion

    standing = stand_motion(scene.body, 1, scene.fps)
    skin = posed_means(scene.body, standing)[0]
    joints = joint_paths(scene.body, standing)[0]
    particles = scene.object.particles
    near = np.all((particles >= skin.min(axis=0)) & (particles <= skin.max(axis=0)), axis=1)
    particles = particles[near]
    if len(particles) == 0:
        return
    gap, nearest = KDTree(skin).query(particles)
    inside = _bone_distance(particles, joints) < _bone_distance(skin[nearest], joints)
    if (inside & (gap < 0.2)).any():
        centre = scene.object.cloud.means.mean(axis=0)[:2].round(3).tolist()
        raise InputError(f"scene.placement: the object at {centre} is inside the person at t = 0; move it away")


def _bone_distance(points: Array, joints: Array) -> Array:
    """Distance of points (N, 3) to the nearest bone of joints (24, 3) [m], (N,)."""
    starts, ends = joints[list(PARENTS[1:])], joints[1:]
    along = ends - starts
    share = ((points[:, None] - starts) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    closest = starts + np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(points[:, None] - closest, axis=-1).min(axis=1)
