"""What the person's answer to a contact costs: `python -m analysis.answer_bench [-- overrides]`.

A scene with an impulse and one with a push, each twice in a process of its own; the second run counts, its kernels
being compiled. Counted as the answer is all that the person as a body with mass does, and in a push the exchange with
the grid, in which is also what a limb that nothing stops would cost: an upper bound. Then the same with a limb that
nothing stops, and whether that loads MuJoCo. Exit codes: 0 done; 2 bad input; 3 a run failed.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
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
    "hoi.mpm.coupling.Coupling.place",
    "hoi.mpm.coupling.Coupling.exchange",
)
"""What is counted, the time in one called by another once."""


class Spent:
    """Seconds in functions that may call each other."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
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


def share(overrides: Sequence[str]) -> tuple[float, float]:
    """Seconds of a run whose kernels are compiled, and of the person's answer in it."""
    from hoi import api

    config = api.compose("render=none", *overrides)
    api.run(config)
    with counted() as spent:
        began = time.perf_counter()
        api.run(config)
        return time.perf_counter() - began, spent.seconds


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
