"""No stage 3 (paper, w/o Video-SDS)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import Draft, Refinement, option

if TYPE_CHECKING:
    from hoi.config import Config


@option("stage/refine", "none")
@dataclass
class NoRefinement(Refinement):
    """None: the output of stage 2 is final."""

    stands_for: ClassVar[dict[str, str]] = {"no_video_sds": "stage 3"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("no_video_sds")
        draft.omit("refine", "stage/refine is none: the output of stage 2 is final", "the video prior, stage 3")
