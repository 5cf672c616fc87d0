"""A video of the run, in the record and as run.mp4 beside it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from omegaconf import MISSING

from hoi.errors import InputError, RunError, under
from hoi.stages.contract import LARGEST_PICTURE, SMALLEST_PICTURE, Draft, Renderer, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Run
    from hoi.record import Footage
    from hoi.render.encode import Video as Film
    from hoi.reports import Stage


class View(StrEnum):
    """The names in `hoi.render.cameras.VIEWS`."""

    front = "front"
    side = "side"
    three_quarter = "three_quarter"
    back = "back"
    top = "top"
    follow = "follow"


class RenderBackend(StrEnum):
    taichi = "taichi"
    gsplat = "gsplat"
    reference = "reference"


@option("render", "video")
@dataclass
class Video(Renderer):
    """One picture a frame, from one camera."""

    view: View = MISSING
    """Where the camera stands."""
    width: int = MISSING
    """Of a picture [pixel], even."""
    height: int = MISSING
    """Of a picture [pixel], even."""
    backend: RenderBackend = MISSING
    """What draws: the package's rasteriser, gsplat on a GPU, or the slow reference."""
    sh_degree: int | None = None
    """Highest degree of the Gaussians' harmonics that is drawn; null draws all."""

    @property
    def compiles(self) -> bool:
        return self.backend is RenderBackend.taichi

    def check(self, config: Config, require: Requirements) -> None:
        own, fps = require.of(self.key), config.scene.fps
        require(0.1 <= fps <= 1000, "scene.fps", fps, "in [0.1, 1000] [1/s] for a video")
        for name in ("width", "height"):  # what H.264 can have; its colour planes are half as large
            value = getattr(self, name)
            rule = f"an even number in [{SMALLEST_PICTURE}, {LARGEST_PICTURE}] [pixel]"
            own(SMALLEST_PICTURE <= value <= LARGEST_PICTURE and value % 2 == 0, name, value, rule)
        degree = self.sh_degree
        own(degree is None or 0 <= degree <= 3, "sh_degree", degree, "0, 1, 2 or 3, or null")

    def plan(self, config: Config, draft: Draft) -> None:
        size = f"{self.width}x{self.height}"
        detail = f"{config.scene.frames} pictures of {size}, view {self.view.value}, to run.mp4 and the record"
        draft.run("render", self.backend.value, detail)

    def check_machine(self) -> None:
        if self.backend is RenderBackend.gsplat:
            from hoi.render.gsplat_backend import load_gsplat

            with under(self.key):
                load_gsplat()

    def draw(self, run: Run, device: str, stage: Stage) -> tuple[Film, Footage]:
        started = time.perf_counter()
        from hoi.record import Footage
        from hoi.render.encode import encode
        from hoi.render.film import cameras_of, film
        from hoi.render.replay import replay

        def counted(pictures: Iterator[Any]) -> Iterator[Any]:
            for picture in pictures:
                yield picture
                stage.advance()

        try:
            shown = replay(run, device)
            cameras = cameras_of(shown, self.view.value, self.width, self.height)
            pictures = film(shown, cameras, sh_degree=self.sh_degree, backend=self.backend.value, device=device)
            video = encode(counted(pictures), shown.fps)
        except InputError as error:  # what was put in has been checked: it is the run that cannot be drawn
            raise RunError(f"render: {error}; render=none runs without a video") from error
        stage.numbers["frames_per_second"] = len(video) / (time.perf_counter() - started)
        return video, Footage(video.units, tuple(cameras))
