"""What a study leaves behind: precision.csv, precision.md and precision.png."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from .. import charts, sheets
from ..charts import INK
from .convergence import Order
from .problems import Problem
from .run import STAND_INS

TITLE = "Error against run time of the object's physics"
KINDS = {
    "base": ("#22262b", "o", "base: middle grid, quadratic"),
    "dt": ("#2b6cb0", "s", "time step"),
    "grid": ("#c2571a", "D", "grid"),
    "spline": ("#2f855a", "^", "cubic spline"),
    "precision": ("#805ad5", "P", "other float"),
    "material": ("#b7791f", "X", "other material model"),
    "phases": ("#d61f3c", "*", "phases"),
    "constant velocity": ("#97a0ab", "<", "constant velocity"),
    "ballistic rigid body": ("#4a5560", ">", "ballistic rigid body"),
}
"""Kind of variant -> colour, marker, what the legend calls it."""
EXACT = 1e-11
"""Errors below this are called exact, and drawn at the lower edge where they would crush the others together."""
FIRST = ["problem", "kind", "variant", "cells", "fraction", "spline", "precision", "model", "particles", "steps",
         "seconds", "repeats", "headline", "error", "front", "com", "orientation", "shape", "position"]  # fmt: skip
"""Columns of the CSV, in this order; the further numbers of the problems follow."""


def write(
    folder: Path, problems: Sequence[Problem], table: pd.DataFrame, orders: Sequence[Order], noted: dict[str, str]
) -> list[Path]:
    """The three files, as `analysis.sheets.write`."""
    ordered = table.reindex(columns=[*FIRST, *table.columns.difference(FIRST, sort=False)])
    text = markdown(problems, table, orders, noted)
    return sheets.write(folder, "precision", ordered, noted, text, lambda path: draw(problems, table, noted, path))


# --- words -----------------------------------------------------------------------------------------------------------


def markdown(problems: Sequence[Problem], table: pd.DataFrame, orders: Sequence[Order], noted: dict[str, str]) -> str:
    """The report as text."""
    parts = [f"# {TITLE}", sheets.markdown_list(noted), "## Observed orders", _orders(orders)]
    for problem in problems:
        rows = pd.DataFrame(table[table["problem"] == problem.name])
        parts.append(f"## {problem.name}: {problem.title}")
        if problem.notes:
            parts.append(sheets.markdown_list({name: f"{value:.4g}" for name, value in problem.notes.items()}))
        parts.append(_rows(rows.sort_values("seconds"), problem))
    return sheets.markdown(parts)


def _rows(rows: pd.DataFrame, problem: Problem) -> str:
    known = set(rows.columns[rows.notna().any()])
    further = [c for c in rows if c in known - {*FIRST, "failed", problem.headline}]
    numbers = [*(name for name in problem.known if name in known), *further]
    if problem.headline not in problem.known:
        numbers.insert(0, problem.headline)
    lines = []
    for row in rows.to_dict("records"):
        seconds = f"{row['seconds']:.3g}" if np.isfinite(row["seconds"]) else "failed"
        line = {"variant": row["variant"], "cells": row["cells"], "s": seconds}
        line |= {_unit(name): f"{row[name]:.2e}" if np.isfinite(row[name]) else "" for name in numbers}
        lines.append(line | {"front": "*" if row["front"] else ""})
    return sheets.markdown_table(lines)


def _orders(orders: Sequence[Order]) -> str:
    lines = [
        {
            "series": o.series,
            "error of": o.quantity,
            "cells": " ".join(map(str, o.cells)),
            "errors": " ".join(f"{error:.2e}" for error in o.errors),
            "order": f"{o.observed:.2f}",
            "theory": "" if o.expected is None else f"{o.expected:g}",
            "": o.verdict,
        }
        for o in orders
    ]
    return sheets.markdown_table(lines, ["series", "error of", "cells", "errors", "order", "theory", ""])


def _unit(name: str) -> str:
    return f"{name} [rad]" if name == "orientation" else name


# --- picture ---------------------------------------------------------------------------------------------------------


def draw(problems: Sequence[Problem], table: pd.DataFrame, noted: dict[str, str], path: Path) -> None:
    """Error over seconds, a panel a problem, with the Pareto front as a step line and its members named."""
    columns = min(4, len(problems))
    rows = -(-len(problems) // columns)
    height = 3.7 * rows + 1.5
    figure, axes = plt.subplots(rows, columns, figsize=(max(4.8 * columns, 10), height), squeeze=False, dpi=130)
    for ax in axes.flat[len(problems) :]:
        ax.axis("off")
    for problem, ax in zip(problems, axes.flat, strict=False):
        _panel(ax, problem, pd.DataFrame(table[table["problem"] == problem.name]))
    charts.legend(figure, KINDS.values(), columns=5)
    charts.heading(figure, TITLE, noted, height)
    figure.tight_layout(rect=(0, 0.65 / height, 1, 1 - 0.6 / height), h_pad=2.0)
    figure.savefig(path)
    plt.close(figure)


def _panel(ax: Axes, problem: Problem, rows: pd.DataFrame) -> None:
    """One problem. The stand-ins take no time to speak of: they stand at the left edge, whatever they take."""
    rows = pd.DataFrame(rows[np.isfinite(rows["error"])])
    stands_in = rows["kind"].isin(list(STAND_INS))
    fastest = rows.loc[~stands_in, "seconds"].min()
    floor = rows.loc[rows["error"] > EXACT, "error"].min() / 10
    rows = rows.assign(
        x=rows["seconds"].where(~stands_in, fastest / 3), y=rows["error"].clip(lower=floor), edge=stands_in
    )
    front = pd.DataFrame(rows[rows["front"]]).sort_values("seconds")
    ax.step(front["x"], front["y"], where="post", color=INK, lw=1.2, zorder=1)
    for kind, (colour, marker, _) in KINDS.items():
        chosen = rows[rows["kind"] == kind]
        edges = [INK if on_front else "white" for on_front in chosen["front"]]
        size = 150 if marker == "*" else 60
        ax.scatter(chosen["x"], chosen["y"], s=size, c=colour, marker=marker, edgecolors=edges, linewidths=1.0,
                   zorder=4 if kind in ("base", "phases") else 3, clip_on=False)  # fmt: skip
    ax.set_title(f"{problem.name}: {problem.title}", fontsize=11, color=INK, loc="left")
    unit = " [rad]" if problem.headline == "orientation" else ""
    charts.log_log(ax, "seconds", f"{problem.headline} error{unit}")
    ax.margins(y=0.15)
    ax.set_xlim(fastest / 3, 1.5 * float(rows["x"].to_numpy().max()))
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        if high < 200 * low:
            charts.plain_numbers(axis)
        axis.set_minor_formatter(NullFormatter())
    _name(ax, pd.DataFrame(rows[rows["edge"] | rows["front"] | (rows["error"] < EXACT)]).sort_values("seconds"))


def _name(ax: Axes, rows: pd.DataFrame) -> None:
    """Names beside points: the stand-ins' with what they take, the front's below it, where nothing is."""
    point = ax.figure.dpi / 72
    lowest = above = np.inf
    for row in rows.to_dict("records"):
        at = ax.transData.transform((row["x"], row["y"]))[1] / point
        text = row["variant"]
        if row["edge"]:
            taken = 1000 * row["seconds"]
            text += f", {taken:.0f} ms" if taken >= 1 else f", {taken:.1g} ms"
            place, align = (9, -9 if abs(at - above) < 16 else 5), "left"
            above = at
        else:
            lowest = min(at - 9, lowest - 8)
            place, align = (-7, lowest - at), "right"
        text += ", exact" if row["error"] < EXACT else ""
        ax.annotate(text, (row["x"], row["y"]), xytext=place, color=INK, fontsize=7.5, zorder=5,
                    textcoords="offset points", ha=align, va="center")  # fmt: skip
