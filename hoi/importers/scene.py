"""Turn a scene file of PhysGaussian or DreamPhysics into configs: python -m hoi.importers.scene FILE.json --object DIR

It writes scene/NAME.yaml, object/NAME.yaml, material/NAME.yaml and, where the file has a grid, stage/object/NAME.yaml
into a folder that `hoi.run --config-dir` takes. The object stands in front of the person, and all else stands to it as
in the file: the file's up becomes Z, the highest floor below the object becomes z = 0. Keys that have no counterpart
here are printed with the reason.
"""

import argparse
import math
import re
import shlex
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from hoi.data import Material
from hoi.errors import InputError, about
from hoi.files import CONF
from hoi.importers.physgaussian.reader import CAMERA, SceneFile, read_scene_file
from hoi.mpm.materials import check_material
from hoi.mpm.stability import time_step_limit
from hoi.terminal.arguments import refusing
from hoi.terminal.program import program

REACH = 1.0
"""Way from the person to the object [m]."""
FPS = 20.0
"""Of the motion prior [1/s]."""
RESTITUTION, GROUND_FRICTION = 0.3, 0.5
"""Of the impulse, and against a ground; scene files have neither."""
MODELS = {
    "jelly": "fixed_corotated",
    "metal": "von_mises",
    "plasticine": "von_mises",
    "sand": "drucker_prager",
    "foam": "viscoplastic",
    "snow": "snow",
    "watermelon": "fixed_corotated",
}
FLOW_KEYS = {
    "metal": {"yield_stress", "hardening", "xi"},
    "plasticine": {"yield_stress", "hardening", "xi"},
    "foam": {"yield_stress", "plastic_viscosity"},
    "sand": {"friction_angle"},
    "jelly": set(),
    "snow": set(),
    "watermelon": set(),
}
"""What a material of the file takes beside elasticity."""
SNOW = {"hardening": 10.0, "critical_compression": 2.5e-2, "critical_stretch": 7.5e-3}
"""Stomakhin et al. 2013, A Material Point Method for Snow Simulation, table 2; PhysGaussian's snow has no stress."""
LEFT_OUT = dict.fromkeys(CAMERA, "a camera; a record is looked at from anywhere") | {
    "particle_filling": "the interior is filled in another way, see hoi.objects.filling",
    "sim_area": "all of the object's file is simulated; cut the object out of it",
    "opacity_threshold": "faint Gaussians are removed, see hoi.objects.cleaning",
    "rpic_damping": "motion is not damped",
    "pic_damping": "motion is not damped",
    "grid_v_damping_scale": "motion is not damped",
    "softening": "what yields does not weaken",
    "frame_dt": f"the motion prior has {FPS:g} frames a second; the duration is kept",
}
"""Key -> why it is not carried over."""
NO_DAMPING = {"rpic_damping": 0.0, "pic_damping": 0.0, "grid_v_damping_scale": 1.0}
"""From here up grid_v_damping_scale does nothing, and so do the others at these values."""


@dataclass(frozen=True)
class Imported:
    """The configs, as what their YAML says."""

    scene: dict[str, Any]
    object: dict[str, Any]
    material: dict[str, Any]
    mover: dict[str, Any]
    """Empty where the file has neither cells nor a step."""
    remarks: tuple[str, ...]
    """What is not carried over, or not as it stands, a line each."""


