"""What a record's camera saw, as a browser takes it: an MP4, and a few stills of it in a row."""

import base64
import io
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from hoi import record
from hoi.errors import InputError
from hoi.render.encode import Video, check_fps, write_mp4

STILLS = 8
STILL_HEIGHT = 150
"""[pixel]"""
QUALITY = 80
"""Of the stills' JPEG."""
MOST_PIXELS = 4096 * 4096
"""A picture that claims more is not decoded."""
LONGEST = 120.0
"""Seconds of video that are looked at."""


@dataclass(frozen=True)
class Still:
    jpeg: bytes
    time: float
    """[s]"""
    struck: bool
    """The one nearest to the contact."""


@dataclass(frozen=True)
class Film:
    mp4: bytes
    stills: tuple[Still, ...]
    width: int
    """[pixel], as `height`."""
    height: int
    fps: float
    seconds: float


def film(path: Path, fps: float | None, contact: float | None) -> Film:
    """The video in the record, or where it has none the one beside it (run.mp4).

    Args:
        fps: the run's frames a second; None where no one knows. contact: time of the contact [s].

    Raises:
        InputError: there is no video, or none that can be decoded.
    """
    beside = path.with_suffix(".mp4")
    try:
        footage = record.video(path)
    except InputError:
        if not beside.is_file():
            raise
        return _look(beside.read_bytes(), contact)
    rate = check_fps(footage.fps or fps or 0.0)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mp4"
        write_mp4(Video(0, 0, rate, footage.units), file)  # copied, not encoded: its size stands in the pictures
        return _look(file.read_bytes(), contact)


def choose(count: int, wanted: int, struck: int | None) -> list[int]:
    """`wanted` of the pictures 0..count-1, evenly, `struck` among them in place of its nearest neighbour."""
    chosen = np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(int))
    if struck is not None and struck not in chosen:
        inner = chosen[1:-1] if len(chosen) > 2 else chosen
        inner[np.abs(inner - struck).argmin()] = struck
    return sorted(chosen.tolist())


def _look(mp4: bytes, contact: float | None) -> Film:
    with av.open(io.BytesIO(mp4), "r", metadata_errors="replace") as clip:
        track = _track(clip)
        rate = Fraction(track.average_rate or 0)
        if not rate:
            raise InputError("its video says no rate")
        count = sum(packet.size > 0 for packet in clip.demux(track))
    if count > LONGEST * rate:
        raise InputError(f"its video lasts {float(count / rate):g} s, at most {LONGEST:g} s are shown")
    struck = None if contact is None else round(contact * rate)
    struck = struck if struck is not None and struck < count else None
    chosen, stills, size = set(choose(count, STILLS, struck)), [], (0, 0)
    with av.open(io.BytesIO(mp4), "r", metadata_errors="replace") as clip:
        for index, frame in enumerate(clip.decode(_track(clip))):
            size = frame.width, frame.height
            if index in chosen:
                stills.append(Still(_jpeg(frame), float(index / rate), index == struck))
    if len(stills) != len(chosen):
        raise InputError(f"its video has {len(stills)} of {len(chosen)} pictures that can be decoded")
    return Film(mp4, tuple(stills), *size, float(rate), float(count / rate))


def _track(clip: Any) -> Any:
    if not clip.streams.video:
        raise InputError("its video has no pictures")
    track = clip.streams.video[0]
    if not 0 < track.width * track.height <= MOST_PIXELS:
        raise InputError(f"its video claims {track.width}x{track.height}, at most {MOST_PIXELS} pixels are decoded")
    track.thread_count = 1
    return track


def _jpeg(frame: Any) -> bytes:
    width = max(1, round(frame.width * STILL_HEIGHT / frame.height))
    small = frame.reformat(width=width, height=STILL_HEIGHT, format="rgb24", interpolation="AREA")
    file = io.BytesIO()
    Image.fromarray(small.to_ndarray()).save(file, "JPEG", quality=QUALITY, optimize=True)
    return file.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """Bytes as a place that a page can show without asking for anything."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
