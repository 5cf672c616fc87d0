"""Sentences in time as one motion of any length: the denoiser's predictions for windows of a timeline, put together.

Spatio-temporal collage (Petrovich et al. 2024, Multi-Track Timeline Control for Text-Driven 3D Human Motion
Generation): at each step of the diffusion every act is denoised by itself, in a window as long as the motions that the
prior was trained on, and of each body part the frames of the act that moves it are kept. Two differences, both for a
prior that knows windows of one length alone: an act that is too long has several, and where two windows meet, one fades
into the other (as in MultiDiffusion, Bar-Tal et al. 2023), where STMC adds both and takes an unconditional prediction
of the seam away (DiffCollage).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from hoi.data import Act
from hoi.motion.features import FEATURE_COUNT, PARTS, columns_of
from hoi.motion.prior import MotionPrior

OVERLAP = 0.5
"""How long one window fades into the next, STMC's [s]."""
PEAK = 1.05
"""How long after a window's start the embedded prior's strikes are fastest, on average, however long it is [s]."""
ROWS = 64
"""Windows in one forward pass."""


@dataclass(frozen=True)
class Layout:
    """The windows of a timeline, all of one length W."""

    acts: tuple[int, ...]
    """Whose sentence each has, (C,)."""
    starts: tuple[int, ...]
    """First frame of each, (C,)."""
    length: int
    weights: Tensor
    """What of each prediction is kept, (C, W, 205): over all windows they sum to 1 at each frame and feature."""

    def near(self, first: int, last: int) -> list[int]:
        """The windows that show one of the frames from `first` to `last`."""
        return [c for c, start in enumerate(self.starts) if start <= last and start + self.length > first]


@dataclass(frozen=True)
class Timeline:
    """The acts of a person, for one prior."""

    prior: MotionPrior
    acts: tuple[Act, ...]
    text: Tensor
    """Features of the sentences, (A, text_dim)."""

    @classmethod
    def of(cls, prior: MotionPrior, acts: Sequence[Act]) -> "Timeline":
        return cls(prior, tuple(acts), prior.encode_text([act.prompt for act in acts]))

    def layout(self, frames: int) -> Layout:
        """Of so many frames of the prior."""
        return layout(self.acts, frames, self.prior.fps, self.prior.lengths)

    def windows(
        self, x_t: Tensor, t: Tensor, chosen: Sequence[Sequence[int]], guidance: float, rescale: float
    ) -> Tensor:
        """X0_hat in the `chosen` windows of each row: x_t (B, T, 205), t (B,), B x K windows -> (B, K, W, 205)."""
        found = self.layout(x_t.shape[1])
        pairs = [(row, window) for row, windows in enumerate(chosen) for window in windows]
        seen = torch.stack([x_t[row, found.starts[c] : found.starts[c] + found.length] for row, c in pairs])
        text = self.text[[found.acts[c] for _, c in pairs]]
        times = t[[row for row, _ in pairs]]
        parts = [
            self.prior.predict_x0(seen[k : k + ROWS], times[k : k + ROWS], text[k : k + ROWS], guidance, rescale)
            for k in range(0, len(pairs), ROWS)
        ]
        return torch.cat(parts).unflatten(0, (len(chosen), -1))

    def predict_x0(self, x_t: Tensor, t: Tensor, guidance: float, rescale: float) -> Tensor:
        """X0_hat of the whole timeline, (B, T, 205)."""
        found = self.layout(x_t.shape[1])
        every = range(len(found.starts))
        predicted = self.windows(x_t, t, [every] * len(x_t), guidance, rescale)
        whole = torch.zeros_like(x_t)
        for c, start in enumerate(found.starts):
            whole[:, start : start + found.length] += found.weights[c].to(x_t) * predicted[:, c]
        return whole


