"""What an option of a stage is, and what each stage asks of its options. Light: what runs is imported when it runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, TypeAlias, TypeVar

from hoi.data import Check, Missing, Omission, Step

if TYPE_CHECKING:
    from hoi.config import Config, SceneConf
    from hoi.data import (
        Act,
        Contact,
        ContactSearch,
        Material,
        Motion,
        ObjectState,
        ObjectTrajectory,
        Run,
        Scene,
        State,
        Target,
    )
    from hoi.method.attraction import Batch, Term
    from hoi.method.hmsd import ScoreDistillation
    from hoi.method.object_motion import Mover
    from hoi.record import Footage
    from hoi.render.encode import Video
    from hoi.reports import Stage

GROUPS = (
    "stage/attraction",
    "stage/contact",
    "stage/motion",
    "stage/object",
    "stage/refine",
    "stage/coordinate",
    "render",
)
"""Config groups of options, in the order in which a variant's label names what they leave out."""
SMALLEST_PICTURE, LARGEST_PICTURE = 16, 8192
"""Edges of a picture [pixel]."""
D_CONTACT = 0.01
"""d_contact where no contact is looked for [m]."""


class Requirements:
    """What a config must be; collects what it is not, a line each."""

    def __init__(self, prefix: str = "", problems: list[str] | None = None) -> None:
        self.problems: list[str] = [] if problems is None else problems
        self._prefix = prefix

    def __call__(self, holds: bool, name: str, value: object, rule: str) -> None:
        if not holds:
            self.problems.append(f"{self._prefix}{name} must be {rule}, got {value}")

    def of(self, key: str) -> Requirements:
        """The same for the keys below `key`."""
        return Requirements(f"{self._prefix}{key}.", self.problems)


@dataclass
class Draft:
    """A plan in the making; see `hoi.data.Plan`."""

    materials: tuple[Material, ...]
    """The object's, checked."""
    steps: list[Step] = field(default_factory=list)
    omissions: list[Omission] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)
    uses: list[str] = field(default_factory=list)
    missing: list[Missing] = field(default_factory=list)
    without: list[str] = field(default_factory=list)
    """Labels of what is left out, each one of its option's `stands_for`."""

    def run(self, name: str, implementation: str, reason: str) -> None:
        self.steps.append(Step(name, implementation, reason))

    def omit(self, what: str, because: str, saves: str) -> None:
        self.omissions.append(Omission(what, because, saves))

    def lack(self, key: str, what: str, path: str, remedy: str, size: str = "") -> None:
        self.missing.append(Missing(key, what, path, size, remedy))

    def check(self, name: str, value: str, detail: str) -> None:
        self.checks.append(Check(name, value, detail))


@dataclass
class Option:
    """One thing that a stage can be."""

    group: ClassVar[str]
    """In `conf/`: "stage/object"."""
    name: ClassVar[str]
    """On the command line: "mpm"."""
    stands_for: ClassVar[dict[str, str]] = {}
    """Label of a variant -> what a run with that label does without."""

    def check(self, config: Config, require: Requirements) -> None:
        """State what its values must be; `require.of(self.key)` takes names of its own fields."""

    def plan(self, config: Config, draft: Draft) -> None:
        """Its lines of the plan, and what it needs and does not find (`draft.missing`).

        Raises:
            InputError: values that physics forbids.
        """

    def units(self) -> int:
        """Of work, for a progress bar."""
        return 1

    @property
    def key(self) -> str:
        """Of its values in the config: "stage.object"."""
        return self.group.replace("/", ".")


OPTIONS: dict[tuple[str, str], type[Option]] = {}
"""By group and name; filled by `option`."""
T = TypeVar("T", bound=type[Option])


def option(group: str, name: str) -> Callable[[T], T]:
    """Makes a dataclass the option of that name."""

    def register(cls: T) -> T:
        cls.group, cls.name = group, name
        OPTIONS[group, name] = cls
        return cls

    return register


def labels() -> dict[str, str]:
    """Label of a variant -> what a run with it does without, in the order in which a label names them."""
    found: dict[str, str] = {}
    for group in GROUPS:
        for (of, _), cls in OPTIONS.items():
            found |= cls.stands_for if of == group else {}
    return found


