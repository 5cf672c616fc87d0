"""A page against reality: each experiment of which the world knows the outcome, ours beside it, and the verdict.

    python -m analysis.reality [-o runs/reality]

Writes reality.csv, .md and .png. A module joins in with a tuple EXPERIMENTS of `analysis.experiments.Experiment`.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import pandas as pd

from hoi.terminal.program import program

from . import command
from .experiments import Experiment

MODULES = ("analysis.experiments", "analysis.experiments_people")
"""Where rows come from, in this order."""


def measured(experiments: Sequence[Experiment]) -> pd.DataFrame:
    """A row an experiment: what was measured, what is published, and whether they agree."""
    rows = []
    for experiment in experiments:
        value = experiment.measure()
        low, high = experiment.published
        rows.append({
            "experiment": experiment.title, "unit": experiment.unit, "ours": value, "from": low, "to": high,
            "tolerance": experiment.tolerance, "agrees": experiment.agrees(value), "source": experiment.source,
        })  # fmt: skip
        print(f"{experiment.title}: {value:.3g} {experiment.unit}", flush=True)
    return pd.DataFrame(rows)


def markdown(table: pd.DataFrame) -> str:
    """The table as text."""
    lines = ["| experiment | published | ours | verdict | source |", "|---|---|---|---|---|"]
    for row in table.to_dict("records"):
        published = f"{row['from']:g}" if row["from"] == row["to"] else f"{row['from']:g} to {row['to']:g}"
        verdict = "agrees" if row["agrees"] else f"out by {_out(row):+.0%}"
        unit = "" if row["unit"] == "-" else f" {row['unit']}"
        lines.append(
            f"| {row['experiment']} | {published}{unit} | {row['ours']:.3g}{unit} | {verdict} | {row['source']} |"
        )
    return "\n".join(lines)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Ours over the middle of what is published, with the range allowed."""
    from matplotlib import pyplot as plt

    middle = (table["from"] + table["to"]) / 2
    low = (table["from"] - table["tolerance"] * table["from"].abs()) / middle
    high = (table["to"] + table["tolerance"] * table["to"].abs()) / middle
    figure, axes = plt.subplots(figsize=(9, 1.2 + 0.42 * len(table)), layout="constrained")
    places = range(len(table))[::-1]
    axes.barh(places, high - low, left=low, height=0.5, color="#cfe3d6", label="published, with tolerance")
    colours = ["#2f855a" if agrees else "#d61f3c" for agrees in table["agrees"]]
    axes.scatter(table["ours"] / middle, places, color=colours, zorder=3, label="ours")
    axes.axvline(1.0, color="#97a0ab", linewidth=0.8)
    axes.set_yticks(list(places), table["experiment"])
    axes.set_xlabel("over the middle of the published range")
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.12), ncols=2, frameon=False)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _out(row: dict) -> float:
    bound = row["from"] if row["ours"] < row["from"] else row["to"]
    return row["ours"] / bound - 1


@command.exit_code("analysis.reality")
def main(arguments: Sequence[str] | None = None) -> None:
    parser = command.parser("analysis.reality", "Hold the physics against published measurements.", "-o runs/reality")
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/reality"))
    given = parser.parse_args(arguments)
    experiments = [each for module in MODULES for each in import_module(module).EXPERIMENTS]
    table = measured(experiments)
    given.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(given.out / "reality.csv", index=False)
    (given.out / "reality.md").write_text(f"{markdown(table)}\n")
    draw(table, given.out / "reality.png")
    print(given.out / "reality.md")


if __name__ == "__main__":
    program(main)
