"""glTF with `KHR_gaussian_splatting`: points with rotation (xyzw), linear scale, opacity and harmonics as attributes.

Read are `.glb` and `.gltf` with buffers inside or beside it, each splat primitive where its nodes put it, also packed
as SPZ (`KHR_gaussian_splatting_compression_spz_2`). glTF has y up.
"""

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import hoi
from hoi.data import Array, GaussianCloud, fields_of
from hoi.errors import InputError
from hoi.files import whole_file
from hoi.gaussians.cloud import SH_C0, cloud_of, colours, sh_degree, stretch
from hoi.gaussians.found import CloudFile, brief
from hoi.gaussians.spz import read_spz

NAME, PACKED = (
    "KHR_gaussian_splatting",
    ("KHR_gaussian_splatting_compression_spz_2", "KHR_gaussian_splatting_compression_spz"),
)
UP = ("+y", "glTF's way: y points up")
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_DEEP = 200  # nodes below one another


def read_khr(data: bytes | memoryview, path: Path) -> CloudFile:
    """Raises:
    InputError: broken, cut short, or without splats.
    """
    try:
        document, binary = opened(data)
        clouds = list(_clouds(document, _Buffers(document, binary, path)))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError, struct.error) as error:
        reason = f"{type(error).__name__} {brief(error)}"
        raise InputError(f"broken glTF, not well formed ({reason})") from None
    if not clouds:
        raise InputError(f"a glTF of meshes, not of Gaussians: no primitive has {NAME}")
    bands = max(cloud.sh.shape[1] for cloud in clouds)
    padded = [replace(c, sh=np.pad(c.sh, ((0, 0), (0, bands - c.sh.shape[1]), (0, 0)))) for c in clouds]
    joined = GaussianCloud(*map(np.concatenate, zip(*(fields_of(c).values() for c in padded), strict=True)))
    return CloudFile(joined, *UP)


def holds_splats(data: bytes | memoryview) -> bool:
    """Whether a glTF names the extension.

    Raises:
        InputError: broken.
    """
    document, _ = opened(data)
    return NAME in json.dumps([document.get("extensionsUsed"), document.get("meshes")])


def opened(data: bytes | memoryview) -> tuple[dict[str, Any], memoryview]:
    """The JSON of a .glb or .gltf, and the binary chunk.

    Raises:
        InputError: neither, or cut short.
    """
    text, binary = bytes(data) if bytes(data[:4]) != b"glTF" else b"", memoryview(b"")
    if not text:
        if len(data) < 20:
            raise InputError(f"cut short, {len(data)} bytes of a glTF header")
        _, version, length = struct.unpack_from("<4sII", data)
        if version != 2 or length > len(data):
            raise InputError(f"broken glTF or cut short: version {version}, {length} bytes, {len(data)} are there")
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", data, at)
            if size > length - at - 8:
                raise InputError(f"broken glTF or cut short: a chunk of {size} bytes, {length - at - 8} are there")
            chunk = memoryview(data)[at + 8 : at + 8 + size]
            text, binary = (bytes(chunk), binary) if kind == b"JSON" else (text, chunk if kind == b"BIN\0" else binary)
            at += 8 + size
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"broken glTF: its JSON ({brief(error)})") from None
    if not isinstance(document, dict):
        raise InputError("broken glTF: its JSON is no object")
    return document, binary


