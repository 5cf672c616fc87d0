"""Temporally masked Video-SDS (paper, Video-SDS for Contact Fidelity), with the prior in the package or CogVideoX."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from omegaconf import MISSING

from hoi.errors import under
from hoi.stages.contract import LARGEST_PICTURE, SMALLEST_PICTURE, Draft, Requirements, option
from hoi.stages.refine import WindowedRefinement
from hoi.video_prior.files import EMBEDDED_PICTURE, cogvideox_at, missing_video_prior
from hoi.video_prior.memory import guess

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Motion, Scene, State
    from hoi.refine.meeting import Meeting
    from hoi.refine.window import Window
    from hoi.reports import Stage
    from hoi.video_prior import VideoPrior


class VideoPriorKind(StrEnum):
    embedded = "embedded"
    cogvideox = "cogvideox"


@option("stage/refine", "video_sds")
@dataclass
class VideoSDS(WindowedRefinement):
    """Temporally masked Video-SDS."""

    prior: VideoPriorKind = MISSING
    """The one in the package, or CogVideoX-5B."""
    checkpoint: str | None = None
    """Of CogVideoX a folder or hub name; of an embedded prior a file or folder, null for the one in the package."""
    learning_rate: float = MISSING
    """Of Adam on theta [-]."""
    step: float | None = MISSING
    """Instead of Adam: how far the limb moves in the first iteration [m], falling linearly to 0; null: Adam."""
    guidance: float = MISSING
    """Classifier-free guidance scale [-]."""
    guidance_rescale: float = MISSING
    """Share of the guided prediction's overshoot that is taken back [-]."""
    t_min: int = MISSING
    """Diffusion timesteps, of 1000, are drawn from here ..."""
    t_max: int = MISSING
    """... up to this ..."""
    t_max_end: int = MISSING
    """... which falls linearly to this ..."""
    t_max_iterations: int = MISSING
    """... in so many iterations and stays there."""
    viewpoints: int = MISSING
    """Cameras, evenly spaced on a circle around the action; of the embedded prior, along the surface in contact."""
    views_at_once: int = MISSING
    """From so many of them an iteration looks."""
    elevation: float = MISSING
    """Of the cameras above the horizon; along a surface, on average [rad]."""
    crop: float | None = MISSING
    """Half of what a picture of the contact shows [m]; null: as the embedded prior was trained; CogVideoX sees all."""
    distance: float | None = MISSING
    """Radius of that circle [m]; null frames what the prior wants to see."""
    width: int = MISSING
    """Of the pictures [pixel]; the embedded prior has its own size."""
    height: int = MISSING
    """Of the pictures [pixel]; the embedded prior has its own size."""
    clip_frames: int | None = MISSING
    """Frames that the prior sees; null: as many as it was trained on."""
    offload: bool = MISSING
    """Keep on the GPU only what is at work (prior=cogvideox)."""
    lambda_geometry: float = MISSING
    """Of the loss of stage/refine=geometric, added to Video-SDS; the paper has none [-]."""

    def check(self, config: Config, require: Requirements) -> None:
        super().check(config, require)
        own, embedded = require.of(self.key), self.prior is VideoPriorKind.embedded
        rule = f"a folder or hub name: {self.key}.prior is cogvideox"
        own(embedded or self.checkpoint is not None, "checkpoint", "null", rule)
        own(self.learning_rate > 0, "learning_rate", self.learning_rate, "greater than 0")
        own(0 <= self.guidance_rescale <= 1, "guidance_rescale", self.guidance_rescale, "in [0, 1]")
        for name, highest in (("t_max", 999), ("t_max_end", self.t_max), ("t_min", self.t_max_end)):
            own(0 <= getattr(self, name) <= highest, name, getattr(self, name), f"in [0, {highest}]")
        own(self.t_max_iterations >= 1, "t_max_iterations", self.t_max_iterations, "1 or more")
        own(self.step is None or self.step > 0, "step", self.step, "greater than 0 [m], or null")
        own(self.viewpoints >= 1, "viewpoints", self.viewpoints, "1 or more")
        own(self.views_at_once >= 1, "views_at_once", self.views_at_once, "1 or more")
        own(abs(self.elevation) < math.pi / 2, "elevation", self.elevation, "in (-pi/2, pi/2)")
        distance, clip = self.distance, self.clip_frames
        rule = "greater than 0 [m], or null" if embedded else f"null with {self.key}.prior=cogvideox"
        own(self.crop is None or (embedded and self.crop > 0), "crop", self.crop, rule)
        own(distance is None or distance > 0, "distance", distance, "greater than 0 [m], or null")
        for name in ("width", "height"):
            value = getattr(self, name)
            inside = SMALLEST_PICTURE <= value <= LARGEST_PICTURE and value % SMALLEST_PICTURE == 0
            own(inside, name, value, f"a multiple of {SMALLEST_PICTURE} up to {LARGEST_PICTURE}")
        if embedded:  # what it has been trained on
            own(clip is None, "clip_frames", clip, f"null with {self.key}.prior=embedded")
            for name in ("width", "height"):
                rule = f"{EMBEDDED_PICTURE} with {self.key}.prior=embedded"
                own(getattr(self, name) == EMBEDDED_PICTURE, name, getattr(self, name), rule)
        else:
            whole = clip is None or (clip >= 1 and clip % 4 == 1)
            own(whole, "clip_frames", clip, "4 k + 1 frames (9, 13, ..., 49), or null")
        own(self.lambda_geometry >= 0, "lambda_geometry", self.lambda_geometry, "0 or more")

    def plan(self, config: Config, draft: Draft) -> None:
        super().plan(config, draft)
        draft.missing += missing_video_prior(f"{self.key}.checkpoint", self.prior, self.checkpoint)
        if self.prior is VideoPriorKind.cogvideox and self.checkpoint is not None:
            size = self.height, self.width
            memory = guess(cogvideox_at(self.checkpoint), self.clip_frames, size, self.offload)
            draft.check("gpu_memory", f"{memory.peak / 1e9:.0f} GB", "for stage 3 in bfloat16, a guess from its sizes")

    def described(self) -> str:
        said = f", CFG {self.guidance:g}, {self.prior.value} {self.checkpoint or 'in the package'}"
        return f"{said}, + {self.lambda_geometry:g} L_geometry" if self.lambda_geometry > 0 else said

    def refine(self, scene: Scene, state: State, config: Config, device: str, stage: Stage) -> Motion:
        from hoi.refine.stage import Nearest, refined

        distance = config.stage.contact.d_contact

        def improve(meeting: Meeting) -> Motion:
            from hoi.method.video_sds import memory_may_run_out
            from hoi.video_prior import load_video_prior

            nearest = None if self.needed_above is None else Nearest(meeting, distance, self.needed_above)
            with memory_may_run_out(), under(self.key, "prior", "checkpoint", "width", "clip_frames", "half_width"):
                prior = load_video_prior(
                    self.prior,
                    device,
                    checkpoint=self.checkpoint,
                    width=self.width,
                    height=self.height,
                    clip_frames=self.clip_frames,
                    offload=self.offload,
                )
                prior.prepare(config.scene.scene_prompt, config.scene.negative_prompt)
                improved = self.distilled(prior, scene, state, meeting.window, config.seed, device, stage, nearest)
            return improved if nearest is None else nearest.kept(stage)

        return refined(scene, state, self.window(state, scene.frames), distance, improve, stage, self.needed_above)

    def distilled(
        self,
        prior: VideoPrior,
        scene: Scene,
        state: State,
        window: Window,
        seed: int,
        device: str,
        stage: Stage,
        enough: Callable[[Motion], bool] | None = None,
    ) -> Motion:
        """`hoi.method.video_sds.video_sds` with these settings."""
        from hoi.method.video_sds import Timesteps, Viewpoints, geometry_beside, video_sds

        assert state.trajectory is not None
        return video_sds(
            prior,
            scene,
            state,
            window,
            timesteps=Timesteps(self.t_min, self.t_max, self.t_max_end, self.t_max_iterations),
            looks=Viewpoints(self.viewpoints, self.views_at_once, self.elevation, self.distance, self.crop),
            guidance=self.guidance,
            rescale=self.guidance_rescale,
            iterations=self.iterations,
            learning_rate=self.learning_rate,
            step=self.step,
            seed=seed,
            device=device,
            stage=stage,
            others=geometry_beside(scene, state.trajectory, self.weights, self.lambda_geometry, device),
            enough=enough,
        )
