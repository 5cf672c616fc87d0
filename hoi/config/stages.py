"""The stages of the method, each with what it can be replaced by."""

from dataclasses import dataclass

from omegaconf import MISSING

from hoi.config.choices import (
    AttractionKind,
    AttractionTarget,
    ContactKind,
    ContactModel,
    MotionInit,
    MotionKind,
    MoverKind,
    Precision,
    RefineKind,
    RefineWhen,
    Sampler,
    Spline,
    UpAxis,
    VideoPriorKind,
)


@dataclass
class MotionConf:
    """Stage 1."""

    kind: MotionKind = MISSING
    """Distilled from a motion prior, or none."""


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
    """Guidance scale of that sample [-]."""
    sample_rescale: float = MISSING
    """Share of its overshoot that is taken back [-]."""
    sampler: Sampler = MISSING
    """Ancestral, with fresh noise at each step, or DDIM, without."""
    sample_steps: int | None = MISSING
    """Evenly spaced timesteps of that sample; null takes all."""
    iterations: int = MISSING
    """N_init."""
    learning_rate: float = MISSING
    """Of Adam on X = (r, omega, theta) [-]."""
    guidance: float = MISSING
    """Classifier-free guidance scale of the distillation [-]."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back [-]."""
    t_min: int = MISSING
    """Diffusion timesteps are drawn from here ..."""
    t_max: int = MISSING
    """... up to the one before this."""


@dataclass
class CoordinateConf:
    """Stage 2."""

    iterations: int = MISSING
    """N_sync."""
    learning_rate: float = MISSING
    """Of Adam on X [-]."""
    decay: float = MISSING
    """Share of the iterations, the last ones, over which the learning rate falls to 0 [-]."""
    lambda_hmsd: float = MISSING
    """Of L_HMSD [-]."""
    lambda_feet: float = MISSING
    """Of the feet [-]: those that the free motion plants stay there, and none goes into the ground."""


@dataclass
class AttractionConf:
    """The pull of stage 2 towards the object."""

    kind: AttractionKind = MISSING
    """The windowed loss, or none."""


@dataclass
class WindowedConf(AttractionConf):
    """The windowed attraction loss."""

    lambda_attr: float = MISSING
    """Of L_attr [-]."""
    growth: float = MISSING
    """Of lambda_attr, each iteration in which the joint is not yet where it should be at t* [-]."""
    sigma: float = MISSING
    """Standard deviation of the window [frames]."""
    half_width: int = MISSING
    """Delta t*: the window ends here [frames]."""
    target: AttractionTarget = MISSING
    """Where the joint is pulled: to the object's surface along its own strike, or to the centre of mass."""


@dataclass
class ContactConf:
    """What happens when person and object touch."""

    kind: ContactKind = MISSING
    """Looked for, or none."""


@dataclass
class ImpulseConf(ContactConf):
    """Contact detection and what it does to the object."""

    model: ContactModel = MISSING
    """The paper's impulse, or the striking limb as a moving obstacle in the MPM."""
    tau: float = MISSING
    """tau_contact: least share of a joint's Gaussians that touch [-]."""
    distance: float = MISSING
    """d_contact [m]."""
    between_frames: bool = MISSING
    """Look between frames too, so that a fast strike cannot pass through unseen."""
    friction: float = MISSING
    """Coulomb coefficient between limb and object, for model=collider [-]."""
    samples: int = MISSING
    """Times a frame at which the limb's place is computed, for model=collider; straight lines in between."""


@dataclass
class MoverConf:
    """What moves the object."""

    kind: MoverKind = MISSING
    """The MPM, or straight lines."""


