"""From what Hydra composed to a checked config: every problem at once, each a line that names field, value and rule."""

import math
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.config import (
    CONF,
    Config,
    ContactModel,
    HMSDConf,
    HumanKind,
    ImpulseConf,
    MaterialConf,
    MotionInit,
    MPMConf,
    ObjectKind,
    PlaneContact,
    VideoConf,
    VideoPriorKind,
    VideoSDSConf,
    WindowConf,
    WindowedConf,
)
from hoi.errors import InputError
from hoi.video_prior.files import EMBEDDED_PICTURE

SMALLEST_PICTURE, LARGEST_PICTURE = 16, 8192
"""Edges that H.264 can have [pixel]; its colour planes are half as large, so they are even."""


def to_config(composed: DictConfig) -> Config:
    """The composed, checked configuration as dataclasses.

    In `composed`, so in what is recorded and hashed, the regions' materials are filled in.

    Raises:
        InputError: a missing value, or anything `validate` finds; one line a problem.
    """
    fill_in_materials(composed)
    missing = sorted(OmegaConf.missing_keys(composed))
    if missing:
        raise InputError(f"{', '.join(missing)}: no value given")
    config: Any = OmegaConf.to_object(composed)
    problems = validate(config)
    if problems:
        raise InputError("\n".join(problems))
    return config


def fill_in_materials(composed: DictConfig) -> None:
    """Put the whole material in the place of each region's (see `hoi.config.RegionConf`).

    Raises:
        InputError: an unknown name or field, or a value of the wrong type.
    """
    for index, region in enumerate(composed.object.regions):
        where = f"object.regions.{index}.material"
        if OmegaConf.is_missing(region, "material"):
            continue
        material = region.material
        if isinstance(material, str):
            material = _preset(material, where)
        elif not isinstance(material, DictConfig):
            raise InputError(f"{where} must be a name or a mapping, got {material}")
        base = OmegaConf.structured(MaterialConf) if "model" in material else composed.material
        try:
            region.material = OmegaConf.merge(base, material)
        except OmegaConfBaseException as error:
            raise InputError(f"{where}: {str(error).splitlines()[0]}") from None


def _preset(name: str, where: str) -> Any:
    """conf/material/NAME.yaml without what is Hydra's."""
    path = CONF / "material" / f"{name}.yaml"
    known = sorted(file.stem for file in path.parent.glob("*.yaml"))
    if name not in known:
        raise InputError(f"{where}: unknown material {name!r}; allowed are {', '.join(known)}, or a mapping")
    preset: Any = OmegaConf.load(path)
    del preset["defaults"]
    return preset


def _numbers(node: Any, path: str = "") -> list[tuple[str, float]]:
    """Every number of a dataclass tree with its dotted name."""
    if hasattr(node, "__dataclass_fields__"):
        pairs = [(name, getattr(node, name)) for name in node.__dataclass_fields__]
    elif isinstance(node, list):
        pairs = [(str(i), value) for i, value in enumerate(node)]
    else:
        return [(path, node)] if isinstance(node, (int, float)) and not isinstance(node, bool) else []
    return [found for name, value in pairs for found in _numbers(value, f"{path}.{name}" if path else name)]


