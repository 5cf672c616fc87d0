"""What a training leaves behind: the prior itself, training.json (what went in and came out) and curve.png."""

import argparse
from collections import Counter
from typing import Any

import numpy as np

from hoi.motion.text import MINILM_SHA256
from hoi.training.report import curves, read_log, write_report
from hoi.training.video import contacts
from hoi.training.video.clips import Clips
from hoi.training.video.contacts import FLAWS, LIMBS, OBJECT_SHARES, PEOPLE
from hoi.video_prior.denoiser import Architecture
from hoi.video_prior.embedded import CROP, Description, save_embedded
from hoi.video_prior.files import VIDEO_PRIOR_NAME


def publish(state: dict[str, Any], clips: Clips, held_out: int, options: argparse.Namespace, command: str) -> None:
    """Write video_prior.safetensors, training.json and curve.png beside log.jsonl.

    Args:
        state: a training's checkpoint (see `.training.Training.state`); its moving average is published.
        held_out: how many of the clips, the last ones, were only tested on.
    """
    out = options.out
    architecture = Architecture(**{**state["architecture"], "channels": tuple(state["architecture"]["channels"])})
    description = Description(architecture, state["step"], MINILM_SHA256)
    save_embedded(out / VIDEO_PRIOR_NAME, state["average"], (state["text_mean"], state["text_std"]), description)
    log = read_log(out)
    tested = [row for row in log if "held_out" in row]
    tests, made = tested[-1] if tested else {}, recipe(clips, held_out)
    write_report(out, state, log, options, command, tests=tests, clips=made)
    with curves(out / "curve.png", 2, (7, 5)) as (upper, lower):
        upper.semilogy([row["step"] for row in log], [row["loss"] for row in log], linewidth=1, label="training")
        upper.semilogy([row["step"] for row in tested], [row["held_out"] for row in tested], label="held-out clips")
        upper.set(ylabel="MSE of v", title="the embedded video prior")
        upper.legend()
        for said in ("clean", "flawed"):
            lower.plot(
                [row["step"] for row in tested], [row[f"mended_{said}"] for row in tested], label=f"called {said}"
            )
        lower.set(ylabel="share of a flaw mended [-]")
        lower.legend()


def recipe(clips: Clips, held_out: int) -> dict[str, Any]:
    """What was drawn, and how often."""

    def count(numbers: np.ndarray, names: list[str]) -> dict[str, int]:
        return {names[number]: found for number, found in sorted(Counter(numbers.tolist()).items())}

    flaws = {
        flaw: [round(float(value), 4) for value in np.percentile(np.abs(clips.amount[:, index]), (5, 50, 95))]
        for index, flaw in enumerate(FLAWS)
    }
    return {
        "views": len(clips),
        "held_out": held_out,
        "depth_or_gap_5_50_95_percent": flaws,
        "limbs": count(clips.limb, [limb.name for limb in LIMBS]),
        "objects": count(clips.shape, list(OBJECT_SHARES)),
        "people": count(clips.person, list(PEOPLE)),
        "half_of_picture": CROP,
        "person_gaussians": contacts.PERSON_GAUSSIANS,
        "motions": "drawn from the motion prior in the package",
    }
