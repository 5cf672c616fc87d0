"""A record as the page shows it: plain texts and numbers, whatever the record holds."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hoi.data import Check, Omission, Step
from hoi.errors import InputError, RunError

from ..metrics import GROUPS, METRICS
from ..metrics.cost import STAGES
from ..records import Record, load
from ..table import KEYS
from ..writers import number, plain
from .media import Film, film

LABELS = (*KEYS, "seed")
"""What a run is called by: one short line each."""
MOST = 100
"""Steps, stages, checks and notes of a run that are shown."""
OTHER = len(STAGES)
"""The colour of what is no stage."""


@dataclass(frozen=True)
class Part:
    """A stage's share of the run's time."""

    name: str
    seconds: float
    colour: int
    """Index of its stage in `STAGES`, `OTHER` for others."""
    share: float = 0.0
    iterations: int = 0
    told: str = ""
    """Its numbers and notes."""


@dataclass(frozen=True)
class Shown:
    """One run. What its record lacks is empty."""

    row: dict[str, Any]
    """Its row of the table."""
    anchor: str
    outcome: str = ""
    prompts: tuple[tuple[str, str], ...] = ()
    steps: tuple[Step, ...] = ()
    omissions: tuple[Omission, ...] = ()
    checks: tuple[Check, ...] = ()
    parts: tuple[Part, ...] = ()
    seconds: float = math.nan
    numbers: tuple[tuple[str, tuple[tuple[str, str, str], ...]], ...] = ()
    """Group, then title, value, definition."""
    facts: tuple[tuple[str, str], ...] = ()
    config: str = ""
    film: Film | None = None
    no_film: str = ""
    """Why there is none."""
    problem: str = ""
    """Why the record is not shown."""

    @property
    def struck(self) -> bytes:
        """The picture at contact, else the middle one; empty without pictures."""
        stills = self.film.stills if self.film is not None else ()
        chosen = next((still for still in stills if still.struck), stills[len(stills) // 2] if stills else None)
        return b"" if chosen is None else chosen.jpeg


def look(folder: Path, row: dict[str, Any], anchor: str) -> Shown:
    """The run of a table's row. Nothing that a file holds is raised."""
    path = folder / str(row["path"])
    row = row | {key: plain(row[key]) for key in LABELS}
    if row["status"] == "unreadable":
        return Shown(row, anchor, problem=str(row["reason"]))
    try:
        return _shown(load(path), row, anchor)
    except Exception as error:  # one odd record must not take the page along
        return Shown(row, anchor, problem=_told(error, path))


def parts_of(times: list[Part], total: float) -> tuple[Part, ...]:
    """The parts with their shares of the total [s], and the rest of it as "between"."""
    times = [part for part in times if math.isfinite(part.seconds) and part.seconds >= 0]
    used = sum(part.seconds for part in times)
    if math.isfinite(total) and total > used:
        times, used = [*times, Part("between", total - used, OTHER)], total
    return tuple(
        Part(part.name, part.seconds, part.colour, part.seconds / used if used else 0.0, part.iterations, part.told)
        for part in times
    )


def colour_of(stage: str) -> int:
    return STAGES.index(stage) if stage in STAGES else OTHER


def _shown(record: Record, row: dict[str, Any], anchor: str) -> Shown:
    run = record.run
    seconds = _float(run.result.get("seconds", ""))
    times = [
        Part(report.stage, report.seconds, colour_of(report.stage), 0.0, report.iterations, _numbers(report))
        for report in run.reports[:MOST]
    ]
    fps = run.scene.fps if run.scene is not None else _float(record.conf("scene", "fps", default=""))
    seen, why = None, ""
    try:
        seen = film(record.path, fps if math.isfinite(fps) else None, _contact(record, fps))
    except Exception as error:  # whatever is wrong with the video, the rest is shown
        why = _told(error, record.path)
    return Shown(
        row=row,
        anchor=anchor,
        outcome=run.result.get("outcome", ""),
        prompts=_prompts(record),
        steps=run.plan.steps[:MOST],
        omissions=run.plan.omissions[:MOST],
        checks=run.plan.checks[:MOST],
        parts=parts_of(times, seconds),
        seconds=seconds,
        numbers=_measured(row),
        facts=_facts(record),
        config=run.config_yaml,
        film=seen,
        no_film=why,
    )


def _prompts(record: Record) -> tuple[tuple[str, str], ...]:
    names = {"motion": "motion_prompt", "scene": "scene_prompt", "negative": "negative_prompt"}
    found = {label: record.conf("scene", name, default="") for label, name in names.items()}
    if not found["motion"] and record.run.scene is not None:
        found["motion"] = record.run.scene.motion_prompt
    return tuple((label, str(text)) for label, text in found.items() if text)


def _contact(record: Record, fps: float) -> float | None:
    """Time of the contact that pushed the object, else of the first [s]."""
    search = record.run.state.contact
    if search is None or not search.contacts or not fps > 0:
        return None
    time = (search.push or search.contacts[0]).frame / fps
    return time if math.isfinite(time) and time >= 0 else None


def _numbers(report: Any) -> str:
    given = [f"{name.replace('_', ' ')} {number(value)}" for name, value in list(report.numbers.items())[:MOST]]
    return "; ".join([*given, *report.notes[:MOST]])


def _measured(row: dict[str, Any]) -> tuple[tuple[str, tuple[tuple[str, str, str], ...]], ...]:
    groups = []
    for group in GROUPS:
        values = [(m.heading, number(float(row[k])), m.definition) for k, m in METRICS.items() if m.group == group]
        if given := tuple(each for each in values if each[1]):
            groups.append((group, given))
    return tuple(groups)


def _facts(record: Record) -> tuple[tuple[str, str], ...]:
    facts, steps = record.run.provenance, {step.name for step in record.run.plan.steps}
    program = "analysis.ingest" if "ingest" in steps else "analysis.baseline" if "clip" in facts else "hoi.run"
    told = {
        "command": f"python -m {program} {facts.get('overrides', '')}".strip(),
        "commit": facts.get("git", ""),
        "config hash": facts.get("config_hash", ""),
        "seed": facts.get("seed", ""),
        "started": facts.get("started", ""),
        "device": record.run.result.get("device", "") or facts.get("device", ""),
        "threads": facts.get("threads", ""),
        "platform": facts.get("platform", ""),
        "versions": ", ".join(
            f"{name.removeprefix('version.')} {text}" for name, text in facts.items() if name.startswith("version.")
        ),
    }
    told |= {name: text for name, text in facts.items() if name.startswith("sha256.")}
    return tuple((name, text) for name, text in list(told.items())[:MOST] if text)


def _float(text: object) -> float:
    try:
        return float(text)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        return math.nan


def _told(error: Exception, path: Path) -> str:
    """One line, with the file as it is called below its folder."""
    text = " ".join(str(error).split()).replace(f"{path.parent.as_posix()}/", "")
    return text if isinstance(error, InputError | RunError) else f"{type(error).__name__}: {text}"