def convert(file: SceneFile, name: str, model: Path | None = None, size: float | None = None) -> Imported:
    """What a scene file is in our terms.

    Args:
        file: see `hoi.importers.physgaussian.reader`.
        name: of the configs.
        model: the object's Gaussians: a 3DGS file or model directory.
        size: longest side of the object as it stands [m]; the file's `scale` by default. All other lengths follow, and
            the time step with the cells; velocities, gravity and the material stay.

    Raises:
        InputError: a material that cannot be, or Gaussians that cannot be read.
    """
    from hoi.gaussians import load_clean
    from hoi.importers.physgaussian.space import boxes, frame_of, placing, planes, tidy, velocity
    from hoi.objects.cleaning import clean

    remarks = list(file.remarks)
    points = None if model is None else clean(load_clean(model)[0])[0].means.astype(np.float64)
    frame = frame_of(file, points, size, remarks)
    up, yaw, orientation = placing(frame.rotation)
    material, parts = _materials(file, name)
    walls = planes(file, frame, remarks)
    floors = [-wall["point"][2] for wall in walls if wall["normal"][:2] == [0, 0] and wall["normal"][2] > 0]
    floors = [floor for floor in floors if floor > 0]
    if not floors:
        remarks.append(f"no floor: the object floats, its centre {frame.factor:g} m up")
    height = min(floors, default=frame.factor)
    position = tidy([0.0, REACH + frame.longest / 2, height])
    walls = [wall | {"point": tidy(np.add(wall["point"], position))} for wall in walls]
    frames = max(round(file.numbers["frame_dt"] * file.numbers["frame_num"] * FPS), 3)
    scene = {
        "name": name,
        "motion_prompt": "a person walks forward and kicks with the right foot",
        "scene_prompt": "A man kicks an object with his right foot. Sharp, realistic, steady camera.",
        "negative_prompt": "penetration, intersecting geometry, floating, blurry, distorted body, extra limbs",
        "frames": frames,
        "fps": FPS,
        "gravity": tidy(frame.vector(file.gravity)),
        "ground": False,
        "planes": walls,
        "placement": {
            "position": position,
            "yaw": yaw,
            "orientation": orientation,
            "velocity": velocity(file, frame, remarks),
        },
        "striking_limb": "auto",
        "expected_limb": "auto",
        "contact_joint": "auto",
        "contact_frame": frames // 2,
    }
    regions = zip(boxes(file, frame, remarks), parts, strict=False)  # no boxes of an object that is askew
    thing = {
        "name": name,
        "path": None if model is None else str(model.resolve()),
        "size": round(frame.size, 9),
        "up": up,
        "regions": [{"box": box, "material": _mapping(part)} for box, part in regions],
    }
    mover = _mover(file, frame.factor, (material, *parts), remarks)
    remarks += _left_out(file)
    remarks.append(
        f"the file has no restitution, ground friction or prompt: {RESTITUTION:g}, {GROUND_FRICTION:g}, a kick"
    )
    return Imported(scene, thing, _mapping(material), mover, tuple(remarks))


def _materials(file: SceneFile, name: str) -> tuple[Material, list[Material]]:
    """The material, and those of the parts; yield stress, hardening and viscosity as `hoi.mpm.materials` has them.

    Raises:
        InputError: there can be no such material; names the file.
    """
    n = file.numbers
    flow: dict[str, float] = dict(SNOW) if file.material == "snow" else {}
    keys = FLOW_KEYS[file.material]
    if "yield_stress" in keys:
        if n["yield_stress"] is None:
            raise InputError(f"{file.path}: yield_stress must be given for {file.material}")
        # PhysGaussian's bound of |dev tau|, which here is sqrt(2/3) of the yield stress, as there for foam alone
        flow["yield_stress"] = n["yield_stress"] * (1.0 if file.material == "foam" else math.sqrt(3 / 2))
    if "xi" in keys and n["hardening"] == 1:
        flow["hardening"] = 3 / 2 * n["xi"] / (1 + n["nu"])  # the bound grows by 2 mu xi times |plastic strain|
    if "plastic_viscosity" in keys:
        flow["viscosity"] = n["plastic_viscosity"] / 2  # |dev tau| over |strain rate|
    if "friction_angle" in keys:
        flow["friction_angle"] = math.radians(n["friction_angle"])
    model = MODELS[file.material]
    material = Material(name, model, n["E"], n["nu"], n["density"], RESTITUTION, GROUND_FRICTION, **flow)
    parts = [
        replace(
            material, name=f"{name}_{k}", youngs_modulus=part["E"], poisson_ratio=part["nu"], density=part["density"]
        )
        for k, part in enumerate(file.parts, 1)
    ]
    for checked in (material, *parts):
        with about(f"{file.path}: {file.material}"):
            check_material(checked)
    return material, parts


def _mapping(material: Material) -> dict[str, Any]:
    """A material as the config has it, without what its model does not use."""
    neutral = {field.name: field.default for field in fields(Material)}
    return {name: value for name, value in vars(material).items() if value != neutral[name]}


def _mover(file: SceneFile, factor: float, materials: Sequence[Material], remarks: list[str]) -> dict[str, Any]:
    """Cells and time step, where the file has them."""
    if not file.given & {"n_grid", "grid_lim"}:
        if "substep_dt" in file.given:
            remarks.append("substep_dt: goes with cells that the file does not name; chosen by the stability limit")
        return {}
    mover = {"cells_across": None, "domain": factor * file.numbers["grid_lim"], "grid": file.numbers["n_grid"]}
    if "substep_dt" not in file.given:
        return mover
    dt = factor * file.numbers["substep_dt"]
    limit = min(time_step_limit(material, mover["domain"] / mover["grid"]) for material in materials)
    if dt < limit:
        return mover | {"dt": dt}
    remarks.append(f"substep_dt: {dt:g} s is above the stability limit of {limit:.3g} s, by which it is chosen instead")
    return mover


