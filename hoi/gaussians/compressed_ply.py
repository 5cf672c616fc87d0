"""`compressed.ply` of SuperSplat and gsplat: chunks of 256 Gaussians with bounds, four packed integers a Gaussian.

Positions and log scales have 11, 10 and 11 bits between a chunk's bounds, rotations the index of the largest of w, x,
y, z and 10 bits of each other, colours and opacity 8 bits each (between bounds where the chunks have them), harmonics a
byte.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array
from hoi.errors import InputError
from hoi.gaussians.cloud import SH_C0
from hoi.gaussians.found import CloudFile, brief, found
from hoi.gaussians.ply import parsed, up_of

CHUNK = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")


def read_compressed(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: broken, cut short, or chunks that do not fit the Gaussians.
    """
    ply = parsed(data, path)
    if "chunk" not in ply or "vertex" not in ply:
        raise InputError("a compressed PLY without chunks")
    chunks, vertex = ply["chunk"], ply["vertex"]
    try:
        places, turns, sizes, colours = (np.asarray(vertex[name]).astype(np.uint32) for name in PACKED)
        bounds = {
            name: np.stack(
                [[np.asarray(chunks[f"{end}_{axis}"], np.float64) for axis in axes] for end in ("min", "max")]
            )
            for name, axes in (("place", "xyz"), ("size", ("scale_x", "scale_y", "scale_z")))
        }
        tinted = "min_r" in {p.name for p in chunks.properties}
        tint = (
            np.stack([[np.asarray(chunks[f"{end}_{c}"], np.float64) for c in "rgb"] for end in ("min", "max")])
            if tinted
            else None
        )
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(f"broken compressed PLY: {brief(error)}") from None
    if -(-len(places) // CHUNK) != chunks.count:
        raise InputError(f"broken compressed PLY: {chunks.count} chunks for {len(places)} Gaussians, {CHUNK} each")
    chunk = np.arange(len(places)) // CHUNK

    def between(shares: Array, ends: Array) -> Array:
        low, high = ends[:, :, chunk].transpose(0, 2, 1)
        return low + shares * (high - low)

    rgba = np.stack([(colours >> shift & 255) / 255 for shift in (24, 16, 8, 0)], 1)
    rgb = rgba[:, :3] if tint is None else between(rgba[:, :3], tint)
    sh = np.concatenate([(rgb[:, None] - 0.5) / SH_C0, _harmonics(ply, len(places))], 1)
    return found(
        between(_thirds(places), bounds["place"]),
        _rotations(turns),
        np.exp(between(_thirds(sizes), bounds["size"])),
        rgba[:, 3],
        sh,
        *up_of(ply.comments),
    )


def _thirds(packed: NDArray[np.uint32]) -> Array:
    """11, 10 and 11 bits as shares of 1, (N, 3)."""
    return np.stack([(packed >> 21) / 2047, (packed >> 11 & 1023) / 1023, (packed & 2047) / 2047], 1)


def _rotations(packed: NDArray[np.uint32]) -> Array:
    """wxyz from the largest's index and the three others in order."""
    others = (np.stack([packed >> 20 & 1023, packed >> 10 & 1023, packed & 1023], 1) / 1023 - 0.5) * np.sqrt(2)
    largest = np.sqrt(np.maximum(0, 1 - (others**2).sum(1)))
    index = (packed >> 30).astype(np.intp)
    quaternions = np.empty((len(packed), 4))
    for which in range(4):
        rows = index == which
        quaternions[rows] = np.insert(others[rows], which, largest[rows], axis=1)
    return quaternions


def _harmonics(ply: Any, count: int) -> Array:
    """Higher coefficients (N, K, 3), from bytes that span [-4, 4]; none where there are none."""
    if "sh" not in ply:
        return np.zeros((count, 0, 3), np.float32)
    element = ply["sh"]
    names = [p.name for p in element.properties]
    if (
        element.count != count
        or sorted(names) != sorted(f"f_rest_{i}" for i in range(len(names)))
        or len(names) not in (9, 24, 45)
    ):
        raise InputError(f"broken compressed PLY: {element.count} rows of {len(names)} harmonics for {count} Gaussians")
    stored = np.stack([np.asarray(element[f"f_rest_{i}"]).astype(np.float32) for i in range(len(names))], 1)
    shares = np.where(stored == 0, 0, np.where(stored == 255, 1, (stored + 0.5) / 256))
    return ((shares - 0.5) * 8).reshape(count, 3, -1).transpose(0, 2, 1)
