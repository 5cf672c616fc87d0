"""What the person's answer to a contact costs: `python -m analysis.answer_bench [-- overrides]`.

A scene with an impulse and one with a push, in a process of its own: once to compile, once with a limb that nothing
stops, once with the answer. Counted as the answer is all that the person as a body with mass does, and what a step
takes in which it pushes beyond one in which a limb that nothing stops does. All in CPU seconds, which a busy machine
leaves alone. Then whether a limb that nothing stops loads MuJoCo. Exit codes: 0 done; 2 bad input; 3 a run failed.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from unittest import mock

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command

SCENES = {"impulse": "scene=kick_soccer_ball", "push": "scene=push_box"}
ANSWER = (
    "hoi.method.reaction.person_at",
    "hoi.method.reaction.react",
    "hoi.method.reaction.pushed_back",
    "hoi.body.dynamics.Person.inverse_mass",
    "hoi.body.pushing.Pushing.advance",
    "hoi.body.pushing.Pushing.foreseen",
    "hoi.mpm.coupling.Coupling.begin",
    "hoi.mpm.coupling.Coupling.end",
)
"""What is counted, the time in one called by another once."""


class Spent:
    """Seconds in functions that may call each other."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self.seconds, self._depth, self._clock = 0.0, 0, clock

    def counting(self, function: Callable) -> Callable:
        """The function, its time counted."""

        def counted(*args: object, **kwargs: object) -> object:
            self._depth += 1
            began = self._clock()
            try:
                return function(*args, **kwargs)
            finally:
                self._depth -= 1
                if not self._depth:
                    self.seconds += self._clock() - began

        return counted


@contextmanager
def counted(places: Sequence[str] = ANSWER) -> Iterator[Spent]:
    """While it lasts, the time spent in the functions at these places is counted."""
    spent = Spent()
    with ExitStack() as stack:
        for place in places:
            head, _, name = place.rpartition(".")
            try:
                owner = importlib.import_module(head)
            except ModuleNotFoundError:
                module, _, kind = head.rpartition(".")
                owner = getattr(importlib.import_module(module), kind)
            stack.enter_context(mock.patch.object(owner, name, spent.counting(getattr(owner, name))))
        yield spent


@dataclass
class Steps:
    """Of the grid in which a limb pushes; what passes between them and the person aside."""

    seconds: float = 0.0
    count: int = 0

    @property
    def each(self) -> float:
        """[s]"""
        return self.seconds / max(self.count, 1)


@contextmanager
def pushing_steps() -> Iterator[Steps]:
    """While it lasts, the steps with a limb near the object are counted."""
    from hoi.mpm.coupling import Coupling
    from hoi.mpm.solver import Launch, Simulation

    steps, aside, launch = Steps(), Spent(), Simulation._launch

    def timed(simulation: Simulation, prepared: Launch, **options: bool) -> int:
        collider, before = simulation.collider, aside.seconds
        moving = collider is not None and collider.times[0] <= simulation.time < collider.times[-1]
        began = time.process_time()
        done = launch(simulation, prepared, **options)
        if prepared.coupled or (moving and prepared.near):
            steps.seconds += time.process_time() - began - (aside.seconds - before)
            steps.count += done
        return done

    with ExitStack() as stack:
        for name in ("begin", "end"):
            function = aside.counting(getattr(Coupling, name))
            stack.enter_context(mock.patch.object(Coupling, name, function))
        stack.enter_context(mock.patch.object(Simulation, "_launch", timed))
        yield steps


def share(overrides: Sequence[str]) -> tuple[float, float]:
    """CPU seconds of a run whose kernels are compiled, and of the person's answer in it."""
    from hoi import api

    config = api.compose("render=none", *overrides)
    api.run(config)
    with pushing_steps() as unstopped:
        api.run(api.compose("render=none", "stage.contact.limb=infinite", *overrides))
    with pushing_steps() as coupled, counted() as spent:
        began = time.process_time()
        api.run(config)
        seconds = time.process_time() - began
    dearer = coupled.each - unstopped.each if unstopped.count else 0.0
    return seconds, spent.seconds + coupled.count * max(dearer, 0.0)


def loads_mujoco(overrides: Sequence[str]) -> bool:
    """Whether a run of a limb that nothing stops does, in this process."""
    from hoi import api

    api.run(api.compose("render=none", "stage.contact.limb=infinite", *overrides))
    return "mujoco" in sys.modules


def apart(call: str) -> list[float]:
    """What a function of this module gives in a process of its own.

    Raises:
        InputError: it fails there.
    """
    code = f"from analysis import answer_bench\nprint('answer:', answer_bench.{call})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    said = [line for line in done.stdout.splitlines() if line.startswith("answer:")]
    if done.returncode or not said:
        raise InputError(f"{call} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
    return [float({"True": 1, "False": 0}.get(word, word)) for word in said[-1][7:].strip(" ()").split(",")]


@command.exit_code("analysis.answer_bench")
def main() -> None:
    parser = command.parser(
        "analysis.answer_bench", "What the person's answer to a contact costs.", "-- experiment=smoke"
    )
    parser.add_argument("overrides", nargs="*", help="config overrides, as for hoi.run")
    overrides = parser.parse_args().overrides
    for what, scene in SCENES.items():
        seconds, answer = apart(f"share({[scene, *overrides]!r})")
        print(f"{what}, {scene}: the person's answer takes {answer:.2f} of {seconds:.1f} s, {answer / seconds:.1%}")
    (loaded,) = apart(f"loads_mujoco({[SCENES['push'], *overrides]!r})")
    print(f"stage.contact.limb=infinite: MuJoCo is {'' if loaded else 'not '}loaded")


if __name__ == "__main__":
    program(main)
