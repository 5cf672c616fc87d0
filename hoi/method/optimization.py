"""The three stages, one after the other, over a plan (paper, Optimization)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hoi.body.skinning import stand_motion
from hoi.data import Motion, ObjectState, ObjectTrajectory, Plan, Scene, State, Target
from hoi.errors import under
from hoi.method.approach import approach, hastened
from hoi.method.attraction import Batch, coordinate
from hoi.method.hmsd import ScoreDistillation
from hoi.method.object_motion import Mover, at_rest, free_motion
from hoi.reports import Stages, shared_stage

if TYPE_CHECKING:
    from hoi.config import Config

Recall = Callable[[str, Callable[[], Any]], tuple[Any, bool]]
"""(step, what computes it) -> what comes of the step, and whether it was known."""


RECALLED = "as an earlier run of the same settings computed it, in that time"


def computed_anew(step: str, compute: Callable[[], Any]) -> tuple[Any, bool]:
    """Knows nothing."""
    return compute(), False


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
    """The motion prior, where the plan uses it; loaded when it is first needed."""
    recall: Recall = computed_anew
    """Finds what another walk has computed: "free motion", "motion", "coordinate", "resimulate"."""

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

        def moved() -> tuple[ObjectTrajectory, tuple[ObjectState, ...]]:
            with shared_stage(self.stages, "free motion", scenes[0].frames - 1) as (stage, *others):
                move = self.move if plan.keeps("free_motion") else at_rest
                found = free_motion(scenes[0], move, stage)
                for other in others:
                    other.numbers.update(stage.numbers)
                    other.notes.extend(stage.notes)
            return found

        def distilled() -> Sequence[Motion]:
            with shared_stage(self.stages, "motion", options.motion.units()) as each:
                alone = replace(scenes[0], object=None, planes=())  # of nothing else it may depend
                return options.motion.motions(alone, self._prior(), self.batch.seeds, each)

        trajectory, self.restarts = self._recalled("free motion", self.stages, moved)
        self.states = [State(motion, trajectory) for motion in motions]
        if plan.keeps("motion"):
            self._move(self._recalled("motion", self.stages, distilled))

    def coordinate(self) -> None:
        """Windowed attraction: the person meets the object.

        Raises:
            InputError: the person would start inside the object.
            RunError: the motion is not finite.
        """
        options, before = self.config.stage, self.states

        def attracted() -> list[tuple[Motion, Target | None]]:
            self.states = [self.aimed(scene, state) for scene, state in zip(self.batch.scenes, before, strict=True)]
            if self.plan.keeps("coordinate"):
                pulls = "attraction" in self.plan.uses
                attraction = options.attraction.term(self.batch, self.states) if pulls else None
                with shared_stage(self.stages, "coordinate", options.coordinate.iterations) as each:
                    settings = vars(options.coordinate)
                    self._move(coordinate(self.batch, self.states, self._prior(), attraction, each, **settings))
            return [(state.motion, state.target) for state in self.states if state.motion is not None]

        met = self._recalled("coordinate", self.stages, attracted)
        self.states = [replace(s, motion=motion, target=aim) for s, (motion, aim) in zip(before, met, strict=True)]

    def interact(self, run: int) -> None:
        """The object answers, the contact looks right: the rest of one run.

        Raises:
            RunError: a stage cannot go on.
        """
        scene, stages, options = self.batch.scenes[run], self.stages[run], self.config.stage
        state = self.states[run]
        motion, trajectory = state.motion, state.trajectory
        assert motion is not None and trajectory is not None

        # Contact detection and re-simulation.
        def answered() -> State:
            model = options.contact.beside(options.object)
            with stages.stage("contact", 1):
                together = state.target.joints if state.target else ()
                search = model.search(scene, motion, trajectory, together)
            self.states[run] = found = replace(state, contact=search)
            if (push := search.push) is not None:
                with stages.stage("resimulate", scene.frames - int(push.frame)) as stage:
                    found = model.answer(scene, found, self.restarts, self.move, stage)
            return found

        if self.plan.keeps("contact"):
            self.states[run] = state = self._recalled("resimulate", [stages], answered)

        # Video-SDS for Contact Fidelity: theta of the frames around contact; the object's trajectory is held fixed.
        if self.plan.keeps("refine"):
            config = replace(self.config, seed=self.batch.seeds[run])
            with stages.stage("refine", options.refine.units()) as stage:
                refined = options.refine.refine(scene, state, config, self.batch.device, stage)
            self.states[run] = replace(state, motion=refined)

    def aimed(self, scene: Scene, state: State) -> State:
        """j* and t*, and the motion from where and when it has to start for its strike to meet the object."""
        motion, trajectory = state.motion, state.trajectory
        assert motion is not None and trajectory is not None
        target = self.config.stage.motion.target(scene, motion, self.config.scene)
        if self.config.scene.tempo != 1:
            motion = hastened(motion, target, self.config.scene.tempo)
        if "approach" in self.plan.uses:
            with under("scene"):
                motion, target = approach(scene, motion, trajectory, target, self.config.scene.meeting_height)
        return replace(state, motion=motion, target=target)

    def _prior(self) -> ScoreDistillation | None:
        if self.distillation is None and self.plan.keeps("motion") and "motion_prior" in self.plan.uses:
            stand = self.config.scene.approach == "stand"
            self.distillation = self.config.stage.motion.prior(self.batch.scenes[0], self.batch.device, stand)
        return self.distillation

    def _recalled(self, step: str, runs: Sequence[Stages], compute: Callable[[], Any]) -> Any:
        """What comes of a step, and what its stages said: recalled, or computed."""
        before = [(len(run.reports), len(run.history)) for run in runs]

        def made() -> tuple[Any, list[Any]]:
            found = compute()
            return found, [(run.reports[r:], run.history[h:]) for run, (r, h) in zip(runs, before, strict=True)]

        (found, said), known = self.recall(step, made)
        if known:
            for run, (reports, history) in zip(runs, said, strict=True):
                run.reports += [replace(each, notes=(*each.notes, RECALLED)) for each in reports]
                run.history += history
        return found

    def _move(self, motions: Sequence[Motion]) -> None:
        self.states = [replace(s, motion=motion) for s, motion in zip(self.states, motions, strict=True)]
