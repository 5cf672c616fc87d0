"""No motion prior: the pose is optimised from the standing pose (paper, w/o MDM)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.data import Act, Motion, Scene, Target
from hoi.stages.contract import Draft, MotionSource, option

if TYPE_CHECKING:
    from hoi.config import Config, SceneConf


@option("stage/motion", "none")
@dataclass
class NoMotion(MotionSource):
    """None: the person stands until stage 2 moves them."""

    stands_for: ClassVar[dict[str, str]] = {"no_mdm": "the motion prior"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("no_mdm")
        because = "stage/motion is none: the pose starts standing, j* and t* come from the scene"
        draft.omit("motion", because, "importing the motion prior and its text encoder")

    def target(self, scene: Scene, motion: Motion, conf: SceneConf, act: Act | None = None) -> Target:
        if act is not None:
            time = act.at if math.isfinite(act.at) else 0.5 * (act.start + act.end)
            limb = LIMBS[act.strikes][-1]
            return Target(limb, min(round(time * scene.fps), scene.frames - 2), "scene")
        together = tuple(JOINT_NAMES.index(name) for name in conf.striking_joints or ())
        hold = round(conf.hold * scene.fps)
        return Target(JOINT_NAMES.index(conf.contact_joint), conf.contact_frame, "scene", together, hold)
