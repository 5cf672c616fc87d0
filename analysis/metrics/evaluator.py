"""Naturalness and text alignment by the package's judge of motions (`hoi.motion.evaluator`), in NumPy.

The weights are read from its safetensors file. Sentences come embedded: those of the scenes from `prompts.npz` beside
this file, which `python -m analysis.metrics.prompts` writes; others from the user's cache of embeddings, or by the
text encoder itself, the one thing here that takes torch.
"""

import hashlib
import json
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from scipy.special import erf

import hoi
from hoi.caches import user_caches
from hoi.data import Array
from hoi.errors import InputError

from ..posing import local_rotations
from ..records import Record, Undefined
from .features import encode
from .metric import NAN

WEIGHTS = Path(hoi.__file__).parent / "motion" / "weights"
PROMPTS = Path(__file__).parent / "prompts.npz"
FORMAT = "hoi motion evaluator 1"


@dataclass(frozen=True)
class Judge:
    """The two towers and what they know."""

    weights: dict[str, Array]
    rest_joints: Array
    """T-pose joints of the skeleton that it was trained with [m], (24, 3)."""
    fps: float
    text_encoder: str
    """SHA-256 of the sentence encoder's weights."""

    def embed_motion(self, features: Array) -> Array:
        """Unnormalised features (T, 205) -> unit (64,)."""
        w = self.weights
        hidden = ((features - w["mean"]) / w["std"]).astype(np.float32).T
        for layer, stride in ((0, 2), (3, 2), (6, 1)):
            hidden = _gelu(_convolve(hidden, w[f"frames.{layer}.weight"], w[f"frames.{layer}.bias"], stride))
        pooled = np.concatenate([hidden.mean(-1), hidden.max(-1)])
        return _unit(w["motion.1.weight"] @ pooled + w["motion.1.bias"])

    def embed_text(self, sentence: Array) -> Array:
        """The encoder's embedding (384,) -> unit (64,)."""
        w = self.weights
        return _unit(w["text.3.weight"] @ _gelu(w["text.0.weight"] @ sentence + w["text.0.bias"]) + w["text.3.bias"])

    def strangeness(self, embedding: Array) -> float:
        """Distance of a motion's embedding to that of the nearest real motion, 0 to 2."""
        return float(np.linalg.norm(self.weights["known"] - embedding, axis=1).min())


@lru_cache(maxsize=1)
def judge() -> Judge:
    """The one in the package.

    Raises:
        InputError: its files are missing or of another format.
    """
    path = WEIGHTS / "evaluator.safetensors"
    try:
        with safe_open(path, framework="numpy") as file:
            noted = file.metadata() or {}
            weights = {name: file.get_tensor(name) for name in file.keys()}
        prior = json.loads((WEIGHTS / "prior.json").read_text())
    except (OSError, SafetensorError, ValueError) as error:
        raise InputError(f"evaluator: {path} cannot be read: {error}") from error
    if noted.get("format") != FORMAT:
        raise InputError(f"evaluator: {path}: format is {noted.get('format')!r}, not {FORMAT!r}")
    return Judge(weights, np.array(prior["rest_joints"]), float(prior["fps"]), noted["text_encoder"])


def naturalness(record: Record) -> float:
    """Distance of the motion's embedding to that of the nearest of 1024 real motions, by the package's evaluator: 0 to
    2, lower is more natural. At its frame rate, 20, alone."""
    return judge().strangeness(_motion_embedding(record))


def text_alignment(record: Record) -> float:
    """Cosine of the motion's and the motion prompt's embedding by the package's evaluator, -1 to 1. At its frame rate,
    20, alone."""
    embedding, sentence = _motion_embedding(record), sentence_embedding(record.scene.motion_prompt)
    return NAN if sentence is None else float(judge().embed_text(sentence) @ embedding)


@lru_cache(maxsize=2)
def _motion_embedding(record: Record) -> Array:
    known, body, motion = judge(), record.scene.body, record.motion
    if len(motion) < 3 or abs(motion.fps - known.fps) > 1e-6:
        raise Undefined
    # The judge knows one skeleton, people come in sizes.
    ratio = leg_length(known.rest_joints) / leg_length(body.rest_joints)
    translation = np.asarray(motion.translation, np.float64) * ratio
    return known.embed_motion(encode(local_rotations(motion), translation, known.rest_joints))


def leg_length(rest_joints: Array) -> float:
    """Height of the pelvis above the lowest joint in the T-pose [m]."""
    return float(rest_joints[0, 1] - rest_joints[:, 1].min())


@lru_cache(maxsize=64)
def sentence_embedding(sentence: str) -> Array | None:
    """The sentence encoder's embedding, (384,); None where the encoder is not installed."""
    shipped = shipped_prompts()
    if sentence in shipped:
        return shipped[sentence]
    cached = _cached(sentence)
    return _computed(sentence) if cached is None else cached


@lru_cache(maxsize=1)
def shipped_prompts() -> dict[str, Array]:
    """The scenes' motion prompts with their embeddings, (384,) each; empty where they are another encoder's."""
    with np.load(PROMPTS, allow_pickle=False) as file:
        if str(file["text_encoder"]) != judge().text_encoder:
            return {}
        return dict(zip(file["sentences"].tolist(), file["embeddings"], strict=True))


def _cached(sentence: str) -> Array | None:
    """From where `hoi.motion.text` keeps what has been embedded before."""
    if (folder := user_caches()) is None:
        return None
    key = hashlib.sha256("\0".join(["minilm", judge().text_encoder, sentence]).encode()).hexdigest()
    try:
        with safe_open(folder / "hoi" / "text" / f"{key}.safetensors", framework="numpy") as file:
            same = (file.metadata() or {}).get("sentence") == sentence
            return file.get_tensor("embedding") if same else None
    except (OSError, SafetensorError):
        return None


def _computed(sentence: str) -> Array | None:
    try:
        from hoi.motion.text import default_cache, minilm

        return minilm(default_cache()).embed([sentence])[0].numpy()
    except (ImportError, InputError) as error:
        print(f"analysis.metrics: no text alignment for {sentence!r}: {error}", file=sys.stderr)
        return None


def _convolve(x: Array, weight: Array, bias: Array, stride: int) -> Array:
    """(C, T) -> (O, T'), as torch.nn.Conv1d with padding of half the kernel (O, C, K)."""
    width = weight.shape[-1]
    padded = np.pad(x, ((0, 0), (width // 2, width // 2)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, width, axis=1)[:, ::stride]  # (C, T', K)
    return np.einsum("ock,ctk->ot", weight, windows, optimize=True) + bias[:, None]


def _gelu(x: Array) -> Array:
    return 0.5 * x * (1 + erf(x / np.sqrt(2.0)))


def _unit(x: Array) -> Array:
    return x / max(float(np.linalg.norm(x)), 1e-12)
