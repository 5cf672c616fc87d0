"""A run's Gaussians frame by frame, packed as viser's splats are; worked out when first asked for."""

import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from hoi import record
from hoi.data import Run
from hoi.errors import about
from hoi.gaussians import SH_C0
from hoi.render.film import lit_at
from hoi.render.look import Look
from hoi.render.replay import Replay, replay
from hoi.render.splats import Splats

Packed = NDArray[np.uint32]
UNIT = 0.01
"""Packed lengths are in these [m]: variances are half floats, which in square metres end at (0.24 mm)^2."""
KEPT_BYTES = 600_000_000
"""Of packed frames, over all runs together; what does not fit is worked out again each time."""


Moment = dict[str, Packed]
"""What a run shows in one frame: "person" and "object", whichever it has."""


class Moments:
    """The frames of a run. May be asked from several threads."""

    def __init__(self, run: Run, kept_bytes: int = KEPT_BYTES) -> None:
        """
        Raises:
            InputError: as `hoi.render.replay.replay`.
        """
        self.run, self._look = run, Look()
        self.replay: Replay = replay(run)
        self._kept: dict[int, Moment] = {}
        self._room, self._lock = kept_bytes, threading.Lock()
        self._last: dict[str, tuple[Splats, Packed]] = {}

    def at(self, frame: int) -> Moment:
        """What is seen in a frame of the run."""
        found = self._kept.get(frame)
        if found is None:
            with self._lock:
                found = self._kept.get(frame) or self._made(frame)
        return found

    def prepare(self, frame: int) -> bool:
        """Work a frame out ahead; whether there was room to keep it."""
        self.at(frame)
        return frame in self._kept

    def _made(self, frame: int) -> Moment:
        seen = lit_at(self.replay, self.replay.parts(frame), self._look)
        moment = {name: self._packed(name, splats) for name, splats in zip(self.replay.names, seen, strict=True)}
        size = sum(packed.nbytes for packed in moment.values())
        if size <= self._room:
            self._room -= size
            self._kept[frame] = moment
        return moment

    def _packed(self, part: str, splats: Splats) -> Packed:
        last = self._last.get(part)
        if last is None or last[0] is not splats:  # what neither moves nor is lit anew is the same object
            last = self._last[part] = splats, pack(splats)
        return last[1]


def load(paths: Sequence[Path]) -> list[Moments]:
    """The runs of records.

    Raises:
        InputError: as `hoi.record.read`, or one has nothing to show.
    """
    found = []
    for path in paths:
        run = record.read(path)
        with about(path):
            found.append(Moments(run, KEPT_BYTES // len(paths)))
    return found


def pack(splats: Splats) -> Packed:
    """Eight words a Gaussian, (N, 8): centre (3 f4), nothing, upper triangle of the covariance (6 f2), RGBA (4 u1).

    Lengths in `UNIT`. Colours are those of degree 0; what is not finite is transparent.
    """
    means, covariances = splats.means.numpy() / np.float32(UNIT), splats.covariances.numpy() / np.float32(UNIT**2)
    rgba = np.column_stack([0.5 + SH_C0 * splats.sh[:, 0].numpy(), splats.opacities.numpy()])
    broken = ~(np.isfinite(means).all(1) & np.isfinite(covariances).all((1, 2)) & np.isfinite(rgba).all(1))
    if broken.any():
        means, covariances, rgba = (np.where(broken.reshape(-1, *[1] * (a.ndim - 1)), 0, a)
                                    for a in (means, covariances, rgba))  # fmt: skip
    packed = np.zeros((len(splats), 8), np.uint32)
    packed[:, :3] = np.ascontiguousarray(means, np.float32).view(np.uint32)
    triangle = covariances.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].clip(-65504, 65504)
    packed[:, 4:7] = np.ascontiguousarray(triangle, np.float16).view(np.uint32)
    packed[:, 7] = np.rint(np.clip(rgba, 0, 1) * 255).astype(np.uint8).view(np.uint32)[:, 0]
    return packed


def faded(packed: Packed, opacity: float) -> Packed:
    """The same Gaussians with their opacities times `opacity`."""
    if opacity >= 1:
        return packed
    rgba = packed[:, 7].copy().view(np.uint8).reshape(-1, 4)
    rgba[:, 3] = np.rint(rgba[:, 3] * opacity)
    result = packed.copy()
    result[:, 7] = rgba.view(np.uint32)[:, 0]
    return result


def single_threaded() -> None:
    """Posing a frame is so little work that more threads than one only take time from the pictures."""
    torch.set_num_threads(1)
