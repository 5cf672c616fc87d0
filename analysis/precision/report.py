"""What a study leaves behind: precision.csv, precision.md and precision.png."""

import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from analysis.precision.convergence import Order
from analysis.precision.problems import Problem
from analysis.precision.run import STAND_INS
from hoi.compute import compiler
from hoi.runner.provenance import git_state

INK, MUTED, GRID = "#22262b", "#7a828c", "#e3e6ea"
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


def facts(threads: int) -> dict[str, str]:
    """Where and with what the times were measured."""
    return {
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()}",
        "threads": str(threads),
        "python": platform.python_version(),
        **{name: version(name) for name in ("hoi", compiler(), "numpy")},
        "commit": git_state() or "not a checkout",
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def write(
    folder: Path, problems: Sequence[Problem], table: pd.DataFrame, orders: Sequence[Order], noted: dict[str, str]
) -> list[Path]:
    """The three files, in `folder`, which is made when it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"precision.{ending}" for ending in ("csv", "md", "png")]
    rest = [column for column in table if column not in FIRST]
    table[FIRST + rest].assign(**noted).to_csv(paths[0], index=False)
    paths[1].write_text(markdown(problems, table, orders, noted), encoding="utf-8")
    draw(problems, table, noted, paths[2])
    return paths


# --- words -----------------------------------------------------------------------------------------------------------


def markdown(problems: Sequence[Problem], table: pd.DataFrame, orders: Sequence[Order], noted: dict[str, str]) -> str:
    """The report as text."""
    parts = [
        "# Error against run time of the object's physics",
        markdown_list(noted),
        "## Observed orders",
        _orders(orders),
    ]
    for problem in problems:
        rows = pd.DataFrame(table[table["problem"] == problem.name])
        parts.append(f"## {problem.name}: {problem.title}")
        if problem.notes:
            parts.append(markdown_list({name: f"{value:.4g}" for name, value in problem.notes.items()}))
        parts.append(_rows(rows.sort_values("seconds"), problem))
    return "\n\n".join(parts) + "\n"


def _rows(rows: pd.DataFrame, problem: Problem) -> str:
    known = set(rows.columns[rows.notna().any()])
    further = [c for c in rows if c in known - {*FIRST, "failed", problem.headline}]
    numbers = [*(name for name in problem.known if name in known), *further]
    if problem.headline not in problem.known:
        numbers.insert(0, problem.headline)
    lines = [["variant", "cells", "s", *(_unit(name) for name in numbers), "front"]]
    for row in rows.to_dict("records"):
        values = [f"{row[name]:.2e}" if np.isfinite(row[name]) else "" for name in numbers]
        seconds = f"{row['seconds']:.3g}" if np.isfinite(row["seconds"]) else "failed"
        lines.append([row["variant"], str(row["cells"]), seconds, *values, "*" if row["front"] else ""])
    return markdown_table(lines)


def _orders(orders: Sequence[Order]) -> str:
    lines = [["series", "error of", "cells", "errors", "order", "theory", ""]]
    for o in orders:
        errors = " ".join(f"{error:.2e}" for error in o.errors)
        theory = "" if o.expected is None else f"{o.expected:g}"
        lines.append(
            [o.series, o.quantity, " ".join(map(str, o.cells)), errors, f"{o.observed:.2f}", theory, o.verdict]
        )
    return markdown_table(lines)


def _unit(name: str) -> str:
    return f"{name} [rad]" if name == "orientation" else name


def markdown_table(lines: list[list[str]]) -> str:
    """A Markdown table of these cells, its columns aligned."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    text = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + " |" for line in lines]
    return "\n".join([text[0], "|" + "|".join("-" * (w + 2) for w in widths) + "|", *text[1:]])


def markdown_list(values: dict[str, str]) -> str:
    return "\n".join(f"- {name}: {value}" for name, value in values.items())


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
    handles = [Line2D([], [], color=c, marker=m, ls="", ms=8, label=text) for c, m, text in KINDS.values()]
    handles.append(Line2D([], [], color=INK, lw=1.2, label="Pareto front"))
    figure.legend(handles=handles, loc="lower center", ncols=5, frameon=False, fontsize=9.5)
    title = "Error against run time of the object's physics"
    figure.text(0.01, 1 - 0.1 / height, title, fontsize=15, color=INK, va="top")
    commit, _, dirty = noted["commit"].partition("+")
    threads = "1 thread" if noted["threads"] == "1" else f"{noted['threads']} threads"
    under = f"{noted['machine']}; {threads}; {compiler()} {noted[compiler()]}; commit {commit[:14]} {dirty}"
    figure.text(0.01, 1 - 0.45 / height, under, fontsize=9, color=MUTED, va="top")
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
    _style(ax, problem)
    ax.set_xlim(fastest / 3, 1.5 * float(rows["x"].to_numpy().max()))
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        axis.set_minor_formatter(NullFormatter())
        if high < 200 * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _name(ax, pd.DataFrame(rows[rows["edge"] | rows["front"] | (rows["error"] < EXACT)]).sort_values("seconds"))


def _style(ax: Axes, problem: Problem) -> None:
    ax.set(xscale="log", yscale="log")
    ax.margins(y=0.15)
    ax.set_title(f"{problem.name}: {problem.title}", fontsize=11, color=INK, loc="left")
    ax.set_ylabel(f"{problem.headline} error" + (" [rad]" if problem.headline == "orientation" else ""), fontsize=9)
    ax.set_xlabel("seconds", fontsize=9)
    ax.grid(True, which="major", color=GRID, lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(which="both", labelsize=8, colors=MUTED)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


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
