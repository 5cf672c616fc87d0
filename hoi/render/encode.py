"""Pictures -> H.264 -> MP4, and PNG. The only module that knows PyAV.

One encoding serves twice: its access units go into records as they are (Annex B, a picture each, no B-frames, parameter
sets with every key frame, as `foxglove.CompressedVideo` wants them) and into an MP4 without being encoded again.
"""

import io
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hoi.errors import InputError
from hoi.files import whole_file

CRF = 18
"""Constant rate factor of x264: what is lost cannot be seen."""
PRESET = "fast"
KEY_FRAMES = 1.0
"""Seconds from one key frame to the next, so that a viewer can jump."""
_BT709 = 1  # the code of these primaries, transfer and matrix in H.264, table E-3 to E-5
_LIMITED_RANGE = 1

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Video:
    """Encoded pictures."""

    width: int
    """[pixel], as `height`."""
    height: int
    fps: Fraction
    units: tuple[bytes, ...]
    """H.264 access units in Annex B, one a picture, in the order in which they are shown."""

    def __len__(self) -> int:
        return len(self.units)


def check_size(width: int, height: int) -> None:
    """H.264 with colours at half the resolution needs even sizes.

    Raises:
        InputError: an odd size, or one that is too small or too large.
    """
    if width % 2 or height % 2 or not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise InputError(f"size {width}x{height}: a video's width and height are even numbers from 16 to 8192")


def check_fps(fps: float) -> Fraction:
    """The frame rate as a ratio of small numbers.

    Raises:
        InputError: not a rate that can be played.
    """
    if not 0.1 <= fps <= 1000:
        raise InputError(f"{fps:g} pictures a second: 0.1 to 1000 are allowed")
    return Fraction(fps).limit_denominator(1001)


def encode(pictures: Iterable[Pixels], fps: float) -> Video:
    """Encode pictures (height, width, 3), display-ready RGB in bytes, all of one size.

    One thread, so that the same pictures give the same bytes.

    Raises:
        InputError: as `check_size` and `check_fps`.
        ValueError: no pictures, or pictures of different sizes or types.
    """
    rate, coder, size, units = check_fps(fps), None, (0, 0), []
    for index, picture in enumerate(pictures):
        if coder is None:
            size = picture.shape[:2]
            coder = _coder(size[1], size[0], rate)
        if picture.shape != (*size, 3) or picture.dtype != np.uint8:
            raise ValueError(f"picture {index} is {picture.shape} {picture.dtype}, not {(*size, 3)} uint8")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709")
        frame.pts = index
        units += [bytes(packet) for packet in coder.encode(frame)]
    if coder is None:
        raise ValueError("no pictures to encode")
    units += [bytes(packet) for packet in coder.encode(None)]
    return Video(size[1], size[0], rate, tuple(units))


def _coder(width: int, height: int, rate: Fraction) -> av.VideoCodecContext:
    check_size(width, height)
    coder: Any = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = width, height, "yuv420p"
    coder.framerate, coder.time_base = rate, 1 / rate
    coder.gop_size, coder.max_b_frames, coder.thread_count = max(1, round(KEY_FRAMES * rate)), 0, 1
    coder.color_primaries = coder.color_trc = coder.colorspace = _BT709
    coder.color_range = _LIMITED_RANGE
    coder.options = {"crf": str(CRF), "preset": PRESET, "x264-params": "repeat-headers=1:annexb=1"}
    return coder


def write_mp4(video: Video, path: Path) -> None:
    """Write an MP4 whose index comes first, so that it plays while it loads.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    stream = io.BytesIO(b"".join(video.units))
    with whole_file(path) as part, av.open(stream, "r", format="h264") as source:
        with av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as target:
            track = target.add_stream_from_template(source.streams.video[0])
            track.time_base = 1 / video.fps
            index = 0
            for packet in source.demux(source.streams.video[0]):
                if packet.size == 0:  # the demuxer's word for the end
                    continue
                packet.stream, packet.time_base = track, 1 / video.fps
                packet.pts, packet.dts, packet.duration = index, index, 1
                target.mux(packet)
                index += 1


def write_png(picture: Pixels, path: Path) -> None:
    """Write a picture (height, width, 3) of bytes.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    with whole_file(path) as part:
        Image.fromarray(picture).save(part, format="png", optimize=False)
