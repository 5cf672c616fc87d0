"""`.splat`: 32 bytes a Gaussian (position 3 f4, scale 3 f4, RGBA 4 u1, quaternion 4 u1), no view dependence."""

from pathlib import Path

import numpy as np

from hoi.data import GaussianCloud
from hoi.errors import InputError
from hoi.gaussians.cloud import colours, sh_from_colours
from hoi.gaussians.found import CloudFile, found

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])


def read_splat(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: not whole rows.
    """
    if len(data) % _ROW.itemsize:
        raise InputError(f"{len(data)} bytes is not a multiple of {_ROW.itemsize}; cut short or not a .splat file")
    rows = np.frombuffer(data, _ROW)
    rgba = rows["rgba"] / np.float32(255)
    quaternions = (rows["quaternion"] - np.float32(128)) / np.float32(128)
    return found(rows["mean"], quaternions, rows["scale"], rgba[:, 3], sh_from_colours(rgba[:, :3]))


def write_splat(cloud: GaussianCloud, path: Path) -> None:
    """Write 32 bytes a Gaussian; colours lose their view dependence and are rounded to bytes, as are rotations."""
    rows = np.zeros(len(cloud), _ROW)
    rows["mean"], rows["scale"] = cloud.means, cloud.scales
    rgba = np.column_stack([colours(cloud), cloud.opacities])
    rows["rgba"] = np.clip(np.rint(rgba * 255), 0, 255)
    rows["quaternion"] = np.clip(np.rint(cloud.quaternions * 128 + 128), 0, 255)
    rows.tofile(path)
