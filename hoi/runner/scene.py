"""From the config to the fixed scene: a person, an object, their places and units."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from hoi.config import Config, HumanConf, HumanKind, ObjectKind, PlaneContact, SceneConf
from hoi.data import Act, Body, GaussianCloud, Plan, Plane, Scene, SceneObject
from hoi.errors import under
from hoi.method.scene_representation import check_apart, check_clear
from hoi.plan import make_plan, materials_of

PARTICLES_PER_CELL = 4
"""Particles of the object's interior in a grid cell; its Gaussians come on top near the surface."""


def build_scene(
    config: Config, plan: Plan | None = None, *, thing: SceneObject | None = None, body: Body | None = None
) -> Scene:
    """Load the person and the object and place them.

    Args:
        plan: of the config; None makes it.
        thing, body: in place of those that the config names.

    Raises:
        InputError: a broken file, a region without particles, or an object in the ground, a wall or the person.
    """
    conf = config.scene
    planes = planes_of(conf, config.material.ground_friction)
    scene = Scene(
        name=conf.name,
        body=body or load_body(config.human, config.seed),
        object=thing or load_object(config),
        motion_prompt=conf.motion_prompt,
        frames=conf.frames,
        fps=conf.fps,
        gravity=np.array(conf.gravity),
        planes=tuple(planes.values()),
        setting=conf.setting.value,
        acts=acts_of(conf),
    )
    with under("scene"):
        check_clear(scene.thing, planes)
        if "approach" not in (plan or make_plan(config)).uses:
            check_apart(scene)
    return scene


def acts_of(conf: SceneConf) -> tuple[Act, ...]:
    return tuple(
        Act(
            prompt=act.prompt,
            start=act.start,
            end=act.end,
            parts=tuple(act.parts),
            strikes=act.strikes or "",
            at=math.nan if act.at is None else act.at,
            sends=tuple((np.array(act.sends) / np.linalg.norm(act.sends)).tolist()) if act.sends else (),
            tempo=act.tempo,
            flesh=math.nan if act.flesh is None else act.flesh,
        )
        for act in conf.acts
    )


def load_body(conf: HumanConf, seed: int) -> Body:
    if conf.kind is HumanKind.builtin:
        from hoi.body.people import load_person

        return load_person(conf.person or conf.name, conf.gaussians, seed)
    assert conf.path is not None  # checked by `validate`
    if conf.kind is HumanKind.smpl:
        from hoi.importers.smpl import load_smpl

        outfit = conf.person or "man"
        assert conf.gaussians is not None  # checked by `validate`
        with under("human", "person"):
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


def load_object(config: Config, cloud: GaussianCloud | None = None) -> SceneObject:
    """The object at its place; `cloud` [m], Z up, in place of the Gaussians that the config names."""
    from hoi.objects.load import load_builtin, load_cloud, load_file, place
    from hoi.objects.regions import Region, region_of

    conf, placement = config.object, config.scene.placement
    spacing = config.stage.object.cell(conf.size) / PARTICLES_PER_CELL ** (1 / 3)
    if cloud is not None:
        loaded = load_cloud(conf.name, cloud, spacing, conf.max_gaussians)
    elif conf.kind is ObjectKind.builtin:
        loaded = load_builtin(conf.shape or conf.name, spacing, conf.size, conf.max_gaussians)
    else:
        assert conf.path is not None  # checked by `validate`
        most = conf.max_gaussians
        loaded = load_file(Path(conf.path), conf.size, conf.up, spacing, most, max_drawn=conf.max_drawn)
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
