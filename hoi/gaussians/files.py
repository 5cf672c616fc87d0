"""Which format a file has, by its content, and the cloud in it."""

import mmap
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from hoi.data import GaussianCloud
from hoi.errors import InputError, about
from hoi.gaussians.cloud import select
from hoi.gaussians.found import MOST_UNPACKED, CloudFile, unzipped
from hoi.gaussians.khr import holds_splats
from hoi.gaussians.ply import up_of

MAX_DROPPED_FRACTION = 0.01
"""A file with more unusable Gaussians than this is taken as broken; empty rows do not count."""

READERS: dict[str, str] = {
    "ply": "hoi.gaussians.ply:read_ply",
    "compressed ply": "hoi.gaussians.compressed_ply:read_compressed",
    "splat": "hoi.gaussians.splat:read_splat",
    "spz": "hoi.gaussians.spz:read_spz",
    "sog": "hoi.gaussians.sog:read_sog",
    "ksplat": "hoi.gaussians.ksplat:read_ksplat",
    "gltf": "hoi.gaussians.khr:read_khr",
}
"""Format -> what reads it, (data, path) -> CloudFile; imported when it is needed."""
ALLOWED = "3DGS .ply (compressed or not), .splat, .ksplat, .spz, .sog, and .glb or .gltf with KHR_gaussian_splatting"
UNREAD = {
    ".rad": "a .rad file (Spark's stream)",
    ".lcc": "an .lcc file (XGRIDS)",
    ".lcc2": "an .lcc2 file (XGRIDS)",
    ".usd": "a USD file", ".usda": "a USD file", ".usdc": "a USD file", ".usdz": "a USD file",
    ".splatv": "a .splatv file (animated)",
    ".4dgs": "a .4dgs file (animated)",
    ".gsd": "a .gsd file", ".plyv": "a .plyv file",
    ".npz": "a NumPy archive", ".pt": "a PyTorch checkpoint", ".pth": "a PyTorch checkpoint",
    ".ckpt": "a PyTorch checkpoint", ".fbx": "an FBX file", ".blend": "a Blender file", ".abc": "an Alembic file",
    ".las": "a LAS point cloud", ".laz": "a LAZ point cloud", ".e57": "an E57 point cloud", ".xyz": "a point list",
    ".pcd": "a PCD point cloud",
}  # fmt: skip
"""What is known and not read, by extension, called by its name."""


def read_file(path: Path) -> CloudFile:
    """What a file holds, in its axes and units, its rows usable or not (see `load_clean`).

    Args:
        path: a file of one of `ALLOWED`, gzipped or not, told apart by content; a 3DGS model directory, of which the
            last iteration is read; a folder of an unpacked `.sog`, or its meta.json.

    Raises:
        InputError: the file is missing, empty, cut short, of another kind, or holds no Gaussian.
    """
    path = _file_in(Path(path))
    try:
        with path.open("rb") as file:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if path.stat().st_size else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give {ALLOWED}") from None
    with about(path):
        if not len(data):
            raise InputError("the file is empty")
        content: bytes | memoryview = memoryview(data)
        if bytes(content[:2]) == b"\x1f\x8b" and unzipped(content, 4) != b"NGSP":
            content = unzipped(content, MOST_UNPACKED + 1)
            if len(content) > MOST_UNPACKED:
                raise InputError(f"gzip that unpacks to more than {MOST_UNPACKED >> 20} MiB; unpack it first")
            if not content:
                raise InputError("the file is empty once unpacked")
        kind = kind_of(content, path)
        read: Callable[[bytes | memoryview, Path], CloudFile] = resolve_name(READERS[kind])
        try:
            it = read(content, path)
        except (MemoryError, OverflowError) as error:
            raise InputError(f"broken: asks for more memory than there is ({error})") from None
        if len(it.cloud) == 0:
            raise InputError("holds no Gaussian")
    return it


def up_in(path: Path) -> tuple[str, str]:
    """Up axis of a file and what says so, without reading its Gaussians where the head tells.

    Raises:
        InputError: as `read_file`.
    """
    path = _file_in(Path(path))
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give {ALLOWED}") from None
    if head.startswith(b"ply"):
        lines = head.partition(b"end_header")[0].decode("latin-1").splitlines()
        return up_of([line.strip()[8:] for line in lines if line.strip().startswith("comment ")])
    it = read_file(path)
    return it.up, it.why


