"""The parts of a run as JSON, CSV and NPZ, and back. Nothing here is pickled; small vectors come back as float64."""

import csv
import io
import json
import math
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin

import numpy as np

from hoi.data import Array, Body, GaussianCloud, Scene, SceneObject, fields_of

T = TypeVar("T")

_SCENE = ("name", "motion_prompt", "frames", "fps", "gravity", "planes", "setting", "acts")
_BODY = ("name", "source")
_OBJECT = ("name", "size", "notes", "material", "other_materials")


def plain(value: Any) -> Any:
    """Dataclasses, arrays and tuples as what JSON can say. Non-finite numbers become "NaN", "Infinity", "-Infinity"."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(fields_of(value))
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def restore(kind: type[T], values: dict[str, Any], **more: Any) -> T:
    """The dataclass `kind` from what `plain` made of it, and from `more` fields as they are.

    Raises:
        TypeError: a field is missing, or of a type no record holds.
    """
    known = {f.name: _restored(f.type, values[f.name]) for f in fields(kind) if f.name in values and f.name not in more}  # pyright: ignore[reportArgumentType]
    return kind(**known, **more)


def _restored(kind: Any, value: Any) -> Any:
    if is_dataclass(kind) and isinstance(kind, type):
        return restore(kind, value)
    if kind in (int, float, str):
        return kind(value)
    if kind is Array:
        return np.array(value, np.float64)
    if get_origin(kind) is tuple:
        return tuple(_restored(get_args(kind)[0], item) for item in value)
    if get_origin(kind) is dict:
        return {key: float(item) for key, item in value.items()}
    raise TypeError(f"no record holds a {kind}")


def to_json(value: Any) -> bytes:
    """Compact JSON of `plain(value)`."""
    return json.dumps(plain(value), separators=(",", ":"), allow_nan=False).encode()


def history_to_csv(rows: tuple[dict[str, float | str], ...]) -> bytes:
    """One line a row; strings are quoted, numbers are not, what a row lacks is empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    if columns:
        table.writeheader()
    for row in rows:
        table.writerow({key: value if isinstance(value, str) else float(value) for key, value in row.items()})
    return text.getvalue().encode()


def history_from_csv(data: bytes) -> tuple[dict[str, float | str], ...]:
    """The inverse of `history_to_csv`."""
    table = csv.DictReader(io.StringIO(data.decode(), newline=""), quoting=csv.QUOTE_NONNUMERIC)
    return tuple({key: value for key, value in row.items() if value != ""} for row in table)


def scene_files(scene: Scene) -> dict[str, bytes]:
    """Attachment name -> content: `scene.json`, `body.npz`, and `object.npz` where there is an object."""
    body, thing = scene.body, scene.object
    facts = _facts(scene, _SCENE) | {"body": _facts(body, _BODY), "object": thing and _facts(thing, _OBJECT)}
    files = {"scene.json": to_json(facts), "body.npz": _npz(body)}
    return files if thing is None else files | {"object.npz": _npz(thing)}


def scene_from_files(files: dict[str, bytes]) -> Scene:
    """The inverse of `scene_files`. Records from before there were planes and regions have none, and those of a person
    alone had an object without particles."""
    facts, thing = json.loads(files["scene.json"]), None
    body = restore(Body, facts["body"], **_arrays(files["body.npz"], Body))
    if facts["object"] is not None:
        arrays = _arrays(files["object.npz"], SceneObject)
        thing = restore(SceneObject, facts["object"], **arrays) if len(arrays["particles"]) else None
    return restore(Scene, facts, body=body, object=thing)


def _facts(owner: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(owner, name) for name in names}


def _npz(owner: Body | SceneObject) -> bytes:
    """The arrays of the cloud, and all others, by the names of their fields."""
    values = fields_of(owner.cloud) | fields_of(owner)
    if isinstance(owner, SceneObject) and owner.drawn is not None:
        values |= {f"drawn_{name}": array for name, array in fields_of(owner.drawn).items()}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    return buffer.getvalue()


def _arrays(data: bytes, owner: type) -> dict[str, Any]:
    """The inverse of `_npz`; what `owner` has no field for is left out."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        clouds = {
            field: GaussianCloud(
                **{f.name: archive[prefix + f.name] for f in fields(GaussianCloud) if prefix + f.name in archive.files}
            )
            for field, prefix in (("cloud", ""), ("drawn", "drawn_"))
            if f"{prefix}means" in archive.files
        }
        return clouds | {f.name: archive[f.name] for f in fields(owner) if f.name in archive.files}
