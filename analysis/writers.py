"""Tables as files: CSV for machines; Markdown, LaTeX and HTML for people, by topic, with pandas and its Styler."""

import html
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from .learned.sidecar import SCORES
from .metrics import GROUPS, METRICS
from .reported import QUESTIONS, reported

UNREADABLE = "(unreadable)"
SPREAD = (
    "One row a variant: mean ± sample standard deviation over its finished runs, scenes and seeds alike; in brackets "
    "the number of runs that have a value, where that is not all n of them. An empty cell: no run of the variant "
    "defines it. ↓ lower is better, ↑ higher is better."
)
REPORTED = (
    "Reported by the paper, not measured here: its own scenes, weights, videos and 23 raters; time on one H200. Its "
    "two tables had different raters' means for the full method; both are given."
)
NO_SCORES = "empty: no record has scores; `python -m analysis.learned DIR --viclip FILE --vqa FOLDER` adds them"
NO_OPINIONS = "empty: no opinion scores were given; `--mos study.csv` adds those of `python -m analysis.study score`"
NOWHERE = "empty: no run here defines it"
MARKS = "abcdefghijklmnopqrstuvwxyz"


@dataclass(frozen=True)
class Shown:
    """One table as people see it: plain text, to be escaped by whoever writes it."""

    title: str
    head: list[str]
    rows: list[list[str]]
    notes: list[str] = field(default_factory=list)


