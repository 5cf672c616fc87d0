"""Animated GLB (glTF 2.0, binary) -> vertices over time: node animation, morph targets and skins, by node.

The specification is https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html. What trimesh reads of a GLB is its rest
pose, so the animation is read here. A file is read alone: what it refers to outside itself is refused.
"""

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array
from hoi.errors import InputError

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENTS: dict[int, Any] = {
    5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32,
}  # fmt: skip
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
HERMITE = np.array([[2, -3, 0, 1], [1, -2, 1, 0], [-2, 3, 0, 0], [1, -1, 0, 0]])
"""Of (s^3, s^2, s, 1): the weights of start, its tangent, end, its tangent."""
MOST_VERTICES = 2_000_000
KNOWN_EXTENSIONS = ("KHR_mesh_quantization",)
"""Of those that a file may say it cannot be read without; all others change materials or pack the vertices."""


@dataclass(frozen=True)
class Part:
    """The triangles of one node."""

    node: int
    corners: int
    """V."""
    faces: NDArray[np.int64]
    colours: Array | None
    """RGB in [0, 1], (V, 3)."""


@dataclass(frozen=True)
class _Track:
    """An animation channel."""

    node: int
    path: str
    """"translation", "rotation", "scale" or "weights"."""
    times: Array
    values: Array
    """(K, width), of a cubic spline (K, 3, width)."""
    interpolation: str

    def at(self, time: float) -> Array:
        """The value at a time [s], the ends held."""
        after = int(np.searchsorted(self.times, time, side="right"))
        cubic = self.interpolation == "CUBICSPLINE"
        if after == 0 or after == len(self.times):
            key = self.values[0 if after == 0 else -1]
            return key[1] if cubic else key
        length = self.times[after] - self.times[after - 1]
        share = (time - self.times[after - 1]) / length
        start, end = self.values[after - 1], self.values[after]
        if cubic:
            h = HERMITE @ share ** np.arange(3, -1, -1)
            value = h[0] * start[1] + h[1] * length * start[2] + h[2] * end[1] + h[3] * length * end[0]
            return value / np.linalg.norm(value) if self.path == "rotation" else value
        if self.interpolation == "STEP":
            return start
        if self.path == "rotation":
            return _slerp(start, end, share)
        return start + share * (end - start)


