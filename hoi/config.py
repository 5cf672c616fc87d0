"""The typed configuration: one dataclass a group, registered with Hydra, checked as a whole by `validate`.

Defaults live in `conf/`, not here: a field without a value there is an error at composition. No heavy imports.
"""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.errors import InputError

CONF = Path(__file__).parent / "conf"
if not CONF.is_dir():  # a checkout: the folder stands beside the package, a wheel carries it inside
    CONF = Path(__file__).parents[1] / "conf"


class Device(StrEnum):
    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


class Ablation(StrEnum):
    full = "full"
    no_attraction = "no_attraction"
    no_contact = "no_contact"
    no_mdm = "no_mdm"
    no_mpm = "no_mpm"
    no_video_sds = "no_video_sds"


class HumanKind(StrEnum):
    builtin = "builtin"
    avatar = "avatar"


class ObjectKind(StrEnum):
    builtin = "builtin"
    file = "file"


class MaterialModel(StrEnum):
    fixed_corotated = "fixed_corotated"
    neo_hookean = "neo_hookean"


class MotionKind(StrEnum):
    hmsd = "hmsd"
    none = "none"


class MotionInit(StrEnum):
    sample = "sample"
    stand = "stand"


class AttractionKind(StrEnum):
    windowed = "windowed"
    none = "none"


class AttractionTarget(StrEnum):
    surface = "surface"
    com = "com"


class ContactKind(StrEnum):
    impulse = "impulse"
    none = "none"


class MoverKind(StrEnum):
    mpm = "mpm"
    constant_velocity = "constant_velocity"


class Precision(StrEnum):
    float32 = "float32"
    float64 = "float64"


class RefineKind(StrEnum):
    video_sds = "video_sds"
    none = "none"


@dataclass
class HumanConf:
    """The person."""

    kind: HumanKind = MISSING
    name: str = MISSING
    person: str | None = None
    """Which of the people in the package, for kind=builtin."""
    path: str | None = None
    """Canonical 3DGS PLY, for kind=avatar."""
    skinning: str | None = None
    """Skinning .npz beside it; skinning.npz in the PLY's folder when null."""
    gaussians: int = MISSING
    """Gaussians sampled on a built-in person's skin."""


@dataclass
class ObjectConf:
    """The object, before it is placed."""

    kind: ObjectKind = MISSING
    name: str = MISSING
    shape: str | None = None
    """Which of the shapes in the package, for kind=builtin."""
    path: str | None = None
    """3DGS file (.ply, .splat, .spz), for kind=file."""
    size: float = MISSING
    """Largest extent [m]."""
    up: str = MISSING
    """The file's up axis: +x, -x, +y, -y, +z or -z."""
    stable: bool = MISSING
    """Stays where it is when put on the ground: its motion at rest need not be simulated."""
    max_gaussians: int = MISSING
    """A larger cloud is thinned to this."""


@dataclass
class MaterialConf:
    """See `hoi.data.Material`."""

    name: str = MISSING
    model: MaterialModel = MISSING
    youngs_modulus: float = MISSING
    poisson_ratio: float = MISSING
    density: float = MISSING
    restitution: float = MISSING
    ground_friction: float = MISSING


@dataclass
class MotionConf:
    """Stage 1."""

    kind: MotionKind = MISSING


@dataclass
class HMSDConf(MotionConf):
    """Human motion score distillation."""

    checkpoint: str | None = None
    """The motion prior: null for the one in the package, or a file or folder."""
    init: MotionInit = MISSING
    """Start from a sample of the prior, or from the standing pose."""
    sample_guidance: float = MISSING
    """Guidance scale of that sample."""
    iterations: int = MISSING
    """N_init."""
    learning_rate: float = MISSING
    guidance: float = MISSING
    """Classifier-free guidance scale of the distillation."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back."""
    t_min: int = MISSING
    t_max: int = MISSING
    """Diffusion timesteps are drawn from [t_min, t_max)."""


@dataclass
class CoordinateConf:
    """Stage 2."""

    iterations: int = MISSING
    """N_sync."""
    learning_rate: float = MISSING
    lambda_hmsd: float = MISSING


@dataclass
class AttractionConf:
    kind: AttractionKind = MISSING


@dataclass
class WindowedConf(AttractionConf):
    """The windowed attraction loss."""

    lambda_attr: float = MISSING
    sigma: float = MISSING
    """Standard deviation of the window [frames]."""
    half_width: int = MISSING
    """Delta t* [frames]: the window ends here."""
    target: AttractionTarget = MISSING


@dataclass
class ContactConf:
    kind: ContactKind = MISSING


