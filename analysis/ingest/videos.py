"""An MP4 of another system as the video of a record: decoded, and encoded as records have it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from hoi.errors import InputError
from hoi.record import Footage
from hoi.render.encode import Video, check_fps, check_size, encode

MOST_PICTURES = 3000
MOST_PIXELS = 4096 * 4096


def read_video(path: Path, fps: float | None = None) -> tuple[Video, Footage]:
    """The video, at its own rate or at `fps`; an odd last row or column is cut off.

    Raises:
        InputError: no such file, no MP4, cut short, damaged, or too large.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with open(path, "rb") as file, av.open(file, format="mp4") as container:  # as a file: it can name no other one
            if not container.streams.video:
                raise InputError(f"{path} has no video in it")
            stream = container.streams.video[0]
            rate = fps or float(stream.average_rate or 0)
            check_fps(rate)
            check_size(stream.width // 2 * 2, stream.height // 2 * 2)
            if stream.width * stream.height > MOST_PIXELS:
                raise InputError(f"{path} has pictures of {stream.width}x{stream.height}, at most {MOST_PIXELS} pixels")
            video = encode(_pictures(container, path), rate)
            promised = stream.frames
    except InputError as error:
        raise error if str(path) in str(error) else InputError(f"{path}: {error}") from None
    except FFmpegError as error:
        raise InputError(f"{path} cannot be decoded: {error.strerror or 'no MP4'}") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if promised and len(video) < promised:
        raise InputError(f"{path} is cut short: {len(video)} of {promised} pictures can be decoded")
    if len(video) < 2:
        raise InputError(f"{path} has {len(video)} picture, 2 or more are needed")
    return video, Footage(video.units, (), float(video.fps))


def _pictures(container: Any, path: Path) -> Iterator[NDArray[np.uint8]]:
    for index, frame in enumerate(container.decode(video=0)):
        if index == MOST_PICTURES:
            raise InputError(f"{path} has more than {MOST_PICTURES} pictures")
        yield frame.to_ndarray(format="rgb24")[: frame.height // 2 * 2, : frame.width // 2 * 2]
