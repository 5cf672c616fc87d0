"""The typed configuration: one dataclass a group, registered with Hydra, checked as a whole by `hoi.validate`.

Defaults live in `conf/`, not here: a field without a value there is an error at composition. No heavy imports.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from hoi.choices import (
    Ablation,
    Approach,
    AttractionKind,
    AttractionTarget,
    ContactKind,
    ContactModel,
    Device,
    HumanKind,
    MaterialModel,
    MotionInit,
    MotionKind,
    MoverKind,
    ObjectKind,
    PlaneContact,
    Precision,
    RefineKind,
    RefineWhen,
    RenderBackend,
    RenderKind,
    Sampler,
    Spline,
    UpAxis,
    VideoPriorKind,
    View,
)

CONF = Path(__file__).parent / "conf"
if not CONF.is_dir():  # a checkout: the folder stands beside the package, a wheel carries it inside
    CONF = Path(__file__).parents[1] / "conf"


@dataclass
class HumanConf:
    """The person."""

    kind: HumanKind = MISSING
    name: str = MISSING
    person: str | None = None
    """Which of the people in the package, for kind=builtin; whose clothes to wear, for kind=smpl."""
    path: str | None = None
    """Avatar folder or canonical 3DGS PLY, for kind=avatar; SMPL's .npz or .pkl, for kind=smpl."""
    skinning: str | None = None
    """Skinning .npz of an avatar; skinning.npz in the PLY's folder when null."""
    gaussians: int = MISSING
    """Gaussians sampled on a built-in person's or an SMPL body's skin."""
    betas: list[float] = field(default_factory=list)
    """Shape parameters of an SMPL body; those left out are 0."""
    pose_correctives: bool = True
    """Whether an SMPL body keeps its pose blend shapes."""


@dataclass
class BoxConf:
    """A box in the object's own frame, in units of its size: the whole object lies within [-0.5, 0.5]^3.

    The frame is the one that `up` makes, Z up, before the object is turned and placed; its origin is the centre of the
    object's bounding box.
    """

    centre: list[float] = MISSING
    half_size: list[float] = MISSING


@dataclass
class RegionConf:
    """A part of the object that is made of something else."""

    box: BoxConf = field(default_factory=BoxConf)
    material: Any = MISSING
    """A name in conf/material, or a mapping: of what differs from the object's own material, or a whole one if it names
    a `model`. `hoi.validate` puts the `MaterialConf` here."""


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
    regions: list[RegionConf] = field(default_factory=list)
    """Parts of other materials; where they overlap, the later one holds."""


@dataclass
class MaterialConf:
    """See `hoi.data.Material`. What has a value here is for some models only; `hoi.mpm.materials` says for which."""

    name: str = MISSING
    model: MaterialModel = MISSING
    youngs_modulus: float = MISSING
    poisson_ratio: float = MISSING
    density: float = MISSING
    restitution: float = MISSING
    ground_friction: float = MISSING
    yield_stress: float | None = None
    """[Pa]; null never yields."""
    hardening: float = 0.0
    viscosity: float = 0.0
    friction_angle: float = 0.0
    """[rad]."""
    critical_compression: float = 0.0
    critical_stretch: float = 0.0


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
    """Start from a sample of the prior, from the standing pose, or from a motion file."""
    path: str | None = None
    """The motion file (.npz, .bvh), for init=file."""
    start_time: float = 0.0
    """Where in the file the motion begins [s]."""
    up: UpAxis = UpAxis.auto
    """The file's up axis; auto tells it from the person's."""
    sample_guidance: float = MISSING
    """Guidance scale of that sample."""
    sample_rescale: float = MISSING
    """Share of its overshoot that is taken back."""
    sampler: Sampler = MISSING
    """Ancestral, with fresh noise at each step, or DDIM, without."""
    sample_steps: int | None = MISSING
    """Evenly spaced timesteps of that sample; null takes all."""
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
    decay: float = MISSING
    """Share of the iterations, the last ones, over which the learning rate falls to 0."""
    lambda_hmsd: float = MISSING
    lambda_feet: float = MISSING
    """Of the feet: those that the free motion plants stay there, and none goes into the ground."""


