"""The paper's contact: one impulse, after which the whole object has V_post."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hoi.stages.contact import Detection
from hoi.stages.contract import option

if TYPE_CHECKING:
    from hoi.data import ContactSearch, ObjectState, ObjectTrajectory, Scene, State
    from hoi.method.object_motion import Mover
    from hoi.reports import Stage


@option("stage/contact", "impulse")
@dataclass
class Impulse(Detection):
    """Contact detection, and the paper's impulse."""

    since = "from t_c to T"

    def answer(
        self, scene: Scene, state: State, restarts: Sequence[ObjectState], move: Mover, stage: Stage
    ) -> tuple[ObjectTrajectory, ContactSearch]:
        from hoi.method.resimulation import resimulate

        assert state.trajectory is not None and state.contact is not None and state.contact.push is not None
        push = state.contact.push
        return resimulate(scene, state.trajectory, restarts, push, move, stage), state.contact
