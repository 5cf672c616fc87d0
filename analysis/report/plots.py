"""The variants side by side, number by number: a dot a run, a bar at their mean."""

import io
import math
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator

from ..metrics import METRICS
from ..table import DONE, variant_place
from ..writers import plain

NUMBERS = ("contact_expected", "causality", "depth", "ballistic", "deformation", "naturalness", "alignment", "seconds")
"""What tells the variants apart."""
COLUMNS = 4
MOST = 24
"""Variants in the figure."""
INK, MUTED = "#010203", "#040506"
"""Stand for the page's own colours, which change with light and dark."""
DOT, MEAN = "#3b82c4", "#d9622b"
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "hoi", "text.parse_math": False, "font.family": "sans-serif",
    "font.size": 9, "text.color": INK, "axes.labelcolor": MUTED, "axes.edgecolor": MUTED, "xtick.color": MUTED,
    "ytick.color": INK,
}  # fmt: skip


def variants_svg(runs: pd.DataFrame) -> str:
    """An SVG to stand in a page, in its colours; empty where no run is done.

    Args:
        runs: as `analysis.table.collect` gives them.
    """
    done = runs.loc[runs["status"] == DONE]
    groups = sorted(done.groupby(["experiment", "variant"]), key=lambda item: variant_place(*map(str, item[0])))[:MOST]
    shown = [key for key in NUMBERS if done[key].notna().any()]
    if not groups or not shown:
        return ""
    several = len({experiment for (experiment, _), _ in groups}) > 1
    names = [f"{plain(e)}: {plain(v)}"[:40] if several else plain(v)[:32] for (e, v), _ in groups]
    rows = math.ceil(len(shown) / COLUMNS)
    with matplotlib.rc_context(STYLE):
        figure = Figure(
            figsize=(12, rows * (0.8 + 0.24 * len(groups))), layout=ConstrainedLayoutEngine(h_pad=0.12, w_pad=0.1)
        )
        FigureCanvasSVG(figure)
        axes = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False)
        for place, each in enumerate(axes.flat):
            if place >= len(shown):
                each.set_axis_off()
                continue
            _panel(each, shown[place], [group for _, group in groups])
        axes[0, 0].set_yticks(range(len(groups)), names)
        axes[0, 0].set_ylim(len(groups) - 0.5, -0.5)
        file = io.StringIO()
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    for colour, own in ((INK, "currentColor"), (MUTED, "var(--muted)")):
        text = text.replace(colour, own)
    return text[text.index("<svg") :]


def _panel(axes, key: str, groups: list[pd.DataFrame]) -> None:
    for row, group in enumerate(groups):
        values = group[key].dropna().to_numpy(float)
        values = values[np.isfinite(values)]
        # A fixed spread keeps dots of the same value apart, and the same records the same bytes.
        offsets = 0.22 * (((np.arange(len(values)) * 0.618) % 1) - 0.5) * 2
        axes.plot(values, row + offsets, ".", color=DOT, markersize=7, alpha=0.6, markeredgewidth=0)
        if len(values):
            axes.plot([values.mean()] * 2, [row - 0.34, row + 0.34], color=MEAN, linewidth=2.2, solid_capstyle="round")
    axes.set_title(METRICS[key].heading, fontsize=9.5, loc="left")
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=MUTED, alpha=0.2, linewidth=0.6)
    low, high = axes.dataLim.intervalx
    low, high = (min(low, 0.0), max(high, 0.0)) if math.isfinite(low + high) else (0.0, 0.0)
    axes.set_xlim(low - 0.04 * (high - low), high + 0.06 * (high - low) or 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(4))
