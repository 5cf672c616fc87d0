"""The run as a camera saw it: MP4 and GIF, of the recorded video where there is one."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from hoi import record
from hoi.data import Run
from hoi.errors import InputError, RunError
from hoi.files import whole_file
from hoi.render.encode import Pixels, Video, check_fps, encode

VIEW = "action"
GIF_WIDTH, GIF_BYTES = 480, 5_000_000
"""Width at most [pixel], and size at most."""
GIF_NARROWEST = 64
GIF_RATE = 50
"""More pictures a second than this no browser plays at their pace."""
_SAMPLES = 16
"""Pictures that the palette is taken from."""


def video_of(run: Run, path: Path) -> Video:
    """The video in the record at `path`; without one, the run drawn as a film shows it.

    Raises:
        InputError: the run shows nothing, or its video is damaged.
    """
    try:
        footage = record.video(path)
    except record.NoVideo:
        return _drawn(run)
    scene_fps = run.scene.fps if run.scene is not None else None
    fps = footage.fps or scene_fps
    if fps is None:
        raise InputError("the run has a video, but no frame rate")
    width, height = (footage.cameras[0].width, footage.cameras[0].height) if footage.cameras else (0, 0)
    return Video(width, height, check_fps(fps), footage.units)


def _drawn(run: Run) -> Video:
    from hoi.render.cameras import HEIGHT, WIDTH
    from hoi.render.film import cameras_of, film
    from hoi.render.replay import replay

    shown = replay(run)
    return encode(film(shown, cameras_of(shown, VIEW, WIDTH, HEIGHT)), shown.fps)


def write_gif(video: Video, path: Path, most: int = GIF_BYTES) -> None:
    """Write a GIF that plays for ever, as wide as `GIF_WIDTH` or as `most` bytes allow.

    Raises:
        InputError: the video cannot be decoded, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    pictures = list(_decoded(video))
    if not pictures:
        raise InputError("the recorded video has no picture that can be decoded")
    fps = float(video.fps)
    if fps > GIF_RATE:
        kept = np.unique(np.floor(np.arange(0, len(pictures), fps / GIF_RATE)).astype(int))
        pictures, fps = [pictures[i] for i in kept], GIF_RATE
    ends = np.rint(np.arange(1, len(pictures) + 1) * 100 / fps) * 10  # GIF counts hundredths of a second
    lasts = np.diff(ends, prepend=0).astype(int).tolist()
    width = min(GIF_WIDTH, pictures[0].shape[1])
    while len(data := _gif(pictures, width, lasts)) > most:
        if width <= GIF_NARROWEST:
            raise RunError(f"{path}: {len(pictures)} pictures make no GIF of {most} bytes; write the MP4")
        width = max(GIF_NARROWEST, int(0.95 * width * (most / len(data)) ** 0.5))
    with whole_file(path) as part:
        part.write_bytes(data)


def _gif(pictures: list[Pixels], width: int, lasts: list[int]) -> bytes:
    """All pictures with one palette, undithered, so that what stands still costs nothing."""
    size = (width, max(1, round(width * pictures[0].shape[0] / pictures[0].shape[1])))
    small = [Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS) for picture in pictures]
    chosen = [small[i] for i in np.unique(np.linspace(0, len(small) - 1, _SAMPLES).round().astype(int))]
    palette = Image.fromarray(np.concatenate([np.asarray(picture) for picture in chosen])).quantize(256)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in small]
    data = io.BytesIO()
    frames[0].save(data, "GIF", save_all=True, append_images=frames[1:], duration=lasts, loop=0, optimize=False)
    return data.getvalue()


def _decoded(video: Video) -> Iterator[Pixels]:
    import av
    from av.error import FFmpegError

    decoder = av.CodecContext.create("h264", "r")
    try:
        for unit in (*video.units, None):
            for frame in decoder.decode(None if unit is None else av.Packet(unit)):  # pyright: ignore
                yield frame.to_ndarray(format="rgb24").astype(np.uint8, copy=False)
    except FFmpegError as error:
        raise InputError(f"the recorded video cannot be decoded: {error.strerror}") from error
