"""The three stages, one after the other, over a plan (paper, Optimization)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hoi.body.skinning import stand_motion
from hoi.data import Motion, ObjectState, Plan, Scene, State
from hoi.errors import under
from hoi.method.approach import approach
from hoi.method.attraction import Batch, coordinate
from hoi.method.hmsd import ScoreDistillation
from hoi.method.object_motion import Mover, at_rest, free_motion
from hoi.reports import Stages, shared_stage

if TYPE_CHECKING:
    from hoi.config import Config


@dataclass
class Walk:
    """Runs of one config that differ in nothing but seed, and how far they have come.

    They share the object's free motion and move their persons as one batch until each meets the object.
    """

    config: "Config"
    plan: Plan
    batch: Batch
    move: Mover
    stages: Sequence[Stages]
    states: list[State] = field(default_factory=list)
    """What the stages have written so far, one a run; also when one fails."""
    restarts: tuple[ObjectState, ...] = ()
    """The object's state at each frame of its free motion, for the re-simulation."""
    distillation: ScoreDistillation | None = None
    """The motion prior, where the plan uses it."""

    def synthesise(self) -> None:
        """Agent Motion Synthesis: the object's free motion, and the human's, distilled from the motion prior.

        Raises:
            InputError: a file of the motion cannot be read.
            RunError: a stage cannot go on.
        """
        plan, scenes, options = self.plan, self.batch.scenes, self.config.stage
        motions = [stand_motion(scene.body, scene.frames, scene.fps) for scene in scenes]
        if plan.keeps("motion"):
            options.motion.read(scenes[0])

        with shared_stage(self.stages, "free motion", scenes[0].frames - 1) as (stage, *others):
            move = self.move if plan.keeps("free_motion") else at_rest
            trajectory, self.restarts = free_motion(scenes[0], move, stage)
            for other in others:
                other.numbers.update(stage.numbers)
                other.notes.extend(stage.notes)
        self.states = [State(motion, trajectory) for motion in motions]
        if plan.keeps("motion"):
            with shared_stage(self.stages, "motion", options.motion.units()) as each:
                if "motion_prior" in plan.uses:
                    stand = self.config.scene.approach == "stand"
                    self.distillation = options.motion.prior(scenes[0], self.batch.device, stand)
                self._move(options.motion.motions(scenes[0], self.distillation, self.batch.seeds, each))

    def coordinate(self) -> None:
        """Windowed attraction: the person meets the object.

        Raises:
            InputError: the person would start inside the object.
            RunError: the motion is not finite.
        """
        plan, options = self.plan, self.config.stage
        self.states = [self.aimed(scene, state) for scene, state in zip(self.batch.scenes, self.states, strict=True)]
        if plan.keeps("coordinate"):
            attraction = options.attraction.term(self.batch, self.states) if "attraction" in plan.uses else None
            with shared_stage(self.stages, "coordinate", options.coordinate.iterations) as each:
                settings = vars(options.coordinate)
                self._move(coordinate(self.batch, self.states, self.distillation, attraction, each, **settings))

    def interact(self, run: int) -> None:
        """The object answers, the contact looks right: the rest of one run.

        Raises:
            RunError: a stage cannot go on.
        """
        scene, stages, options = self.batch.scenes[run], self.stages[run], self.config.stage
        state = self.states[run]
        assert state.motion is not None and state.trajectory is not None

        # Contact detection and re-simulation.
        if self.plan.keeps("contact"):
            with stages.stage("contact", 1):
                together = state.target.joints if state.target else ()
                search = options.contact.search(scene, state.motion, state.trajectory, together)
            self.states[run] = state = replace(state, contact=search)
            if (push := search.push) is not None:
                with stages.stage("resimulate", scene.frames - int(push.frame)) as stage:
                    state = options.contact.answer(scene, state, self.restarts, self.move, stage)
                self.states[run] = state

        # Video-SDS for Contact Fidelity: theta of the frames around contact; the object's trajectory is held fixed.
        if self.plan.keeps("refine"):
            config = replace(self.config, seed=self.batch.seeds[run])
            with stages.stage("refine", options.refine.units()) as stage:
                motion = options.refine.refine(scene, state, config, self.batch.device, stage)
            self.states[run] = replace(state, motion=motion)

    def aimed(self, scene: Scene, state: State) -> State:
        """j* and t*, and the motion from where and when it has to start for its strike to meet the object."""
        motion, trajectory = state.motion, state.trajectory
        assert motion is not None and trajectory is not None
        target = self.config.stage.motion.target(scene, motion, self.config.scene)
        if "approach" in self.plan.uses:
            with under("scene"):
                motion, target = approach(scene, motion, trajectory, target)
        return replace(state, motion=motion, target=target)

    def _move(self, motions: Sequence[Motion]) -> None:
        self.states = [replace(s, motion=motion) for s, motion in zip(self.states, motions, strict=True)]
