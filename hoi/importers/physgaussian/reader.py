"""Reads the scene files of PhysGaussian, and of DreamPhysics, which took them over.

A scene file is one JSON object. The object's cloud is turned (`rotation_degree` about `rotation_axis`, one after the
other), its longest side made `scale` long and its bounding box centred at (1, 1, 1) in a cubic grid [0, grid_lim]^3 of
n_grid^3 cells. Lengths are metres, times seconds, angles degrees. The defaults are those of PhysGaussian's
utils/decode_param.py, and so is the spelling of the keys; DreamPhysics differs in that its E counts 1e7 Pa.
"""

import difflib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hoi.errors import InputError, about

MATERIALS = ("jelly", "metal", "sand", "foam", "snow", "plasticine", "watermelon")
"""The last is GaussianFluent's, whose scenes are written the same way."""
DREAMPHYSICS_E = 1e7
"""Unit of E in DreamPhysics [Pa]."""
SOFTEST = 1e3
"""An E below this is in DreamPhysics' unit: the softest of PhysGaussian's files has 2e3 Pa, the stiffest of
DreamPhysics' 0.1."""

NUMBERS: dict[str, float | None] = {
    "E": 1e5,
    "nu": 0.4,
    "density": 200.0,
    "n_grid": 50,
    "grid_lim": 2.0,
    "substep_dt": 1e-4,
    "frame_dt": 1e-2,
    "frame_num": 100,
    "scale": 1.0,
    "yield_stress": None,
    "hardening": 0.0,
    "xi": 0.0,
    "friction_angle": 25.0,
    "plastic_viscosity": 0.0,
    "softening": 0.1,
    "opacity_threshold": 0.02,
    "rpic_damping": 0.0,
    "pic_damping": 0.0,
    "grid_v_damping_scale": 1.1,
}
"""Key -> default."""
POSITIVE = ("E", "density", "n_grid", "grid_lim", "substep_dt", "frame_dt", "frame_num", "scale")
WHOLE = ("n_grid", "frame_num")
OTHERS = ("material", "g", "rotation_degree", "rotation_axis", "additional_material_params", "boundary_conditions")
CAMERA = (
    "mpm_space_viewpoint_center", "mpm_space_vertical_upward_axis", "default_camera_index", "show_hint",
    "init_azimuthm", "init_azimuth", "init_elevation", "init_radius", "delta_a", "delta_e", "delta_r", "move_camera",
)  # fmt: skip
"""`init_azimuthm` is how PhysGaussian spells it."""
PROCESSING = ("sim_area", "particle_filling")
KNOWN = (*NUMBERS, *OTHERS, *CAMERA, *PROCESSING)

CONDITIONS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "bounding_box": ((), ()),
    "surface_collider": (("point", "normal", "surface", "friction", "start_time", "end_time"), ()),
    "cuboid": (("point", "size", "velocity"), ("start_time", "end_time", "reset")),
    "particle_impulse": (("force",), ("num_dt", "start_time", "point", "size")),
    "enforce_particle_translation": (("point", "size", "velocity", "start_time", "end_time"), ()),
    "enforce_particle_velocity_rotation": (
        ("point", "normal", "half_height_and_radius", "rotation_scale", "translation_scale", "start_time", "end_time"),
        (),
    ),
    "release_particles_sequentially": (
        ("normal", "start_position", "end_position", "num_layers", "start_time", "end_time"),
        (),
    ),
}
"""Type of a boundary condition -> keys it needs, keys it may have."""
CONDITION_DEFAULTS = {
    "start_time": 0.0,
    "end_time": 1e3,
    "reset": 0,
    "num_dt": 1,
    "point": [1.0, 1.0, 1.0],
    "size": [1.0, 1.0, 1.0],
}
SURFACES = ("sticky", "slip", "separate", "cut")
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class SceneFile:
    """What a file says, checked, with the defaults filled in and E in Pa."""

    path: Path
    dialect: str
    """"PhysGaussian" or "DreamPhysics"."""
    material: str
    numbers: Mapping[str, Any]
    """The keys of `NUMBERS`."""
    gravity: Vector
    rotations: tuple[tuple[int, float], ...]
    """(axis, angle in degrees), applied in this order."""
    parts: tuple[Mapping[str, Any], ...]
    """additional_material_params: point, size (half), E, nu, density."""
    conditions: tuple[Mapping[str, Any], ...]
    """boundary_conditions."""
    up: Vector
    """mpm_space_vertical_upward_axis."""
    given: frozenset[str]
    """The known keys that the file has."""
    remarks: tuple[str, ...]
    """What reading it made of doubtful things, a line each."""


