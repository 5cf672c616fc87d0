"""Any video -> an MP4 that every browser plays and that says nothing about where it comes from."""

from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.render.encode import Pixels, encode, write_mp4

LONGEST = 120.0
"""Seconds a clip of a study may last."""


def anonymise(source: Path, target: Path) -> None:
    """Write the pictures of `source` alone: no tags, no chapters, no sound, which could name the system.

    H.264 at 4:2:0 is kept bit for bit in a new container; everything else is encoded anew.

    Raises:
        InputError: not a video, one without pictures, or one that is too long; or `target` cannot be written.
    """
    try:
        with av.open(str(source), metadata_errors="replace") as clip:
            if not clip.streams.video:
                raise InputError(f"{source} has no pictures")
            track = clip.streams.video[0]
            seconds = 0.0 if clip.duration is None else clip.duration / av.time_base
            if seconds > LONGEST:
                raise InputError(f"{source} lasts {seconds:g} s; at most {LONGEST:g} s are allowed")
            if track.codec_context.name == "h264" and track.codec_context.pix_fmt in ("yuv420p", "yuvj420p"):
                _copy(clip, track, target)
                return
            pictures = (_even(frame) for frame in clip.decode(track))
            write_mp4(encode(pictures, float(track.average_rate or 25)), target)
    except FFmpegError as error:
        raise InputError(f"{source} is no video that can be read: {error.strerror}") from error
    except ValueError as error:  # `encode` got no pictures, or some of another size; InputError is one too
        raise error if isinstance(error, InputError) else InputError(f"{source}: {error}") from error


def _copy(clip: InputContainer, track: av.VideoStream, target: Path) -> None:
    with whole_file(target) as part, av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as out:
        copy = out.add_stream_from_template(track)
        copy.metadata.clear()
        count = 0
        for packet in clip.demux(track):
            if packet.dts is None:  # the demuxer's word for the end
                continue
            packet.stream = copy
            out.mux(packet)
            count += 1
        if not count:
            raise ValueError("no pictures")


def _even(frame: av.VideoFrame) -> Pixels:
    """H.264 wants even sizes: the last row or column goes."""
    picture = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
    return picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
