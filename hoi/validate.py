"""From what Hydra composed to a checked config: every problem at once, each a line that names field, value and rule."""

import math
from typing import Any

from omegaconf import DictConfig, OmegaConf

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.config import Config, HMSDConf, HumanKind, ImpulseConf, MPMConf, ObjectKind, WindowedConf
from hoi.errors import InputError


def to_config(composed: DictConfig) -> Config:
    """The composed, checked configuration as dataclasses.

    Raises:
        InputError: a missing value, or anything `validate` finds; one line a problem.
    """
    missing = sorted(OmegaConf.missing_keys(composed))
    if missing:
        raise InputError(f"{', '.join(missing)}: no value given")
    config: Any = OmegaConf.to_object(composed)
    problems = validate(config)
    if problems:
        raise InputError("\n".join(problems))
    return config


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
    require(config.threads is None or config.threads >= 1, "threads", config.threads, "1 or more, or null")
    require(config.human_points >= 100, "human_points", config.human_points, "100 or more")
    require(config.human.gaussians >= 1000, "human.gaussians", config.human.gaussians, "1000 or more")
    if config.human.kind is HumanKind.avatar:
        require(config.human.path is not None, "human.path", config.human.path, "the path of a 3DGS PLY file")
    if config.object.kind is ObjectKind.file:
        require(config.object.path is not None, "object.path", config.object.path, "the path of a 3DGS file")
    require(config.object.size > 0, "object.size", config.object.size, "greater than 0 [m]")
    axes = ("+x", "-x", "+y", "-y", "+z", "-z")
    require(config.object.up in axes, "object.up", config.object.up, f"one of {', '.join(axes)}")
    require(config.object.max_gaussians >= 100, "object.max_gaussians", config.object.max_gaussians, "100 or more")
    restitution = config.material.restitution
    require(0 <= restitution <= 1, "material.restitution", restitution, "in [0, 1]")
    friction = config.material.ground_friction
    require(friction >= 0, "material.ground_friction", friction, "0 or more")

    require(scene.frames >= 2, "scene.frames", scene.frames, "2 or more")
    require(scene.fps > 0, "scene.fps", scene.fps, "greater than 0 [1/s]")
    for name, vector, length in (
        ("scene.gravity", scene.gravity, 3),
        ("scene.placement.position", placement.position, 3),
        ("scene.placement.velocity", placement.velocity, 3),
        ("scene.placement.angular_velocity", placement.angular_velocity, 3),
    ):
        require(len(vector) == length, name, vector, f"a list of {length} numbers")
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
        require(motion.iterations >= 0, "stage.motion.iterations", motion.iterations, "0 or more")
        rescale = motion.guidance_rescale
        require(0 <= rescale <= 1, "stage.motion.guidance_rescale", rescale, "in [0, 1]")
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
    require(coordinate.lambda_hmsd >= 0, "stage.coordinate.lambda_hmsd", coordinate.lambda_hmsd, "0 or more")
    attraction = stage.attraction
    if isinstance(attraction, WindowedConf):
        require(attraction.lambda_attr >= 0, "stage.attraction.lambda_attr", attraction.lambda_attr, "0 or more")
        require(attraction.sigma > 0, "stage.attraction.sigma", attraction.sigma, "greater than 0 [frames]")
        width = attraction.half_width
        require(width >= 0, "stage.attraction.half_width", width, "0 or more [frames]")
    contact = stage.contact
    if isinstance(contact, ImpulseConf):
        require(0 < contact.tau <= 1, "stage.contact.tau", contact.tau, "in (0, 1]")
        require(contact.distance > 0, "stage.contact.distance", contact.distance, "greater than 0 [m]")
    mover = stage.object
    if isinstance(mover, MPMConf):
        require(0 < mover.limit_fraction <= 1, "stage.object.limit_fraction", mover.limit_fraction, "in (0, 1]")
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
    return problems
