"""A whole trajectory backwards: the phases of `hoi.mpm.phases`, each by its own rule.

The MPM goes back by its steps, flight by its closed form; what lies still keeps its place, and owes its speed nothing.
The times of the changes are held. By the event rule the time t_e of a change adds (what the one phase does - what the
other does) dt_e, and at the changes here both do the same: flight ends before anything is touched and begins where
nothing is any more, but for the vibration that the walk leaves out by its own tolerance. Where a phase is to begin at
an event of one's own, `hoi.gradient.flight.landing_backwards` differentiates its time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hoi.data import Array, Material, ObjectState
from hoi.gradient.backwards import Cotangent, Gradient, MaterialGradient, Recording
from hoi.gradient.flight import flight_backwards
from hoi.mpm.phases import Surroundings, Walk
from hoi.mpm.rigid import Flight
from hoi.mpm.solver import Simulation


@dataclass
class _Phase:
    began: float
    run: Recording | None = None
    flight: Flight | None = None
    departed: ObjectState | None = None


class Course(Walk):
    """A walk that remembers enough to be taken backwards.

    Args:
        state, masses, end, surroundings, size, moment, frequency, tolerance, drag: those of `Walk`.
        volumes, material: those of `Simulation`. settings: all others of `Simulation`.
    """

    def __init__(
        self, state: ObjectState, masses: Array, volumes: Array, material: Material | Sequence[Material], *,
        end: float, surroundings: Surroundings, size: float, moment: float, frequency: float | None,
        tolerance: float | None, drag: float = 0.0, **settings: Any,
    ) -> None:  # fmt: skip
        self.passed: list[_Phase] = []
        gravity = settings.get("gravity", (0.0, 0.0, -9.81))

        def start(state: ObjectState, now: float) -> Simulation:
            return Recording(state, volumes, material, planes=surroundings.planes, **settings)

        super().__init__(
            state, masses, start, end=end, gravity=np.asarray(gravity), surroundings=surroundings, size=size,
            moment=moment, frequency=frequency, tolerance=tolerance, drag=drag,
        )  # fmt: skip

    def _begin_mpm(self) -> None:
        super()._begin_mpm()
        assert isinstance(self.simulation, Recording)
        self.passed.append(_Phase(self.time, run=self.simulation))

    def _rolls_on(self) -> None:
        """A ball that rolls stays with the MPM, which goes backwards by its steps."""

    def _leave_mpm(self, phase: str, energy: float) -> None:
        super()._leave_mpm(phase, energy)
        flight = self.path if phase == "flight" else None
        assert flight is None or isinstance(flight, Flight)
        self.passed.append(_Phase(self.time, flight=flight, departed=self.here))

    def backwards(self, cotangents: Sequence[tuple[float, Cotangent]]) -> Gradient:
        """The gradient of a number, given its derivatives with respect to the states at some times.

        Raises:
            InputError, RunError: as `hoi.gradient.backwards.Recording.backwards`.
        """
        later, until, found = Cotangent(), self.time, []
        for number, phase in reversed(list(enumerate(self.passed))):
            own = [(t - phase.began, c) for t, c in cotangents if phase.began < t <= until or t == number == 0]
            ends = [*own, (until - phase.began, later)]
            if phase.run is not None:
                found.append(phase.run.backwards([*own, (phase.run.time, later)]))
                later = found[-1].cotangent
            elif phase.flight is not None:
                assert phase.departed is not None
                back = [
                    flight_backwards(phase.flight, phase.departed, self._masses, self._moment, t, c) for t, c in ends
                ]
                later = _sum([each for each, _, _ in back])
                found.append(sum(gravity for _, gravity, _ in back))
            else:
                later = _sum([replace(c, velocities=None, affine=None) for _, c in ends])
            until = phase.began
        runs = [each for each in found if isinstance(each, Gradient)]
        gravity = sum((each.gravity if isinstance(each, Gradient) else each for each in found), np.zeros(3))
        materials = tuple(
            MaterialGradient(*np.sum([list(vars(each).values()) for each in one], axis=0).tolist())
            for one in zip(*(run.materials for run in runs), strict=True)
        )
        friction = tuple(np.sum([run.friction for run in runs], axis=0).tolist())
        return replace(runs[-1], materials=materials, friction=friction, gravity=gravity)


def _sum(cotangents: Sequence[Cotangent]) -> Cotangent:
    sums: dict[str, Array | None] = {}
    for name in vars(Cotangent()):
        given = [values for each in cotangents if (values := getattr(each, name)) is not None]
        sums[name] = np.sum(given, axis=0) if given else None
    return Cotangent(**sums)
