"""What a run will do, decided from the config alone, before anything heavy is imported.

A step that the scene does not need is left out, with the reason and what that saves in the plan and in the record.
An omission is exact or carries its error bound. Each option of a stage adds its own lines (`hoi.stages`).
"""

import math
from pathlib import Path

from hoi.config import Ablation, Config, MaterialConf, ObjectKind
from hoi.data import Check, Material, Plan
from hoi.errors import InputError, under
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
    """Kept steps, omissions and checks of a config.

    Raises:
        InputError: a material or time step out of range, weights that do not exist, or a label that contradicts
            `ablation`.
    """
    draft = Draft(materials_of(config))
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
    return Plan(variant, tuple(draft.steps), tuple(draft.omissions), tuple(draft.checks), tuple(draft.uses))


def _scene_checks(config: Config, materials: tuple[Material, ...]) -> list[Check]:
    """What is beside the ground and the object's own material."""
    checks = []
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
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)) + f"  {row[3]}"
        for row in rows
    ]
    return "\n".join([f"variant {plan.variant}", *lines]) + "\n"
