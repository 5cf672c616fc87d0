"""What a run takes, and what it does not have to do."""

from collections.abc import Callable

import numpy as np

from analysis.metrics.metric import NAN
from analysis.records import Record

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
    """Share of the MPM's steps that the run did not take, of those that its plan counts for the free motion over the
    whole scene and the re-simulation from t_c to the end: rest, flight and longer time steps save them."""
    run = record.run
    planned = next((check.value for check in run.plan.checks if check.name == "steps"), None)
    scene = run.scene
    if planned is None or scene is None or scene.frames < 1:
        return NAN
    push = run.state.contact.push if run.state.contact is not None else None
    again = 0.0 if push is None else 1 - push.frame / scene.frames
    whole = float(planned) * (1 + again)
    taken = sum(report.numbers.get("steps", 0.0) for report in run.reports)
    return NAN if whole <= 0 else 1 - taken / whole


def _number(values: dict[str, str], key: str) -> float:
    try:
        value = float(values[key])
    except (KeyError, ValueError):
        return NAN
    return value if np.isfinite(value) else NAN