def validate(config: Config) -> list[str]:
    """All that is wrong with a composed config, one sentence each; empty when it is fine.

    What needs a file or the physics is checked where the file is opened and in `hoi.plan`.
    """
    problems = [f"{name} must be finite, got {value}" for name, value in _numbers(config) if not math.isfinite(value)]
    if problems:
        return problems

    def require(holds: bool, name: str, value: object, rule: str) -> None:
        if not holds:
            problems.append(f"{name} must be {rule}, got {value}")

    scene, stage, placement = config.scene, config.stage, config.scene.placement
    require(config.seed >= 0, "seed", config.seed, "0 or more")
    require(config.seeds >= 1, "seeds", config.seeds, "1 or more")
    require(config.threads is None or config.threads >= 1, "threads", config.threads, "1 or more, or null")
    require(config.human_points >= 100, "human_points", config.human_points, "100 or more")
    require(config.human.gaussians >= 1000, "human.gaussians", config.human.gaussians, "1000 or more")
    if config.human.kind is HumanKind.avatar:
        require(
            config.human.path is not None,
            "human.path",
            config.human.path,
            "the path of an avatar's folder or 3DGS PLY file",
        )
    if config.human.kind is HumanKind.smpl:
        require(config.human.path is not None, "human.path", config.human.path, "the path of an SMPL .npz or .pkl file")
    shapeless = config.human.kind is not HumanKind.smpl
    rule = f"empty: human.kind is {config.human.kind.value}"
    require(not (shapeless and config.human.betas), "human.betas", config.human.betas, rule)
    if config.object.kind is ObjectKind.file:
        require(config.object.path is not None, "object.path", config.object.path, "the path of a 3DGS file")
    require(config.object.size > 0, "object.size", config.object.size, "greater than 0 [m]")
    axes = ("+x", "-x", "+y", "-y", "+z", "-z")
    require(config.object.up in axes, "object.up", config.object.up, f"one of {', '.join(axes)}")
    require(config.object.max_gaussians >= 100, "object.max_gaussians", config.object.max_gaussians, "100 or more")
    materials = {"material": config.material}
    for index, region in enumerate(config.object.regions):
        name, box = f"object.regions.{index}", region.box
        materials[f"{name}.material"] = region.material
        for part, vector in (("centre", box.centre), ("half_size", box.half_size)):
            require(len(vector) == 3, f"{name}.box.{part}", vector, "a list of 3 numbers")
        require(all(half > 0 for half in box.half_size), f"{name}.box.half_size", box.half_size, "greater than 0")
    for name, material in materials.items():
        require(0 <= material.restitution <= 1, f"{name}.restitution", material.restitution, "in [0, 1]")
        require(material.ground_friction >= 0, f"{name}.ground_friction", material.ground_friction, "0 or more")

    require(scene.frames >= 2, "scene.frames", scene.frames, "2 or more")
    require(scene.fps > 0, "scene.fps", scene.fps, "greater than 0 [1/s]")
    for name, vector, length in (
        ("scene.gravity", scene.gravity, 3),
        ("scene.placement.position", placement.position, 3),
        ("scene.placement.velocity", placement.velocity, 3),
        ("scene.placement.angular_velocity", placement.angular_velocity, 3),
    ):
        require(len(vector) == length, name, vector, f"a list of {length} numbers")
    turn = placement.orientation
    require(len(turn) == 4 and any(turn), "scene.placement.orientation", turn, "a quaternion wxyz that is not zero")
    on_ground = len(placement.position) == 3 and placement.position[2] is None
    require(scene.ground or not on_ground, "scene.placement.position", placement.position, "a number in z: no ground")
    for index, plane in enumerate(scene.planes or []):
        name, coulomb = f"scene.planes.{index}", plane.contact is PlaneContact.coulomb
        require(len(plane.point) == 3, f"{name}.point", plane.point, "a list of 3 numbers")
        normal = plane.normal
        require(len(normal) == 3 and any(normal), f"{name}.normal", normal, "a list of 3 numbers, not all 0")
        friction = plane.friction
        require(friction is None or coulomb, f"{name}.friction", friction, f"null: contact is {plane.contact.value}")
        require(friction is None or friction >= 0, f"{name}.friction", friction, "0 or more, or null")
    xy = placement.position[:2]
    require(None not in xy, "scene.placement.position", placement.position, "numbers in x and y")
    require(scene.expected_limb in LIMBS, "scene.expected_limb", scene.expected_limb, f"one of {', '.join(LIMBS)}")
    limb = scene.striking_limb
    require(limb is None or limb in LIMBS, "scene.striking_limb", limb, f"null or one of {', '.join(LIMBS)}")
    joints = ", ".join(JOINT_NAMES)
    require(scene.contact_joint in JOINT_NAMES, "scene.contact_joint", scene.contact_joint, f"one of {joints}")
    last = scene.frames - 1
    require(0 <= scene.contact_frame <= last, "scene.contact_frame", scene.contact_frame, f"in [0, {last}]")

    motion = stage.motion
    if isinstance(motion, HMSDConf):
        rule = "3 or more: the motion prior sees velocities and their changes"
        require(scene.frames >= 3, "scene.frames", scene.frames, rule)
        require(motion.iterations >= 0, "stage.motion.iterations", motion.iterations, "0 or more")
        given, named = motion.path is not None, motion.init is MotionInit.file
        rule = f"{'the path of a .npz or .bvh file' if named else 'null'}: stage.motion.init is {motion.init.value}"
        require(given == named, "stage.motion.path", "null" if motion.path is None else motion.path, rule)
        require(motion.start_time >= 0, "stage.motion.start_time", motion.start_time, "0 or more [s]")
        for name in ("guidance_rescale", "sample_rescale"):
            require(0 <= getattr(motion, name) <= 1, f"stage.motion.{name}", getattr(motion, name), "in [0, 1]")
        steps = motion.sample_steps
        require(steps is None or steps >= 1, "stage.motion.sample_steps", steps, "1 or more, or null")
        require(motion.learning_rate > 0, "stage.motion.learning_rate", motion.learning_rate, "greater than 0")
        require(
            0 <= motion.t_min < motion.t_max,
            "stage.motion.t_min",
            motion.t_min,
            f"in [0, stage.motion.t_max = {motion.t_max})",
        )
    coordinate = stage.coordinate
    require(coordinate.iterations >= 0, "stage.coordinate.iterations", coordinate.iterations, "0 or more")
    rate = coordinate.learning_rate
    require(rate > 0, "stage.coordinate.learning_rate", rate, "greater than 0")
    decay, feet = coordinate.decay, coordinate.lambda_feet
    require(0 <= decay <= 1, "stage.coordinate.decay", decay, "in [0, 1]")
    require(feet >= 0, "stage.coordinate.lambda_feet", feet, "0 or more")
    require(coordinate.lambda_hmsd >= 0, "stage.coordinate.lambda_hmsd", coordinate.lambda_hmsd, "0 or more")
    attraction = stage.attraction
    if isinstance(attraction, WindowedConf):
        require(attraction.lambda_attr >= 0, "stage.attraction.lambda_attr", attraction.lambda_attr, "0 or more")
        require(attraction.growth >= 1, "stage.attraction.growth", attraction.growth, "1 or more")
        require(attraction.sigma > 0, "stage.attraction.sigma", attraction.sigma, "greater than 0 [frames]")
        width = attraction.half_width
        require(width >= 0, "stage.attraction.half_width", width, "0 or more [frames]")
    contact = stage.contact
    if isinstance(contact, ImpulseConf):
        require(0 < contact.tau <= 1, "stage.contact.tau", contact.tau, "in (0, 1]")
        require(contact.distance > 0, "stage.contact.distance", contact.distance, "greater than 0 [m]")
        require(contact.friction >= 0, "stage.contact.friction", contact.friction, "0 or more")
        require(contact.samples >= 1, "stage.contact.samples", contact.samples, "1 or more")
        pushes = contact.model is ContactModel.impulse or isinstance(stage.object, MPMConf)
        rule = f"impulse where stage/object is {stage.object.kind.value}: a limb can only push what the MPM moves"
        require(pushes, "stage.contact.model", contact.model.value, rule)
    mover = stage.object
    if isinstance(mover, MPMConf):
        require(0 < mover.limit_fraction <= 1, "stage.object.limit_fraction", mover.limit_fraction, "in (0, 1]")
        tolerance = mover.vibration_tolerance
        require(tolerance >= 0, "stage.object.vibration_tolerance", tolerance, "0 or more")
        require(mover.dt is None or mover.dt > 0, "stage.object.dt", mover.dt, "greater than 0 [s], or null")
        for name in ("cells_across", "grid", "domain"):
            value = getattr(mover, name)
            require(value is None or value > 0, f"stage.object.{name}", value, "greater than 0, or null")
        by_domain = (mover.domain is None) == (mover.grid is None)
        require(
            by_domain and (mover.cells_across is None) != (mover.domain is None),
            "stage.object",
            f"cells_across={mover.cells_across}, domain={mover.domain}, grid={mover.grid}",
            "given either cells_across or both domain and grid",
        )
    refine = stage.refine
    if isinstance(refine, WindowConf):
        require(refine.tolerance >= 0, "stage.refine.tolerance", refine.tolerance, "0 or more [m]")
        require(refine.half_width >= 0, "stage.refine.half_width", refine.half_width, "0 or more [frames]")
        require(refine.iterations >= 1, "stage.refine.iterations", refine.iterations, "1 or more")
        for name in ("lambda_penetration", "lambda_touch", "lambda_pose", "lambda_smooth"):
            require(getattr(refine, name) >= 0, f"stage.refine.{name}", getattr(refine, name), "0 or more")
    if isinstance(refine, VideoSDSConf):
        given, embedded = refine.checkpoint, refine.prior is VideoPriorKind.embedded
        rule = "a folder or hub name: stage.refine.prior is cogvideox"
        require(embedded or given is not None, "stage.refine.checkpoint", "null", rule)
        require(refine.learning_rate > 0, "stage.refine.learning_rate", refine.learning_rate, "greater than 0")
        rescale = refine.guidance_rescale
        require(0 <= rescale <= 1, "stage.refine.guidance_rescale", rescale, "in [0, 1]")
        for name, highest in (("t_max", 999), ("t_max_end", refine.t_max), ("t_min", refine.t_max_end)):
            timestep = getattr(refine, name)
            require(0 <= timestep <= highest, f"stage.refine.{name}", timestep, f"in [0, {highest}]")
        falls = refine.t_max_iterations
        require(falls >= 1, "stage.refine.t_max_iterations", falls, "1 or more")
        require(refine.viewpoints >= 1, "stage.refine.viewpoints", refine.viewpoints, "1 or more")
        require(abs(refine.elevation) < math.pi / 2, "stage.refine.elevation", refine.elevation, "in (-pi/2, pi/2)")
        distance, clip = refine.distance, refine.clip_frames
        require(distance is None or distance > 0, "stage.refine.distance", distance, "greater than 0 [m], or null")
        for name in ("width", "height"):
            value = getattr(refine, name)
            inside = SMALLEST_PICTURE <= value <= LARGEST_PICTURE and value % SMALLEST_PICTURE == 0
            require(inside, f"stage.refine.{name}", value, f"a multiple of {SMALLEST_PICTURE} up to {LARGEST_PICTURE}")
        if embedded:  # what it has been trained on
            size, fixed = EMBEDDED_PICTURE, "null with stage.refine.prior=embedded"
            require(clip is None, "stage.refine.clip_frames", clip, fixed)
            for name in ("width", "height"):
                value, rule = getattr(refine, name), f"{size} with stage.refine.prior=embedded"
                require(value == size, f"stage.refine.{name}", value, rule)
        else:
            whole = clip is None or (clip >= 1 and clip % 4 == 1)
            require(whole, "stage.refine.clip_frames", clip, "4 k + 1 frames (9, 13, ..., 49), or null")
        require(refine.lambda_geometry >= 0, "stage.refine.lambda_geometry", refine.lambda_geometry, "0 or more")
    render = config.render
    if isinstance(render, VideoConf):
        require(0.1 <= scene.fps <= 1000, "scene.fps", scene.fps, "in [0.1, 1000] [1/s] for a video")
        for name in ("width", "height"):
            value = getattr(render, name)
            rule = f"an even number in [{SMALLEST_PICTURE}, {LARGEST_PICTURE}] [pixel]"
            inside = SMALLEST_PICTURE <= value <= LARGEST_PICTURE
            require(inside and value % 2 == 0, f"render.{name}", value, rule)
        degree = render.sh_degree
        require(degree is None or 0 <= degree <= 3, "render.sh_degree", degree, "0, 1, 2 or 3, or null")
    return problems