def read_scene_file(path: Path, dialect: str | None = None) -> SceneFile:
    """Read and check a scene file.

    Args:
        path: a JSON file.
        dialect: "physgaussian" or "dreamphysics"; None tells them apart by the size of E.

    Raises:
        InputError: not JSON, or a value of the wrong kind; names the key.
    """
    with about(path):
        try:
            values = json.loads(path.read_text("utf-8-sig"))
        except OSError as error:
            raise InputError(error.strerror) from None
        except UnicodeDecodeError:
            raise InputError("not a JSON file") from None
        except json.JSONDecodeError as error:
            raise InputError(f"not a JSON file: line {error.lineno}: {error.msg}") from None
        return _scene_file(path, values, dialect)


def _scene_file(path: Path, values: Any, dialect: str | None) -> SceneFile:
    if not isinstance(values, dict):
        raise InputError("must hold one JSON object {...}")
    remarks = _unknown(values, KNOWN, "")
    numbers = {key: _number(values, key, default) for key, default in NUMBERS.items()}
    for key in POSITIVE:
        if not numbers[key] > 0:
            raise InputError(key, f"{numbers[key]:g}", "greater than 0")
    for key in WHOLE:
        if numbers[key] != int(numbers[key]):
            raise InputError(key, f"{numbers[key]:g}", "a whole number")
        numbers[key] = int(numbers[key])
    material = values.get("material", "jelly")
    if material not in MATERIALS:
        raise InputError("material", repr(material), f"one of {', '.join(MATERIALS)}")
    if material == "watermelon":
        remarks.append("material: watermelon breaks by cam-clay, which there is none of; it is elastic and stays whole")
    if "g" not in values:
        remarks.append("g: not given, taken as [0, 0, -9.8]")
    angles, axes = (_list(values, key, []) for key in ("rotation_degree", "rotation_axis"))
    if len(angles) != len(axes) or any(axis not in (0, 1, 2) for axis in axes):
        raise InputError(
            f"rotation_degree and rotation_axis must be equally long, axes 0, 1 or 2, got {angles} and {axes}"
        )
    parts = [
        {"density": numbers["density"], **part}
        for part in _entries(values, "additional_material_params", ("point", "size", "E", "nu"), ("density",), remarks)
    ]
    if dialect is None:
        dialect = "dreamphysics" if numbers["E"] < SOFTEST else "physgaussian"
        if dialect == "dreamphysics":
            remarks.append(f"E: {numbers['E']:g} is so small that it is taken to count {DREAMPHYSICS_E:g} Pa")
    if dialect == "dreamphysics":
        if "E" not in values:
            raise InputError("E must be given")
        numbers["E"] *= DREAMPHYSICS_E
        parts = [{**part, "E": part["E"] * DREAMPHYSICS_E} for part in parts]
    return SceneFile(
        path=path,
        dialect="DreamPhysics" if dialect == "dreamphysics" else "PhysGaussian",
        material=material,
        numbers=numbers,
        gravity=_vector(values, "g", [0.0, 0.0, -9.8]),
        rotations=tuple(zip((int(axis) for axis in axes), angles, strict=True)),
        parts=tuple(parts),
        conditions=tuple(_conditions(values, remarks)),
        up=_vector(values, "mpm_space_vertical_upward_axis", [0.0, 0.0, 1.0]),
        given=frozenset(values) & frozenset(KNOWN),
        remarks=tuple(remarks),
    )


