"""`.spz`, Niantic's: positions, alphas, colours, log scales, rotations and harmonics of all Gaussians, one by one.

Versions 2 and 3 are one gzip stream, version 4 has a plain header of 32 bytes, extensions, a table and a zstd stream
for each of the six. Axes are right, up, back unless Adobe's extension says otherwise.
"""

import gzip
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.files import whole_file
from hoi.gaussians.cloud import sh_degree
from hoi.gaussians.found import CloudFile, check_claim, found, unzipped

MAGIC, VERSION = 0x5053474E, 3
FRACTION = 16
"""Bits after the point of a position that is written: steps of 0.015 mm up to 128 m; fewer in a larger scene."""
_HEADER = struct.Struct("<IIIBBBB")
_LONG_HEADER = struct.Struct("<IIIBBBBI12x")
_EXTENDED = 0x2  # the flag
_ADOBE_AXES = 0xADBE0003
_AXES = (
    None, "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF", "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"
)  # fmt: skip
_LETTERS = {"R": (0, 1), "L": (0, -1), "U": (1, 1), "D": (1, -1), "B": (2, 1), "F": (2, -1)}


def read_spz(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: another version, broken, or cut short.
    """
    packed = bytes(data[:2]) == b"\x1f\x8b"
    head = unzipped(data, _HEADER.size, _HEADER.size) if packed else bytes(data[: _LONG_HEADER.size])
    if len(head) < (_HEADER.size if packed else _LONG_HEADER.size):
        raise InputError(f"cut short, {len(head)} bytes of an SPZ header")
    magic, version, count, degree, bits, flags, streams = _HEADER.unpack(head[: _HEADER.size])
    if magic != MAGIC or version not in ((2, 3) if packed else (4,)) or degree > 4 or bits > 24:
        raise InputError(
            f"no readable SPZ (magic {magic:#x}, version {version}, degree {degree}, {count} points); "
            f"allowed are version 2, 3 and 4, degree 0 to 4"
        )
    # bytes a Gaussian: position, alpha, colour, log scale, rotation, higher harmonics
    widths = (9, 1, 3, 3, 3 if version == 2 else 4, 3 * ((degree + 1) ** 2 - 1))
    check_claim(count, degree, len(data), sum(widths))
    if packed:
        size = count * sum(widths)
        payload = unzipped(data, _HEADER.size + size + _MOST_EXTENSIONS, _HEADER.size + size)[_HEADER.size :]
        blocks = np.split(np.frombuffer(payload[:size], np.uint8), count * np.cumsum(widths)[:-1])
        extensions = payload[size:]
    else:
        (table,) = _LONG_HEADER.unpack(head)[-1:]
        blocks = _streams(data, table, streams, [count * width for width in widths])
        extensions = bytes(data[_LONG_HEADER.size : min(table, _LONG_HEADER.size + _MOST_EXTENSIONS)])
    up, why, mirror = _axes(extensions if flags & _EXTENDED else b"")
    return _decoded(blocks, count, version, degree, bits, up, why, mirror)


_MOST_EXTENSIONS = 1 << 16


def _streams(data: bytes | memoryview, table: int, streams: int, sizes: list[int]) -> list[NDArray[np.uint8]]:
    """The unpacked streams of version 4; the last is left out where there are no harmonics."""
    import zstandard

    wanted = sizes if sizes[-1] else sizes[:-1]
    if streams not in (len(wanted), len(sizes)) or not _LONG_HEADER.size <= table <= len(data) - 16 * streams:
        raise InputError(f"broken SPZ: {streams} streams with a table at byte {table} of {len(data)}")
    entries = np.frombuffer(data[table : table + 16 * streams], "<u8").reshape(-1, 2).tolist()
    at, blocks = table + 16 * streams, []
    for (packed, unpacked), size in zip(entries, sizes, strict=False):
        if unpacked != size or packed > len(data) - at:
            raise InputError(f"broken SPZ or cut short: a stream of {packed} bytes for {unpacked}, must be for {size}")
        try:
            reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(bytes(data[at : at + packed]))
            block = reader.read(size + 1) if size or packed else b""
        except zstandard.ZstdError as error:
            raise InputError(f"broken SPZ: no zstd stream ({error})") from None
        if len(block) != size:
            raise InputError(f"broken SPZ: a stream unpacks to {len(block)} bytes, must be {size}")
        blocks.append(np.frombuffer(block, np.uint8))
        at += packed
    return blocks + [np.zeros(0, np.uint8)] * (len(sizes) - len(blocks))


def _axes(extensions: bytes) -> tuple[str, str, bool]:
    """Up axis, what says so, and whether the axes are left-handed."""
    name, why, at = "RUB", "SPZ's own way: y points up", 0
    while at + 8 <= len(extensions):
        kind, length = struct.unpack_from("<II", extensions, at)
        if kind == _ADOBE_AXES and length == 4 and at + 12 <= len(extensions):
            (number,) = struct.unpack_from("<I", extensions, at + 8)
            if number >= len(_AXES):
                raise InputError(f"SPZ_ADOBE_coordinate_system {number}, must be 1 to {len(_AXES) - 1}")
            if number:
                name = str(_AXES[number])
                why = f"SPZ_ADOBE_coordinate_system says {name}"
        at += 8 + length
    frame = np.zeros((3, 3))
    for axis, letter in enumerate(name):
        row, sign = _LETTERS[letter]
        frame[row, axis] = sign
    vertical = next(axis for axis, letter in enumerate(name) if letter in "UD")
    up = ("+" if name[vertical] == "U" else "-") + "xyz"[vertical]
    return up, why, bool(np.linalg.det(frame) < 0)  # right, up, back is right-handed


def _decoded(
    blocks: list[NDArray[np.uint8]], count: int, version: int, degree: int, bits: int, up: str, why: str, mirror: bool
) -> CloudFile:
    fixed, alphas, dc, log_scales, rotations, view = (block.reshape(count, -1) for block in blocks)
    places = fixed.reshape(count, 3, 3).astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
    means = (places - ((places >> 23) << 24)) / float(1 << bits)  # 24-bit two's complement
    kept = min(degree, 3)  # a fourth degree is left out
    sh = np.empty((count, (kept + 1) ** 2, 3), np.float32)
    sh[:, 0] = (dc / np.float32(255) - np.float32(0.5)) / np.float32(0.15)
    sh[:, 1:] = view.reshape(count, -1, 3)[:, : (kept + 1) ** 2 - 1]
    sh[:, 1:] = (sh[:, 1:] - 128) / 128
    quaternions = _first_three(rotations) if version == 2 else _smallest_three_of(rotations)
    scales = np.exp(log_scales / np.float32(16) - np.float32(10))
    notes = () if degree <= 3 else ("left out the harmonics of degree 4",)
    if mirror:
        # The x axis is turned over: so is its share of the rotation, and each harmonic that is odd in x.
        means[:, 0] *= -1
        quaternions[:, 2:] *= -1
        sh[:, _ODD_IN_X[_ODD_IN_X < sh.shape[1]]] *= -1
        notes = (*notes, "mirrored: its axes are left-handed")
    return found(means, quaternions, scales, alphas[:, 0] / np.float32(255), sh, up, why, notes)


_ODD_IN_X = np.array([3, 4, 7, 10, 13, 15])


def _first_three(rotations: NDArray[Any]) -> Array:
    """Version 2: x, y, z as bytes; w >= 0 follows from unit length."""
    xyz = rotations / np.float32(127.5) - np.float32(1)
    return np.column_stack([np.sqrt(np.maximum(0.0, 1.0 - (xyz**2).sum(1))), xyz])


def _smallest_three_of(rotations: NDArray[Any]) -> Array:
    """Later: 2 bits tell the largest of x, y, z, w; the others have a sign and 9 bits each, the last one lowest."""
    packed = rotations.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16, 1 << 24], np.uint32)
    largest = packed >> 30
    xyzw = np.zeros((len(packed), 4), np.float32)
    for component in (3, 2, 1, 0):
        stored = largest != component
        magnitude = (packed & 511) / 511.0 * np.sqrt(0.5)
        xyzw[stored, component] = np.where(packed & 512, -magnitude, magnitude)[stored]
        packed = np.where(stored, packed >> 10, packed)
    xyzw[np.arange(len(packed)), largest] = np.sqrt(np.maximum(0.0, 1.0 - (xyzw**2).sum(1)))
    return xyzw[:, [3, 0, 1, 2]]


def write_spz(cloud: GaussianCloud, path: Path) -> None:
    """Write SPZ version 3: gzip of positions, alphas, colours, log scales, rotations, higher harmonics.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    degree, count = sh_degree(cloud), len(cloud)
    reach = float(np.abs(cloud.means).max(initial=1e-9))
    bits = int(np.clip(np.floor(np.log2((2**23 - 1) / reach)), 0, FRACTION))
    fixed = np.rint(cloud.means.astype(np.float64) * 2**bits).astype("<i4")
    parts = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(count, 3, 4)[:, :, :3],
        _bytes(cloud.opacities * 255),
        _bytes((cloud.sh[:, 0] * 0.15 + 0.5) * 255),
        _bytes((np.log(np.maximum(cloud.scales, 1e-9)) + 10) * 16),
        _smallest_three(cloud.quaternions),
        _bytes(cloud.sh[:, 1:] * 128 + 128),
    ]
    header = _HEADER.pack(MAGIC, VERSION, count, degree, bits, 0, 0)
    with whole_file(path) as part:
        part.write_bytes(gzip.compress(header + b"".join(p.tobytes() for p in parts), compresslevel=6, mtime=0))


def _bytes(values: Array) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _smallest_three(quaternions: Array) -> np.ndarray:
    """wxyz (N, 4) -> 4 bytes each: 2 bits for the largest of x, y, z, w, then sign and 9 bits of the others."""
    xyzw = quaternions[:, [1, 2, 3, 0]].astype(np.float64)
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(np.take_along_axis(xyzw, largest[:, None], 1) < 0, -1, 1)
    packed = largest.astype(np.uint32)
    for component in range(4):
        magnitude = np.minimum(np.rint(np.abs(xyzw[:, component]) * np.sqrt(2) * 511), 511).astype(np.uint32)
        coded = (packed << 10) | ((xyzw[:, component] < 0).astype(np.uint32) << 9) | magnitude
        packed = np.where(largest == component, packed, coded)
    return packed.astype("<u4").view(np.uint8)