class _Buffers:
    """What accessors and views of a document hold."""

    def __init__(self, document: dict[str, Any], binary: memoryview, path: Path) -> None:
        self._document, self._binary, self._path = document, binary, path
        self._read: dict[int, memoryview] = {}

    def view(self, index: int) -> tuple[memoryview, int]:
        """Bytes of a buffer view, and its stride; 0 where it has none."""
        view = self._document["bufferViews"][_whole(index)]
        if lost := [name for name in view.get("extensions", {}) if "meshopt" in name]:
            raise InputError(
                f"a glTF packed with {brief(lost[0])}, which is not read; unpack it with gltfpack or gltf-transform"
            )
        buffer = self._buffer(_whole(view["buffer"]))
        start, length = _whole(view.get("byteOffset", 0)), _whole(view["byteLength"])
        if start + length > len(buffer):
            raise InputError(f"broken glTF or cut short: a view up to byte {start + length} of {len(buffer)}")
        return buffer[start : start + length], _whole(view.get("byteStride", 0))

    def array(self, index: int) -> NDArray[Any]:
        """An accessor as float32 (count, width), normalized integers as shares of 1."""
        accessor = self._document["accessors"][_whole(index)]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError("a glTF with sparse accessors, which are not read")
        kind, width, count = (
            np.dtype(_TYPES[accessor["componentType"]]),
            _WIDTHS[accessor["type"]],
            _whole(accessor["count"]),
        )
        content, stride = self.view(accessor["bufferView"])
        start, row = _whole(accessor.get("byteOffset", 0)), kind.itemsize * width
        stride = stride or row
        if stride < row or (count and start + stride * (count - 1) + row > len(content)):
            raise InputError(f"broken glTF: an accessor of {count} x {row} bytes in a view of {len(content)}")
        values = np.ndarray((count, width), kind, content, start, (stride, kind.itemsize)).astype(np.float32)
        if accessor.get("normalized") and kind.kind in "iu":
            values = np.maximum(values / np.float32(np.iinfo(kind).max), -1)
        return values

    def _buffer(self, index: int) -> memoryview:
        if index not in self._read:
            uri = self._document["buffers"][index].get("uri")
            if uri is None:
                self._read[index] = self._binary
            elif uri.startswith("data:"):
                try:
                    self._read[index] = memoryview(base64.b64decode(uri.partition(",")[2], validate=True))
                except binascii.Error as error:
                    raise InputError(f"broken glTF: a buffer of base64 ({error})") from None
            elif Path(uri).is_absolute() or ".." in Path(uri).parts or ":" in uri:
                raise InputError(f"broken glTF: a buffer in {brief(uri)!r}, must be a file beside it")
            else:
                try:
                    self._read[index] = memoryview((self._path.parent / uri).read_bytes())
                except OSError as error:
                    raise InputError(f"its buffer {brief(uri)!r} cannot be read ({error.strerror})") from None
        return self._read[index]


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InputError(f"broken glTF: {brief(value)} where a whole number from 0 must be")
    return value


def _clouds(document: dict[str, Any], buffers: _Buffers) -> Iterator[GaussianCloud]:
    """Each splat primitive, where its nodes put it."""
    for mesh, matrix in _placed(document):
        for primitive in document["meshes"][mesh]["primitives"]:
            extension = primitive.get("extensions", {}).get(NAME)
            if extension is None:
                continue
            packed = next((extension["extensions"][n] for n in PACKED if n in extension.get("extensions", {})), None)
            if packed is not None:
                cloud = read_spz(buffers.view(packed["bufferView"])[0], Path()).cloud
            else:
                cloud = _cloud(primitive["attributes"], buffers, extension.get("colorSpace", ""))
            if not np.array_equal(matrix, np.eye(4)):
                places = cloud.means.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
                cloud = stretch(cloud, places, np.broadcast_to(matrix[:3, :3], (len(cloud), 3, 3)))
            yield cloud


