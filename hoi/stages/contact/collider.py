"""Contact that deforms: detected as in the paper, but then the limb pushes the object, as capsules in the MPM."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from omegaconf import MISSING

from hoi.errors import RunError
from hoi.stages.contact import Detection
from hoi.stages.contact.impulse import Impulse
from hoi.stages.contract import Answered, Draft, ObjectMover, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import ObjectState, Scene, State
    from hoi.method.object_motion import Mover
    from hoi.reports import Stage


@option("stage/contact", "collider")
@dataclass
class Collider(Detection):
    """Contact detection, and the striking limb as a moving obstacle in the MPM."""

    since = "from when the limb is last clear of it to T, the limb a moving obstacle"
    lasting = True

    friction: float = MISSING
    """Coulomb coefficient between limb and object [-]."""
    samples: int = MISSING
    """Times a frame at which the limb's place is computed; straight lines in between."""

    def check(self, config: Config, require: Requirements) -> None:
        super().check(config, require)
        own = require.of(self.key)
        own(self.friction >= 0, "friction", self.friction, "0 or more")
        own(self.samples >= 1, "samples", self.samples, "1 or more")

    def beside(self, mover: ObjectMover) -> Detection:
        """The paper's impulse, all else alike, where nothing is simulated that a limb could press (w/o MPM)."""
        if mover.yields:
            return self
        return Impulse(**{each.name: getattr(self, each.name) for each in fields(Detection)})

    def plan(self, config: Config, draft: Draft) -> None:
        mover = config.stage.object
        if mover.yields:
            return super().plan(config, draft)
        self.beside(mover).plan(config, draft)
        because = f"stage/object={mover.name} has no matter that a limb could press: it gives one impulse"
        draft.omit("the limb as a moving obstacle", because, "its capsules")

    def answer(
        self, scene: Scene, state: State, restarts: Sequence[ObjectState], move: Mover, stage: Stage
    ) -> Answered:
        from hoi.body.limb_collider import NEAR_IN_ANSWER, limb_collider, ready_to_push
        from hoi.method.resimulation import push_by

        motion, free, search = state.motion, state.trajectory, state.contact
        assert motion is not None and free is not None and search is not None and search.push is not None
        push = search.push
        if not self.answers(scene, stage):
            with self._apart():
                limbs, notes = limb_collider(scene, motion, free, push, samples=self.samples, friction=self.friction)
            stage.notes.extend(notes)
            start = float(limbs.times[0]) * scene.fps
            trajectory, pushed, pushes, states = push_by(scene, free, restarts, push, start, limbs, move, stage)
            return replace(state, trajectory=trajectory, contact=search.with_push(pushed, pushes)), states
        from hoi.method.reaction import pushed_back, pushing

        with self._apart():
            ready = ready_to_push(scene, motion, free, push, self.samples, NEAR_IN_ANSWER)
        stage.notes.extend(ready.notes)
        person = pushing(scene, motion, ready, self.muscles, self.friction)
        start = person.person.time * scene.fps
        trajectory, pushed, pushes, states = push_by(scene, free, restarts, push, start, person, move, stage)
        motion, pushed = pushed_back(scene, motion, person, pushed, self.muscles, stage)
        return replace(state, motion=motion, trajectory=trajectory, contact=search.with_push(pushed, pushes)), states

    @contextmanager
    def _apart(self) -> Iterator[None]:
        """Tells what to do where a limb that is to push is in the object from the first."""
        try:
            yield
        except RunError as error:
            raise RunError(
                f"stage/contact=collider: {error}; move scene.placement.position away from the person, or use "
                "stage/contact=impulse"
            ) from None
