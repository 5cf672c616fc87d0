"""What a running stage says of itself: iterations, losses, numbers and notes, for the record."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext

from hoi.data import StageReport

Advance = Callable[..., object]
"""Told of so many more units of work done; of one, when not told how many."""
Bar = Callable[[str, int], AbstractContextManager[Advance]]
"""(name, total units) -> what shows them, while they are done."""


def no_bar(name: str, total: int) -> AbstractContextManager[Advance]:
    """Shows nothing."""
    return nullcontext(lambda units: None)


class Stages:
    """Runs stages one after the other and keeps their reports and loss history."""

    def __init__(self, bar: Bar = no_bar) -> None:
        self.bar = bar
        self.reports: list[StageReport] = []
        self.history: list[dict[str, float | str]] = []

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator["Stage"]:
        """A stage of `total` units; its report is kept when the block ends without an error."""
        with shared_stage([self], name, total) as (stage,):
            yield stage


@contextmanager
def shared_stage(runs: Sequence[Stages], name: str, total: int) -> Iterator[list["Stage"]]:
    """A stage that several runs go through together: each keeps a report, with its share of the time."""
    with runs[0].bar(name, total) as advance:
        steps: list[Advance] = [advance, *([lambda units: None] * (len(runs) - 1))]
        stages = [Stage(name, step, run.history) for step, run in zip(steps, runs, strict=True)]
        started = time.perf_counter()
        yield stages
    seconds = (time.perf_counter() - started) / len(runs)
    for run, stage in zip(runs, stages, strict=True):
        notes = [f"of a batch of {len(runs)} runs, which share its time"] if len(runs) > 1 else []
        report = StageReport(name, seconds, stage.iterations, stage.numbers, (*stage.notes, *notes))
        run.reports.append(report)


class Stage:
    """What a running stage may say."""

    def __init__(self, name: str, advance: Advance, history: list[dict[str, float | str]]) -> None:
        self.name = name
        self.iterations = 0
        self.numbers: dict[str, float] = {}
        self.notes: list[str] = []
        self._advance, self._history = advance, history

    def advance(self, units: int = 1) -> None:
        self._advance(units)

    def iteration(self, number: int, losses: dict[str, float]) -> None:
        """Keep one optimiser iteration's losses."""
        self._history.append({"stage": self.name, "iteration": float(number), **losses})
        self.iterations = number + 1
        self._advance(1)


def quiet(name: str = "") -> Stage:
    """A stage that is nobody's."""
    return Stage(name, lambda units: None, [])
