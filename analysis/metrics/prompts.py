"""Write `prompts.npz`, the embeddings of the scenes' motion prompts: `python -m analysis.metrics.prompts`.

With them the table needs no text encoder. Run it again when a scene's motion prompt changes.
"""

import os
from pathlib import Path

import numpy as np
import yaml

from hoi.config import CONF
from hoi.terminal.program import program

from .evaluator import PROMPTS


def scene_prompts(folder: Path = CONF / "scene") -> list[str]:
    """The motion prompts of the scenes in conf/, each once, in order."""
    files = sorted(folder.glob("*.yaml"))
    scenes = (yaml.safe_load(file.read_text()) or {} for file in files)
    return sorted({scene["scene"]["motion_prompt"] for scene in scenes if "scene" in scene})


def main() -> None:
    from hoi.motion.text import minilm

    encoder, sentences = minilm(), scene_prompts()
    embeddings = np.concatenate([encoder.embed([sentence]).numpy() for sentence in sentences])  # alone: no padding
    part = PROMPTS.with_suffix(".part.npz")
    np.savez_compressed(
        part, sentences=np.array(sentences), embeddings=embeddings, text_encoder=np.array(encoder.sha256)
    )
    os.replace(part, PROMPTS)
    print(f"{PROMPTS}: {len(sentences)} sentences")


if __name__ == "__main__":
    program(main)
