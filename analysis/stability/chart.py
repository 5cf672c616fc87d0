"""The map: a panel a family, a tile a case, coloured by its verdict and by how much of the limits it took."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from .blows import Blow, shares_of
from .cases import Case
from .verdict import Verdict, shares

INK, MUTED, FAILED, REFUSED, STOPPED, NOT_RUN = "#22262b", "#7a828c", "#c81e3a", "#a9bdd6", "#8a7ca8", "#ffffff"
UNITS = (
    "E Pa, rho kg/m³, v and u (collider) m/s, w rad/s, L m, g m/s², m kg, tilt °, t s, gap cells, f friction, "
    "e restitution, dt in limits, kick in wave speeds"
)
MARGIN = LinearSegmentedColormap.from_list("margin", ["#1b7a4b", "#8fc98a", "#f2e394"])
"""Of what a case took of the limit it came closest to: none to all."""
COLUMNS = 5
TILE_WIDTH, TILE_HEIGHT, COLUMN_WIDTH, LABEL_WIDTH = 0.36, 0.19, 4.65, 1.95
"""[inch]"""
HEAD, FOOT, TOP, BOTTOM = 0.30, 0.26, 1.0, 0.15
"""Above a panel, below it, above and below all of them [inch]."""
MARKS = {"energy": "E", "momentum": "M", "angular momentum": "M", "cells deeper": "P", "refused": "R", "ran": "R"}
"""What a failed tile says, by a word of its reason; "!" for an error."""


def draw(results: Mapping[str, tuple[Case | Blow, Verdict]], path: Path) -> None:
    """Writes the map of the results by id as a PNG."""
    families: dict[str, list[tuple[Case | Blow, Verdict]]] = {}
    for case, verdict in results.values():
        families.setdefault(case.family, []).append((case, verdict))
    panels = [_Panel(family) for family in families.values()]
    heights = np.zeros(COLUMNS)
    places = []
    for panel in panels:
        column = int(heights.argmin())
        places.append((column, heights[column]))
        heights[column] += panel.height
    width, height = COLUMNS * COLUMN_WIDTH, TOP + heights.max() + BOTTOM
    figure = plt.figure(figsize=(width, height), facecolor="white")
    for panel, (column, above) in zip(panels, places, strict=True):
        panel.draw(figure.add_axes((
            (column * COLUMN_WIDTH + LABEL_WIDTH) / width,
            1 - (TOP + above + HEAD + len(panel.rows) * TILE_HEIGHT) / height,
            len(panel.columns) * TILE_WIDTH / width,
            len(panel.rows) * TILE_HEIGHT / height,
        )))  # fmt: skip
    _legend(figure, results, height)
    figure.savefig(path, dpi=110)
    plt.close(figure)


class _Panel:
    """One family: the last value of an id runs along x, the others along y."""

    def __init__(self, results: list[tuple[Case | Blow, Verdict]]) -> None:
        values = [case.id.split("/")[1:] for case, _ in results]
        self.title = results[0][0].family.replace("_", " ")
        flat = max(len(value) for value in values) == 1 and len(values) > 8
        self.places = [(value[-1], "") if flat else (" ".join(value[:-1]), value[-1]) for value in values]
        self.rows = list(dict.fromkeys(row for row, _ in self.places))
        self.columns = list(dict.fromkeys(column for _, column in self.places))
        self.turned = max(len(column) for column in self.columns) > 6
        self.results = results

    @property
    def height(self) -> float:
        return HEAD + len(self.rows) * TILE_HEIGHT + FOOT + (0.45 if self.turned else 0.0)

    def draw(self, axes: Axes) -> None:
        for (row, column), (case, verdict) in zip(self.places, self.results, strict=True):
            _tile(axes, self.columns.index(column), self.rows.index(row), case, verdict)
        axes.set_xlim(0, len(self.columns))
        axes.set_ylim(len(self.rows), 0)
        axes.set_xticks(np.arange(len(self.columns)) + 0.5, self.columns, fontsize=7, color=INK)
        if self.turned:
            plt.setp(axes.get_xticklabels(), rotation=35, ha="right", rotation_mode="anchor")
        axes.set_yticks(np.arange(len(self.rows)) + 0.5, self.rows, fontsize=7, color=INK)
        axes.tick_params(length=0, pad=2)
        axes.spines[:].set_visible(False)
        axes.set_title(self.title, fontsize=9, fontweight="bold", color=INK, loc="left", pad=4)


def _tile(axes: Axes, x: int, y: int, case: Case | Blow, verdict: Verdict) -> None:
    taken = shares_of(verdict) if isinstance(case, Blow) else shares(case, verdict)
    held = MARGIN(min(max(taken, default=0.0), 1.0))
    colours = {"failed": FAILED, "refused": REFUSED, "stopped": STOPPED, "not run": NOT_RUN}
    edge, width = (MUTED, 0.4) if verdict.verdict == "not run" else ("white", 1.2)
    axes.add_patch(
        Rectangle((x, y), 1, 1, facecolor=colours.get(verdict.verdict, held), edgecolor=edge, linewidth=width)
    )
    if verdict.verdict == "failed":
        mark = next((mark for word, mark in MARKS.items() if word in verdict.reason[:30]), "!")
        axes.text(x + 0.5, y + 0.53, mark, color="white", fontsize=7, fontweight="bold", ha="center", va="center")


def _legend(figure: Figure, results: Mapping[str, tuple[Case | Blow, Verdict]], height: float) -> None:
    counts = Counter(verdict.verdict for _, verdict in results.values())
    title = "Extreme cases of object and person"
    figure.text(0.01, 1 - 0.22 / height, title, fontsize=15, fontweight="bold", color=INK, va="center")
    text = ", ".join(
        f"{counts[name]} {name}" for name in ("held", "refused", "stopped", "failed", "not run") if name in counts
    )
    figure.text(0.01, 1 - 0.52 / height, f"{len(results)} cases: {text}", fontsize=10, color=INK, va="center")
    figure.text(0.01, 1 - 0.75 / height, UNITS, fontsize=8, color=MUTED, va="center")
    patches = [
        Patch(color=MARGIN(0.0), label="held, far from every limit"),
        Patch(color=MARGIN(0.5), label="half of a limit taken"),
        Patch(color=MARGIN(1.0), label="just held"),
        Patch(color=REFUSED, label="refused, as it must be"),
        Patch(
            color=STOPPED,
            label="stopped in one line, as it may: crushed flat, its step too long, the person thrown about",
        ),
        Patch(color=FAILED, label="failed: E energy, M momentum, P penetration, R refusal, ! error"),
        Patch(facecolor=NOT_RUN, edgecolor=MUTED, label="not run"),
    ]
    figure.legend(handles=patches, loc="upper left", bbox_to_anchor=(0.3, 1 - 0.12 / height), ncols=4, frameon=False,
                  fontsize=9, handlelength=1.2)  # fmt: skip
