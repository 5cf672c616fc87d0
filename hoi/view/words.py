"""A run in words and curves: its plan and facts as Markdown, its losses as series. No markup of a record's own."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hoi.data import Array, Run

LONGEST = 400
"""Characters of one text that are shown."""
FACTS = ("scene", "experiment", "seed", "git", "started", "device", "config_hash")
"""Of the provenance; the rest is in the record."""


@dataclass(frozen=True)
class Curves:
    """Losses of one stage, over its iterations."""

    title: str
    iterations: Array
    """(n,)"""
    losses: Mapping[str, Array]
    """Label -> values (n,), NaN where there is none."""

    @property
    def logarithmic(self) -> bool:
        """Whether all of them are positive."""
        return all(bool((values[np.isfinite(values)] > 0).all()) for values in self.losses.values())


def plain(text: object) -> str:
    """One line of text for Markdown, whatever stands in it."""
    line = " ".join(str(text).split())
    line = line if len(line) <= LONGEST else line[: LONGEST - 1] + "…"
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", line)


def plan_markdown(run: Run) -> str:
    """What the run's plan kept, left out and checked."""
    plan = run.plan
    lines = [f"**{plain(plan.variant)}**", ""]
    lines += [f"- **{plain(s.name)}**, {plain(s.implementation)}: {plain(s.reason)}" for s in plan.steps]
    if plan.omissions:
        lines += ["", "Left out", ""]
        lines += [f"- **{plain(o.what)}**: {plain(o.because)}; saves {plain(o.saves)}" for o in plan.omissions]
    if plan.checks:
        lines += ["", "Checks", ""]
        lines += [f"- **{plain(c.name)}** {plain(c.value)}: {plain(c.detail)}" for c in plan.checks]
    return "\n".join(lines)


def facts_markdown(run: Run) -> str:
    """What came out, how long each stage took, and where the run comes from."""
    lines = [f"“{plain(run.scene.motion_prompt)}”", ""] if run.scene is not None else []
    facts = {**run.result, **{name: run.provenance[name] for name in FACTS if name in run.provenance}}
    lines += ["|  |  |", "|---|---|"]
    lines += [f"| {plain(name)} | {plain(value)} |" for name, value in facts.items()]
    if run.reports:
        lines += ["", "| stage | s |", "|---|---|"]
        lines += [f"| {plain(report.stage)} | {report.seconds:.1f} |" for report in run.reports]
    return "\n".join(lines)


def curves_of(runs: Sequence[Run], labels: Sequence[str]) -> list[Curves]:
    """The losses of all runs, stage by stage; labels stand before the losses' names where there are several runs."""
    series: dict[str, dict[str, dict[float, float]]] = {}
    for run, label in zip(runs, labels, strict=True):
        for row in run.history:
            stage, iteration = row.get("stage"), row.get("iteration")
            for name, value in row.items():
                if name in ("stage", "iteration") or isinstance(value, str) or not isinstance(iteration, int | float):
                    continue
                line = f"{label} · {name}" if len(runs) > 1 else name
                series.setdefault(str(stage), {}).setdefault(line, {})[iteration] = float(value)
    found = []
    for stage, lines in series.items():
        iterations = np.array(sorted(set().union(*lines.values())))
        losses = {name: np.array([line.get(i, np.nan) for i in iterations]) for name, line in lines.items()}
        found.append(Curves(stage, iterations, losses))
    return found
