"""Motions to compare: what is asked for, and who answers (real clips, the nearest sentence's clip, a prior)."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hoi.motion.diffusion import ancestral_sample, ddim_sample
from hoi.motion.features import FEATURE_COUNT
from hoi.motion.prior import MotionPrior
from hoi.training.motion.dataset import FRAMES, TrainingSet

from .measures import LIMBS, SIDES

POOL = 32
BATCH = 32


@dataclass(frozen=True)
class Case:
    """One sentence to be answered with a motion."""

    kind: str
    """"label/side" or "label"."""
    caption: str
    window: int
    """Row of a real window that the sentence describes."""
    others: tuple[str, ...] = ()
    """Sentences of other kinds, for R-precision."""

    @property
    def label(self) -> str:
        return self.kind.partition("/")[0]

    @property
    def side(self) -> str:
        return self.kind.partition("/")[2]


Source = Callable[[Sequence[Case]], Tensor]
"""Answers, features (N, 40, 205)."""


def sentences_of(data: TrainingSet, window: int) -> list[str]:
    """What describes a window. Where a side is known only what names it: the rest fits both sides."""
    side = data.kinds[window].partition("/")[2]
    return [data.captions[row] for row in data.caption_choices[window] if side in data.captions[row]]


def by_kind(data: TrainingSet) -> dict[str, list[int]]:
    """Windows of each kind."""
    rows: dict[str, list[int]] = {}
    for window, kind in enumerate(data.kinds):
        rows.setdefault(kind, []).append(window)
    return rows


def held_out_cases(held_out: TrainingSet, known: set[str], each: int, seed: int) -> list[Case]:
    """As many cases of every held-out kind that training has, too; pools of 32 sentences, each of another kind."""
    draw = random.Random(seed)
    windows = {kind: rows for kind, rows in by_kind(held_out).items() if kind in known}
    cases = []
    for kind, rows in windows.items():
        for _ in range(each):
            window = draw.choice(rows)
            others = draw.sample([other for other in windows if other != kind], POOL - 1)
            told = tuple(draw.choice(sentences_of(held_out, draw.choice(windows[other]))) for other in others)
            cases.append(Case(kind, draw.choice(sentences_of(held_out, window)), window, told))
    return cases


def strike_cases(data: TrainingSet, each: int, seed: int) -> list[Case]:
    """As many cases of every strike whose limb is known, half of them left."""
    draw = random.Random(seed)
    windows = by_kind(data)
    cases = []
    for label in LIMBS:
        kinds = [label] if label in windows else [f"{label}/{side}" for side in SIDES]
        for number in range(each):
            kind = kinds[number % len(kinds)]
            window = draw.choice(windows[kind])
            cases.append(Case(kind, draw.choice(sentences_of(data, window)), window))
    return cases


def real(data: TrainingSet) -> Source:
    """The clips themselves."""
    return lambda cases: data.features[[case.window for case in cases]]


def another(data: TrainingSet, seed: int) -> Source:
    """Other windows of the same kinds."""
    draw, windows = random.Random(seed), by_kind(data)
    return lambda cases: data.features[[draw.choice(windows[case.kind]) for case in cases]]


def nearest_sentence(data: TrainingSet, embed: Callable[[list[str]], Tensor], seed: int) -> Source:
    """A training window that the training caption nearest to the sentence describes: what needs no prior at all."""
    draw = random.Random(seed)
    known = embed(data.captions)
    windows: dict[int, list[int]] = {}
    for window, rows in enumerate(data.caption_choices):
        for row in rows:
            windows.setdefault(row, []).append(window)

    def answer(cases: Sequence[Case]) -> Tensor:
        likeness = embed([case.caption for case in cases]) @ known[1:].T  # row 0 is the empty sentence
        return data.features[[draw.choice(windows[1 + int(row)]) for row in likeness.argmax(-1)]]

    return answer


def drawn_from(prior: MotionPrior, sampler: str, steps: int, guidance: float, rescale: float, seed: int) -> Source:
    """Samples of a prior, in so many steps: "ancestral", with fresh noise in each, or "ddim", without."""

    def draw(text: Tensor, generator: torch.Generator) -> Tensor:
        def predict(x: Tensor, t: Tensor) -> Tensor:
            return prior.predict_x0(x, t, text, guidance, rescale)

        shape = (len(text), FRAMES, FEATURE_COUNT)
        sample = ddim_sample if sampler == "ddim" else ancestral_sample
        return sample(predict, shape, prior.alphas_cumprod, generator, min(steps, prior.timesteps), prior.device)

    def answer(cases: Sequence[Case]) -> Tensor:
        generator = torch.Generator().manual_seed(seed)
        text = prior.encode_text([case.caption for case in cases])
        return torch.cat([prior.denormalise(draw(rows, generator)).cpu() for rows in text.split(BATCH)])

    return answer
