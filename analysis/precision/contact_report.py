"""What a study of contacts leaves behind: contacts.csv, contacts.md and contacts.png."""

from pathlib import Path

import pandas as pd
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from .. import charts, sheets
from ..charts import GRID, INK, MUTED
from .errors import pareto_front

KINDS = {
    "none": ("#22262b", "o"),
    "geometric": ("#2f855a", "D"),
    "embedded": ("#2b6cb0", "s"),
    "embedded + geometric": ("#c2571a", "^"),
}
"""Kind of way -> colour, marker."""
LEAST_SECONDS = 0.1
"""Where doing nothing is drawn."""
TITLE = "Contact fidelity against run time of stage 3"
PANELS = {"penetration": "deepest penetration [mm]", "touching": "touching at t_c [%]"}


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over starts of each way, with n, those that got shallower, and those that stopped."""
    table = pd.DataFrame(table[table["deepest before"].notna()])  # those with a contact, and the limb near it
    table = table.assign(shallower=table["penetration"] < table["deepest before"])
    groups = table.groupby(["setting", "way", "kind"], sort=False)
    names = ["penetration", "touching", "gap", "strange"]
    parts = [groups["seconds"].agg(n="size", seconds="median"), groups[["shallower", "stopped"]].sum()]
    parts += [groups[names].mean(), groups[names].std(ddof=0).add_suffix(" sd")]
    return pd.concat(parts, axis=1).reset_index()


def write(folder: Path, table: pd.DataFrame, noted: dict[str, str]) -> list[Path]:
    """The three files, as `analysis.sheets.write`."""
    return sheets.write(folder, "contacts", table, noted, markdown(table, noted), lambda path: draw(table, path))


def markdown(table: pd.DataFrame, noted: dict[str, str]) -> str:
    """The report as text."""
    parts = [f"# {TITLE}", sheets.markdown_list(noted)]
    for setting, rows in summarise(table).groupby("setting", sort=False):
        parts += [f"## {setting}", sheets.markdown_table([_cells(row) for row in rows.to_dict("records")])]
    return sheets.markdown(parts)


def _cells(row: dict) -> dict[str, object]:
    return {
        "way": row["way"],
        "n": row["n"],
        "seconds": f"{row['seconds']:.1f}",
        "deepest [mm]": _with_spread(row, "penetration", 1e3, 1),
        "shallower": int(row["shallower"]),
        "touching [%]": _with_spread(row, "touching", 1e2, 0),
        "gap [mm]": _with_spread(row, "gap", 1e3, 1),
        "strange": _with_spread(row, "strange", 1, 3),
        "stopped": int(row["stopped"]),
    }


def _with_spread(row: dict, name: str, unit: float, digits: int) -> str:
    return f"{unit * row[name]:.{digits}f} ± {unit * row[f'{name} sd']:.{digits}f}"


def draw(table: pd.DataFrame, path: Path) -> None:
    """Over seconds, a row a setting: depth with the Pareto front, and touching share; bars are standard errors."""
    summary = summarise(table)
    settings = list(summary["setting"].unique())
    figure, axes = plt.subplots(
        len(settings), 2, figsize=(11, 4 * len(settings)), squeeze=False, dpi=130, layout="constrained"
    )
    for setting, row in zip(settings, axes, strict=True):
        rows = pd.DataFrame(summary[summary["setting"] == setting])
        for ax, (name, label) in zip(row, PANELS.items(), strict=True):
            _panel(ax, rows, name, label)
        row[0].set_title(f"{setting} settings", loc="left", color=INK)
    axes[0][0].legend(fontsize=8, frameon=False)
    figure.suptitle(TITLE, x=0.01, ha="left", color=INK)
    figure.savefig(path)
    plt.close(figure)


def _panel(ax: Axes, rows: pd.DataFrame, name: str, label: str) -> None:
    unit = 1e3 if name == "penetration" else 1e2
    error = unit * rows[f"{name} sd"] / rows["n"] ** 0.5
    rows = rows.assign(x=rows["seconds"].clip(lower=LEAST_SECONDS), y=unit * rows[name], error=error)
    for kind, (colour, marker) in KINDS.items():
        of = pd.DataFrame(rows[rows["kind"] == kind])
        counted, ended = (pd.DataFrame(of[mask]) for mask in (of["way"] != kind, of["way"] == kind))
        until = f"{kind}, until out" if len(counted) else kind
        for some, line, called in ((counted, ":", kind), (ended, "", until)):
            if len(some):
                face = "white" if called != kind else colour
                ax.errorbar(some["x"], some["y"], some["error"], color=colour, marker=marker, mfc=face, ms=7, ls=line,
                            label=called, capsize=2)  # fmt: skip
    if name == "penetration":
        best = pd.DataFrame(rows[pareto_front(rows["x"].to_numpy(), rows["y"].to_numpy())]).sort_values("x")
        ax.step(best["x"], best["y"], where="post", color=INK, lw=0.8, zorder=0)
    ax.set(xscale="log", xlabel="seconds of stage 3", ylabel=label)
    charts.plain_numbers(ax.xaxis, steps=False)
    ax.set_ylim(bottom=0)
    ax.grid(True, color=GRID)
    ax.tick_params(colors=MUTED, labelsize=8)
