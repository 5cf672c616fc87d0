"""Who and what: the person, the object and what it is made of."""

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from hoi.config.choices import HumanKind, MaterialModel, ObjectKind


@dataclass
class HumanConf:
    """The person."""

    kind: HumanKind = MISSING
    """One of the package, Gaussians of your own, or an SMPL file."""
    name: str = MISSING
    """What plan and record call them."""
    person: str | None = None
    """Which of the people in the package, for kind=builtin; whose clothes to wear, for kind=smpl."""
    path: str | None = None
    """Avatar folder or canonical 3DGS PLY, for kind=avatar; SMPL's .npz or .pkl, for kind=smpl."""
    skinning: str | None = None
    """Skinning .npz of an avatar; skinning.npz in the PLY's folder when null."""
    gaussians: int = MISSING
    """Gaussians sampled on a built-in person's or an SMPL body's skin."""
    betas: list[float] = field(default_factory=list)
    """Shape parameters of an SMPL body [-]; those left out are 0."""
    pose_correctives: bool = True
    """Whether an SMPL body keeps its pose blend shapes."""


@dataclass
class BoxConf:
    """A box in the object's own frame, in units of its size: the whole object lies within [-0.5, 0.5]^3.

    The frame is the one that `up` makes, Z up, before the object is turned and placed; its origin is the centre of the
    object's bounding box.
    """

    centre: list[float] = MISSING
    """Of the box [size]."""
    half_size: list[float] = MISSING
    """Half its edges [size]."""


@dataclass
class RegionConf:
    """A part of the object that is made of something else."""

    box: BoxConf = field(default_factory=BoxConf)
    material: Any = MISSING
    """A name in conf/material, or a mapping: of what differs from the object's own material, or a whole one if it names
    a `model`. `hoi.config.validate` puts the `MaterialConf` here."""


@dataclass
class ObjectConf:
    """The object, before it is placed."""

    kind: ObjectKind = MISSING
    """One of the package, or a 3DGS file."""
    name: str = MISSING
    """What plan and record call it."""
    shape: str | None = None
    """Which of the shapes in the package, for kind=builtin."""
    path: str | None = None
    """3DGS file (.ply, .splat, .ksplat, .spz, .sog, .glb), for kind=file."""
    size: float = MISSING
    """Largest extent [m]."""
    up: str = MISSING
    """The file's up axis: +x, -x, +y, -y, +z or -z; auto takes what the file says, or else its format's way."""
    stable: bool = MISSING
    """Stays where it is when put on the ground: its motion at rest need not be simulated."""
    max_gaussians: int = MISSING
    """A larger cloud is thinned to this; they are the particles of the surface."""
    max_drawn: int | None = None
    """More than these of a file are not shown: what lies between the two limits is carried by the particles. null shows
    what is simulated."""
    regions: list[RegionConf] = field(default_factory=list)
    """Parts of other materials; where they overlap, the later one holds."""


@dataclass
class MaterialConf:
    """See `hoi.data.Material`. What has a value here is for some models only; `hoi.mpm.laws` says for which."""

    name: str = MISSING
    """What plan and record call it."""
    model: MaterialModel = MISSING
    youngs_modulus: float = MISSING
    poisson_ratio: float = MISSING
    density: float = MISSING
    restitution: float = MISSING
    ground_friction: float = MISSING
    yield_stress: float | None = None
    """Stress at which a plastic solid flows [Pa]; null never yields."""
    hardening: float = 0.0
    viscosity: float = 0.0
    friction_angle: float = 0.0
    critical_compression: float = 0.0
    critical_stretch: float = 0.0
