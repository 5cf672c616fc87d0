"""A toy at each stage of the walk: does next to nothing, and writes down what it is asked."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from hoi.body.skinning import stand_motion
from hoi.config import Config, StageConf
from hoi.data import Contact, ContactSearch, Plan, Step, Target
from hoi.errors import RunError
from hoi.method.object_motion import Advanced, at_rest
from hoi.method.pose import PoseParameters
from hoi.record import Footage
from hoi.render.cameras import look_at
from hoi.render.encode import encode
from hoi.stages.contract import Attraction, ContactModel, MotionSource, ObjectMover, Refinement, Renderer
from hoi.stages.coordinate.default import Coordinate

JOINT, FRAME = 8, 2
STEPS = ("free_motion", "motion", "coordinate", "contact", "refine", "render")
USES = ("motion_prior", "attraction")


def planned(without: str = "") -> Plan:
    """Everything but the step, or the use, of this name."""
    steps = tuple(Step(name, "toy", "to be seen") for name in STEPS if name != without)
    return Plan("toy", steps, (), (), tuple(use for use in USES if use != without))


@dataclass
class Toy:
    """What all of them share."""

    asked: list[tuple] = field(default_factory=list)
    """(what, ...), in the order in which it was asked; one list for all."""
    fails: dict[str, int | None] = field(default_factory=dict)
    """What -> the seed for which it breaks, None for any."""

    def note(self, what: str, *more: object) -> None:
        self.asked.append((what, *more))
        if what in self.fails and self.fails[what] in (None, *more):
            raise RunError(f"{what} broke")


@dataclass
class ToyMotion(Toy, MotionSource):
    def prior(self, scene, device, stand):
        """One that wants everything small."""
        self.note("prior", device)
        return SimpleNamespace(
            loss=lambda pose, generators: sum(x.square().flatten(1).sum(1) for x in pose.leaves()),
            pose=lambda motions, device: PoseParameters.of(motions, device),
        )

    def motions(self, scene, distillation, seeds, stages):
        """Standing, with a noise of the seed."""
        self.note("motions", *seeds)
        still = stand_motion(scene.body, scene.frames, scene.fps)
        noises = [np.random.default_rng(seed).normal(0, 0.1, still.body_pose.shape) for seed in seeds]
        return [replace(still, body_pose=(still.body_pose + noise).astype(np.float32)) for noise in noises]

    def target(self, scene, motion, conf, act=None):
        self.note("target")
        return Target(JOINT, FRAME, "scene")


@dataclass
class ToyAttraction(Toy, Attraction):
    def term(self, batch, states):
        """Pulls one joint to x = 1 m."""
        self.note("term", len(states))
        return lambda joints: (joints[:, :, JOINT, 0] - 1).square().mean(dim=1), 1.0


@dataclass
class ToyContact(Toy, ContactModel):
    v_in: float = 1.0

    def search(self, scene, motion, trajectory, together=(), last=None, until=np.inf):
        self.note("search")
        zero, ahead = np.zeros(3), np.array([0.0, 1.0, 0.0])
        contact = Contact(1.5, JOINT, 0.5, zero, ahead, ahead, zero, self.v_in, ahead, ahead, 0.0)
        return ContactSearch((contact,), 0.0, 1.5, JOINT)

    def answer(self, scene, state, restarts, move, stage):
        """The object is 1 m further on."""
        self.note("answer", len(restarts))
        farther = replace(state.trajectory, com=state.trajectory.com + np.array([0, 1, 0]))
        return replace(state, trajectory=farther), restarts


@dataclass
class ToyMover(Toy, ObjectMover):
    def mover(self, object_size, threads, device):
        def move(scene, state, start, stops, stage, collider=None) -> Advanced:
            self.note("move", start, len(stops))
            return replace(at_rest(scene, state, start, stops, stage), phase=("toy",) * len(stops))

        return move


@dataclass
class ToyRefinement(Toy, Refinement):
    def refine(self, scene, state, config, device, stage):
        """The person is 1 m higher."""
        self.note("refine", config.seed)
        return replace(state.motion, translation=state.motion.translation + np.float32([0, 0, 1]))


@dataclass
class ToyRenderer(Toy, Renderer):
    def draw(self, run, device, stage):
        self.note("draw")
        frames = len(run.state.motion)
        video = encode([np.full((16, 16, 3), 40 * frame, np.uint8) for frame in range(frames)], 20)
        return video, Footage(video.units, (look_at((5, 0, 1), (0, 0, 1), width=16, height=16),) * frames)


def toyed(config: Config, *, v_in: float = 1.0, **fails: int | None) -> tuple[Config, list[tuple]]:
    """The config with a toy at each stage, and the list of what they will be asked."""
    asked: list[tuple] = []
    stage = StageConf(
        motion=ToyMotion(asked, fails),
        coordinate=Coordinate(iterations=3, learning_rate=0.01, decay=0.0, lambda_hmsd=0.01, lambda_feet=0.0),
        attraction=ToyAttraction(asked, fails),
        contact=ToyContact(asked, fails, v_in),
        object=ToyMover(asked, fails),
        refine=ToyRefinement(asked, fails),
    )
    return replace(config, stage=stage, render=ToyRenderer(asked, fails)), asked
