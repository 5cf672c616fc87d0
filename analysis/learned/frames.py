"""What there is to score of a record: the pictures of its video and the prompts of its scene."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from hoi import record
from hoi.errors import InputError

from .. import records
from ..records import Record

Pixels = NDArray[np.uint8]
PROMPTS = ("scene_prompt", "motion_prompt")


@dataclass(frozen=True)
class Clip:
    """A record's video with the texts that asked for it."""

    pictures: Pixels
    """RGB, shape (T, height, width, 3)."""
    fps: float
    prompts: dict[str, str]
    """By name of `PROMPTS`."""


def load(path: Path) -> Clip:
    """The video in the record, or where it has none the one beside it (run.mp4).

    Raises:
        InputError: the record cannot be read, lacks a prompt, or has no video that can be decoded.
    """
    found = records.load(path)
    texts = _texts(found)
    beside = path.with_suffix(".mp4")
    try:
        units = record.video(path).units
    except InputError as error:
        if not beside.is_file():
            raise InputError(f"{error}; and there is no {beside.name} beside it") from error
        pictures, fps = read_mp4(beside)
    else:
        pictures, fps = decode(units, path), _rate(found)
    return Clip(pictures, fps, texts)


def decode(units: tuple[bytes, ...], path: Path) -> Pixels:
    """Pictures (T, height, width, 3) of H.264 access units, one each.

    Raises:
        InputError: they are not that; it names `path`.
    """
    decoder: Any = av.CodecContext.create("h264", "r")
    try:
        frames = [frame for unit in units for frame in decoder.decode(av.Packet(unit))]
        frames += decoder.decode(None)
    except FFmpegError as error:
        raise InputError(f"{path}: its video cannot be decoded: {error.strerror}") from error
    if len(frames) != len(units):
        raise InputError(f"{path}: its video decodes to {len(frames)} pictures where {len(units)} should be")
    return _stacked(frames, path)


def read_mp4(path: Path) -> tuple[Pixels, float]:
    """Pictures (T, height, width, 3) of a video file, and their rate [1/s].

    Raises:
        InputError: it is no video, or says no rate.
    """
    try:
        with av.open(str(path)) as container:
            rate = container.streams.video[0].average_rate
            frames = list(container.decode(video=0))
    except (FFmpegError, IndexError, OSError) as error:
        raise InputError(f"{path} cannot be decoded: {' '.join(str(error).split())}") from error
    if not frames or not rate:
        raise InputError(f"{path} has {len(frames)} pictures at {rate} a second")
    return _stacked(frames, path), float(rate)


def _stacked(frames: list[av.VideoFrame], path: Path) -> Pixels:
    if len({(frame.width, frame.height) for frame in frames}) != 1:
        raise InputError(f"{path}: its pictures must all have one size")
    return np.stack([frame.to_ndarray(format="rgb24") for frame in frames]).astype(np.uint8, copy=False)


def _texts(found: Record) -> dict[str, str]:
    texts = {name: found.conf("scene", name) for name in PROMPTS}
    for name, text in texts.items():
        if not isinstance(text, str) or not text.strip():
            raise InputError(f"{found.path}: scene.{name} of its config is {text!r}, must be a text")
    return texts


def _rate(found: Record) -> float:
    fps = found.conf("scene", "fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < math.inf:
        raise InputError(f"{found.path}: scene.fps of its config is {fps!r}, must be a positive number")
    return float(fps)