@dataclass
class MotionSource(Option):
    """Stage 1: where the person's motion comes from."""

    def prior(self, scene: Scene, device: str, stand: bool) -> ScoreDistillation:
        """The motion prior, ready for this scene's prompt and person, who may have to `stand` where they are.

        Asked for only where the plan uses "motion_prior".
        """
        raise NotImplementedError

    def read(self, scene: Scene) -> None:
        """Look at its files, before anything is computed.

        Raises:
            InputError: one cannot be used.
        """

    def motions(
        self, scene: Scene, distillation: ScoreDistillation | None, seeds: Sequence[int], stages: Sequence[Stage]
    ) -> list[Motion]:
        """One motion a seed, from the sentence alone; `stages` are told of one each."""
        raise NotImplementedError

    def target(self, scene: Scene, motion: Motion, conf: SceneConf, act: Act | None = None) -> Target:
        """j* and t* of a motion; of an act, those of its limb in its time."""
        raise NotImplementedError


@dataclass
class Attraction(Option):
    """The pull of stage 2 towards the object."""

    def described(self) -> str:
        """Its term in the plan."""
        return self.name

    def term(self, batch: Batch, states: Sequence[State]) -> Term:
        """Its loss of the joints and that one's weight. Asked for only where the plan uses "attraction"."""
        raise NotImplementedError


Answered: TypeAlias = "tuple[State, Sequence[ObjectState]]"
"""The state after a contact, and the object's at each frame, from which the next one starts again."""


@dataclass
class ContactModel(Option):
    """What happens when person and object touch."""

    lasting: ClassVar[bool] = False
    """Whether its answer holds all that the person's motion as it is does to the object until T."""

    @property
    def d_contact(self) -> float:
        """From where on skin and object touch [m]."""
        return D_CONTACT

    def beside(self, mover: ObjectMover) -> ContactModel:
        """What it is where the object is moved so."""
        return self

    def of(self, act: Act | None) -> ContactModel:
        """What it is for the contacts of an act's strike."""
        return self

    def search(
        self,
        scene: Scene,
        motion: Motion,
        trajectory: ObjectTrajectory,
        together: Sequence[int] = (),
        last: Contact | None = None,
        until: float = math.inf,
    ) -> ContactSearch:
        """The contacts of a motion and the object's, after the `last` one that is answered and before frame `until`;
        `together` are joints that push together."""
        raise NotImplementedError

    def answer(
        self, scene: Scene, state: State, restarts: Sequence[ObjectState], move: Mover, stage: Stage
    ) -> Answered:
        """How object and person go on after the contact that pushes the object: the state with their motions and the
        contacts with what came of them."""
        raise NotImplementedError


@dataclass
class ObjectMover(Option):
    """What moves the object."""

    yields: ClassVar[bool] = False
    """Whether a limb can push it."""

    def cell(self, object_size: float) -> float:
        """What the filling of an object of that size [m] follows: twice the particles' distance, or a grid's dx [m]."""
        return object_size / 12

    def mover(self, object_size: float, threads: int, device: str) -> Mover:
        """Moves an object of that size [m]."""
        raise NotImplementedError

    def closing(self, config: Config, draft: Draft) -> None:
        """Lines of the plan that hang on what all others do."""


@dataclass
class Refinement(Option):
    """Stage 3."""

    def refine(self, scene: Scene, state: State, config: Config, device: str, stage: Stage) -> Motion:
        """The motion with theta refined around contact."""
        raise NotImplementedError


@dataclass
class Renderer(Option):
    """The video of the finished run."""

    @property
    def compiles(self) -> bool:
        """Whether its kernels are compiled, as the MPM's are."""
        return False

    def check_machine(self) -> None:
        """Raises InputError where the pictures cannot be drawn here."""

    def draw(self, run: Run, device: str, stage: Stage) -> tuple[Video, Footage]:
        """The video of a run, and what of it belongs in the record.

        Raises:
            RunError: the run cannot be drawn.
        """
        raise NotImplementedError