@dataclass
class AttractionConf:
    kind: AttractionKind = MISSING


@dataclass
class WindowedConf(AttractionConf):
    """The windowed attraction loss."""

    lambda_attr: float = MISSING
    growth: float = MISSING
    """Of lambda_attr, each iteration in which the joint is not yet where it should be at t*."""
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
    """Contact detection and what it does to the object."""

    model: ContactModel = MISSING
    """The paper's impulse, or the striking limb as a moving obstacle in the MPM."""
    tau: float = MISSING
    """tau_contact: least share of a joint's Gaussians that touch."""
    distance: float = MISSING
    """d_contact [m]."""
    between_frames: bool = MISSING
    """Look between frames too, so that a fast strike cannot pass through unseen."""
    friction: float = MISSING
    """Coulomb coefficient between limb and object, for model=collider."""
    samples: int = MISSING
    """Times a frame at which the limb's place is computed, for model=collider; straight lines in between."""


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
    spline: Spline = MISSING
    """B-splines between particles and grid."""
    precision: Precision = MISSING
    phases: bool = MISSING
    """Leave out the steps that the motion does not need: rest, and flight between contacts."""
    vibration_tolerance: float = MISSING
    """Amplitude of the vibration, and way crept, that `phases` may leave out, relative to the object's size."""


@dataclass
class ConstantVelocityConf(MoverConf):
    """Straight lines: no gravity, no deformation."""


@dataclass
class RefineConf:
    """Stage 3."""

    kind: RefineKind = MISSING


@dataclass
class WindowConf(RefineConf):
    """What moves theta of the frames around t_c, whatever the loss."""

    when: RefineWhen = MISSING
    """Only when a limb enters the object by more than `tolerance`, or whenever there is a contact."""
    tolerance: float = MISSING
    """Deepest penetration in the window that needs no refinement [m]."""
    half_width: float = MISSING
    """Delta t [frames]: the window is [t_c - Delta t, t_c + Delta t]."""
    iterations: int = MISSING
    lambda_penetration: float = MISSING
    """Of the depth of the limb in the object."""
    lambda_touch: float = MISSING
    """Of the distance between the skin of j_c and the object at t_c."""
    lambda_pose: float = MISSING
    """Of leaving stage 2's pose; more for joints farther up the limb."""
    lambda_smooth: float = MISSING
    """Of changing accelerations, in the window and at its edges."""


@dataclass
class GeometricConf(WindowConf):
    """No prior: the limb out of the object and its skin at the surface."""


@dataclass
class VideoSDSConf(WindowConf):
    """Temporally masked Video-SDS."""

    prior: VideoPriorKind = MISSING
    checkpoint: str | None = None
    """Folder or hub name of the video prior; null for the one in the package (prior=embedded)."""
    learning_rate: float = MISSING
    guidance: float = MISSING
    """Classifier-free guidance scale."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back."""
    t_min: int = MISSING
    t_max: int = MISSING
    """Diffusion timesteps, of 1000, are drawn from [t_min, t_max] ..."""
    t_max_end: int = MISSING
    t_max_iterations: int = MISSING
    """... where t_max falls linearly to t_max_end in these iterations and stays there."""
    viewpoints: int = MISSING
    """Cameras, evenly spaced on a circle around the action; an iteration looks from one."""
    elevation: float = MISSING
    """Of the cameras above the horizon [rad]."""
    distance: float | None = MISSING
    """Radius of that circle [m]; null frames what the prior wants to see."""
    width: int = MISSING
    height: int = MISSING
    """Of the pictures [pixel]; the embedded prior has its own size."""
    clip_frames: int | None = MISSING
    """Frames that the prior sees; null: as many as it was trained on."""
    offload: bool = MISSING
    """Keep on the GPU only what is at work (prior=cogvideox)."""
    lambda_geometry: float = MISSING
    """Of the loss of stage/refine=geometric, added to Video-SDS; the paper has none."""