@dataclass
class ImpulseConf(ContactConf):
    """Contact detection and the impulse it gives."""

    tau: float = MISSING
    """tau_contact: least share of a joint's Gaussians that touch."""
    distance: float = MISSING
    """d_contact [m]."""
    between_frames: bool = MISSING
    """Look between frames too, so that a fast strike cannot pass through unseen."""


@dataclass
class MoverConf:
    kind: MoverKind = MISSING


@dataclass
class MPMConf(MoverConf):
    """The material point method."""

    cells_across: int | None = None
    """Grid cells across the object's largest extent; null when `domain` and `grid` are given."""
    domain: float | None = None
    """Edge of the whole domain [m]; with `grid`, the cell size is domain / grid."""
    grid: int | None = None
    dt: float | None = None
    """Time step [s]; null chooses it from the stability limit."""
    limit_fraction: float = MISSING
    """Fraction of the stability limit that a chosen dt takes."""
    precision: Precision = MISSING
    skip_rest: bool = MISSING
    """Leave out the simulation of an object that lies still."""


@dataclass
class ConstantVelocityConf(MoverConf):
    """Straight lines: no gravity, no deformation."""


@dataclass
class RefineConf:
    """Stage 3."""

    kind: RefineKind = MISSING


@dataclass
class StageConf:
    motion: MotionConf = MISSING
    coordinate: CoordinateConf = MISSING
    attraction: AttractionConf = MISSING
    contact: ContactConf = MISSING
    object: MoverConf = MISSING
    refine: RefineConf = MISSING


@dataclass
class PlacementConf:
    """The object at t = 0."""

    position: list[float | None] = MISSING
    """Centre of the object's bounding box [m]; a z of null puts it on the ground."""
    yaw: float = 0.0
    """Turn about Z [rad]."""
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """[m/s]."""
    angular_velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """[rad/s]."""


@dataclass
class SceneConf:
    """Who does what to what, and where."""

    name: str = MISSING
    motion_prompt: str = MISSING
    """p_motion."""
    scene_prompt: str = MISSING
    """p_scene, for the video prior."""
    negative_prompt: str = MISSING
    frames: int = MISSING
    """T."""
    fps: float = MISSING
    """[1/s]."""
    gravity: list[float] = MISSING
    """[m/s^2]."""
    placement: PlacementConf = field(default_factory=PlacementConf)
    striking_limb: str | None = None
    """The limb that j* is chosen from; null takes all joints, as the paper does."""
    expected_limb: str = MISSING
    """What a person should see strike; reported against what did."""
    contact_joint: str = MISSING
    """j* where no motion shows it (w/o MDM)."""
    contact_frame: int = MISSING
    """t* where no motion shows it (w/o MDM)."""


@dataclass
class Config:
    seed: int = MISSING
    out: str = MISSING
    """Folder of the run."""
    overwrite: bool = MISSING
    """Replace a finished record of another config."""
    plan_only: bool = MISSING
    device: Device = MISSING
    """For torch and Taichi alike."""
    threads: int | None = None
    """CPU threads; null takes what the machine has."""
    human_points: int = MISSING
    """Points of the person in the record's point clouds (viewing only)."""
    experiment: str = MISSING
    ablation: Ablation = MISSING
    human: HumanConf = MISSING
    object: ObjectConf = MISSING
    material: MaterialConf = MISSING
    stage: StageConf = field(default_factory=StageConf)
    scene: SceneConf = MISSING


SCHEMAS: dict[tuple[str, str], type] = {
    ("schema", "config"): Config,
    ("schema", "human"): HumanConf,
    ("schema", "object"): ObjectConf,
    ("schema", "material"): MaterialConf,
    ("schema", "scene"): SceneConf,
    ("schema/stage", "hmsd"): HMSDConf,
    ("schema/stage", "no_motion"): MotionConf,
    ("schema/stage", "coordinate"): CoordinateConf,
    ("schema/stage", "windowed"): WindowedConf,
    ("schema/stage", "no_attraction"): AttractionConf,
    ("schema/stage", "impulse"): ImpulseConf,
    ("schema/stage", "no_contact"): ContactConf,
    ("schema/stage", "mpm"): MPMConf,
    ("schema/stage", "constant_velocity"): ConstantVelocityConf,
    ("schema/stage", "refine"): RefineConf,
}


def register() -> None:
    """Put the schemas where the files of `conf/` find them."""
    store = ConfigStore.instance()
    for (group, name), schema in SCHEMAS.items():
        store.store(group=group, name=name, node=schema)


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
