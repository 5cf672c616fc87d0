"""Refinements; all but none move theta of the frames around t_c, whatever the loss."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from omegaconf import MISSING

from hoi.stages.contract import Draft, Refinement, Requirements

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import State
    from hoi.refine.geometric import Weights
    from hoi.refine.window import Window


class RefineWhen(StrEnum):
    needed = "needed"
    always = "always"


class Joints(StrEnum):
    limb = "limb"
    all = "all"


@dataclass
class WindowedRefinement(Refinement):
    """What moves theta of the frames around t_c, whatever the loss."""

    when: RefineWhen = MISSING
    """Only when a limb enters the object by more than `tolerance` or is off it by d_contact, or at every contact."""
    tolerance: float = MISSING
    """Deepest penetration in the window that needs no refinement [m]."""
    half_width: float = MISSING
    """Delta t: the window is t_c plus and minus this [frames]."""
    joints: Joints = MISSING
    """Theta of which joints: of the limb that strikes, from hip or shoulder on, or of all."""
    taper: bool = MISSING
    """Whether frames farther from t_c follow less."""
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

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(self.tolerance >= 0, "tolerance", self.tolerance, "0 or more [m]")
        own(self.half_width >= 0, "half_width", self.half_width, "0 or more [frames]")
        own(self.iterations >= 1, "iterations", self.iterations, "1 or more")
        for name in ("lambda_penetration", "lambda_touch", "lambda_pose", "lambda_smooth"):
            own(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")

    def window(self, state: State, frames: int) -> Window | None:
        """Around the contact of a scene of so many frames; None where there is none."""
        from hoi.refine.stage import contact_window

        whole_body = self.joints is Joints.all
        return contact_window(state, self.half_width, frames, whole_body=whole_body, tapered=self.taper)

    @property
    def needed_above(self) -> float | None:
        """Penetration that needs refinement [m]; None: whatever it is."""
        return self.tolerance if self.when is RefineWhen.needed else None

    @property
    def weights(self) -> Weights:
        from hoi.refine.geometric import Weights

        return Weights(self.lambda_penetration, self.lambda_touch, self.lambda_pose, self.lambda_smooth)

    def units(self) -> int:
        return self.iterations

    def plan(self, config: Config, draft: Draft) -> None:
        needed = f" where a limb is more than {self.tolerance:g} m deep in the object or off it"
        around = "t_c" if any(step.name == "contact" for step in draft.steps) else "t*"
        whose = " of all joints" if self.joints is Joints.all else ""
        detail = (
            f"{self.iterations} iterations on theta{whose} within {self.half_width:g} frames of "
            f"{around}{needed if self.when is RefineWhen.needed else ''}"
        )
        draft.run("refine", self.name, f"{detail}{self.described()}")

    def described(self) -> str:
        """What else the plan says of it."""
        return ""
