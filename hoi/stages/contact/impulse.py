"""The paper's contact: one impulse, after which the object has V_post; and here the limb has taken the opposite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hoi.stages.contact import Detection
from hoi.stages.contract import Answered, option

if TYPE_CHECKING:
    from hoi.data import ObjectState, Scene, State
    from hoi.method.object_motion import Mover
    from hoi.reports import Stage


@option("stage/contact", "impulse")
@dataclass
class Impulse(Detection):
    """Contact detection, and the paper's impulse."""

    since = "from t_c to T"

    def answer(
        self, scene: Scene, state: State, restarts: Sequence[ObjectState], move: Mover, stage: Stage
    ) -> Answered:
        from hoi.method.resimulation import resimulate

        motion, free, search = state.motion, state.trajectory, state.contact
        assert motion is not None and free is not None and search is not None and search.push is not None
        push = search.push
        if not self.answers(scene, stage):
            trajectory, struck, states = resimulate(scene, free, restarts, push, 0.0, 1.0, move, stage)
            return replace(state, trajectory=trajectory, contact=search.with_push(struck)), states
        from hoi.method.reaction import person_at, react

        person = person_at(scene, motion, push.frame / scene.fps, self.muscles)
        limb = person.inverse_mass(push.joint, push.point, push.normal)
        trajectory, struck, states = resimulate(scene, free, restarts, push, limb, self.flesh, move, stage)
        motion = react(person, [struck], stage)
        return replace(state, motion=motion, trajectory=trajectory, contact=search.with_push(struck)), states