def write_tables(
    folder: Path,
    runs: pd.DataFrame,
    summary: pd.DataFrame,
    by: Sequence[str] = (),
    opinions: pd.DataFrame | None = None,
) -> list[Path]:
    """`runs.csv`, `table.csv`, `table.md`, `table.tex` and `table.html`; older ones are replaced.

    Args:
        runs, summary: of `analysis.table`. by: the columns that rows are apart by beside the variant.
        opinions: experiment, variant and q1 to q4; None where there are none.
    """
    tables = shown(summary, by, opinions)
    facts = runs.to_dict("records")
    problems = [f"{plain(row['path'])} failed: {plain(row['reason'])}" for row in facts if row["status"] == "failed"]
    problems += [plain(row["reason"]) for row in facts if row["status"] == "unreadable"]
    texts = {
        "runs.csv": to_csv(runs),
        "table.csv": to_csv(summary.assign(variant=summary["variant"].replace("", UNREADABLE))),
        "table.md": _markdown(tables, problems),
        "table.tex": _latex(tables),
        "table.html": _html(tables, problems),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        part = folder / f"{name}.part"
        part.write_text(text, encoding="utf-8", newline="\n")
        os.replace(part, folder / name)
    return [folder / name for name in texts]


def shown(summary: pd.DataFrame, by: Sequence[str], opinions: pd.DataFrame | None) -> list[Shown]:
    """The tables by topic, then the scores, then what the paper reports of the same."""
    own = summary.loc[summary["variant"] != ""]
    keys = [*by, *(["experiment"] if len(set(own["experiment"])) > 1 else []), "variant"]
    first = [[*(plain(row[key]) for key in keys), str(row["n"]), str(row["failed"])] for row in own.to_dict("records")]
    head, tables = [*keys, "n", "failed"], []
    for group in GROUPS:
        numbers = {key: metric.heading for key, metric in METRICS.items() if metric.group == group}
        tables.append(_measured(group, own, numbers, head, first, dict.fromkeys(numbers, NOWHERE)))
    scores = {key: f"{score.title.removesuffix(' [-]')} ↑" for key, score in SCORES.items()}
    questions = {key: f"{title} ↑" for key, title in QUESTIONS.items()}
    rated = own if opinions is None else own.merge(opinions, on=["experiment", "variant"], how="left")
    rated = rated.assign(**{key: math.nan for key in questions if key not in rated})
    why = dict.fromkeys(scores, NO_SCORES) | dict.fromkeys(questions, NO_OPINIONS)
    tables.append(_measured("Scores of the videos", rated, scores | questions, head, first, why))
    columns = {key: (scores | questions)[key] for key in ("vqa_yes", "viclip", *questions)} | {"seconds": "run [s] ↓"}
    rows = [
        [f"{row['method']} (reported)", row["table"], *(number(row[key]) for key in columns)]
        for row in reported().to_dict("records")
    ]
    tables.append(Shown("Reported by the paper", ["method", "its table", *columns.values()], rows, [REPORTED]))
    return tables


def _measured(
    title: str,
    rows: pd.DataFrame,
    numbers: dict[str, str],
    head: list[str],
    first: list[list[str]],
    why: dict[str, str],
) -> Shown:
    """A table of means; a column without any value gets a footnote that says why."""
    notes: dict[str, str] = {}
    headings = []
    for key, heading in numbers.items():
        if not all(math.isnan(value) for value in rows[key]):
            headings.append(heading)
        else:
            mark = notes.setdefault(why[key], MARKS[len(notes)])
            headings.append(f"{heading} [{mark}]")
    body = [
        [*start, *(_cell(row, key) for key in numbers)]
        for start, row in zip(first, rows.to_dict("records"), strict=True)
    ]
    return Shown(title, [*head, *headings], body, [f"[{mark}] {note}." for note, mark in notes.items()])


def _cell(row: dict, key: str) -> str:
    """Mean ± spread (count)."""
    mean, spread, count = row[key], row.get(f"{key}_sd", math.nan), row.get(f"{key}_n")
    if math.isnan(mean):
        return ""
    text = number(mean) if math.isnan(spread) else f"{number(mean)} ± {number(spread, 2)}"
    return text if count in (None, row["n"]) else f"{text} ({count})"


def number(value: float, digits: int = 3) -> str:
    """Three significant digits; empty for NaN; what is 100 or more as a whole number."""
    if math.isnan(value):
        return ""
    return f"{value:.0f}" if 100 <= abs(value) < 1e7 else f"{value:.{digits}g}"


def plain(text: object) -> str:
    """One short line without control characters, of what a record says."""
    line = " ".join("".join(letter if letter.isprintable() else " " for letter in str(text)).split())
    return line if len(line) <= 200 else f"{line[:199]}…"


def to_csv(table: pd.DataFrame) -> str:
    """Six digits; no text that a spreadsheet would run."""
    texts = [name for name in table if not pd.api.types.is_numeric_dtype(table[name])]
    safe = table.assign(**{name: table[name].map(_no_formula, na_action="ignore") for name in texts})
    return safe.to_csv(index=False, float_format="%.6g", lineterminator="\n")


def _no_formula(text: object) -> object:
    return f"'{text}" if isinstance(text, str) and text.startswith(("=", "+", "-", "@", "\t", "\r", "\n")) else text


def _markdown(tables: list[Shown], problems: list[str]) -> str:
    parts = ["# The runs, in tables", SPREAD]
    for table in tables:
        lines = markdown_table(*([as_markdown(cell) for cell in cells] for cells in (table.head, *table.rows)))
        parts += [f"## {table.title}", lines, *table.notes]
    if problems:
        parts += ["## Failed and unreadable", "\n".join(f"- {as_markdown(problem)}" for problem in problems)]
    return "\n\n".join(parts) + "\n"


def as_text(tables: list[Shown]) -> str:
    """The tables for a terminal: a number a line and a variant a column, or the other way round where that is shorter.

    What no run defines is left out.
    """
    return "\n\n".join(f"{table.title}\n{_columns(table)}" for table in tables if table.rows)


def _columns(table: Shown) -> str:
    rows = [table.head, *table.rows]
    known = [number for number in range(len(table.head)) if any(row[number] for row in table.rows)]
    rows = [[row[number] for number in known] for row in rows]
    if len(rows) <= len(known):
        rows = [list(column) for column in zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def markdown_table(head: Sequence[str], *rows: Sequence[str]) -> str:
    """Lines of cells that are escaped already."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))


def as_markdown(text: str, marks: str = "\\`*_[]|") -> str:
    return "".join(f"\\{letter}" if letter in marks else letter for letter in html.escape(text, quote=False))


def _frame(table: Shown, escape: Callable[[str], str]) -> pd.DataFrame:
    return pd.DataFrame([[escape(c) for c in row] for row in table.rows], columns=[escape(c) for c in table.head])


def _latex(tables: list[Shown]) -> str:
    parts = ["% \\usepackage{booktabs}", f"% {_tex(SPREAD)}"]
    for table in tables:
        style = _frame(table, _tex).style.hide(axis="index")
        label = f"tab:{''.join(c if c.isalnum() else '-' for c in table.title.lower())}"
        caption = " ".join([f"{_tex(table.title)}.", *map(_tex, table.notes)])
        words = sum(name in ("scene", "seed", "experiment", "variant", "method", "its table") for name in table.head)
        layout = "l" * words + "r" * (len(table.head) - words)
        parts.append(
            style.to_latex(
                hrules=True, caption=caption, label=label, position="htbp", position_float="centering",
                column_format=layout,
            )
        )  # fmt: skip
    return "\n".join(parts)


_TEX = str.maketrans({
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "±": r"$\pm$", "↓": r"$\downarrow$", "↑": r"$\uparrow$",
    "|": r"\textbar{}", "<": r"\textless{}", ">": r"\textgreater{}", "…": r"\ldots{}",
})  # fmt: skip


def _tex(text: str) -> str:
    return text.translate(_TEX)


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>The runs, in tables</title><style>
body {{ font: 14px/1.5 system-ui, sans-serif; margin: 2em; color: #22262b }}
table {{ border-collapse: collapse; margin: 1em 0 }} th, td {{ padding: .25em .7em; text-align: left }}
thead th {{ border-top: 2px solid; border-bottom: 1px solid }} tbody tr:last-child td {{ border-bottom: 2px solid }}
</style></head><body>
{body}
</body></html>
"""


def _html(tables: list[Shown], problems: list[str]) -> str:
    parts = ["<h1>The runs, in tables</h1>", f"<p>{_ht(SPREAD)}</p>"]
    for index, table in enumerate(tables):
        # A uuid of its own would be another at every call.
        style = _frame(table, _ht).style.hide(axis="index").set_uuid(f"t{index}")
        parts += [
            f"<h2>{_ht(table.title)}</h2>",
            style.to_html().strip(),
            *(f"<p>{_ht(note)}</p>" for note in table.notes),
        ]
    if problems:
        items = "".join(f"<li>{_ht(problem)}</li>" for problem in problems)
        parts += ["<h2>Failed and unreadable</h2>", f"<ul>{items}</ul>"]
    return _PAGE.format(body="\n".join(parts))


def _ht(text: str) -> str:
    return html.escape(text, quote=False).replace('"', "&quot;")
