"""The page: one HTML file with everything inside. Whatever a record says is text in it, never markup."""

import base64
import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..metrics.cost import STAGES
from ..table import DONE, FAILED, UNREADABLE, summarise, variant_place
from ..writers import SPREAD, number
from ..writers import Shown as Table
from ..writers import shown as shown_tables
from .extras import Extra
from .media import data_uri
from .plots import variants_svg
from .shown import Part, Shown, colour_of, parts_of

HERE = Path(__file__).parent
LONGEST = 20_000
"""Characters of one text that are shown."""


@dataclass(frozen=True)
class Column:
    """A variant in the picture of all scenes."""

    experiment: str
    variant: str

    @property
    def label(self) -> str:
        return self.variant if self.experiment != "baseline" else f"{self.variant} (baseline)"


def build(
    runs: pd.DataFrame,
    shown: Sequence[Shown],
    extras: Sequence[Extra],
    opinions: pd.DataFrame | None = None,
    videos: bool = True,
    limit: int = 200_000_000,
) -> str:
    """The page's text; the same for the same records.

    Args:
        runs: as `analysis.table.collect` gives them. shown: the same, looked at. opinions: as `write_tables` has them.
        videos: whether they go in. limit: bytes of pictures and videos that may; what comes later is named and left
            out, videos first.
    """
    shown, over = _within(shown, extras, videos, limit)
    summary = summarise(runs)
    css, js = ((HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    counts = {DONE: 0, FAILED: 0, UNREADABLE: 0} | Counter(runs["status"].tolist())
    ordered = sorted(shown, key=_place)
    scenes = {scene: [run for run in ordered if run.row["scene"] == scene] for scene in _scenes(ordered)}
    return (
        _environment()
        .get_template("page.html")
        .render(
            css=Markup(css),
            js=Markup(js),
            policy=_policy(js),
            counts=counts,
            total=len(runs),
            scenes=scenes,
            seconds=_duration(sum(run.seconds for run in shown if math.isfinite(run.seconds))),
            commits=sorted({text for run in shown for name, text in run.facts if name == "commit"}),
            figure=Markup(variants_svg(runs)),  # matplotlib escapes the names in it
            tables=[_variant_first(table) for table in shown_tables(summary, (), opinions)],
            spread=SPREAD,
            times=_times(summary),
            stages=[*STAGES, "between"],
            colour_of=colour_of,
            matrix=_matrix(scenes),
            problems=[run for run in ordered if run.row["status"] != DONE or run.problem],
            warnings=sorted(set(runs["warning"].dropna())) if "warning" in runs else [],
            extras=extras,
            over=over,
            limit=limit // 10**6,
            videos=videos,
        )
        + "\n"
    )


def clean(value: object) -> object:
    """What is put into the page: markup of ours as it is; text without control characters, of bounded length."""
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    text = value if len(value) <= LONGEST else f"{value[:LONGEST]}…"
    return "".join(letter if letter.isprintable() or letter == "\n" else " " for letter in text)


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, finalize=clean, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {
        "uri": lambda content, kind: Markup(data_uri(kind, content)),
        "seconds": lambda value: f"{number(value)} s" if math.isfinite(value) else "",
        "percent": lambda value: f"{100 * value:.0f}%",
        "flex": lambda value: f"{max(value, 0.0):.4f}",
        "bytes": lambda content: f"{len(content) / 1e6:.2f} MB",
    }
    return environment


def _policy(js: str) -> Markup:
    """Nothing from elsewhere, no script but the page's own: what a record might smuggle in would not run."""
    digest = base64.b64encode(hashlib.sha256(f"\n{js}".encode()).digest()).decode()
    return Markup(
        f"default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'"
    )


def _within(
    shown: Sequence[Shown], extras: Sequence[Extra], videos: bool, limit: int
) -> tuple[list[Shown], dict[str, int]]:
    """The runs with as much of their films as goes in, and how many stills and videos did not."""
    left = limit - sum(len(picture) for extra in extras for _, picture in extra.pictures)
    kept, over = [], {"stills": 0, "videos": 0}
    for run in shown:
        if run.film is not None:
            size = sum(len(still.jpeg) for still in run.film.stills)
            if size > left:
                over["stills"] += 1
                run = replace(run, film=replace(run.film, stills=()))
            else:
                left -= size
        kept.append(run)
    for index, run in enumerate(kept):
        if run.film is not None and (not videos or len(run.film.mp4) > left):
            over["videos"] += videos
            kept[index] = replace(run, film=replace(run.film, mp4=b""))
        elif run.film is not None:
            left -= len(run.film.mp4)
    return kept, over


def _place(run: Shown) -> tuple:
    row = run.row
    seed = str(row["seed"])
    return (
        str(row["scene"]) == "",
        str(row["scene"]),
        *variant_place(str(row["experiment"]), str(row["variant"])),
        (int(seed), "") if seed.isascii() and seed.isdigit() and len(seed) < 20 else (0, seed),
        str(row["path"]),
    )


def _scenes(ordered: Sequence[Shown]) -> list[str]:
    return list(dict.fromkeys(run.row["scene"] for run in ordered))


def _matrix(scenes: dict[str, list[Shown]]) -> dict[str, Any]:
    """Scenes by variants: the runs of each cell, the one with a picture first."""
    cells: dict[tuple[str, Column], list[Shown]] = {}
    for scene, runs in scenes.items():
        for run in runs:
            if run.row["status"] != UNREADABLE:
                column = Column(str(run.row["experiment"]), str(run.row["variant"]))
                cells.setdefault((scene, column), []).append(run)
    for runs in cells.values():
        runs.sort(key=lambda run: not run.struck)
    columns = sorted({column for _, column in cells}, key=lambda c: variant_place(c.experiment, c.variant))
    return {"columns": columns, "rows": list(dict.fromkeys(scene for scene, _ in cells)), "cells": cells}


def _times(summary: pd.DataFrame) -> list[tuple[str, float, tuple[Part, ...]]]:
    """Mean seconds by stage of each variant. A stage that some runs lack counts as 0 in them."""
    rows = []
    for row in summary.to_dict("records"):
        if not row["n"] or math.isnan(row["seconds"]):
            continue
        keys = {stage: f"seconds_{stage.replace(' ', '_')}" for stage in STAGES}
        given = {stage: row[key] * row[f"{key}_n"] / row["n"] for stage, key in keys.items() if row[f"{key}_n"]}
        parts = parts_of([Part(stage, value, colour_of(stage)) for stage, value in given.items()], row["seconds"])
        name = row["variant"] if row["experiment"] in ("", "laptop") else f"{row['variant']} ({row['experiment']})"
        rows.append((str(name), float(row["seconds"]), parts))
    return rows


def _variant_first(table: Table) -> Table:
    """The column that stays in sight while the rest of the table is moved."""
    if "variant" not in table.head:
        return table
    at = table.head.index("variant")

    def turned(row: list[str]) -> list[str]:
        return [row[at], *row[:at], *row[at + 1 :]]

    return replace(table, head=turned(table.head), rows=[turned(row) for row in table.rows])


def _duration(seconds: float) -> str:
    minutes = seconds / 60
    return f"{seconds:.0f} s" if minutes < 2 else f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"
