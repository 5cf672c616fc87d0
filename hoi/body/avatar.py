"""Avatars: a canonical 3DGS cloud `gaussians.ply` with its skinning beside it in `skinning.npz`.

The cloud is in the T-pose, in SMPL's rest frame (y up, facing +z, left at +x), metres. The .npz holds

    weights (N, 24), rest_joints (24, 3) [m], parents (24,), joint_names (24,), up "y", pose "tpose", source, licence

and, if the person has pose blend shapes, pose_directions (N, 3, 207), see `hoi.data.Body`; with joints in SMPL's order
(`hoi.body.skeleton`). Exporters of any reconstruction method can write it.
"""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS, POSE_FEATURES
from hoi.data import Body
from hoi.errors import InputError, about
from hoi.gaussians import read_gaussians, write_ply

PLY_NAME = "gaussians.ply"
SKINNING_NAME = "skinning.npz"
ROW_SUM_TOLERANCE = 1e-2
LICENCE_MARK = "; licence: "


def load_avatar(ply_path: Path | str, skinning_path: Path | str | None = None) -> Body:
    """A person from a canonical 3DGS PLY and its skinning.

    Args:
        ply_path: the cloud, see `hoi.gaussians.read_gaussians` for what it may be; or a folder of `save_avatar`.
        skinning_path: the .npz; default `skinning.npz` beside the cloud.

    Raises:
        InputError: a file is missing or broken, or a key is missing, misshapen, not finite or of unknown meaning.
    """
    ply_path = Path(ply_path)
    folder = ply_path if ply_path.is_dir() else ply_path.parent
    name = folder.resolve().name if ply_path.name == PLY_NAME or ply_path.is_dir() else ply_path.stem
    if (ply_path / PLY_NAME).is_file():
        ply_path = ply_path / PLY_NAME
    skinning_path = folder / SKINNING_NAME if skinning_path is None else Path(skinning_path)
    cloud = read_gaussians(ply_path)
    for key, array in vars(cloud).items():
        if array is not None and not np.isfinite(array).all():
            raise InputError(f"{ply_path}: {key}: holds values that are not finite")
    skinning = _read_npz(skinning_path)

    with about(skinning_path):
        weights = _numbers(skinning, "weights", (len(cloud), JOINT_COUNT))
        rest_joints = _numbers(skinning, "rest_joints", (JOINT_COUNT, 3))
        parents = _numbers(skinning, "parents", (JOINT_COUNT,))
        if weights.min() < 0:
            raise InputError(f"weights: smallest is {weights.min():g}; must not be negative")
        sums = weights.sum(axis=1)
        worst = int(np.abs(sums - 1).argmax())
        if abs(sums[worst] - 1) > ROW_SUM_TOLERANCE:
            raise InputError(f"weights: row {worst} sums to {sums[worst]:g}; each row must sum to 1")
        # Files keep the root's parent as -1 or, after SMPL, as the largest unsigned integer.
        if tuple(parents[1:]) != PARENTS[1:]:
            raise InputError(f"parents={parents.astype(int).tolist()}: must be SMPL's {list(PARENTS)}")
        names = tuple(str(name) for name in np.atleast_1d(_get(skinning, "joint_names")))
        if names != JOINT_NAMES:
            raise InputError(f"joint_names={','.join(names)}: must be {','.join(JOINT_NAMES)}")
        for key, allowed in (("up", "y"), ("pose", "tpose")):
            if (value := str(_get(skinning, key))) != allowed:
                raise InputError(f"{key}={value!r}: must be {allowed!r}")

        source, licence = (str(_get(skinning, key)) for key in ("source", "licence"))
        weights = (weights / sums[:, None]).astype(np.float32)
        directions = None
        if "pose_directions" in skinning:
            shape = (len(cloud), 3, POSE_FEATURES)
            directions = _numbers(skinning, "pose_directions", shape).astype(np.float16)
    licensed = f"{source}{LICENCE_MARK}{licence}"
    return Body(name, cloud, weights, rest_joints.astype(np.float32), licensed, directions)


def save_avatar(body: Body, folder: Path | str) -> None:
    """Write `gaussians.ply` and `skinning.npz`, as `load_avatar` reads them, into a folder, made if need be."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    source, mark, licence = body.source.partition(LICENCE_MARK)
    write_ply(body.cloud, folder / PLY_NAME)
    extra: dict[str, Any] = (
        {} if body.pose_directions is None else {"pose_directions": body.pose_directions.astype(np.float16)}
    )
    np.savez_compressed(
        folder / SKINNING_NAME,
        weights=body.skinning_weights.astype(np.float32),
        rest_joints=body.rest_joints.astype(np.float32),
        parents=np.array(PARENTS),
        joint_names=np.array(JOINT_NAMES),
        up="y",
        pose="tpose",
        source=source,
        licence=licence if mark else "unknown",
        **extra,
    )


def _read_npz(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give a skinning .npz") from None
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        raise InputError(f"{path}: not a skinning .npz of plain arrays") from None


def _get(data: dict[str, NDArray[Any]], key: str) -> NDArray[Any]:
    if key not in data:
        raise InputError(f"{key}: missing; the file has {', '.join(data) or 'nothing'}")
    return data[key]


def _numbers(data: dict[str, NDArray[Any]], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = _get(data, key)
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise InputError(f"{key}: {array.dtype} of shape {array.shape}; must be numbers of shape {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{key}: holds values that are not finite")
    return array.astype(np.float64)