def _placed(document: dict[str, Any]) -> Iterator[tuple[int, Array]]:
    """Meshes and their matrices to the world; all meshes, unmoved, of a document without a scene."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    if not scenes:
        yield from ((index, np.eye(4)) for index in range(len(document.get("meshes", []))))
        return
    stack = [(node, np.eye(4), 0) for node in scenes[_whole(document.get("scene", 0))].get("nodes", [])]
    seen = 0
    while stack:
        index, above, depth = stack.pop()
        node = nodes[_whole(index)]
        seen += 1
        if depth > _DEEP or seen > max(1000, 10 * len(nodes)):
            raise InputError("broken glTF: its nodes go in a circle")
        matrix = above @ _matrix(node)
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
            raise InputError(f"broken glTF: node {index} has a scale of zero or a matrix that is not finite")
        if "mesh" in node:
            yield _whole(node["mesh"]), matrix
        stack += [(child, matrix, depth + 1) for child in node.get("children", [])]


def _matrix(node: dict[str, Any]) -> Array:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    turn = Rotation.from_quat(np.array(node.get("rotation", [0, 0, 0, 1]), np.float64).reshape(4)).as_matrix()
    matrix[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
    matrix[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    return matrix


def _cloud(attributes: dict[str, int], buffers: _Buffers, space: str) -> GaussianCloud:
    wanted = {"POSITION": 3, f"{NAME}:ROTATION": 4, f"{NAME}:SCALE": 3, f"{NAME}:OPACITY": 1}
    if missing := [name for name in wanted if name not in attributes]:
        raise InputError(f"broken glTF: Gaussians without {', '.join(missing)}")
    columns = [buffers.array(attributes[name]) for name in wanted]
    degree = max((d for d in range(4) if f"{NAME}:SH_DEGREE_{d}_COEF_0" in attributes), default=-1)
    if degree < 0:
        if "COLOR_0" not in attributes:
            raise InputError(f"broken glTF: Gaussians without {NAME}:SH_DEGREE_0_COEF_0")
        harmonics = [(buffers.array(attributes["COLOR_0"])[:, :3] - 0.5) / SH_C0]
    else:
        names = [f"{NAME}:SH_DEGREE_{d}_COEF_{k}" for d in range(degree + 1) for k in range(2 * d + 1)]
        harmonics = [buffers.array(attributes[name]) for name in names]
    means, turns, scales, opacities = columns
    sizes = {len(column) for column in (*columns, *harmonics)}
    widths = [column.shape[1] for column in columns] == [3, 4, 3, 1] and all(h.shape[1] == 3 for h in harmonics)
    if len(sizes) != 1 or not widths:
        raise InputError(f"broken glTF: attributes of {sorted(sizes)} Gaussians, or of another width than theirs")
    sh = np.stack(harmonics, 1)
    if space.startswith("lin_"):
        sh = _displayed(sh)
    return cloud_of(means, turns[:, [3, 0, 1, 2]], scales, opacities[:, 0], sh)


def _displayed(sh: Array) -> Array:
    """Harmonics of linear light -> of the sRGB that is shown, to first order about each Gaussian's own colour."""
    linear = np.maximum(0.5 + SH_C0 * sh[:, 0], 0)
    low = linear <= 0.0031308
    shown = np.where(low, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    slope = np.where(low, 12.92, 1.055 / 2.4 * np.maximum(linear, 0.0031308) ** (1 / 2.4 - 1))
    return np.concatenate([((shown - 0.5) / SH_C0)[:, None], sh[:, 1:] * slope[:, None]], 1).astype(np.float32)


def write_khr(cloud: GaussianCloud, path: Path) -> None:
    """Write a .glb in glTF's own axes, y up: turn what has z up before.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    shown = np.column_stack([np.clip(colours(cloud), 0, 1), cloud.opacities])
    columns: dict[str, Array] = {
        "POSITION": cloud.means,
        "COLOR_0": shown,
        f"{NAME}:ROTATION": cloud.quaternions[:, [1, 2, 3, 0]],
        f"{NAME}:SCALE": cloud.scales,
        f"{NAME}:OPACITY": cloud.opacities[:, None],
    }
    names = [f"{NAME}:SH_DEGREE_{d}_COEF_{k}" for d in range(sh_degree(cloud) + 1) for k in range(2 * d + 1)]
    columns |= {name: cloud.sh[:, index] for index, name in enumerate(names)}
    body, views, accessors = bytearray(), [], []
    for name, values in columns.items():
        stored = np.ascontiguousarray(values, "<f4")
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": stored.nbytes, "target": 34962})
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[stored.shape[1]]
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1,
            "componentType": 5126,
            "count": len(stored),
            "type": kind,
        }
        if name == "POSITION":
            accessor |= {"min": stored.min(0).tolist(), "max": stored.max(0).tolist()}
        accessors.append(accessor)
        body += stored.tobytes()
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "sortingMethod": "cameraDistance",
                 "projection": "perspective"}  # fmt: skip
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(columns)},
        "extensions": {NAME: extension},
    }
    document = {
        "asset": {"version": "2.0", "generator": f"hoi {hoi.__version__}"},
        "extensionsUsed": [NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "gaussians"}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": len(body)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    with whole_file(path) as part:
        part.write_bytes(
            head
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(body), b"BIN\0")
            + bytes(body)
        )
