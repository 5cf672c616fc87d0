"""What a training leaves behind: the prior itself, training.json (what went in and came out) and curve.png."""

import argparse
from typing import Any

from hoi.motion.prior import DENOISER_PREFIX, STATISTICS, write_prior
from hoi.motion.text import MINILM_PACKAGE, MINILM_SHA256
from hoi.training.report import curves, read_log, write_report


def publish(state: dict[str, Any], facts: dict[str, Any], options: argparse.Namespace, command: str) -> None:
    """Write prior.safetensors, prior.json, training.json and curve.png beside log.jsonl.

    Args:
        state: a training's checkpoint (`.training.Training.state`); the moving average is what is published.
        facts: what the checkpoint does not know: data files and their hashes, windows per label.
    """
    out = options.out
    tensors = {DENOISER_PREFIX + name: value for name, value in state["average"].items()}
    statistics = (state[name] for name in ("mean", "std", "text_mean", "text_std"))
    description = {
        "source": f"embedded prior, {state['step']} steps",
        "features": "smplrifke",
        "architecture": state["architecture"],
        "timesteps": state["timesteps"],
        "fps": state["fps"],
        "text_encoder": {"name": "all-MiniLM-L6-v2", "package": MINILM_PACKAGE, "sha256": MINILM_SHA256},
        "rest_joints": [[round(value, 6) for value in row] for row in state["rest_joints"].tolist()],
    }
    write_prior(out, tensors | dict(zip(STATISTICS, statistics, strict=True)), description)
    log = read_log(out)
    write_report(out, state, log, options, command, **facts)
    with curves(out / "curve.png", 1, (6, 3.5)) as (axes,):
        axes.semilogy([row["step"] for row in log], [row["loss"] for row in log], linewidth=1)
        axes.set(ylabel="MSE of the normalised $x_0$", title="training loss")
