"""No pull towards the object (paper, w/o Attraction)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import Attraction, Draft, option

if TYPE_CHECKING:
    from hoi.config import Config


@option("stage/attraction", "none")
@dataclass
class NoAttraction(Attraction):
    """None: stage 2 runs on the motion prior alone."""

    stands_for: ClassVar[dict[str, str]] = {"no_attraction": "the attraction"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("no_attraction")
        draft.omit("attraction", "stage/attraction is none", "the attraction loss")
