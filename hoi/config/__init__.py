"""The typed configuration: one dataclass a group, registered with Hydra, checked as a whole by `hoi.config.validate`.

Those of the stages are their options, in `hoi.stages`. Defaults live in `conf/`, not here: a field without a value
there is an error at composition. Each field says what it is and, in brackets, its unit ([-] for a number that has
none); `docs/` makes the reference of all keys from that. No heavy imports.
"""

from dataclasses import dataclass, field

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from hoi.config.agents import BoxConf, HumanConf, MaterialConf, ObjectConf, RegionConf
from hoi.config.choices import Ablation, Approach, Device, HumanKind, MaterialModel, ObjectKind, PlaneContact
from hoi.config.scene import ActConf, PlacementConf, PlaneConf, SceneConf
from hoi.files import CONF
from hoi.stages import options
from hoi.stages.contract import Attraction, ContactModel, MotionSource, ObjectMover, Option, Refinement, Renderer
from hoi.stages.coordinate.default import Coordinate

__all__ = [
    "CONF",
    "SCHEMAS",
    "Ablation",
    "ActConf",
    "Approach",
    "BoxConf",
    "Config",
    "Device",
    "HumanConf",
    "HumanKind",
    "MaterialConf",
    "MaterialModel",
    "ObjectConf",
    "ObjectKind",
    "PlacementConf",
    "PlaneConf",
    "PlaneContact",
    "RegionConf",
    "SceneConf",
    "StageConf",
    "register",
]


@dataclass
class StageConf:
    """The stages."""

    motion: MotionSource = MISSING
    coordinate: Coordinate = MISSING
    attraction: Attraction = MISSING
    contact: ContactModel = MISSING
    object: ObjectMover = MISSING
    refine: Refinement = MISSING


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
    mdm: str = MISSING
    """Folder of the published motion prior, STMC's MDM-SMPL, for `stage/motion=hmsd_paper`."""
    cogvideox: str = MISSING
    """Folder or hub name of CogVideoX-5B, for `stage/refine=cogvideox`."""
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
    render: Renderer = MISSING
    scene: SceneConf = MISSING

    @property
    def options(self) -> tuple[Option, ...]:
        """What each stage is, in the order in which a run is planned."""
        stage = self.stage
        return (
            stage.object, stage.motion, stage.attraction, stage.coordinate, stage.contact, stage.refine, self.render
        )  # fmt: skip

    def lies_still(self) -> bool:
        """Whether the object's free motion is to stay where it is."""
        placement = self.scene.placement
        moving = any(placement.velocity) or any(placement.angular_velocity)
        x, y, z = self.scene.gravity
        falls = x or y or z > 0
        return self.object.stable and placement.position[2] is None and not moving and not falls


SCHEMAS: dict[tuple[str, str], type] = {
    ("schema", "config"): Config,
    ("schema", "human"): HumanConf,
    ("schema", "object"): ObjectConf,
    ("schema", "material"): MaterialConf,
    ("schema", "scene"): SceneConf,
    **{(f"schema/{group}", name): schema for (group, name), schema in options().items()},
}
"""By group and name; an option's are those of its file in `conf/`, below `schema`."""


def register() -> None:
    """Put the schemas where the files of `conf/` find them."""
    store = ConfigStore.instance()
    for (group, name), schema in SCHEMAS.items():
        store.store(group=group, name=name, node=schema)
