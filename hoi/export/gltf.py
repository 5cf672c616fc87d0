"""glTF 2.0 as one binary file (.glb): arrays into a buffer, the JSON that names them, and both into a container."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hoi
from hoi.files import whole_file

VERTICES, INDICES = 34962, 34963
POINTS, TRIANGLES = 0, 4
_COMPONENTS = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_JSON_CHUNK, _BINARY_CHUNK = b"JSON", b"BIN\0"


class Document:
    """A glTF document in the making: `add` what its tables hold, `array` what lies in its buffer."""

    def __init__(self, **asset: str) -> None:
        self._tables: dict[str, Any] = {"asset": {"version": "2.0", "generator": f"hoi {hoi.__version__}", **asset}}
        self._buffer = bytearray()

    def add(self, table: str, **entry: Any) -> int:
        """Append to "nodes", "meshes", ...; its index. Entries that are None are left out."""
        rows = self._tables.setdefault(table, [])
        rows.append({key: value for key, value in entry.items() if value is not None})
        return len(rows) - 1

    def count(self, table: str) -> int:
        """How many entries a table has so far."""
        return len(self._tables.get(table, ()))

    def array(
        self,
        values: NDArray[Any],
        kind: str = "f4",
        *,
        target: int | None = None,
        normalized: bool = False,
        bounds: bool = False,
    ) -> int:
        """The index of an accessor of values (N, ...), stored as `kind`; matrices (N, 4, 4) are given row by row."""
        stored = np.ascontiguousarray(values.swapaxes(1, 2) if values.ndim == 3 else values, f"<{kind}")
        self._buffer += bytes(-len(self._buffer) % 4)
        view = self.add("bufferViews", buffer=0, byteOffset=len(self._buffer), byteLength=stored.nbytes, target=target)
        self._buffer += stored.tobytes()
        extremes = {}
        if bounds:
            extremes = {"min": np.atleast_1d(stored.min(0)).tolist(), "max": np.atleast_1d(stored.max(0)).tolist()}
        return self.add(
            "accessors",
            bufferView=view,
            componentType=_COMPONENTS[kind],
            count=len(stored),
            type=_SHAPES[values.shape[1:]],
            normalized=normalized or None,
            **extremes,
        )

    def write(self, path: Path, roots: list[int], **extras: Any) -> None:
        """Write the file; the scene shows the nodes `roots`.

        Raises:
            InputError: the path cannot be written to.
            RunError: the disk is full or broken.
        """
        self._buffer += bytes(-len(self._buffer) % 4)
        scenes = {"scene": 0, "scenes": [{"nodes": roots, "extras": extras}]}
        tables = self._tables | scenes | {"buffers": [{"byteLength": len(self._buffer)}]}
        text = json.dumps(tables, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = ((_JSON_CHUNK, text), (_BINARY_CHUNK, bytes(self._buffer)))
        body = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
        with whole_file(path) as part:
            part.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
