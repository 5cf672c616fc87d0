"""What a run takes, and what it does not have to do."""

from collections.abc import Callable

import numpy as np

from ..records import Record
from .metric import NAN

STAGES = ("free motion", "motion", "coordinate", "contact", "resimulate", "refine", "render")


def seconds(record: Record) -> float:
    """Wall-clock time of the run, all stages and what is between them."""
    return _number(record.run.result, "seconds")


def peak_memory(record: Record) -> float:
    """Highest resident memory of the run's process; of runs in one process, up to the end of each."""
    return _number(record.run.result, "peak_memory_mb")


def stage_seconds(stage: str) -> Callable[[Record], float]:
    """The metric of one stage's seconds."""

    def function(record: Record) -> float:
        times = [report.seconds for report in record.run.reports if report.stage == stage]
        return sum(times) if times else NAN

    function.__doc__ = f"Wall-clock time of the stage {stage!r}; empty where the plan leaves it out."
    return function


def left_out(record: Record) -> float:
    """Share of the MPM's steps that the run left out, in flight and at rest, of those and the steps it took, by the
    stages' own count; empty where the MPM moved nothing."""
    numbers = [report.numbers for report in record.run.reports]
    taken, spared = (sum(each.get(name, 0.0) for each in numbers) for name in ("steps", "steps_left_out"))
    return spared / (taken + spared) if taken + spared > 0 else NAN


def _number(values: dict[str, str], key: str) -> float:
    try:
        value = float(values[key])
    except (KeyError, ValueError):
        return NAN
    return value if np.isfinite(value) else NAN
