"""The parts of a run as JSON, CSV and NPZ, and back. Nothing here is pickled; small vectors come back as float64."""

import csv
import io
import json
import math
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_origin

import numpy as np

from hoi.data import Array, Body, GaussianCloud, Material, Plane, Scene, SceneObject

T = TypeVar("T")

_CLOUD = tuple(f.name for f in fields(GaussianCloud))
_BODY = ("skinning_weights", "rest_joints")
_OBJECT = ("particles", "volumes", "velocity", "angular_velocity")


def plain(value: Any) -> Any:
    """Dataclasses, arrays and tuples as what JSON can say. Non-finite numbers become "NaN", "Infinity", "-Infinity"."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def restore(kind: type[T], values: dict[str, Any]) -> T:
    """The flat dataclass `kind` from what `plain` made of it.

    Raises:
        TypeError: a field is missing, or of a type no record holds.
    """
    return kind(**{f.name: _restore_field(f.type, values[f.name]) for f in fields(kind) if f.name in values})  # pyright: ignore[reportArgumentType]


def _restore_field(kind: Any, value: Any) -> Any:
    if kind in (int, float, str):
        return kind(value)
    if kind is Array:
        return np.array(value, np.float64)
    if get_origin(kind) is tuple:
        return tuple(value)
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
    """Attachment name -> content: `scene.json`, `body.npz`, `object.npz`."""
    body, thing = scene.body, scene.object
    facts = {
        "name": scene.name,
        "motion_prompt": scene.motion_prompt,
        "frames": scene.frames,
        "fps": scene.fps,
        "gravity": scene.gravity,
        "planes": scene.planes,
        "body": {"name": body.name, "source": body.source},
        "object": {
            "name": thing.name,
            "size": thing.size,
            "notes": thing.notes,
            "material": thing.material,
            "other_materials": thing.other_materials,
        },
    }
    return {
        "scene.json": to_json(facts),
        "body.npz": _npz(
            {name: getattr(body.cloud, name) for name in _CLOUD},
            body,
            _BODY if body.pose_directions is None else (*_BODY, "pose_directions"),
        ),
        "object.npz": _npz(
            {name: getattr(thing.cloud, name) for name in _CLOUD},
            thing,
            _OBJECT if thing.region is None else (*_OBJECT, "region"),
        ),
    }


def scene_from_files(files: dict[str, bytes]) -> Scene:
    """The inverse of `scene_files`. Records from before there were planes and regions have none."""
    facts = json.loads(files["scene.json"])
    body, thing = _arrays(files["body.npz"]), _arrays(files["object.npz"])
    return Scene(
        name=facts["name"],
        body=Body(
            cloud=_cloud(body),
            **facts["body"],
            **_named(body, _BODY),
            pose_directions=body.get("pose_directions"),
        ),
        object=SceneObject(
            name=facts["object"]["name"],
            cloud=_cloud(thing),
            material=restore(Material, facts["object"]["material"]),
            size=float(facts["object"]["size"]),
            notes=tuple(facts["object"]["notes"]),
            other_materials=tuple(restore(Material, m) for m in facts["object"].get("other_materials", ())),
            region=thing["region"].astype(np.int32) if "region" in thing else None,
            **_named(thing, _OBJECT),
        ),
        motion_prompt=facts["motion_prompt"],
        frames=int(facts["frames"]),
        fps=float(facts["fps"]),
        gravity=np.array(facts["gravity"], np.float64),
        planes=tuple(restore(Plane, plane) for plane in facts.get("planes", ())),
    )


def _npz(arrays: dict[str, Array], owner: Any, names: tuple[str, ...]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays, **{name: getattr(owner, name) for name in names})
    return buffer.getvalue()


def _arrays(data: bytes) -> dict[str, Array]:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _cloud(arrays: dict[str, Array]) -> GaussianCloud:
    return GaussianCloud(**_named(arrays, _CLOUD))


def _named(arrays: dict[str, Array], names: tuple[str, ...]) -> dict[str, Any]:
    return {name: arrays[name] for name in names}
