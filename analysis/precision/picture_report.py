"""What a study of the renderer leaves behind: rendering.csv, rendering.md and rendering.png."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from analysis.precision.pictures import COVERED, REFERENCE_SHARE, View
from analysis.precision.report import GRID, INK, MUTED, markdown_list, markdown_table
from hoi.compute import compiler
from hoi.render.splats import Picture

KINDS = {
    "harmonics": ("#2f855a", "^", "SH degree", "right"),
    "alpha": ("#2b6cb0", "s", "least alpha", "left"),
    "transmittance": ("#c2571a", "D", "least T", "above right"),
    "number": ("#805ad5", "P", "float64, exact exponential", "above"),
    "tile": ("#b7791f", "X", "pixels across a tile", "below"),
    "all": ("#d61f3c", "*", "several at once", "right"),
    "base": ("#22262b", "o", "base: 3DGS's cut-offs, float32", "left"),
}
"""Kind of variant -> colour, marker, what the legend calls it, where a point has its name."""
PLACES = {
    "left": (-6, 0, "right", "center"),
    "right": (6, 0, "left", "center"),
    "above": (0, 6, "center", "bottom"),
    "above right": (4, 3, "left", "bottom"),
    "below": (0, -7, "center", "top"),
}
"""Offset from the point [pt], horizontal and vertical alignment."""
AGREES = 1e-9
"""Difference of a colour up to which the float64 picture is the brute force one: round-off."""
HALO = withStroke(linewidth=1.5, foreground="white")
STEP = 1 / 255
"""Of colours in a file."""
TITLE = "Error against run time of the renderer"


def write(
    folder: Path,
    views: Sequence[View],
    table: pd.DataFrame,
    disagreement: Mapping[str, float],
    truths: Mapping[str, Picture],
    noted: dict[str, str],
) -> list[Path]:
    """The three files, in `folder`, which is made when it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"rendering.{ending}" for ending in ("csv", "md", "png")]
    table.assign(disagreement=[disagreement[name] for name in table["scene"]], **noted).to_csv(paths[0], index=False)
    paths[1].write_text(markdown(views, table, disagreement, noted), encoding="utf-8")
    draw(views, table, truths, noted, paths[2])
    return paths


def verdict(disagreement: float) -> str:
    """Whether float64 and brute force make the same picture."""
    return "as expected" if disagreement < AGREES else "NOT as expected"


# --- words -----------------------------------------------------------------------------------------------------------


def markdown(
    views: Sequence[View], table: pd.DataFrame, disagreement: Mapping[str, float], noted: dict[str, str]
) -> str:
    """The report as text."""
    parts = [f"# {TITLE}", markdown_list(noted)]
    parts.append(
        "Truth: float64, exact exponential, nothing left out. RMS and PSNR are over the pixels of which Gaussians "
        f"cover {COVERED:.0%} or more, the largest error is of all; colours go from 0 to 1."
    )
    for view in views:
        rows = pd.DataFrame(table[table["scene"] == view.name])
        camera, off = view.camera, disagreement[view.name]
        parts.append(f"## {view.name}: {view.title}")
        parts.append(
            markdown_list(
                {
                    "Gaussians": f"{len(view.splats)}",
                    "picture": f"{camera.width} x {camera.height}",
                    f"float64 against brute force, picture 1/{REFERENCE_SHARE} as wide": f"{off:.1e}, {verdict(off)}",
                }
            )
        )
        parts.append(_rows(rows))
    return "\n\n".join(parts) + "\n"


def _rows(rows: pd.DataFrame) -> str:
    lines = [["variant", "ms", "least to most", "RMS", "PSNR [dB]", "largest", "front"]]
    for row in rows.to_dict("records"):
        median, least, most = (1e3 * row[name] for name in ("seconds", "fastest", "slowest"))
        errors = [f"{row['error']:.2e}", f"{row['psnr']:.1f}", f"{row['largest']:.2e}"]
        mark = "*" if row["front"] else ""
        lines.append([row["variant"], f"{median:.1f}", f"{least:.1f} to {most:.1f}", *errors, mark])
    return markdown_table(lines)


# --- picture ---------------------------------------------------------------------------------------------------------


