"""Stage 2: the person meets the object (paper, Physically-Aware Interaction Synthesis)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from omegaconf import MISSING

from hoi.stages.contract import Draft, Option, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config


@option("stage/coordinate", "default")
@dataclass
class Coordinate(Option):
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

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(self.iterations >= 0, "iterations", self.iterations, "0 or more")
        own(self.learning_rate > 0, "learning_rate", self.learning_rate, "greater than 0")
        own(0 <= self.decay <= 1, "decay", self.decay, "in [0, 1]")
        own(self.lambda_feet >= 0, "lambda_feet", self.lambda_feet, "0 or more")
        own(self.lambda_hmsd >= 0, "lambda_hmsd", self.lambda_hmsd, "0 or more")

    def plan(self, config: Config, draft: Draft) -> None:
        approach = config.scene.approach
        if approach != "none":
            draft.uses.append("approach")
            draft.run("approach", approach.value, "the person placed and turned such that the strike meets the object")
        else:
            draft.omit("approach", "scene.approach is none: the person starts at the origin facing +Y", "placement")
        if (tempo := config.scene.tempo) != 1:
            draft.check("tempo", f"{tempo:g}", "times as fast as the prior's is the strike, by a time warp around t*")
        terms = []
        if "hmsd" in draft.uses:
            terms.append(f"{self.lambda_hmsd:g} L_HMSD")
        if "attraction" in draft.uses:
            terms.append(config.stage.attraction.described())
        if "hmsd" in draft.uses and self.lambda_feet > 0:
            terms.append(f"{self.lambda_feet:g} L_feet")
        if not terms or not self.iterations:
            draft.omit("coordinate", "there is nothing to optimise", "stage 2")
            return
        draft.run("coordinate", "adam", f"{self.iterations} iterations, {' + '.join(terms)}")
