"""The windowed attraction loss (paper, Windowed Attraction Loss)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from omegaconf import MISSING

from hoi.stages.contract import Attraction, Draft, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import State
    from hoi.method.attraction import Batch, Term


class AttractionTarget(StrEnum):
    surface = "surface"
    com = "com"


@option("stage/attraction", "windowed")
@dataclass
class Windowed(Attraction):
    """The windowed attraction loss."""

    stands_for: ClassVar[dict[str, str]] = {"no_attraction": "the attraction"}

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

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(self.lambda_attr >= 0, "lambda_attr", self.lambda_attr, "0 or more")
        own(self.growth >= 1, "growth", self.growth, "1 or more")
        own(self.sigma > 0, "sigma", self.sigma, "greater than 0 [frames]")
        own(self.half_width >= 0, "half_width", self.half_width, "0 or more [frames]")

    def plan(self, config: Config, draft: Draft) -> None:
        if self.lambda_attr > 0:
            draft.uses.append("attraction")
        else:
            draft.without.append("no_attraction")
            draft.omit("attraction", "stage.attraction.lambda_attr is 0", "the attraction loss")

    def described(self) -> str:
        return f"{self.lambda_attr:g} L_attr to the {self.target.value}"

    def term(self, batch: Batch, states: Sequence[State]) -> Term:
        from hoi.method.attraction import windowed_attraction

        to_com = self.target is AttractionTarget.com
        return windowed_attraction(
            batch, states, self.lambda_attr, self.growth, self.sigma, self.half_width, to_com=to_com
        )
