"""What a reader of a format finds in a file, and what all readers share: limits, and float64 until it is centred."""

import zlib
from dataclasses import dataclass

import numpy as np

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians.cloud import cloud_of

INRIA_UP = "INRIA's way, as COLMAP's cameras have it: y points down"
MOST_FLOATS, MOST_PACKED = 64_000_000, 20
"""A compressed file may hold so many numbers, or more if it is not shorter than this many times less: a file of a few
kilobytes that claims a gigabyte is a trap."""
MOST_UNPACKED = 512 << 20
"""Of a file that is packed as a whole [bytes]."""
_LOST = 1e-4  # of the cloud's spread: a coordinate's step in float32 from which on it is centred


@dataclass(frozen=True)
class CloudFile:
    """A cloud in the file's axes and units, and what the file says beside it."""

    cloud: GaussianCloud
    up: str = "-y"
    """The axis of the file that points up, as `hoi.objects.load.UP` names it."""
    why: str = INRIA_UP
    """What says so."""
    notes: tuple[str, ...] = ()
    """What reading did to it, a line each."""


def found(
    means: Array, quaternions: Array, scales: Array, opacities: Array, sh: Array, up: str = "-y", why: str = INRIA_UP,
    notes: tuple[str, ...] = (),
) -> CloudFile:  # fmt: skip
    """A cloud of what a file holds: means (N, 3) as exact as they are there, and centred where float32 would not hold
    them (coordinates of a map)."""
    if len(means):
        finite = means[np.isfinite(means).all(1)]
        low, middle, high = np.percentile(finite, (10, 50, 90), axis=0) if len(finite) else np.zeros((3, 3))
        step = float(np.spacing(np.float32(np.abs(middle).max())))
        if step > _LOST * (high - low).max() > 0:
            means = means - middle
            notes = (
                *notes,
                f"centred: moved by {tuple(np.round(-middle, 3).tolist())}, which float32 does not resolve",
            )
    return CloudFile(cloud_of(means, quaternions, scales, opacities, sh), up, why, notes)


def brief(what: object) -> str:
    """Anything a file says, or an error about it, in at most 80 printable characters of one line."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(what).split()))[:80]


def check_claim(count: int, degree: int, packed: int, bytes_each: int) -> None:
    """Refuse a header that claims what a file of `packed` bytes cannot honestly hold.

    Raises:
        InputError: too many Gaussians.
    """
    floats = count * (11 + 3 * (degree + 1) ** 2)
    if floats > MOST_FLOATS and count * bytes_each > MOST_PACKED * packed:
        raise InputError(
            f"claims {count} Gaussians of degree {degree} in {packed} bytes; a file as long holds at most "
            f"{max(MOST_FLOATS // (11 + 3 * (degree + 1) ** 2), MOST_PACKED * packed // bytes_each)}"
        )


def unzipped(data: bytes | memoryview, most: int, at_least: int = 0) -> bytes:
    """The first bytes, up to `most`, of gzip data.

    Raises:
        InputError: no gzip, cut short, or fewer than `at_least` bytes.
    """
    unpacker = zlib.decompressobj(wbits=31)
    try:
        content = unpacker.decompress(data, most)
    except zlib.error as error:
        raise InputError(f"broken gzip ({error})") from None
    if not unpacker.eof and len(content) < max(most, at_least):
        raise InputError(f"cut short: the gzip data end after {len(content)} bytes unpacked")
    if len(content) < at_least:
        raise InputError(f"cut short, {len(content)} of {at_least} bytes")
    return content
