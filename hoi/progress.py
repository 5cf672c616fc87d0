"""One progress bar a stage, and what the stage took."""

import sys
import time
from collections.abc import Callable, Iterator
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
        interval = 0.1 if sys.stderr.isatty() else 10.0  # a log file wants a line, not a film
        with tqdm(total=total, desc=f"{name:>12}", mininterval=interval, dynamic_ncols=True) as bar:
            stage = Stage(name, bar.update, self.history)
            started = time.perf_counter()
            yield stage
            bar.update(total - bar.n)
        seconds = time.perf_counter() - started
        self.reports.append(StageReport(name, seconds, stage.iterations, stage.numbers, tuple(stage.notes)))


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
