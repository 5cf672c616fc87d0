"""What a run will do, decided from the config alone, before anything heavy is imported.

A step that the scene does not need is left out, with the reason and what that saves in the plan and in the record.
An omission is exact or carries its error bound. Each option of a stage adds its own lines (`hoi.stages`). Whatever is
missing is found here, all of it, and said in one go.
"""

import math
from pathlib import Path

from hoi.config import Ablation, Config, Device, HumanKind, MaterialConf, ObjectKind
from hoi.data import Check, Material, Missing, Plan
from hoi.errors import InputError, under
from hoi.gpu import gpus
from hoi.stages.contract import Draft, labels


def material_of(conf: MaterialConf) -> Material:
    """The checked material.

    Raises:
        InputError: a value that its model does not allow or does not use.
    """
    from hoi.mpm.materials import check_material

    material = Material(
        name=conf.name,
        model=conf.model.value,
        youngs_modulus=conf.youngs_modulus,
        poisson_ratio=conf.poisson_ratio,
        density=conf.density,
        restitution=conf.restitution,
        ground_friction=conf.ground_friction,
        yield_stress=math.inf if conf.yield_stress is None else conf.yield_stress,
        hardening=conf.hardening,
        viscosity=conf.viscosity,
        friction_angle=conf.friction_angle,
        critical_compression=conf.critical_compression,
        critical_stretch=conf.critical_stretch,
    )
    check_material(material)
    return material


def materials_of(config: Config) -> tuple[Material, ...]:
    """The checked materials of the object: its own, then each region's.

    Raises:
        InputError: as `material_of`.
    """
    materials = [material_of(config.material)]
    for index, region in enumerate(config.object.regions):
        with under(f"object.regions.{index}"):
            materials.append(material_of(region.material))
    return tuple(materials)


def make_plan(config: Config) -> Plan:
    """Kept steps, omissions and checks of a config, and all that these need and that is not there.

    Raises:
        InputError: a material or time step out of range, or a label that contradicts `ablation`.
    """
    draft = Draft(materials_of(config), missing=_missing(config))
    for option in config.options:
        option.plan(config, draft)
    config.stage.object.closing(config, draft)
    draft.checks += _scene_checks(config, draft.materials)
    parts = labels()
    variant = "+".join(sorted(draft.without, key=list(parts).index)) or "full"
    if config.ablation is not Ablation.full and config.ablation.value not in draft.without:
        raise InputError(
            f"ablation={config.ablation.value} contradicts the rest of the config, which runs with "
            f"{parts[config.ablation.value]} (variant {variant}); drop one of the two"
        )
    return Plan(
        variant,
        tuple(draft.steps),
        tuple(draft.omissions),
        tuple(draft.checks),
        tuple(draft.uses),
        tuple(draft.missing),
    )


def check_complete(plan: Plan) -> None:
    """Before anything is computed.

    Raises:
        InputError: something that the plan needs is missing; a line each, also of what is merely better to have.
    """
    if any(each.needed for each in plan.missing):
        raise InputError("\n".join(map(str, plan.missing)))


def _missing(config: Config) -> list[Missing]:
    """Of the person, the object and the machine."""
    found, human = [], config.human
    if human.kind is not HumanKind.builtin and human.path is not None:
        path = Path(human.path)
        what = "SMPL model file" if human.kind is HumanKind.smpl else "avatar's folder or PLY file"
        get = "docs/people.md says where they are from; human=man and others are in the package"
        if not path.exists():
            found.append(Missing("human.path", what, str(path), "", get))
        elif human.kind is HumanKind.avatar:
            beside = path if path.is_dir() else path.parent
            files = {"human.path": beside / "gaussians.ply"} if path.is_dir() else {}
            files["human.skinning"] = Path(human.skinning) if human.skinning else beside / "skinning.npz"
            found += [Missing(key, "file", str(file), "", get) for key, file in files.items() if not file.is_file()]
    if config.object.kind is ObjectKind.file and config.object.path is not None:
        if not Path(config.object.path).exists():
            get = "object=soccer_ball and others are in the package"
            found.append(Missing("object.path", "3DGS file", config.object.path, "", get))
    if config.device is Device.cuda and not gpus():
        found.append(Missing("device", "CUDA device", "", "", "device=auto or device=cpu run without one"))
    return found


def _scene_checks(config: Config, materials: tuple[Material, ...]) -> list[Check]:
    """What is beside the ground and the object's own material."""
    checks = []
    striking = sorted((act for act in config.scene.acts if act.strikes), key=lambda act: act.start)
    if len(striking) > 1:
        said = [f"{act.strikes} is aimed with what the object does from {act.start:g} s on" for act in striking[1:]]
        first = f"{striking[0].strikes} is aimed and answered as alone"
        detail = "; then ".join([first, *said]) + "; each answered before the next, all before that as it was"
        checks.append(Check("order", f"{len(striking)} strikes", detail))
    if config.scene.planes or not config.scene.ground:
        walls = config.scene.planes or []
        names = ["the ground"] if config.scene.ground else []
        names += [f"{wall.contact.value} at {wall.point} facing {wall.normal}" for wall in walls]
        checks.append(Check("planes", str(len(names)), "; ".join(names) or "empty space"))
    thing = config.object
    if thing.kind is ObjectKind.file and thing.up == "auto" and thing.path is not None and Path(thing.path).exists():
        from hoi.objects.load import up_in

        checks.append(Check("up", *up_in(Path(thing.path))))
    if len(materials) > 1:
        checks.append(Check("materials", str(len(materials)), ", ".join(material.name for material in materials)))
    return checks


def format_plan(plan: Plan) -> str:
    """The plan as one table."""
    rows = [("RUN", step.name, step.implementation, step.reason) for step in plan.steps]
    rows += [("OMIT", o.what, "", f"{o.because}; saves {o.saves}") for o in plan.omissions]
    rows += [("CHECK", check.name, check.value, check.detail) for check in plan.checks]
    rows += [("LACK", m.key, "needed" if m.needed else "optional", str(m).partition(": no ")[2]) for m in plan.missing]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)) + f"  {row[3]}"
        for row in rows
    ]
    return "\n".join([f"variant {plan.variant}", *lines]) + "\n"