def draw(
    views: Sequence[View], table: pd.DataFrame, truths: Mapping[str, Picture], noted: dict[str, str], path: Path
) -> None:
    """A row a view: what it looks like, RMS error and largest error over milliseconds."""
    height = 4.6 * len(views) + 1.2
    figure, axes = plt.subplots(
        len(views), 3, figsize=(16, height), squeeze=False, dpi=130, width_ratios=[1.0, 1.8, 1.8]
    )
    for view, (shown, middle, worst) in zip(views, axes, strict=True):
        rows = pd.DataFrame(table[table["scene"] == view.name])
        _show(shown, view, truths[view.name])
        _panel(middle, rows, "error", "RMS error")
        _decibels(middle)
        _panel(worst, rows, "largest", "largest error")
        worst.axhline(STEP, color=MUTED, lw=0.8, ls=":")
        worst.annotate("1/255", (1, STEP), xycoords=("axes fraction", "data"), xytext=(-2, 2), fontsize=7.5,
                       textcoords="offset points", color=MUTED, ha="right")  # fmt: skip
    handles = [Line2D([], [], color=c, marker=m, ls="", ms=8, label=text) for c, m, text, _ in KINDS.values()]
    handles.append(Line2D([], [], color=INK, lw=1.2, label="Pareto front"))
    figure.legend(handles=handles, loc="lower center", ncols=8, frameon=False, fontsize=9.5)
    figure.text(0.01, 1 - 0.1 / height, TITLE, fontsize=15, color=INK, va="top")
    commit, _, dirty = noted["commit"].partition("+")
    threads = "1 thread" if noted["threads"] == "1" else f"{noted['threads']} threads"
    machine = f"{noted['machine']}; {threads}; {compiler()} {noted[compiler()]}; commit {commit[:14]} {dirty}"
    figure.text(0.01, 1 - 0.45 / height, machine, fontsize=9, color=MUTED, va="top")
    figure.tight_layout(rect=(0, 0.4 / height, 1, 1 - 0.7 / height), h_pad=2.0, w_pad=2.0)
    figure.savefig(path)
    plt.close(figure)


def _show(ax: Axes, view: View, true: Picture) -> None:
    """The part of the picture in which there is something."""
    rows, columns = (true.alpha >= COVERED).nonzero().unbind(1)
    part = true.colour[int(rows.min()) : int(rows.max()) + 1, int(columns.min()) : int(columns.max()) + 1]
    ax.imshow(part.clamp(0, 1).numpy())
    ax.axis("off")
    ax.set_title(f"{view.name}: {view.title}", fontsize=11, color=INK, loc="left")
    under = f"{len(view.splats):,} Gaussians in {view.camera.width} x {view.camera.height} pixels"
    ax.text(0, -0.03, under, fontsize=9, color=MUTED, va="top", transform=ax.transAxes)


def _panel(ax: Axes, rows: pd.DataFrame, error: str, called: str) -> None:
    """One measure of error over milliseconds; a bar goes from the fastest to the slowest picture."""
    rows = rows.assign(ms=1e3 * rows["seconds"])
    if error == "error":  # of which the front is
        front = pd.DataFrame(rows[rows["front"]]).sort_values("ms")
        ax.step(front["ms"], front[error], where="post", color=INK, lw=1.2, zorder=1)
    for kind, (colour, marker, _, place) in KINDS.items():
        chosen = pd.DataFrame(rows[rows["kind"] == kind])
        reach = [chosen["ms"] - 1e3 * chosen["fastest"], 1e3 * chosen["slowest"] - chosen["ms"]]
        ax.errorbar(chosen["ms"], chosen[error], xerr=reach, fmt="none", ecolor=colour, elinewidth=0.7, alpha=0.25)
        ax.scatter(chosen["ms"], chosen[error], s=120 if marker == "*" else 45, c=colour, marker=marker,
                   edgecolors="white", linewidths=0.8, zorder=4 if kind == "base" else 3)  # fmt: skip
        x, y, ha, va = PLACES[place]
        for row in chosen.to_dict("records"):
            ax.annotate(_short(row["variant"]), (row["ms"], row[error]), xytext=(x, y), textcoords="offset points",
                        color=colour, fontsize=7, ha=ha, va=va, zorder=5, path_effects=[HALO])  # fmt: skip
    ax.set(xscale="log", yscale="log")
    times = rows["ms"].to_numpy()
    ax.set_xlim(0.8 * times.min(), 2.2 * times.max())
    ax.margins(y=0.1)
    ax.set_ylabel(called, fontsize=9)
    ax.set_xlabel("milliseconds a picture", fontsize=9)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.grid(True, which="major", color=GRID, lw=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(which="both", labelsize=8, colors=MUTED)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _short(variant: str) -> str:
    """What the legend does not say."""
    if variant == "base":
        return ""
    for start in ("alpha from ", "T to ", "SH degree ", "tiles of "):
        variant = variant.removeprefix(start)
    return variant


def _decibels(ax: Axes) -> None:
    """The PSNR at the right edge of a panel of RMS errors."""
    right = ax.twinx()
    low, high = ax.get_ylim()
    right.set_ylim(-20 * np.log10(low), -20 * np.log10(high))
    right.set_ylabel("PSNR [dB]", fontsize=9)
    right.tick_params(labelsize=8, colors=MUTED)
    for side in ("top", "right", "left"):
        right.spines[side].set_visible(False)