def _conditions(values: dict[str, Any], remarks: list[str]) -> list[dict[str, Any]]:
    conditions = _objects(values, "boundary_conditions")
    checked = []
    for index, condition in enumerate(conditions):
        where = f"boundary_conditions.{index}"
        kind = condition.get("type")
        if kind not in CONDITIONS:
            raise InputError(f"{where}.type", repr(kind), f"one of {', '.join(CONDITIONS)}")
        needed, optional = CONDITIONS[kind]
        rest = {key: value for key, value in condition.items() if key != "type"}
        if kind == "surface_collider" and (surface := rest.pop("surface", None)) not in SURFACES:
            raise InputError(f"{where}.surface", repr(surface), f"one of {', '.join(SURFACES)}")
        needed = tuple(key for key in needed if key != "surface")
        defaults = {key: CONDITION_DEFAULTS[key] for key in optional}
        entry = {"type": kind, **defaults, **_entry(rest, where, needed, optional, remarks)}
        if kind == "surface_collider":
            entry["surface"] = surface
            if not any(entry["normal"]):
                raise InputError(f"{where}.normal must not be zero")
            if entry["friction"] < 0:
                raise InputError(f"{where}.friction", f"{entry['friction']:g}", "0 or more")
        checked.append(entry)
    return checked


VECTORS = ("point", "normal", "size", "velocity", "force")
PAIRS = ("half_height_and_radius",)


def _entries(
    values: dict[str, Any], key: str, needed: Sequence[str], optional: Sequence[str], remarks: list[str]
) -> list[dict[str, Any]]:
    entries = _objects(values, key)
    return [_entry(entry, f"{key}.{i}", needed, optional, remarks) for i, entry in enumerate(entries)]


def _entry(
    entry: dict[str, Any], where: str, needed: Sequence[str], optional: Sequence[str], remarks: list[str]
) -> dict[str, Any]:
    """Its known values, of the right kind."""
    missing = [key for key in needed if key not in entry]
    if missing:
        raise InputError(f"{where}: needs {', '.join(missing)}")
    remarks += _unknown(entry, (*needed, *optional), f"{where}.")
    checked: dict[str, Any] = {}
    for key in (key for key in (*needed, *optional) if key in entry):
        if key in VECTORS:
            checked[key] = _vector(entry, key, [], where)
        elif key in PAIRS:
            checked[key] = _list(entry, key, [], where)
        else:
            checked[key] = _number(entry, key, None, where)
    return checked


def _objects(values: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = values.get(key, [])
    if not (isinstance(found, list) and all(isinstance(entry, dict) for entry in found)):
        raise _wrong("", key, "a list of JSON objects", found)
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _number(values: Mapping[str, Any], key: str, default: float | None, where: str = "") -> Any:
    value = values.get(key, default)
    if not (_is_number(value) or (value is None and key not in values)):
        raise _wrong(where, key, "a number", value)
    return value


def _list(values: Mapping[str, Any], key: str, default: list[float], where: str = "", count: int | None = None) -> Any:
    value = values.get(key, default)
    if not (isinstance(value, list) and all(map(_is_number, value)) and count in (None, len(value))):
        raise _wrong(where, key, f"a list of {'' if count is None else f'{count} '}numbers", value)
    return value


def _vector(values: Mapping[str, Any], key: str, default: list[float], where: str = "") -> Vector:
    x, y, z = _list(values, key, default, where, 3)
    return float(x), float(y), float(z)


def _wrong(where: str, key: str, rule: str, value: Any) -> InputError:
    return InputError(f"{where}.{key}" if where else key, f"{value!r:.60}", rule)


def _unknown(values: Mapping[str, Any], known: Sequence[str], where: str) -> list[str]:
    lines = []
    for key in values:
        if key not in known:
            close = difflib.get_close_matches(key, known, 1)
            lines.append(f"{where}{key}: unknown key, left out" + (f"; did you mean {close[0]}?" if close else ""))
    return lines
