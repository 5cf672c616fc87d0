"""A video of the run, in the record and as run.mp4 beside it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from omegaconf import MISSING

from hoi.errors import InputError, RunError, under
from hoi.render import Ground
from hoi.stages.contract import LARGEST_PICTURE, SMALLEST_PICTURE, Draft, Renderer, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Run
    from hoi.record import Footage
    from hoi.render.encode import Video as Film
    from hoi.reports import Stage


class View(StrEnum):
    """The action, and the names in `hoi.render.cameras.VIEWS`."""

    action = "action"
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
    light: bool = MISSING
    """A sky and a key light on what knows its surface: the people and objects of the package, and SMPL bodies."""
    shadows: bool = MISSING
    """Whether person and object keep the key light from each other and from the ground."""
    relight: bool = MISSING
    """Whether captured Gaussians, which hold a light already, get this one too, as a gain that keeps their mean."""
    antialiased: bool = MISSING
    """Make up for what the rasteriser widens each Gaussian by, so that small ones far away stay as thin as they are."""
    ground: Ground | None = None
    """What the ground looks like; null is the scene's setting."""
    fps: float | None = None
    """Pictures a second of run.mp4, a multiple of the scene's: the moments between its frames are interpolated. The
    record's own video keeps a picture a frame. null is the scene's."""

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
        if self.fps is not None:
            whole = fps <= self.fps <= 240 and abs(self.fps / fps - round(self.fps / fps)) < 1e-9
            own(whole, "fps", self.fps, f"null, or a multiple of scene.fps={fps:g} up to 240 [1/s]")
        degree = self.sh_degree
        own(degree is None or 0 <= degree <= 3, "sh_degree", degree, "0, 1, 2 or 3, or null")

    def plan(self, config: Config, draft: Draft) -> None:
        size = f"{self.width}x{self.height}"
        if self.backend is RenderBackend.gsplat and find_spec("gsplat") is None:
            remedy = f"pip install gsplat, or {self.key}.backend=taichi"
            draft.lack(f"{self.key}.backend", "package gsplat", "", remedy)
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
        from hoi.render.between import frames_at
        from hoi.render.encode import encode
        from hoi.render.film import cameras_of, film
        from hoi.render.light import DAY
        from hoi.render.look import Look
        from hoi.render.replay import replay

        def counted(pictures: Iterator[Any]) -> Iterator[Any]:
            for picture in pictures:
                yield picture
                stage.advance()

        def kept(pictures: Iterator[Any], every: int, recorded: list[Any]) -> Iterator[Any]:
            for number, picture in enumerate(pictures):
                if every > 1 and number % every == 0:
                    recorded.append(picture)
                yield picture

        try:
            shown = replay(run, device, relight=self.relight)
            look = Look(
                light=DAY if self.light else None,
                shadows=self.shadows,
                antialiased=self.antialiased,
                ground=self.ground,
            )
            every = 1 if self.fps is None else round(self.fps / shown.fps)
            if every > 1:  # of each frame one picture, and some between it and the next
                shown = shown.retimed(frames_at(shown.frames, shown.fps, shown.fps * every), shown.fps * every)
            cameras = cameras_of(shown, self.view.value, self.width, self.height)
            pictures = film(
                shown, cameras, look=look, sh_degree=self.sh_degree, backend=self.backend.value, device=device
            )
            recorded: list[Any] = []
            video = encode(counted(kept(pictures, every, recorded)), shown.fps)
            own = video if every == 1 else encode(iter(recorded), shown.fps / every)
        except InputError as error:  # what was put in has been checked: it is the run that cannot be drawn
            raise RunError(f"render: {error}; render=none runs without a video") from error
        stage.numbers["frames_per_second"] = len(video) / (time.perf_counter() - started)
        return video, Footage(own.units, tuple(cameras[::every]))
