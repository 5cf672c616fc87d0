"""Contact models; all but none detect contact as the paper does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from omegaconf import MISSING

from hoi.stages.contract import ContactModel, Draft, Requirements

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import ContactSearch, Motion, ObjectTrajectory, Scene


@dataclass
class Detection(ContactModel):
    """Contact detection (paper, Contact Detection and Re-simulation Details)."""

    since: ClassVar[str]
    """From when on the object is simulated again."""

    tau: float = MISSING
    """tau_contact: least share of a joint's Gaussians that touch [-]."""
    distance: float = MISSING
    """d_contact [m]."""
    between_frames: bool = MISSING
    """Look between frames too, so that a fast strike cannot pass through unseen."""

    @property
    def d_contact(self) -> float:
        return self.distance

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(0 < self.tau <= 1, "tau", self.tau, "in (0, 1]")
        own(self.distance > 0, "distance", self.distance, "greater than 0 [m]")

    def plan(self, config: Config, draft: Draft) -> None:
        where = "between frames too" if self.between_frames else "at whole frames"
        draft.run("contact", self.name, f"tau {self.tau:g}, d {self.distance:g} m, {where}")
        draft.run("resimulate", config.stage.object.name, f"{self.since}, when a contact pushes the object")

    def search(self, scene: Scene, motion: Motion, trajectory: ObjectTrajectory) -> ContactSearch:
        from hoi.method.contact import find_contact

        return find_contact(
            scene, motion, trajectory, tau=self.tau, distance=self.distance, between_frames=self.between_frames
        )
