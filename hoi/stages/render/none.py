"""No video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hoi.stages.contract import Draft, Renderer, option

if TYPE_CHECKING:
    from hoi.config import Config


@option("render", "none")
@dataclass
class NoVideo(Renderer):
    """Nothing is drawn, and nothing imported for it."""

    def plan(self, config: Config, draft: Draft) -> None:
        draft.omit("render", "render is none", "the pictures, the encoder, run.mp4")