@dataclass
class MPMConf(MoverConf):
    """The material point method."""

    cells_across: int | None = None
    """Grid cells across the object's largest extent; null when `domain` and `grid` are given."""
    domain: float | None = None
    """Edge of the whole domain [m]; with `grid`, the cell size is domain / grid."""
    grid: int | None = None
    """Cells along that edge."""
    dt: float | None = None
    """Time step [s]; null chooses it from the stability limit."""
    limit_fraction: float = MISSING
    """Fraction of the stability limit that a chosen dt takes [-]."""
    spline: Spline = MISSING
    """B-splines between particles and grid."""
    precision: Precision = MISSING
    """Of particles and grid."""
    phases: bool = MISSING
    """Leave out the steps that the motion does not need: rest, and flight between contacts."""
    vibration_tolerance: float = MISSING
    """Amplitude of the vibration, and way crept, that `phases` may leave out, relative to the object's size [-]."""


@dataclass
class ConstantVelocityConf(MoverConf):
    """Straight lines: no gravity, no deformation."""


@dataclass
class RefineConf:
    """Stage 3."""

    kind: RefineKind = MISSING
    """Video-SDS, geometry alone, or none."""


@dataclass
class WindowConf(RefineConf):
    """What moves theta of the frames around t_c, whatever the loss."""

    when: RefineWhen = MISSING
    """Only when a limb enters the object by more than `tolerance`, or whenever there is a contact."""
    tolerance: float = MISSING
    """Deepest penetration in the window that needs no refinement [m]."""
    half_width: float = MISSING
    """Delta t: the window is t_c plus and minus this [frames]."""
    iterations: int = MISSING
    """Of the optimiser; at most so many where `when` is needed."""
    lambda_penetration: float = MISSING
    """Of the depth of the limb in the object [-]."""
    lambda_touch: float = MISSING
    """Of the distance between the skin of j_c and the object at t_c [-]."""
    lambda_pose: float = MISSING
    """Of leaving stage 2's pose; more for joints farther up the limb [-]."""
    lambda_smooth: float = MISSING
    """Of changing accelerations, in the window and at its edges [-]."""


@dataclass
class GeometricConf(WindowConf):
    """No prior: the limb out of the object and its skin at the surface."""


@dataclass
class VideoSDSConf(WindowConf):
    """Temporally masked Video-SDS."""

    prior: VideoPriorKind = MISSING
    """The one in the package, or CogVideoX-5B."""
    checkpoint: str | None = None
    """Of CogVideoX a folder or hub name; of an embedded prior a file or folder, null for the one in the package."""
    learning_rate: float = MISSING
    """Of Adam on theta [-]."""
    guidance: float = MISSING
    """Classifier-free guidance scale [-]."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back [-]."""
    t_min: int = MISSING
    """Diffusion timesteps, of 1000, are drawn from here ..."""
    t_max: int = MISSING
    """... up to this ..."""
    t_max_end: int = MISSING
    """... which falls linearly to this ..."""
    t_max_iterations: int = MISSING
    """... in so many iterations and stays there."""
    viewpoints: int = MISSING
    """Cameras, evenly spaced on a circle around the action; an iteration looks from one."""
    elevation: float = MISSING
    """Of the cameras above the horizon [rad]."""
    distance: float | None = MISSING
    """Radius of that circle [m]; null frames what the prior wants to see."""
    width: int = MISSING
    """Of the pictures [pixel]; the embedded prior has its own size."""
    height: int = MISSING
    """Of the pictures [pixel]; the embedded prior has its own size."""
    clip_frames: int | None = MISSING
    """Frames that the prior sees; null: as many as it was trained on."""
    offload: bool = MISSING
    """Keep on the GPU only what is at work (prior=cogvideox)."""
    lambda_geometry: float = MISSING
    """Of the loss of stage/refine=geometric, added to Video-SDS; the paper has none [-]."""


@dataclass
class StageConf:
    """The stages."""

    motion: MotionConf = MISSING
    coordinate: CoordinateConf = MISSING
    attraction: AttractionConf = MISSING
    contact: ContactConf = MISSING
    object: MoverConf = MISSING
    refine: RefineConf = MISSING
