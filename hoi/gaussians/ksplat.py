"""`.ksplat`, of GaussianSplats3D: sections of buckets; float32 (level 0), or 16 bits and half floats (1, 2).

At levels 1 and 2 a position is 16 bits an axis about the centre of its bucket; harmonics are half floats (1) or bytes
between the file's bounds (2), a band after the other, in it channel by channel.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array
from hoi.errors import InputError
from hoi.gaussians.cloud import sh_from_colours
from hoi.gaussians.found import CloudFile, found

_HEADER, _SECTION = 4096, 1024
_HEAD = np.dtype(
    {
        "names": ["major", "minor", "sections", "count", "level", "low", "high"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u2", "<f4", "<f4"],
        "offsets": [0, 1, 4, 16, 20, 36, 40],
        "itemsize": _HEADER,
    }
)
_SECTION_HEAD = np.dtype(
    {
        "names": ["count", "room", "bucket", "buckets", "block", "stride", "range", "full", "partial", "degree"],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": _SECTION,
    }
)
_REST = (0, 9, 24, 45)
_HALF_RANGE, _STEPS = 1.5, 32767


def read_ksplat(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: another version, broken, or cut short.
    """
    if len(data) < _HEADER:
        raise InputError(f"cut short, {len(data)} of the {_HEADER} bytes of a .ksplat header")
    head = np.frombuffer(data[:_HEADER], _HEAD)[0]
    sections, level = int(head["sections"]), int(head["level"])
    at = _HEADER + sections * _SECTION
    if (head["major"], head["minor"]) != (0, 1) or level > 2 or at > len(data):
        raise InputError(
            f"no readable .ksplat (version {head['major']}.{head['minor']}, level {level}, {sections} sections, "
            f"{len(data)} bytes); allowed are version 0.1, level 0 to 2"
        )
    parts = []
    for section in np.frombuffer(data[_HEADER:at], _SECTION_HEAD):
        part, at = _section(data, at, section, level, (float(head["low"]), float(head["high"])))
        parts.append(part)
    if not parts or not sum(len(part[0]) for part in parts):
        raise InputError("holds no Gaussian")
    bands = max(part[4].shape[1] for part in parts)
    harmonics = [np.pad(part[4], ((0, 0), (0, bands - part[4].shape[1]), (0, 0))) for part in parts]
    columns = [np.concatenate(column) for column in zip(*(part[:4] for part in parts), strict=True)]
    means, quaternions, scales, opacities = columns
    return found(means, quaternions, scales, opacities, np.concatenate(harmonics))


def _section(
    data: bytes | memoryview, at: int, head: np.void, level: int, bounds: tuple[float, float]
) -> tuple[tuple[Array, ...], int]:
    """Means, quaternions, scales, opacities, harmonics of a section, and where the next one starts."""
    count, room, buckets, degree = (int(head[name]) for name in ("count", "room", "buckets", "degree"))
    partial, full, capacity, stride = (int(head[name]) for name in ("partial", "full", "bucket", "stride"))
    if degree > 3 or count > room or full > count:
        raise InputError(f"broken .ksplat: a section of {count} Gaussians in room for {room}, degree {degree}")
    real, kind = ("<f4", "<f4") if level == 0 else ("<u2", "<f2")
    row = np.dtype(
        [("mean", real, 3), ("scale", kind, 3), ("quaternion", kind, 4), ("rgba", "u1", 4),
         ("rest", ("<f4", "<f2", "u1")[level], _REST[degree])]
    )  # fmt: skip
    tables = stride * buckets + 4 * partial
    end = at + tables + row.itemsize * room
    if end > len(data):
        raise InputError(
            f"cut short, or a section of a .ksplat that claims too much: {end} bytes, {len(data)} are there"
        )
    rows = np.frombuffer(data[at + tables : at + tables + row.itemsize * count], row)
    means = rows["mean"].astype(np.float64)
    if level:
        sizes = np.frombuffer(data[at : at + 4 * partial], "<u4")
        left = count - full * capacity  # those in buckets that are not full
        if left < 0 or sizes.sum(dtype=np.int64) < left or (buckets and stride < 12):
            raise InputError(f"broken .ksplat: its buckets hold other than {count} Gaussians")
        last = full + np.searchsorted(sizes.cumsum(dtype=np.int64), np.arange(left), side="right")
        owner = np.concatenate([np.repeat(np.arange(full), capacity), last])
        if count and owner.max() >= buckets:
            raise InputError(f"broken .ksplat: {buckets} buckets, a Gaussian in bucket {owner.max()}")
        centres = np.frombuffer(data[at + 4 * partial : at + tables], np.uint8).reshape(buckets, stride)[:, :12]
        steps = int(head["range"]) or _STEPS
        means = (means - steps) * (float(head["block"]) / 2 / steps) + np.ascontiguousarray(centres).view("<f4")[owner]
    rgba = rows["rgba"] / np.float32(255)
    sh = np.concatenate([sh_from_colours(rgba[:, :3]), _harmonics(rows["rest"], degree, level, bounds)], 1)
    return (means, rows["quaternion"].astype(np.float32), rows["scale"].astype(np.float32), rgba[:, 3], sh), end


def _harmonics(rest: NDArray, degree: int, level: int, bounds: tuple[float, float]) -> Array:
    """(N, K, 3)."""
    values = rest.astype(np.float32).reshape(len(rest), -1)
    if level == 2:
        low, high = bounds[0] or -_HALF_RANGE, bounds[1] or _HALF_RANGE
        values = np.float32(low) + values / np.float32(255) * np.float32(high - low)
    bands, start = [np.zeros((len(rest), 0, 3), np.float32)], 0
    for band in range(1, degree + 1):
        width = 2 * band + 1
        bands.append(values[:, start : start + 3 * width].reshape(-1, 3, width).transpose(0, 2, 1))
        start += 3 * width
    return np.concatenate(bands, 1)