@dataclass
class StageConf:
    motion: MotionConf = MISSING
    coordinate: CoordinateConf = MISSING
    attraction: AttractionConf = MISSING
    contact: ContactConf = MISSING
    object: MoverConf = MISSING
    refine: RefineConf = MISSING


@dataclass
class RenderConf:
    """The video of the finished run."""

    kind: RenderKind = MISSING


@dataclass
class VideoConf(RenderConf):
    """One picture a frame, from one camera."""

    view: View = MISSING
    """Where the camera stands."""
    width: int = MISSING
    height: int = MISSING
    """[pixel], even."""
    backend: RenderBackend = MISSING
    sh_degree: int | None = None
    """Highest degree of the Gaussians' harmonics that is drawn; null draws all."""


@dataclass
class PlacementConf:
    """The object at t = 0."""

    position: list[float | None] = MISSING
    """Centre of the object's bounding box [m]; a z of null puts it on the ground."""
    yaw: float = 0.0
    """Turn about Z [rad]."""
    orientation: list[float] = field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])
    """Turn before that: quaternion wxyz of any length."""
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """[m/s]."""
    angular_velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """[rad/s]."""


@dataclass
class PlaneConf:
    """A wall that the object cannot enter; see `hoi.data.Plane`."""

    point: list[float] = MISSING
    """[m]."""
    normal: list[float] = MISSING
    """Into the free side, of any length."""
    contact: PlaneContact = PlaneContact.coulomb
    friction: float | None = None
    """Coulomb coefficient; null takes material.ground_friction."""


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
    ground: bool = True
    """Whether the half-space z < 0 is solid, with the material's ground_friction."""
    planes: list[PlaneConf] | None = None
    """Walls beside the ground."""
    placement: PlacementConf = field(default_factory=PlacementConf)
    approach: Approach = Approach.step
    """The person is placed and turned such that the strike ends at the object, and steps in (step) or stays where they
    are (stand); none: they start at the origin facing +Y, wherever the object is. It is a part of the attraction:
    without one, or without a motion prior, the person starts there too."""
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
    seeds: int = MISSING
    """Runs to do: of seed, seed + 1, ..., their persons optimised as one batch."""
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
    render: RenderConf = MISSING
    scene: SceneConf = MISSING


SCHEMAS: dict[tuple[str, str], type] = {
    ("schema", "config"): Config,
    ("schema", "human"): HumanConf,
    ("schema", "object"): ObjectConf,
    ("schema", "material"): MaterialConf,
    ("schema", "scene"): SceneConf,
    ("schema", "video"): VideoConf,
    ("schema", "no_render"): RenderConf,
    ("schema/stage", "hmsd"): HMSDConf,
    ("schema/stage", "no_motion"): MotionConf,
    ("schema/stage", "coordinate"): CoordinateConf,
    ("schema/stage", "windowed"): WindowedConf,
    ("schema/stage", "no_attraction"): AttractionConf,
    ("schema/stage", "impulse"): ImpulseConf,
    ("schema/stage", "no_contact"): ContactConf,
    ("schema/stage", "mpm"): MPMConf,
    ("schema/stage", "constant_velocity"): ConstantVelocityConf,
    ("schema/stage", "video_sds"): VideoSDSConf,
    ("schema/stage", "geometric"): GeometricConf,
    ("schema/stage", "no_refine"): RefineConf,
}


def register() -> None:
    """Put the schemas where the files of `conf/` find them."""
    store = ConfigStore.instance()
    for (group, name), schema in SCHEMAS.items():
        store.store(group=group, name=name, node=schema)
