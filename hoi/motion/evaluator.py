"""A judge of motions: sentences and motions in one space, close where the one describes the other.

`hoi.training.motion.evaluator` trains it on the clips that priors are trained on, never on those held out.
Contrastive as in TMR (Petrovich et al. 2023) and the evaluators of text-to-motion (Guo et al. 2022), but small: what it
knows are a few dozen kinds of motion and their sides.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.motion.features import FEATURE_COUNT
from hoi.motion.text import TextEncoder, default_cache, minilm

FILE_NAME = "evaluator.safetensors"
FORMAT = "hoi motion evaluator 1"
SHIPPED = Path(__file__).parent / "weights" / FILE_NAME
DIMENSION, WIDTH = 64, 128


class Towers(nn.Module):
    """Motions (B, T, 205) and sentence embeddings (B, text_dim), each -> (B, DIMENSION)."""

    mean: Tensor
    std: Tensor

    def __init__(self, text_dim: int, dropout: float = 0.0):
        super().__init__()
        self.register_buffer("mean", torch.zeros(FEATURE_COUNT))
        self.register_buffer("std", torch.ones(FEATURE_COUNT))
        self.frames = nn.Sequential(
            nn.Conv1d(FEATURE_COUNT, WIDTH, 5, stride=2, padding=2), nn.GELU(), nn.Dropout(dropout),
            nn.Conv1d(WIDTH, WIDTH, 5, stride=2, padding=2), nn.GELU(), nn.Dropout(dropout),
            nn.Conv1d(WIDTH, WIDTH, 3, padding=1), nn.GELU(),
        )  # fmt: skip
        self.motion = nn.Sequential(nn.Dropout(dropout), nn.Linear(2 * WIDTH, DIMENSION))
        self.text = nn.Sequential(
            nn.Linear(text_dim, WIDTH), nn.GELU(), nn.Dropout(dropout), nn.Linear(WIDTH, DIMENSION)
        )

    def embed_motion(self, features: Tensor) -> Tensor:
        hidden = self.frames(((features - self.mean) / self.std).transpose(1, 2))
        return self.motion(torch.cat([hidden.mean(-1), hidden.amax(-1)], dim=-1))

    def embed_text(self, text: Tensor) -> Tensor:
        return self.text(text)


@dataclass(frozen=True)
class Evaluator:
    """Embeddings of unit length: their product is the alignment of a motion with a sentence, in -1 .. 1."""

    towers: Towers
    text_encoder: TextEncoder
    known: Tensor
    """Embeddings of real motions, (K, 64)."""

    @torch.no_grad()
    def embed_motion(self, features: Tensor) -> Tensor:
        """Unnormalised features (B, T, 205) of `hoi.motion.features.encode`, with its own ground -> (B, 64)."""
        return nn.functional.normalize(self.towers.embed_motion(features.float()), dim=-1)

    @torch.no_grad()
    def embed_text(self, sentences: list[str]) -> Tensor:
        """(B, 64)."""
        return nn.functional.normalize(self.towers.embed_text(self.text_encoder.embed(sentences)), dim=-1)

    def strangeness(self, features: Tensor) -> Tensor:
        """Distance of motions to the nearest real one, by their embeddings, (B,): 0 to 2, lower is more natural."""
        return torch.cdist(self.embed_motion(features), self.known).amin(-1)


def save_evaluator(evaluator: Evaluator, path: Path) -> None:
    """One safetensors file with what it was made with."""
    path.parent.mkdir(parents=True, exist_ok=True)
    state = {name: value.contiguous() for name, value in evaluator.towers.state_dict().items()}
    state["known"] = evaluator.known.contiguous()
    with whole_file(path) as part:
        part.write_bytes(save(state, {"format": FORMAT, "text_encoder": evaluator.text_encoder.sha256}))


def load_evaluator(path: Path = SHIPPED, text_cache: Path | None = None) -> Evaluator:
    """The evaluator of a file.

    Raises:
        InputError: the file is missing, damaged, or was made with another text encoder.
    """
    encoder = minilm(text_cache or default_cache())
    try:
        with safe_open(path, framework="pt") as file:
            noted = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}
    except (OSError, SafetensorError) as error:
        raise InputError(f"evaluator: {path} cannot be read: {error}") from error
    if noted.get("format") != FORMAT:
        raise InputError(f"evaluator: {path}: format is {noted.get('format')!r}, not {FORMAT!r}")
    if noted.get("text_encoder") != encoder.sha256:
        raise InputError(f"evaluator: {path} was trained with another text encoder than the one here")
    try:
        known = state.pop("known")
        towers = Towers(state["text.0.weight"].shape[1])
        towers.load_state_dict(state)
    except (KeyError, RuntimeError) as error:
        raise InputError(f"evaluator: {path} is of another architecture: {str(error).splitlines()[0]}") from error
    return Evaluator(towers.eval().requires_grad_(False), encoder, known)
