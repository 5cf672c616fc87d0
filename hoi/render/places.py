"""Grounds that read as a place, drawn by rule: mown grass, a court's coat, a gym's planks. Their pattern has the size
of the real thing, so that lengths can be read off a picture."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from torch import Tensor

from hoi.data import Array
from hoi.render import Ground

RGB = tuple[float, float, float]
TEXELS = 512


@dataclass(frozen=True)
class Place:
    """A ground's look; colours as shown."""

    dark: RGB
    light: RGB
    """Of the pattern's ends."""
    size: float
    """Of the pattern, which repeats [m]."""
    pattern: Callable[[], Array]
    """Values around [0, 1], (TEXELS, TEXELS); they repeat at the borders."""
    line: RGB
    line_every: float
    """[m]"""
    line_width: float
    horizon: RGB
    """What the ground fades to, and the sky begins with."""
    zenith: RGB


def _waves(seed: int, low: float, high: float, stretch: float = 1.0) -> Array:
    """Noise of mean 0 and deviation 1 with `low` to `high` waves a side, longer along y by `stretch`."""
    rng = np.random.default_rng(seed)
    fy, fx = np.meshgrid(np.fft.fftfreq(TEXELS, 1 / TEXELS), np.fft.fftfreq(TEXELS, 1 / TEXELS), indexing="ij")
    waves = np.hypot(fx, fy * stretch)
    band = np.exp(-0.5 * (waves / high) ** 2) * (1 - np.exp(-0.5 * (waves / low) ** 2))
    image = np.fft.ifft2(np.fft.fft2(rng.normal(size=(TEXELS, TEXELS))) * band).real
    return image / image.std()


def _grass() -> Array:
    """Blades, tufts, and the stripes of the mower."""
    edge = 0.5 + 0.5 * np.tanh(8 * np.sin(2 * np.pi * (np.arange(TEXELS) + 0.5) / TEXELS))[None, :]
    return 0.34 + 0.32 * edge + 0.13 * _waves(0, 40, 190, 0.5) + 0.06 * _waves(1, 4, 20)


def _court() -> Array:
    """A rolled coat with a fine grain."""
    return 0.5 + 0.10 * _waves(2, 60, 250) + 0.04 * _waves(3, 2, 9)


def _gym() -> Array:
    """Planks of beech, 8 cm by 1 m in a pattern of 2 m, each of its own tone, with grain and joints."""
    rows = 24
    y, x = np.meshgrid(np.arange(TEXELS), np.arange(TEXELS), indexing="ij")
    row = x * rows // TEXELS
    shift = (np.random.default_rng(4).integers(0, TEXELS, rows))[row]
    plank = ((y + shift) % TEXELS) * 2 // TEXELS
    tone = np.random.default_rng(5).normal(size=(rows, 2))[row, plank]
    joint = (x * rows % TEXELS < rows) | ((y + shift) % (TEXELS // 2) < 2)
    return np.where(joint, -0.25, 0.5 + 0.15 * tone + 0.08 * _waves(6, 20, 160, 9.0))


PLACES = {
    Ground.grass: Place(
        (0.17, 0.31, 0.11), (0.38, 0.55, 0.22), 3.0, _grass, (0.93, 0.95, 0.90), 11.0, 0.10,
        (0.80, 0.87, 0.93), (0.36, 0.58, 0.86),
    ),
    Ground.court: Place(
        (0.14, 0.36, 0.48), (0.26, 0.50, 0.62), 2.0, _court, (0.90, 0.92, 0.92), 3.0, 0.05,
        (0.84, 0.88, 0.92), (0.45, 0.63, 0.86),
    ),
    Ground.gym: Place(
        (0.52, 0.36, 0.21), (0.86, 0.68, 0.46), 2.0, _gym, (0.20, 0.34, 0.55), 4.0, 0.05,
        (0.80, 0.79, 0.76), (0.93, 0.93, 0.92),
    ),
}  # fmt: skip


@cache
def pyramid(ground: Ground) -> tuple[Tensor, tuple[int, ...]]:
    """The pattern and its halvings down to one texel, one after the other, and where each begins."""
    level = torch.tensor(PLACES[ground].pattern(), dtype=torch.float32)
    levels = [level.flatten()]
    while level.shape[0] > 1:
        level = torch.nn.functional.avg_pool2d(level[None, None], 2)[0, 0]
        levels.append(level.flatten())
    starts = np.cumsum([0] + [len(each) for each in levels[:-1]])
    return torch.cat(levels), tuple(starts.tolist())


def pattern_at(ground: Ground, places: Tensor, span: Tensor) -> Tensor:
    """The pattern at places (2, H, W) [m] over footprints `span` [m] wide, (H, W): trilinear, repeating."""
    texels, starts = pyramid(ground)
    texels = texels.to(places.device)
    begin = torch.tensor(starts, device=places.device)
    size = PLACES[ground].size
    fine = (span * (TEXELS / size)).clamp_min(1.0).log2().clamp_max(len(starts) - 1.001)
    level = fine.long()
    mix = fine - level
    found = []
    for each in (level, level + 1):
        side = TEXELS >> each
        x, y = (axis * (side / size) - 0.5 for axis in places)
        left, top = x.floor(), y.floor()
        right, down = x - left, y - top
        columns = [(left.long() + step) % side for step in (0, 1)]
        rows = [begin[each] + (top.long() + step) % side * side for step in (0, 1)]
        above, below = (texels[row + columns[0]] * (1 - right) + texels[row + columns[1]] * right for row in rows)
        found.append(above * (1 - down) + below * down)
    return found[0] + (found[1] - found[0]) * mix
