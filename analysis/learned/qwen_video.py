"""A video as Qwen2-VL and Qwen2.5-VL take it: sampled, resized and cut into patches.

The rules are those of `qwen-vl-utils` and of the processor of `transformers`, which needs torchvision for them.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hoi.errors import InputError

from .frames import Pixels

CLIP_MEAN, CLIP_STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
LEAST_FRAMES, MOST_FRAMES = 4, 768


@dataclass(frozen=True)
class Sampling:
    """How much of a video the model sees. The defaults are those of VQAScore (Lin et al. 2024)."""

    fps: float = 8.0
    """Pictures a second that are looked at."""
    least_pixels: int = 128 * 28 * 28
    """Of a picture."""
    most_pixels: int = 360 * 420


@dataclass(frozen=True)
class Cells:
    """Of a vision tower."""

    patch: int
    """Side [pixel]."""
    merge: int
    """Patches along the side of what becomes one token."""
    frames: int
    """Pictures a patch spans."""


@dataclass(frozen=True)
class VideoPatches:
    values: Tensor
    """(grid_t * grid_h * grid_w, 3 * frames * patch^2), the patches of a token side by side."""
    grid: tuple[int, int, int]
    """Patches along time, height and width."""
    seconds: float
    """From a patch to the next in time [s]."""


def cut(pictures: Pixels, fps: float, cells: Cells, sampling: Sampling) -> VideoPatches:
    """The patches of a video (T, height, width, 3) of RGB bytes.

    Raises:
        InputError: as `sampled` and `fitted`.
    """
    chosen = sampled(len(pictures), fps, cells.frames, sampling.fps)
    height, width = fitted(pictures.shape[1], pictures.shape[2], cells.patch * cells.merge, sampling)
    video = torch.from_numpy(np.ascontiguousarray(pictures[chosen])).permute(0, 3, 1, 2)
    if video.shape[2:] != (height, width):
        video = torch.nn.functional.interpolate(video, (height, width), mode="bicubic", antialias=True)
    mean, std = (torch.tensor(values)[:, None, None] for values in (CLIP_MEAN, CLIP_STD))
    video = (video / 255 - mean) / std
    grid = len(chosen) // cells.frames, height // cells.patch, width // cells.patch
    merge, patch = cells.merge, cells.patch
    blocks = video.reshape(
        grid[0], cells.frames, 3, grid[1] // merge, merge, patch, grid[2] // merge, merge, patch
    )  # time, frame, colour, then row and column each of token, patch, pixel
    values = blocks.permute(0, 3, 6, 4, 7, 2, 1, 5, 8).reshape(math.prod(grid), -1)
    return VideoPatches(values, grid, cells.frames * len(pictures) / (len(chosen) * fps))


def sampled(total: int, fps: float, multiple: int, wanted: float) -> NDArray[np.int64]:
    """Indices of pictures spread evenly over a video, first and last among them: `wanted` a second.

    Raises:
        InputError: the video has fewer pictures than `multiple`.
    """
    if total < multiple:
        raise InputError(f"its video has {total} pictures, the model looks at {multiple} at once")
    count = min(max(total / fps * wanted, LEAST_FRAMES), MOST_FRAMES, total)
    return np.linspace(0, total - 1, int(count // multiple) * multiple).round().astype(np.int64)


def fitted(height: int, width: int, multiple: int, sampling: Sampling) -> tuple[int, int]:
    """Height and width of about the same aspect: multiples, whose product is within the sampling's pixels.

    Raises:
        InputError: one side is over 200 times the other.
    """
    if max(height, width) > 200 * min(height, width):
        raise InputError(f"its pictures are {width}x{height}; the model takes sides of up to 1:200")
    rows, columns = round(height / multiple) * multiple, round(width / multiple) * multiple
    if rows * columns > sampling.most_pixels:
        shrink = math.sqrt(height * width / sampling.most_pixels)
        rows, columns = (max(multiple, math.floor(side / shrink / multiple) * multiple) for side in (height, width))
    elif rows * columns < sampling.least_pixels:
        grow = math.sqrt(sampling.least_pixels / (height * width))
        rows, columns = (math.ceil(side * grow / multiple) * multiple for side in (height, width))
    return rows, columns
