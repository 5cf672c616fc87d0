"""One progress bar a stage, and what the stage took."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from tqdm import tqdm

from hoi.data import StageReport


class Stages:
    """Runs stages one after the other, with a bar each, and keeps their reports and loss history."""

    def __init__(self) -> None:
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
    interval = 0.1 if sys.stderr.isatty() else 10.0  # a log file wants a line, not a film
    with tqdm(total=total, desc=f"{name:>12}", mininterval=interval, dynamic_ncols=True) as bar:
        advance = [bar.update] + [lambda units: None] * (len(runs) - 1)
        stages = [Stage(name, step, run.history) for step, run in zip(advance, runs, strict=True)]
        started = time.perf_counter()
        yield stages
        bar.update(total - bar.n)
    seconds = (time.perf_counter() - started) / len(runs)
    for run, stage in zip(runs, stages, strict=True):
        notes = [f"of a batch of {len(runs)} runs, which share its time"] if len(runs) > 1 else []
        report = StageReport(name, seconds, stage.iterations, stage.numbers, (*stage.notes, *notes))
        run.reports.append(report)


class Stage:
    """What a running stage may say."""

    def __init__(self, name: str, advance: Callable[[int], object], history: list[dict[str, float | str]]) -> None:
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
