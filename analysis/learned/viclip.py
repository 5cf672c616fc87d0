"""The ViCLIP score: cosine of a video and the scene's prompt, from a local checkpoint (paper, Metrics)."""

import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from hoi.errors import InputError
from hoi.motion.text import file_sha256

from .clip_text import TOKEN_FILES, ClipTokens, find_vocabulary, load_tokens
from .files import check_memory, files_sha256
from .frames import Clip, Pixels
from .viclip_model import HEAD, Sizes, ViCLIP

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
SCORED = {"viclip": "scene_prompt", "viclip_motion": "motion_prompt"}
"""Score -> the prompt it is for."""


@dataclass(frozen=True)
class ViclipFiles:
    """A checkpoint and its vocabulary, found but not loaded."""

    weights: Path
    vocabulary: Path

    @property
    def identity(self) -> str:
        """What the scores depend on."""
        tokens = [self.vocabulary]
        if self.vocabulary.is_dir():
            tokens = [file for name in TOKEN_FILES if (file := self.vocabulary / name).is_file()]
        return f"{self.weights.name} sha256:{file_sha256(self.weights)} vocabulary:{files_sha256(tokens)}"

    def load(self, device: torch.device) -> Callable[[Clip], dict[str, float]]:
        """What scores a clip.

        Raises:
            InputError: a file is damaged or another model's, or the memory does not suffice.
        """
        check_memory("--viclip", self.weights.stat().st_size, device)
        model = load_viclip(self.weights).to(device)
        tokens = load_tokens(self.vocabulary, model.sizes.context, model.sizes.vocabulary)
        return ViclipScorer(model, tokens, device)


def find_viclip(weights: Path, vocabulary: Path | None = None) -> ViclipFiles:
    """The files of `--viclip` and `--clip-vocab`.

    Raises:
        InputError: one is missing; the line says which, where it is looked for and where it is to be had.
    """
    if not weights.is_file():
        raise InputError(
            f"--viclip: no ViCLIP checkpoint at {weights}; expected ViCLIP-L_InternVid-FLT-10M.pth or its safetensors "
            "(Hugging Face OpenGVLab/ViCLIP, 1.7 GB; licence CC-BY-NC-SA-4.0)"
        )
    return ViclipFiles(weights, find_vocabulary(vocabulary, weights))


def load_viclip(path: Path) -> ViCLIP:
    """The model of a checkpoint, on the CPU, in float32; its sizes are those of the tensors.

    `path` is safetensors, or a .pth with {"model": state dict} or the state dict alone, of which no code is unpickled.

    Raises:
        InputError: it cannot be read, or is no ViCLIP.
    """
    try:
        if path.suffix == ".safetensors":
            state = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except (OSError, SafetensorError, RuntimeError, ValueError, EOFError, KeyError, pickle.UnpicklingError) as error:
        raise InputError(f"--viclip: {path} cannot be read: {str(error).splitlines()[0]}") from error
    if isinstance(state, dict) and isinstance(state.get("model"), dict):
        state = state["model"]
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise InputError(f"--viclip: {path} holds no state dict")
    state = {str(key).removeprefix("module."): value.float() for key, value in state.items()}
    try:
        sizes = Sizes.of(state)
        for width in (sizes.width, sizes.text_width):
            if width % HEAD:
                raise ValueError(f"a tower {width} wide, no multiple of {HEAD}")
        with torch.device("meta"):
            model = ViCLIP(sizes)
        model.load_state_dict(state, assign=True)
    except (KeyError, IndexError, ValueError, RuntimeError, AssertionError) as error:
        raise InputError(f"--viclip: {path} is no ViCLIP: {' '.join(str(error).split())[:200]}") from error
    return model.eval().requires_grad_(False)


@dataclass
class ViclipScorer:
    """A model with its tokens; tells once of each text that it does not read to its end."""

    model: ViCLIP
    tokens: ClipTokens
    device: torch.device

    def __post_init__(self) -> None:
        self._told: set[str] = set()

    def __call__(self, clip: Clip) -> dict[str, float]:
        """Scores by key of `SCORED`.

        Raises:
            InputError: the video has fewer pictures than the model looks at.
        """
        texts = [clip.prompts[name] for name in SCORED.values()]
        for text in texts:
            self._tell(text)
        video = prepare(clip.pictures, self.model.sizes.frames, self.model.sizes.resolution)
        tokens = torch.stack([self.tokens(text) for text in texts])
        with torch.inference_mode():
            cosines = self.model.similarity(video[None].to(self.device), tokens.to(self.device))[0].clamp(-1, 1)
        return dict(zip(SCORED, cosines.tolist(), strict=True))

    def _tell(self, text: str) -> None:
        cut = self.tokens.cut(text)
        if cut is not None and text not in self._told:
            self._told.add(text)
            print(f"warning: ViCLIP reads {self.tokens.context} tokens, not {cut!r} of {text!r}", file=sys.stderr)


def prepare(pictures: Pixels, frames: int, resolution: int) -> Tensor:
    """Every T // frames-th picture from the first, squeezed into a square, by ImageNet's mean and deviation.

    Args:
        pictures: RGB bytes, (T, height, width, 3).

    Returns:
        (frames, 3, resolution, resolution), float32.

    Raises:
        InputError: fewer than `frames` pictures.
    """
    if len(pictures) < frames:
        raise InputError(f"its video has {len(pictures)} pictures, ViCLIP looks at {frames}")
    chosen = torch.from_numpy(np.ascontiguousarray(pictures[:: len(pictures) // frames][:frames]))
    size = (resolution, resolution)  # the aspect is not kept, and nothing is smoothed before: so it was trained
    square = torch.nn.functional.interpolate(
        chosen.permute(0, 3, 1, 2).float() / 255, size, mode="bilinear", align_corners=False, antialias=False
    )
    mean, std = (torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD))
    return (square - mean) / std
