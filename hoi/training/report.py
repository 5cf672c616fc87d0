"""What a training says of itself: training.json (what went in and came out) and curve.png."""

import argparse
import json
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from hoi.training.loop import LOG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Log = list[dict[str, float]]


def read_log(out: Path) -> Log:
    """Rows of log.jsonl: step, minutes, loss, lr. Steps that a resumed training repeated are counted once."""
    rows = {row["step"]: row for row in map(json.loads, (out / LOG).read_text().splitlines())}
    return [rows[step] for step in sorted(rows)]


def write_report(
    out: Path, state: dict[str, Any], log: Log, options: argparse.Namespace, command: str, **facts: Any
) -> None:
    """Write training.json.

    Args:
        state: of the training's end, see `hoi.training.loop.Training.state`.
        facts: what else there is to say, in the order in which it is to be said.
    """
    report = {
        "steps": state["step"],
        "minutes": round(state["seconds"] / 60, 1),
        "loss": {str(int(row["step"])): row["loss"] for row in log[-1 : -len(log) - 1 : -max(1, len(log) // 10)]},
        "parameters": sum(value.numel() for value in state["average"].values()),
        "architecture": state["architecture"],
        "versions": {"python": platform.python_version(), "torch": torch.__version__},
        **facts,
        "command": command,
        "hardware": options.hardware or f"{options.threads} CPU threads",
    }
    (out / "training.json").write_text(json.dumps(report, indent=1) + "\n")


@contextmanager
def curves(path: Path, rows: int, size: tuple[float, float]) -> Iterator[list["Axes"]]:
    """Axes one above the other, over optimiser steps, whose picture of `size` [inch] is then written to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0].tolist()
    yield axes
    axes[-1].set_xlabel("optimiser step")
    for each in axes:
        each.grid(True, which="both", alpha=0.3)
    figure.savefig(path, dpi=110)
