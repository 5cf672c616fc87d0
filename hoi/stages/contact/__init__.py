"""Contact models; all but none detect contact as the paper does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from omegaconf import MISSING

from hoi.stages.contract import ContactModel, Draft, Requirements

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Act, Contact, ContactSearch, Motion, ObjectTrajectory, Scene
    from hoi.method.reaction import Muscles
    from hoi.reports import Stage

LIGHT = 0.003
"""An object lighter than this does not move the person [kg]: its V_post is off by under 1%, a person struck by it at
10 m/s by under 10 mm (the lightest struck points, toes and fingers of a child, answer with 0.3 kg)."""


class Limb(StrEnum):
    effective = "effective"
    infinite = "infinite"


class Velocity(StrEnum):
    instant = "instant"
    frame = "frame"


class Normal(StrEnum):
    surface = "surface"
    centre_of_mass = "centre_of_mass"


@dataclass
class Detection(ContactModel):
    """Contact detection (paper, Contact Detection and Re-simulation Details), and how heavy the limb is."""

    since: ClassVar[str]
    """From when on the object is simulated again."""

    tau: float = MISSING
    """tau_contact: least share of a joint's Gaussians that touch [-]."""
    distance: float = MISSING
    """d_contact [m]."""
    between_frames: bool = MISSING
    """Look between frames too, so that a fast strike cannot pass through unseen."""
    widened: bool = MISSING
    """Whether the boxes of limb and object are wider by d_contact, so that what touches without overlapping counts."""
    velocity: Velocity = MISSING
    """V_human: of the touched point at t_c, or of the joint over the frame before it."""
    limb: Limb = MISSING
    """What the object meets: the effective mass of the struck point, and the person answers; or a thing that nothing
    stops."""
    one_piece: float = MISSING
    """Share of a blow that a limb takes in one piece, its other joints locked; the rest finds all joints free [-]."""
    recovery: float = MISSING
    """How long the person takes to make good 95% of a small push [s]."""
    flesh: float = MISSING
    """What a limb leaves of the material's restitution, where it is not one that nothing stops [-]."""
    normal: Normal = MISSING
    """n, along which the object is pushed: into the touched surface, or from there to the centre of mass."""

    @property
    def d_contact(self) -> float:
        return self.distance

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(0 < self.tau <= 1, "tau", self.tau, "in (0, 1]")
        own(self.distance > 0, "distance", self.distance, "greater than 0 [m]")
        own(0 <= self.flesh <= 1, "flesh", self.flesh, "in [0, 1]")
        own(0 <= self.one_piece <= 1, "one_piece", self.one_piece, "in [0, 1]")
        own(0 < self.recovery < math.inf, "recovery", self.recovery, "greater than 0 [s]")

    def plan(self, config: Config, draft: Draft) -> None:
        where = "between frames too" if self.between_frames else "at whole frames"
        draft.run("contact", self.name, f"tau {self.tau:g}, d {self.distance:g} m, {where}")
        draft.run("resimulate", config.stage.object.name, f"{self.since}, when a contact pushes the object")
        if self.limb is Limb.infinite:
            draft.omit("the person's answer", "stage.contact.limb is infinite", "the articulated body")
        else:
            how = f"{self.one_piece:.0%} of it in one piece a limb, and is back in {self.recovery:g} s"
            light = f"not where the object weighs under {1000 * LIGHT:g} g"
            draft.run("react", "articulated", f"the person takes the opposite impulse, {how}; {light}")

    def search(
        self,
        scene: Scene,
        motion: Motion,
        trajectory: ObjectTrajectory,
        together: Sequence[int] = (),
        last: Contact | None = None,
        until: float = math.inf,
    ) -> ContactSearch:
        from hoi.method.contact import find_contact

        return find_contact(
            scene,
            motion,
            trajectory,
            tau=self.tau,
            distance=self.distance,
            between_frames=self.between_frames,
            widened=self.widened,
            over_a_frame=self.velocity is Velocity.frame,
            to_com=self.normal is Normal.centre_of_mass,
            together=together,
            last=last,
            until=until,
        )

    def of(self, act: Act | None) -> Detection:
        return self if act is None or math.isnan(act.flesh) else replace(self, flesh=act.flesh)

    @property
    def muscles(self) -> Muscles:
        """How the person takes a blow."""
        from hoi.method.reaction import Muscles

        return Muscles(self.one_piece, self.recovery)

    def answers(self, scene: Scene, stage: Stage) -> bool:
        """Whether the person answers what it strikes; if not for want of weight, the stage is told."""
        mass = float(scene.thing.masses.sum())
        if self.limb is Limb.effective and mass < LIGHT:
            stage.notes.append(f"the object weighs {1000 * mass:.2g} g: the person's answer is left out")
        return self.limb is Limb.effective and mass >= LIGHT
