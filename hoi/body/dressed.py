"""The files of the people in the package, `hoi/body/assets/*.npz`: dressed, textured, quantised to some 25 bytes a
Gaussian.

    means       uint16 between `low` and `high` [m]      normals   int8, octahedral
    quaternions int8                                     openness  int8, octahedral, and its length as uint8
    scales      uint8 of the logarithm between two ends  joints    uint8, the four of most weight, and `weights` uint8
    opacities, rgb  uint8

Octahedral maps are those of Cigolle et al. 2014. Rows go along a Z-order curve, so that neighbours lie side by side.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import IO, ClassVar

import numpy as np
from numpy.typing import NDArray

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array

INFLUENCES = 4


@dataclass(frozen=True)
class Dressed:
    """A person in the T-pose, SMPL's rest frame [m]."""

    name: str
    means: Array
    quaternions: Array
    scales: Array
    opacities: Array
    rgb: Array
    """Albedo as shown, (N, 3)."""
    normals: Array
    """Unit, of the surface with its normal map, (N, 3)."""
    openness: Array
    """Mean direction of open sky, as long as its share, (N, 3)."""
    weights: Array
    """(N, 24)."""
    rest_joints: Array
    """(24, 3)."""

    ARRAYS: ClassVar = ("means", "quaternions", "scales", "opacities", "rgb", "normals", "openness", "weights")


def save(person: Dressed, path: Path) -> None:
    """Write a person."""
    from hoi.body.people import z_order

    order = z_order(person.means)
    rows = {name: np.asarray(getattr(person, name), np.float64)[order] for name in Dressed.ARRAYS}
    low, high = rows["means"].min(0), rows["means"].max(0)
    logarithms = np.log(rows["scales"])
    ends = np.array([logarithms.min(), logarithms.max()])
    joints = np.argsort(-rows["weights"], axis=1, kind="stable")[:, :INFLUENCES]
    shares = np.take_along_axis(rows["weights"], joints, axis=1)
    length = np.linalg.norm(rows["openness"], axis=1)
    columns = {
        "means": _steps((rows["means"] - low) / (high - low), np.uint16),
        "quaternions": np.rint(rows["quaternions"] / np.abs(rows["quaternions"]).max(1, keepdims=True) * 127).astype(
            np.int8
        ),
        "scales": _steps((logarithms - ends[0]) / (ends[1] - ends[0]), np.uint8),
        "opacities": _steps(rows["opacities"], np.uint8),
        "rgb": _steps(rows["rgb"], np.uint8),
        "normals": _to_octahedron(rows["normals"]),
        "openness": _to_octahedron(rows["openness"] / np.maximum(length, 1e-9)[:, None]),
        "open_share": _steps(length, np.uint8),
        "joints": joints.astype(np.uint8),
        "weights": _steps(shares / shares.sum(1, keepdims=True), np.uint8),
    }
    columns = {name: np.ascontiguousarray(values.T) for name, values in columns.items()}  # packs better
    np.savez_compressed(
        path, low=low, high=high, ends=ends, rest_joints=person.rest_joints.astype(np.float32), **columns
    )


def load(name: str, file: IO[bytes]) -> Dressed:
    """Read what `save` has written."""
    with np.load(file, allow_pickle=False) as data:
        rows = {key: data[key].T for key in data.files}
    quaternions = rows["quaternions"].astype(np.float64)
    weights = np.zeros((len(quaternions), JOINT_COUNT))
    np.put_along_axis(weights, rows["joints"].astype(np.intp), rows["weights"] / 255.0, axis=1)
    ends = rows["ends"]
    return Dressed(
        name,
        means=rows["low"] + rows["means"] / 65535.0 * (rows["high"] - rows["low"]),
        quaternions=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        scales=np.exp(ends[0] + rows["scales"] / 255.0 * (ends[1] - ends[0])),
        opacities=rows["opacities"] / 255.0,
        rgb=rows["rgb"] / 255.0,
        normals=_from_octahedron(rows["normals"]),
        openness=_from_octahedron(rows["openness"]) * (rows["open_share"] / 255.0)[:, None],
        weights=weights / weights.sum(1, keepdims=True),
        rest_joints=rows["rest_joints"].T.astype(np.float32),
    )


def _steps(values: Array, dtype: type[np.unsignedinteger]) -> NDArray[np.unsignedinteger]:
    """Numbers in [0, 1] in the whole range of a type."""
    return np.rint(np.clip(values, 0, 1) * np.iinfo(dtype).max).astype(dtype)


def _to_octahedron(vectors: Array) -> NDArray[np.int8]:
    """Unit vectors (N, 3) -> (N, 2)."""
    flat = vectors / np.maximum(np.abs(vectors).sum(1, keepdims=True), 1e-12)
    folded = (1 - np.abs(flat[:, 1::-1])) * np.where(flat[:, :2] < 0, -1.0, 1.0)
    return np.rint(np.where(flat[:, 2:] < 0, folded, flat[:, :2]) * 127).astype(np.int8)


def _from_octahedron(pairs: NDArray[np.int8]) -> Array:
    """The inverse of `_to_octahedron`."""
    flat = pairs / 127.0
    height = 1 - np.abs(flat).sum(1, keepdims=True)
    folded = (1 - np.abs(flat[:, ::-1])) * np.where(flat < 0, -1.0, 1.0)
    vectors = np.concatenate([np.where(height < 0, folded, flat), height], 1)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