def _left_out(file: SceneFile) -> list[str]:
    """The keys that are not carried over, a line a reason."""
    carried = {key for key in NO_DAMPING if key != "grid_v_damping_scale" and file.numbers[key] == NO_DAMPING[key]}
    if file.numbers["grid_v_damping_scale"] >= NO_DAMPING["grid_v_damping_scale"]:
        carried.add("grid_v_damping_scale")
    if not any(file.gravity):
        carried.add("mpm_space_vertical_upward_axis")  # it tells what is up
    reasons: dict[str, list[str]] = {}
    for key, reason in LEFT_OUT.items():
        if key in file.given - carried:
            reasons.setdefault(reason, []).append(key)
    unused = set().union(*FLOW_KEYS.values()) - FLOW_KEYS[file.material]
    if file.given & unused:
        reasons[f"{file.material} does not use it"] = sorted(file.given & unused)
    if file.material == "snow":
        reasons["PhysGaussian's has no stress; it is that of Stomakhin et al. 2013 here"] = ["snow"]
    return [f"{', '.join(keys)}: {reason}" for reason, keys in reasons.items()]


# --- files -----------------------------------------------------------------------------------------------------------


def write_configs(imported: Imported, name: str, folder: Path, source: Path) -> list[Path]:
    """Write the configs, which are called `name`, into `folder`.

    Raises:
        InputError: a config of that name comes with hoi, or a file cannot be written.
    """
    overrides = [{"override /human": "man"}, {"override /object": name}]
    overrides += [{"override /stage/object": name}] if imported.mover else []
    own_material = {"override /material@_global_.material": name}
    configs = {
        "scene": ["/schema/scene@scene", "_self_", *overrides],
        "object": ["from_file", "_self_", own_material],
        "material": ["/schema/material@_here_", "_self_"],
    }
    values: dict[str, Any] = {
        "scene": {"scene": imported.scene},
        "object": imported.object,
        "material": imported.material,
    }
    if imported.mover:
        configs["stage/object"], values["stage/object"] = ["mpm", "_self_"], imported.mover
    files = []
    for group, defaults in configs.items():
        if (CONF / group / f"{name}.yaml").exists():
            raise InputError(f"{group}={name} comes with hoi; give another --name")
        head = "# @package _global_\n" if group == "scene" else ""
        text = OmegaConf.to_yaml(OmegaConf.create({"defaults": defaults, **values[group]}))
        files.append((folder / group / f"{name}.yaml", f"{head}# {group}={name}: imported from {source.name}\n{text}"))
    for file, text in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        except OSError as error:
            raise InputError(f"-o: cannot write {file}: {error.strerror}") from None
    return [file for file, _ in files]


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.importers.scene",
        description="Turn a scene file of PhysGaussian or DreamPhysics into configs.",
        epilog="example: python -m hoi.importers.scene ball_config.json --object model/ball --size 0.22",
    )
    parser.add_argument("file", type=Path, help=".json")
    parser.add_argument("--object", type=Path, help="its Gaussians: a model directory or a 3DGS file")
    parser.add_argument("--size", type=float, help="longest side of the object [m]; default: the file's scale")
    parser.add_argument("--name", help="of the configs; default: that of the file")
    parser.add_argument("--dialect", choices=("physgaussian", "dreamphysics"), help="default: by the size of E")
    parser.add_argument("-o", "--out", type=Path, default=Path("imported"), help="folder of the configs")
    return parser


def _plain(stem: str) -> str:
    """A file's name as that of a config: "Bälle (1)" -> "Balle_1"."""
    ascii_ = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", ascii_).strip("_-")
    return name if name[:1].isalpha() else f"scene_{name}".rstrip("_")


def run(options: argparse.Namespace) -> None:
    """Read, convert, write, report.

    Raises:
        InputError: a file or an option that cannot be used.
    """
    if options.size is not None and not (math.isfinite(options.size) and options.size > 0):
        raise InputError(f"--size must be greater than 0 [m], got {options.size:g}")
    file, name = read_scene_file(options.file, options.dialect), options.name or _plain(options.file.stem)
    if not re.fullmatch(r"[A-Za-z][\w-]*", name, re.ASCII):
        raise InputError(f"--name must start with a letter and have letters, digits, _ and - alone, got {name!r}")
    imported = convert(file, name, options.object, options.size)
    files = write_configs(imported, name, options.out, options.file)
    print("\n".join(imported.remarks))
    print("wrote " + ", ".join(str(file) for file in files))
    path = "" if options.object else " object.path=PATH"
    print(f"python -m hoi.run --config-dir {shlex.quote(str(options.out))} scene={name}{path}")


def main() -> int:
    return refusing(lambda: run(parser().parse_args()))


if __name__ == "__main__":
    program(main)
