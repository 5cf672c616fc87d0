"""The three stages, one after the other, over a plan (paper, Optimization)."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hoi.body.skinning import stand_motion
from hoi.data import Act, Contact, Motion, ObjectState, ObjectTrajectory, Plan, Scene, State, Target
from hoi.errors import under
from hoi.method.approach import SOONEST, SWING, approach, hastened
from hoi.method.attraction import Batch, coordinate
from hoi.method.hmsd import ScoreDistillation
from hoi.method.object_motion import Mover, at_rest, free_motion
from hoi.method.sequence import MOST_AIMS, MOST_CONTACTS, SETTLING, joined, merged, placed_next
from hoi.reports import Stages, shared_stage

if TYPE_CHECKING:
    from hoi.config import Config

Recall = Callable[[str, Callable[[], Any]], tuple[Any, bool]]
"""(step, what computes it) -> what comes of the step, and whether it was known."""


RECALLED = "as an earlier run of the same settings computed it, in that time"


def computed_anew(step: str, compute: Callable[[], Any]) -> tuple[Any, bool]:
    """Knows nothing."""
    return compute(), False


def numbered(stage: str, number: int) -> str:
    """The name of a stage that is gone through again and again, in the reports and for its random stream."""
    return f"{stage} {number + 1}" if number else stage


def each_alone(state: State) -> list[State]:
    """The state as each contact that gave an impulse sees it, the first one also where there is none."""
    search = state.contact
    if search is None or len(search.given) < 2:
        return [state]
    return [replace(state, contact=replace(search, contacts=(contact,))) for contact in search.given]


def targets_of(state: State) -> tuple[Target, ...]:
    """Of all strikes, in the order of time."""
    return () if state.target is None else (state.target, *state.later)


def came_before(scene: Scene, state: State, number: int, last: Contact) -> bool:
    """Whether the last contact is not that of the strike `number`, which is still to come."""
    return bool(scene.strikes) and targets_of(state)[number].frame > last.frame + SOONEST * scene.fps


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
        if self.plan.keeps("contact") or scene.strikes[1:]:
            self.states[run] = self._recalled("resimulate", [stages], lambda: self._answered(run))

        # Video-SDS for Contact Fidelity: theta of the frames around contact; the object's trajectory is held fixed.
        if self.plan.keeps("refine"):
            config = replace(self.config, seed=self.batch.seeds[run])
            for number, seen in enumerate(each_alone(self.states[run])):
                now = replace(seen, motion=self.states[run].motion)
                with stages.stage(numbered("refine", number), options.refine.units()) as stage:
                    refined = options.refine.refine(scene, now, config, self.batch.device, stage)
                self.states[run] = replace(self.states[run], motion=refined)

    def _answered(self, run: int) -> State:
        """Contact detection and re-simulation, strike after strike: what the object does decides where the next is."""
        scene, stages, options = self.batch.scenes[run], self.stages[run], self.config.stage
        model, states = options.contact.beside(options.object), self.restarts
        ends = [*(act.start * scene.fps for act in scene.strikes[1:]), math.inf]
        most = self.config.scene.contacts or (MOST_CONTACTS if scene.acts else 1)
        found, last, begun, count = self.states[run], None, 0, 0
        for number, until in enumerate(ends):
            if number:
                found = self._met_again(run, number, last)
            answered, aims, own = True, 1, model.of(scene.strikes[number] if scene.strikes else None)
            while self.plan.keeps("contact") and answered and count < most:
                motion, trajectory = found.motion, found.trajectory
                assert motion is not None and trajectory is not None
                with stages.stage(numbered("contact", begun), 1):
                    together = found.target.joints if found.target else ()
                    search = model.search(scene, motion, trajectory, together, last, until)
                earlier, now = found.contact, replace(found, contact=search)
                self.states[run] = found = replace(found, contact=merged(earlier, search))
                answered, push = search.push is not None, search.push
                if push is not None:
                    with stages.stage(numbered("resimulate", begun), scene.frames - int(push.frame)) as stage:
                        now, states = own.answer(scene, now, states, self.move, stage)
                    assert now.contact is not None
                    last, found = now.contact.push, replace(now, contact=merged(earlier, now.contact))
                    self.states[run], count = found, count + 1
                    answered = not model.lasting
                    if last is not None and aims < MOST_AIMS and came_before(scene, found, number, last):
                        found, aims, answered = self._met_again(run, number, last), aims + 1, True
                begun += 1
        return found

    def _met_again(self, run: int, number: int, last: Contact | None) -> State:
        """The state with a strike where the object will be; as it was until the last contact and its swing are over."""
        scene, state, options = self.batch.scenes[run], self.states[run], self.config.stage
        motion, trajectory, act = state.motion, state.trajectory, scene.strikes[number]
        assert motion is not None and trajectory is not None
        before = targets_of(state)[:number]
        over = [aim.frame + 1 for aim in before] + ([] if last is None else [last.frame])
        since = min(math.ceil(max(over) + SWING * scene.fps), scene.frames - 1)
        motion, target = self._told(scene, motion, act)
        if "approach" in self.plan.uses:
            moves = self.config.scene.approach == "step"
            motion, target = placed_next(scene, motion, trajectory, target, act, since, moves)
        if self.plan.keeps("coordinate"):
            batch = replace(self.batch, scenes=[scene], seeds=[self.batch.seeds[run]])
            aim = [replace(state, motion=motion, target=target)]
            attraction = options.attraction.term(batch, aim) if "attraction" in self.plan.uses else None
            near = self._prior()
            if near is not None:
                near = near.between(since / scene.fps, target.frame / scene.fps + SETTLING)
            name = numbered("coordinate", sum(r.stage.startswith("coordinate") for r in self.stages[run].reports))
            with shared_stage([self.stages[run]], name, options.coordinate.iterations) as each:
                settings = vars(options.coordinate)
                (moved,) = coordinate(batch, aim, near, attraction, each, **settings, stream=name)
            motion = joined(motion, moved, since)
        first, *later = (*before, target)
        self.states[run] = replace(state, motion=motion, target=first, later=tuple(later))
        return self.states[run]

    def aimed(self, scene: Scene, state: State) -> State:
        """j* and t*, and the motion from where and when it has to start for its strike to meet the object."""
        motion, trajectory = state.motion, state.trajectory
        assert motion is not None and trajectory is not None
        act = scene.strikes[0] if scene.strikes else None
        motion, target = self._told(scene, motion, act)
        if "approach" in self.plan.uses:
            with under("scene"):
                motion, target = approach(scene, motion, trajectory, target, self.config.scene.meeting_height, act)
        return replace(state, motion=motion, target=target)

    def _told(self, scene: Scene, motion: Motion, act: Act | None) -> tuple[Motion, Target]:
        """The motion at the tempo that scene and act ask for, and j* and t*."""
        target = self.config.stage.motion.target(scene, motion, self.config.scene, act)
        tempo = self.config.scene.tempo if act is None else self.config.scene.tempo * act.tempo
        if act is not None:
            target = replace(target, way=act.sends)
        return (motion if tempo == 1 else hastened(motion, target, tempo)), target

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
