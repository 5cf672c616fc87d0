"""Stage 3 without a video prior: in the window, the limb out of the object and its skin at the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import Draft, option
from hoi.stages.refine import WindowedRefinement

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Motion, Scene, State
    from hoi.refine.meeting import Meeting
    from hoi.reports import Stage


@option("stage/refine", "geometric")
@dataclass
class Geometric(WindowedRefinement):
    """No prior: the limb out of the object and its skin at the surface."""

    stands_for: ClassVar[dict[str, str]] = {
        "geometric": "Video-SDS in stage 3"
    }  # not w/o Video-SDS, where stage 2 is final

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("geometric")
        super().plan(config, draft)

    def refine(self, scene: Scene, state: State, config: Config, device: str, stage: Stage) -> Motion:
        from hoi.refine.stage import refined

        def improve(meeting: Meeting) -> Motion:
            from hoi.refine.geometric import Geometry, minimise
            from hoi.refine.window import WindowedPose

            pose = WindowedPose(meeting.motion, meeting.window, device)
            minimise(pose, Geometry(meeting, self.weights, device), self.iterations, stage)
            return pose.motion()

        distance = config.stage.contact.d_contact
        return refined(scene, state, self.window(state, scene.frames), distance, improve, stage, self.needed_above)