@lru_cache(maxsize=16)
def layout(acts: tuple[Act, ...], frames: int, fps: float, lengths: tuple[int, int]) -> Layout:
    """The windows of acts in so many frames.

    A window is as long as the longest act with the fades at its ends, within the `lengths` that the prior knows; of
    acts that are longer there are several. It lies around its act, that of a strike with a time where the prior's
    strikes peak at that time.
    """
    owners = _owners(acts, frames, fps)
    fade = round(OVERLAP * fps)
    spans = {act: _span(owners, act) for act in range(len(acts)) if (owners == act).any()}
    needed = {act: stop - start + fade * ((start > 0) + (stop < frames)) // 2 for act, (start, stop) in spans.items()}
    length = min(max(lengths[0], min(lengths[1], max(needed.values()))), frames)

    of_act: list[int] = []
    starts: list[int] = []
    window_at = np.full_like(owners, -1)
    for act, (start, stop) in spans.items():
        count = 1 if needed[act] <= length else math.ceil((stop - start) / max(length - fade - 1, 1))
        edges = np.linspace(start, stop, count + 1).round().astype(int)
        for first, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            begin = round((first + end - length) / 2)
            if count == 1 and math.isfinite(acts[act].at):
                peak = round((acts[act].at - PEAK) * fps)
                begin = min(max(peak, end + fade // 2 - length), first - fade // 2)
            window_at[:, first:end][owners[:, first:end] == act] = len(starts)
            of_act.append(act)
            starts.append(min(max(begin, 0), frames - length))
    weights = torch.zeros(len(starts), length, FEATURE_COUNT)
    for row, part in enumerate(PARTS):
        columns = columns_of(part)
        for window, kept in _faded(window_at[row], fade):
            shown = torch.as_tensor(kept[starts[window] : starts[window] + length], dtype=torch.float32)
            weights[window, :, columns] += shown[:, None]
    return Layout(tuple(of_act), tuple(starts), length, weights)


def _owners(acts: Sequence[Act], frames: int, fps: float) -> np.ndarray:
    """The act that moves each body part in each frame, (5, T).

    An act that names the part; else the one that names none; else, as STMC has it, the one that moves the legs, or the
    most. Where there is none, the one before goes on, and the first begins at once.
    """
    spans = [(round(act.start * fps), min(round(act.end * fps), frames)) for act in acts]
    base, named = np.full(frames, -1), np.full((len(PARTS), frames), -1)
    ranks = [(not act.parts, "legs" in act.parts, len(act.parts)) for act in acts]
    for act in sorted(range(len(acts)), key=ranks.__getitem__):  # the best claim last
        start, stop = spans[act]
        base[start:stop] = act
        for row, part in enumerate(PARTS):
            if part in acts[act].parts:
                named[row, start:stop] = act
    known = np.flatnonzero(base >= 0)
    if not len(known):
        base[:] = 0
    else:
        at = np.searchsorted(known, np.arange(frames), side="right") - 1
        base = base[known[np.maximum(at, 0)]]
    return np.where(named >= 0, named, base)


def _span(owners: np.ndarray, act: int) -> tuple[int, int]:
    """From the first to behind the last frame in which it moves anything."""
    frames = np.flatnonzero((owners == act).any(axis=0))
    return int(frames[0]), int(frames[-1]) + 1


def _faded(window_at: np.ndarray, fade: int) -> list[tuple[int, np.ndarray]]:
    """Of each stretch of frames with one window: the window, and how much it counts in each frame, (T,)."""
    frames = len(window_at)
    edges = [0, *(np.flatnonzero(np.diff(window_at)) + 1).tolist(), frames]
    lengths = np.diff(edges)
    at = np.arange(frames) + 0.5

    def risen(k: int) -> np.ndarray:
        """From 0 to 1 around the edge k."""
        if k == 0:
            return np.ones(frames)
        if k == len(edges) - 1:
            return np.zeros(frames)
        half = min(fade, int(lengths[k - 1]), int(lengths[k])) / 2
        share = np.clip((at - edges[k] + half) / (2 * half), 0, 1)
        return share**2 * (3 - 2 * share)

    return [(int(window_at[edge]), risen(k) - risen(k + 1)) for k, edge in enumerate(edges[:-1])]