def holds_mesh(path: Path) -> bool:
    """Whether a file is a mesh: .obj, .stl, a PLY with faces and no rotations, a glTF without splats.

    Raises:
        InputError: the file cannot be read.
    """
    path, suffix = Path(path), Path(path).suffix.lower()
    if path.is_dir() or suffix not in (".obj", ".stl", ".ply", ".glb", ".gltf"):
        return False
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
            if head.startswith(b"ply"):
                header = head.partition(b"end_header")[0]
                faces = re.search(rb"element\s+face\s+0*[1-9]", header)
                return faces is not None and b"rot_0" not in header and b"packed_" not in header
            whole = head + file.read() if suffix in (".glb", ".gltf") else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); give {ALLOWED}") from None
    if whole:
        with about(path):
            return not holds_splats(whole)
    return suffix in (".obj", ".stl")


def kind_of(data: bytes | memoryview, path: Path) -> str:
    """The key in `READERS` of a file with this content.

    Raises:
        InputError: none; says what it is where that is known.
    """
    head, suffix = (
        bytes(data[:4096]),
        path.with_suffix("").suffix.lower() if path.suffix == ".gz" else path.suffix.lower(),
    )
    if head.startswith(b"ply"):
        return "compressed ply" if b"property uint packed_position" in head else "ply"
    if head.startswith((b"NGSP", b"\x1f\x8b")):
        return "spz"
    if head.startswith(b"glTF") or suffix == ".gltf":
        return "gltf"
    if (head.startswith(b"PK") and suffix not in UNREAD) or suffix == ".sog" or path.name == "meta.json":
        return "sog"
    if suffix in ("", ".splat", ".ksplat"):
        return suffix[1:] or "splat"
    if head.startswith(b"<!DOCTYPE html") or head.startswith(b"<html"):
        raise InputError("a web page, not a Gaussian cloud: was the download a page about it?")
    if head.startswith(b"version https://git-lfs"):
        raise InputError("a Git LFS pointer, not the file itself; fetch it with git lfs pull")
    if suffix in UNREAD:
        raise InputError(f"{UNREAD[suffix]}, which is not read; allowed are {ALLOWED}")
    raise InputError(f"not a Gaussian cloud; allowed are {ALLOWED}")


def read_gaussians(path: Path) -> GaussianCloud:
    """The cloud of `read_file` alone."""
    return read_file(path).cloud


def load_file_clean(path: Path) -> CloudFile:
    """Read a file and drop its empty and unusable Gaussians (not finite, negative scale, no rotation).

    Returns:
        What `read_file` does, with a note on what was dropped.

    Raises:
        InputError: as `read_file`, or more than 1 % of the Gaussians are unusable, beside rows of zeros alone.
    """
    it = read_file(path)
    cloud = it.cloud
    columns = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities[:, None], cloud.sh.reshape(len(cloud), -1))
    turned = np.isfinite(cloud.quaternions).all(1)
    empty = ~turned & ~cloud.means.any(1)
    usable = np.logical_and.reduce([np.isfinite(column).all(1) for column in columns]) & (cloud.scales >= 0).all(1)
    broken, count = int(np.count_nonzero(~usable & ~empty)), len(cloud)
    if broken > MAX_DROPPED_FRACTION * count:
        why = "are not finite or have a negative scale"
        if np.count_nonzero(~turned & ~empty) > broken / 2:
            why = "have a quaternion of zero or not finite"
        raise InputError(f"{path}: {broken} of {count} Gaussians {why}; at most {MAX_DROPPED_FRACTION:.0%} may be")
    if not usable.any():
        raise InputError(f"{path}: all {count} rows are zero, empty padding and no object")
    notes = it.notes
    if empty.any():
        notes = (*notes, f"dropped {np.count_nonzero(empty)} empty rows, zero in place and rotation")
    if broken:
        notes = (*notes, f"dropped {broken} Gaussians that are not finite")
    return replace(it, cloud=cloud if usable.all() else select(cloud, usable), notes=notes)


def load_clean(path: Path) -> tuple[GaussianCloud, list[str]]:
    """The cloud and the notes of `load_file_clean`."""
    it = load_file_clean(path)
    return it.cloud, list(it.notes)


def _file_in(path: Path) -> Path:
    """The point cloud of a 3DGS model directory, the meta.json of an unpacked `.sog`; any other path as it is."""
    if not path.is_dir():
        return path
    if (path / "meta.json").is_file():
        return path / "meta.json"
    found = {int(p.parent.name[10:]): p for p in path.glob("point_cloud/iteration_[0-9]*/point_cloud.ply")}
    if not found:
        raise InputError(f"{path}: a directory without point_cloud/iteration_<N>/point_cloud.ply; give that or a file")
    return found[max(found)]
