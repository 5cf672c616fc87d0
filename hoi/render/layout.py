"""Pictures side by side, with words on them."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

GAP = 4
"""Between pictures [pixel]; even, as all sizes in a video."""
INK, HALO = (34, 38, 43), (248, 248, 247)

Pixels = NDArray[np.uint8]
"""RGB, (height, width, 3)."""


def tile(pictures: Sequence[Pixels], columns: int) -> Pixels:
    """Pictures of one size in rows of `columns`; white where there are none."""
    if len(pictures) == 1:
        return pictures[0]
    rows = -(-len(pictures) // columns)
    height, width, _ = pictures[0].shape
    page = np.full((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), 255, np.uint8)
    for index, picture in enumerate(pictures):
        top, left = (index // columns) * (height + GAP), (index % columns) * (width + GAP)
        page[top : top + height, left : left + width] = picture
    return page


def columns_for(count: int) -> int:
    """How many of `count` pictures to put side by side: up to three, or what makes rows of about equal length."""
    return count if count <= 3 else -(-count // -(-count // 3))


def shrink(picture: Pixels, height: int) -> Pixels:
    """The picture, no higher than `height`."""
    if len(picture) <= height:
        return picture
    size = (max(1, round(picture.shape[1] * height / len(picture))), height)
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))


def write_on(picture: Pixels, words: str, *, bottom: bool = False) -> Pixels:
    """The picture with words in its upper or lower left corner, as large as fits."""
    if not words:
        return picture
    height, width, _ = picture.shape
    size = max(13, round(height / 21))
    while size > 6 and _font(size).getlength(words) > width - 1.4 * size:
        size -= 1
    margin = 0.7 * size
    page = Image.fromarray(picture)
    place, anchor = ((margin, height - margin), "ld") if bottom else ((margin, margin), "la")
    draw = ImageDraw.Draw(page)
    draw.text(place, words, fill=INK, font=_font(size), anchor=anchor, stroke_width=max(1, size // 9), stroke_fill=HALO)
    return np.asarray(page)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
