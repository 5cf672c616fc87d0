"""The look that the charts of studies share."""

from collections.abc import Iterable, Mapping

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from hoi.compute import compiler

INK, MUTED, GRID = "#22262b", "#7a828c", "#e3e6ea"


def heading(figure: Figure, title: str, noted: Mapping[str, str], height: float) -> None:
    """Title and, under it, where it was measured, in a figure so high [inch]; `noted` as `analysis.sheets.facts`."""
    commit, _, dirty = noted["commit"].partition("+")
    threads = "1 thread" if noted["threads"] == "1" else f"{noted['threads']} threads"
    machine = f"{noted['machine']}; {threads}; {compiler()} {noted[compiler()]}; commit {commit[:14]} {dirty}"
    figure.text(0.01, 1 - 0.1 / height, title, fontsize=15, color=INK, va="top")
    figure.text(0.01, 1 - 0.45 / height, machine, fontsize=9, color=MUTED, va="top")


def legend(figure: Figure, kinds: Iterable[tuple[str, ...]], columns: int) -> None:
    """Below everything: each kind's colour, marker and name, and the line of the Pareto front."""
    handles = [Line2D([], [], color=c, marker=m, ls="", ms=8, label=text) for c, m, text, *_ in kinds]
    handles.append(Line2D([], [], color=INK, lw=1.2, label="Pareto front"))
    figure.legend(handles=handles, loc="lower center", ncols=columns, frameon=False, fontsize=9.5)


def log_log(ax: Axes, x: str, y: str) -> None:
    """Axes of error over time."""
    ax.set(xscale="log", yscale="log")
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(y, fontsize=9)
    ax.grid(True, which="major", color=GRID, lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(which="both", labelsize=8, colors=MUTED)
    ax.spines[["top", "right"]].set_visible(False)


def plain_numbers(axis: Axis, steps: bool = True) -> None:
    """On a logarithmic axis numbers as people write them; with `steps` at 1, 2, 5, 10 and so on."""
    if steps:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
