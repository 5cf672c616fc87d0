"""The typed configuration: one dataclass a group, registered with Hydra, checked as a whole by `hoi.config.validate`.

Defaults live in `conf/`, not here: a field without a value there is an error at composition. Each field says what it is
and, in brackets, its unit ([-] for a number that has none); `docs/` makes the reference of all keys from that. No heavy
imports.
"""

from dataclasses import dataclass, field

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from hoi.config.agents import BoxConf, HumanConf, MaterialConf, ObjectConf, RegionConf
from hoi.config.choices import (
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
from hoi.config.scene import PlacementConf, PlaneConf, RenderConf, SceneConf, VideoConf
from hoi.config.stages import (
    AttractionConf,
    ConstantVelocityConf,
    ContactConf,
    CoordinateConf,
    GeometricConf,
    HMSDConf,
    ImpulseConf,
    MotionConf,
    MoverConf,
    MPMConf,
    RefineConf,
    StageConf,
    VideoSDSConf,
    WindowConf,
    WindowedConf,
)
from hoi.files import CONF

__all__ = [
    "CONF",
    "SCHEMAS",
    "Ablation",
    "Approach",
    "AttractionConf",
    "AttractionKind",
    "AttractionTarget",
    "BoxConf",
    "Config",
    "ConstantVelocityConf",
    "ContactConf",
    "ContactKind",
    "ContactModel",
    "CoordinateConf",
    "Device",
    "GeometricConf",
    "HMSDConf",
    "HumanConf",
    "HumanKind",
    "ImpulseConf",
    "MPMConf",
    "MaterialConf",
    "MaterialModel",
    "MotionConf",
    "MotionInit",
    "MotionKind",
    "MoverConf",
    "MoverKind",
    "ObjectConf",
    "ObjectKind",
    "PlacementConf",
    "PlaneConf",
    "PlaneContact",
    "Precision",
    "RefineConf",
    "RefineKind",
    "RefineWhen",
    "RegionConf",
    "RenderBackend",
    "RenderConf",
    "RenderKind",
    "Sampler",
    "SceneConf",
    "Spline",
    "StageConf",
    "UpAxis",
    "VideoConf",
    "VideoPriorKind",
    "VideoSDSConf",
    "View",
    "WindowConf",
    "WindowedConf",
    "register",
]


@dataclass
class Config:
    """The run."""

    seed: int = MISSING
    """Of all random streams; each stage has its own."""
    seeds: int = MISSING
    """Runs to do: of seed, seed + 1, ..., their persons optimised as one batch."""
    out: str = MISSING
    """Folder of the run."""
    overwrite: bool = MISSING
    """Replace a finished record of another config."""
    plan_only: bool = MISSING
    """Print the plan and stop."""
    device: Device = MISSING
    """For torch and Taichi alike."""
    threads: int | None = None
    """CPU threads; null takes what the machine has."""
    human_points: int = MISSING
    """Points of the person in the record's point clouds (viewing only)."""
    experiment: str = MISSING
    """Name of the settings, for the folder and the tables; `experiment=` chooses them."""
    ablation: Ablation = MISSING
    """What the run claims to leave out, checked against what it does; `ablation=` chooses it."""
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