class Animated:
    """A GLB file.

    Raises:
        InputError: it is no GLB, is cut short, refers to other files, or is not what the specification allows.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _readable(path):
            self._json, self._binary = _chunks(path)
            needed = set(self._json.get("extensionsRequired", ())) - set(KNOWN_EXTENSIONS)
            if needed:
                raise InputError(f"{path} needs the glTF extensions {', '.join(sorted(needed))}; export it without")
            self._nodes: list[dict[str, Any]] = self._json.get("nodes", [])
            self._order = self._walk()
            self._tracks = list(self._read_tracks())
            self._meshes: dict[int, list[dict[str, Any]]] = {}

    @property
    def end(self) -> float:
        """Time of the last key [s]; 0 where nothing is animated."""
        return max((float(track.times[-1]) for track in self._tracks), default=0.0)

    def below(self, name: str | None) -> list[Part]:
        """The triangles of the node of this name and of all below it, or of the whole scene.

        Raises:
            InputError: no such node, or no triangles there.
        """
        with _readable(self.path):
            wanted = {node for node, _ in self._order}
            if name is not None:
                known = {self._nodes[node].get("name", ""): node for node in sorted(wanted, reverse=True)}
                if name not in known:
                    listed = ", ".join(sorted(filter(None, known))[:20])
                    raise InputError(f"{self.path} has no node {name!r}; it has {listed or 'none with a name'}")
                wanted = {known[name]}
                for node, parent in self._order:
                    if parent in wanted:
                        wanted.add(node)
            parts = [self._part(node) for node, _ in self._order if node in wanted and "mesh" in self._nodes[node]]
            if not sum(len(part.faces) for part in parts):
                raise InputError(f"{self.path}: no triangles" + (f" at its node {name!r}" if name else ""))
            return parts

    def vertices(self, parts: list[Part], time: float) -> Array:
        """World positions of all vertices of the parts at a time [s], (V, 3), in the file's axes and units."""
        with _readable(self.path):
            moved: dict[tuple[int, str], Array] = {(t.node, t.path): t.at(time) for t in self._tracks}
            world: dict[int, Array] = {}
            for node, parent in self._order:
                local = self._local(node, moved)
                world[node] = world[parent] @ local if parent >= 0 else local
            return np.concatenate([self._posed(part.node, world, moved) for part in parts])

    def _walk(self) -> list[tuple[int, int]]:
        """(node, parent) of the scene, parents first."""
        scenes = self._json.get("scenes")
        children = {child for node in self._nodes for child in node.get("children", ())}
        roots = [node for node in range(len(self._nodes)) if node not in children]
        if scenes:
            roots = scenes[self._json.get("scene", 0)].get("nodes", [])
        order: list[tuple[int, int]] = []
        seen: set[int] = set()
        left = [(root, -1) for root in reversed(roots)]
        while left:
            node, parent = left.pop()
            if node in seen or not 0 <= node < len(self._nodes):
                raise InputError(f"{self.path}: its nodes are not a tree (node {node})")
            seen.add(node)
            order.append((node, parent))
            left += [(child, node) for child in reversed(self._nodes[node].get("children", ()))]
        return order

    def _read_tracks(self) -> Iterator[_Track]:
        """Those of the first animation."""
        for animation in self._json.get("animations", [])[:1]:
            for channel in animation["channels"]:
                target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
                if "node" not in target or target["path"] not in ("translation", "rotation", "scale", "weights"):
                    continue
                times = self._accessor(sampler["input"]).ravel()
                kind = sampler.get("interpolation", "LINEAR")
                if not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0).any() or times[0] < 0:
                    raise InputError(f"{self.path}: the times of an animation must increase from 0 or later")
                if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
                    raise InputError(f"{self.path}: interpolation {str(kind)[:40]!r} is none of glTF's")
                values = self._accessor(sampler["output"])
                keys = (len(times), 3) if kind == "CUBICSPLINE" else (len(times),)
                yield _Track(target["node"], target["path"], times, values.reshape(*keys, -1), kind)

    def _local(self, node: int, moved: dict[tuple[int, str], Array]) -> Array:
        facts = self._nodes[node]
        if "matrix" in facts:
            return np.array(facts["matrix"], np.float64).reshape(4, 4).T
        still = {"translation": (0.0, 0, 0), "rotation": (0.0, 0, 0, 1), "scale": (1.0, 1, 1)}
        place = {name: moved.get((node, name), np.array(facts.get(name, still[name]), float)) for name in still}
        local = np.eye(4)
        local[:3, :3] = Rotation.from_quat(place["rotation"]).as_matrix() * place["scale"]
        local[:3, 3] = place["translation"]
        return local

    def _primitives(self, node: int) -> list[dict[str, Any]]:
        """Of a node's mesh, read once: positions, faces, targets, joints, weights, colours."""
        mesh = self._nodes[node]["mesh"]
        if mesh not in self._meshes:
            self._meshes[mesh] = [
                self._primitive(facts)
                for facts in self._json["meshes"][mesh]["primitives"]
                if facts.get("mode", TRIANGLES) == TRIANGLES
            ]
        return self._meshes[mesh]

    def _primitive(self, facts: dict[str, Any]) -> dict[str, Any]:
        attributes = facts["attributes"]
        positions = self._accessor(attributes["POSITION"])
        rows = self._accessor(facts["indices"]) if "indices" in facts else np.arange(len(positions))
        faces = rows.astype(np.int64).reshape(-1, 3)
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(positions):
            raise InputError(f"{self.path}: a triangle has a corner beyond its {len(positions)} vertices")
        targets = [self._accessor(target["POSITION"]) for target in facts.get("targets", ()) if "POSITION" in target]
        found: dict[str, Any] = {"positions": positions, "faces": faces, "targets": np.array(targets)}
        for key, names in {"joints": "JOINTS", "weights": "WEIGHTS"}.items():
            sets = [self._accessor(attributes[f"{names}_{i}"]) for i in range(4) if f"{names}_{i}" in attributes]
            found[key] = np.concatenate(sets, axis=1) if sets else None
        colours = self._accessor(attributes["COLOR_0"])[:, :3] if "COLOR_0" in attributes else None
        found["colours"] = colours
        return found

    def _part(self, node: int) -> Part:
        faces, colours, count = [], [], 0
        for primitive in self._primitives(node):
            faces.append(primitive["faces"] + count)
            colours.append(primitive["colours"])
            count += len(primitive["positions"])
        plain = any(each is None for each in colours) or not colours
        return Part(
            node=node,
            corners=count,
            faces=np.concatenate(faces) if faces else np.zeros((0, 3), np.int64),
            colours=None if plain else np.concatenate(colours),
        )

    def _posed(self, node: int, world: dict[int, Array], moved: dict[tuple[int, str], Array]) -> Array:
        facts, placed = self._nodes[node], [np.zeros((0, 3))]
        skin = self._skin(facts["skin"], world) if "skin" in facts else None
        default = facts.get("weights", self._json["meshes"][facts["mesh"]].get("weights"))
        for primitive in self._primitives(node):
            vertices = primitive["positions"]
            shares = moved.get((node, "weights"), None if default is None else np.array(default, float))
            if shares is not None and len(primitive["targets"]):
                vertices = vertices + np.tensordot(shares, primitive["targets"], axes=1)
            if skin is not None and primitive["joints"] is not None:
                rows = primitive["joints"].astype(int)
                weights = primitive["weights"] / np.maximum(primitive["weights"].sum(axis=1, keepdims=True), 1e-12)
                blended = np.einsum("vk,vkij->vij", weights, skin[rows])
            else:
                blended = world[node][None]
            placed.append((blended[:, :3, :3] @ vertices[:, :, None])[..., 0] + blended[:, :3, 3])
        return np.concatenate(placed)

    def _skin(self, index: int, world: dict[int, Array]) -> Array:
        facts = self._json["skins"][index]
        joints = facts["joints"]
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in facts:
            inverse = self._accessor(facts["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        return np.stack([world[joint] for joint in joints]) @ inverse

    def _accessor(self, index: int) -> Array:
        """The numbers of an accessor, (count, width), normalised integers as floats."""
        facts = self._json["accessors"][index]
        count, width = int(facts["count"]), WIDTHS[facts["type"]]
        kind = np.dtype(COMPONENTS[facts["componentType"]])
        if not 0 < count <= MOST_VERTICES * 3:
            raise InputError(f"{self.path}: an accessor claims {count} elements, at most {MOST_VERTICES * 3} are read")
        values = np.zeros((count, width), kind)
        if "bufferView" in facts:
            values = self._view(facts["bufferView"], facts.get("byteOffset", 0), kind, count, width)
        if "sparse" in facts:
            sparse = facts["sparse"]
            few, values = int(sparse["count"]), values.copy()
            at, of = sparse["indices"], sparse["values"]
            row_kind = np.dtype(COMPONENTS[at["componentType"]])
            rows = self._view(at["bufferView"], at.get("byteOffset", 0), row_kind, few, 1).ravel()
            values[rows] = self._view(of["bufferView"], of.get("byteOffset", 0), kind, few, width)
        if not facts.get("normalized", False):
            return values.astype(np.float64)
        return np.maximum(values.astype(np.float64) / np.iinfo(kind.type).max, -1.0)

    def _view(self, index: int, offset: int, kind: np.dtype, count: int, width: int) -> NDArray[Any]:
        facts = self._json["bufferViews"][index]
        buffer = self._json["buffers"][facts["buffer"]]
        if facts["buffer"] != 0 or "uri" in buffer:
            raise InputError(f"{self.path} refers to {str(buffer.get('uri', ''))[:60]!r}; a GLB that holds all is read")
        start, length = facts.get("byteOffset", 0), facts["byteLength"]
        data = self._binary[start : start + length]
        size = kind.itemsize * width
        stride = facts.get("byteStride", size)
        if min(start, offset, length) < 0 or stride < size or offset + stride * (count - 1) + size > len(data):
            raise InputError(f"{self.path}: an accessor claims {count} elements beyond its {len(data)} bytes")
        return np.ndarray((count, width), kind.newbyteorder("<"), data, offset, (stride, kind.itemsize))


def _chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk."""
    data = path.read_bytes()
    if len(data) < 20 or struct.unpack_from("<I", data)[0] != MAGIC:
        raise InputError(f"{path} is not a GLB file")
    _, version, length = struct.unpack_from("<III", data)
    if version != 2:
        raise InputError(f"{path} is glTF version {version}, must be 2")
    if length > len(data):
        raise InputError(f"{path} is cut short: {len(data)} of {length} bytes")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise InputError(f"{path} is cut short: a chunk of {size} bytes ends beyond the file")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    facts = json.loads(found[JSON_CHUNK])
    if not isinstance(facts, dict):
        raise InputError(f"{path}: its JSON is no object")
    return facts, found.get(BINARY_CHUNK, b"")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """What a broken file makes Python trip over, in one line with the file's name."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        raise InputError(f"{path} is damaged: {reason}") from error


def _slerp(start: Array, end: Array, share: float) -> Array:
    """Between two unit quaternions, the short way."""
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    angle = np.arccos(min(cosine, 1.0))
    if angle < 1e-6:
        return start + share * (end - start)
    return (np.sin((1 - share) * angle) * start + np.sin(share * angle) * end) / np.sin(angle)
