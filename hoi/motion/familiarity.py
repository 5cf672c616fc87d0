"""How far a sentence is from those that a motion prior was trained on, and what it is nearest to.

Distance is 1 - cosine of sentence embeddings. Beside the captions of the training stand acts that were not trained
(`hoi.training.motion.acts`): a sentence that one of those is nearer to asks for what the prior has never seen, though
another caption may have most of its words. The embeddings are MiniLM's, which was trained on English alone.
"""

import json
import re
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from hoi.data import Array
from hoi.errors import InputError

CAPTIONS_NAME = "captions.safetensors"
EMBEDDED = Path(__file__).parent / "weights"
FAR = 0.45
"""A sentence further than this from every caption is none that the prior knows. Measured in docs/motion.md."""
MARGIN = 0.02
"""So much nearer an act that was not trained must be than every caption."""
STRIKES = re.compile(r"kick|punch|push(?!up)|karate_(knee|strike)|fight_combo")
"""Kinds of motion in which something is struck."""
NAMED = re.compile(r"\b(kick|punch|jab|push(?![ -]?up)|shov|uppercut|knee(?=s\b|ing|d\b| ))\w*", re.IGNORECASE)
"""Words for what the prior was mostly trained on, whatever the other words of a sentence are."""


@dataclass(frozen=True)
class Captions:
    """What a prior was trained on, in words."""

    sentences: tuple[str, ...]
    kinds: tuple[str, ...]
    """Of each sentence the kind of motion that it describes; empty for an act that was not trained."""
    windows: dict[str, int]
    """Pieces of motion of each kind in the training."""
    embeddings: Array
    """Of unit length, (N, text_dim)."""

    @cached_property
    def words(self) -> frozenset[str]:
        return frozenset(word for sentence in self.sentences for word in sentence.split())

    def familiar_words(self, sentence: str) -> str:
        """The sentence without the words that none here has: what is struck may be anything."""
        return " ".join(word for word in re.findall(r"[\w'-]+", sentence.lower()) if word in self.words)


@dataclass(frozen=True)
class Familiarity:
    """A sentence beside the training."""

    distance: float
    """To the nearest caption [-]."""
    caption: str
    kind: str
    windows: int
    """Pieces of motion of that kind in the training."""
    other: str = ""
    """An act that was not trained and is nearer."""

    @property
    def known(self) -> bool:
        return self.distance <= FAR and not self.other

    @property
    def value(self) -> str:
        return f"{self.distance:.2f}" if self.known else f"{self.distance:.2f} UNKNOWN"

    def __str__(self) -> str:
        nearest = f"'{self.caption}' ({self.kind}, {self.windows} pieces of motion)"
        if self.other:
            return f"the prior was not trained on '{self.other}', which is nearest; of what it was, {nearest} is"
        if not self.known:
            return f"the prior was trained on nothing like this (English alone); nearest is {nearest}"
        if not STRIKES.match(self.kind):
            return f"from {nearest} in the prior's training, no strike: whatever limb is nearest meets the object"
        return f"from {nearest} in the prior's training"


def familiarity(sentence: str, checkpoint: str | Path | None = None) -> Familiarity | None:
    """The sentence beside the training of a prior; None where the prior has no captions with it.

    A caption of the training costs nothing, another sentence its embedding, which is kept for the run.

    Raises:
        InputError: the sentence encoder cannot be had.
    """
    captions = read_captions(EMBEDDED if checkpoint is None else Path(checkpoint))
    if captions is None:
        return None
    plain = " ".join(sentence.lower().split()).rstrip(".!")
    if plain in captions.sentences:
        row = captions.sentences.index(plain)
        if kind := captions.kinds[row]:
            return Familiarity(0.0, plain, kind, captions.windows[kind])
    from hoi.motion.text import default_cache, minilm

    without = captions.familiar_words(sentence)
    strikes = NAMED.search(sentence) is not None
    asked = list(dict.fromkeys([sentence, without])) if strikes and without else [sentence]
    found = [beside(captions, row, strikes) for row in minilm(default_cache()).embed(asked).numpy()]
    return min(found, key=lambda each: (not each.known, each.distance))


def beside(captions: Captions, embedding: Array, strikes: bool = False) -> Familiarity:
    """The nearest caption, of those of strikes alone where asked for; and the nearer act that was not trained."""
    distances = 1 - captions.embeddings @ embedding
    trained = np.array([kind != "" for kind in captions.kinds])
    wanted = np.array([STRIKES.match(kind) is not None for kind in captions.kinds]) if strikes else trained
    first = int(np.where(wanted if wanted.any() else trained, distances, np.inf).argmin())
    kind = captions.kinds[first]
    other = ""
    if not trained.all():
        foreign = int(np.where(trained, np.inf, distances).argmin())
        other = captions.sentences[foreign] if distances[foreign] < distances[first] - MARGIN else ""
    return Familiarity(float(distances[first]), captions.sentences[first], kind, captions.windows[kind], other)


def read_captions(prior: Path) -> Captions | None:
    """The captions beside a prior, its folder or one of its files; None where there are none that can be read."""
    path = (prior if prior.is_dir() else prior.parent) / CAPTIONS_NAME
    return _read(path) if path.is_file() else None


@cache
def _read(path: Path) -> Captions | None:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="np") as file:
            embeddings, told = file.get_tensor("embeddings").astype(np.float32), file.metadata()
        lists = [json.loads(told[name]) for name in ("sentences", "kinds", "windows")]
    except (OSError, SafetensorError, KeyError, TypeError, ValueError):
        return None
    sentences, kinds, windows = lists
    return Captions(tuple(sentences), tuple(kinds), windows, embeddings)


def sentence_check(sentence: str, checkpoint: str | None) -> tuple[str, str] | None:
    """Value and detail of the plan's line about the sentence; None for a strike in the words of the training."""
    try:
        found = familiarity(sentence, checkpoint)
    except InputError as error:
        return "not measured", str(error)
    if found is not None:
        exact = found.distance == 0 and STRIKES.match(found.kind) is not None
        return None if exact else (found.value, str(found))
    why = "how far the sentence is from the prior's training is not known: the captions of that are not with it"
    return "not measured", why if sentence.isascii() else f"{why}; CLIP, the published one's encoder, knows English"
