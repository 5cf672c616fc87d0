"""What a training leaves behind: the prior itself, training.json (what went in and came out) and curve.png."""

import json
import platform
from pathlib import Path
from typing import Any

import torch

from hoi.motion.prior import DENOISER_PREFIX, write_prior
from hoi.motion.text import MINILM_PACKAGE, MINILM_SHA256


def read_log(path: Path) -> list[dict[str, float]]:
    """Rows of log.jsonl: step, minutes, loss, lr. Steps that a resumed training repeated are counted once."""
    rows: dict[float, dict[str, float]] = {}
    for line in path.read_text().splitlines():
        row = json.loads(line)
        rows[row["step"]] = row
    return [rows[step] for step in sorted(rows)]


def publish(state: dict[str, Any], facts: dict[str, Any], out: Path) -> None:
    """Write prior.safetensors, prior.json, training.json and curve.png.

    Args:
        state: a training's checkpoint (`.training.Training.state`); the moving average is what is published.
        facts: what the checkpoint does not know: command, hardware, data files and their hashes, windows per label.
        out: folder that holds log.jsonl.
    """
    tensors = {DENOISER_PREFIX + name: value for name, value in state["average"].items()}
    tensors |= {
        "motion_normalizer.mean": state["mean"],
        "motion_normalizer.std": state["std"],
        "text_normalizer.mean": state["text_mean"],
        "text_normalizer.std": state["text_std"],
    }
    description = {
        "source": f"embedded prior, {state['step']} steps",
        "features": "smplrifke",
        "architecture": state["architecture"],
        "timesteps": state["timesteps"],
        "fps": state["fps"],
        "text_encoder": {"name": "all-MiniLM-L6-v2", "package": MINILM_PACKAGE, "sha256": MINILM_SHA256},
        "rest_joints": [[round(value, 6) for value in row] for row in state["rest_joints"].tolist()],
    }
    write_prior(out, tensors, description)
    log = read_log(out / "log.jsonl")
    report = {
        "steps": state["step"],
        "minutes": round(state["seconds"] / 60, 1),
        "loss": {str(int(row["step"])): row["loss"] for row in log[-1 : -len(log) - 1 : -max(1, len(log) // 10)]},
        "parameters": sum(value.numel() for value in state["average"].values()),
        "architecture": state["architecture"],
        "versions": {"python": platform.python_version(), "torch": torch.__version__},
        **facts,
    }
    (out / "training.json").write_text(json.dumps(report, indent=1) + "\n")
    draw_curve(log, out / "curve.png")


def draw_curve(log: list[dict[str, float]], path: Path) -> None:
    """Loss over steps, logarithmic."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.semilogy([row["step"] for row in log], [row["loss"] for row in log], linewidth=1)
    axes.set(xlabel="optimiser step", ylabel="MSE of the normalised $x_0$", title="training loss")
    axes.grid(True, which="both", alpha=0.3)
    figure.savefig(path, dpi=110)
