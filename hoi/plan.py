"""What a run will do, decided from the config alone, before anything heavy is imported.

A step that the scene does not need is left out, with the reason and what that saves in the plan and in the record.
An omission is exact or carries its error bound.
"""

import math
from pathlib import Path

from hoi.config import (
    Ablation,
    AttractionKind,
    Config,
    ContactKind,
    HMSDConf,
    ImpulseConf,
    MaterialConf,
    MPMConf,
    RefineKind,
    WindowedConf,
)
from hoi.data import Check, Material, Omission, Plan, Step
from hoi.errors import InputError
from hoi.mpm.stability import cfl_number, choose_time_step, time_step_limit

PARTS = {
    "no_attraction": "attraction",
    "no_contact": "contact",
    "no_mdm": "motion prior",
    "no_mpm": "MPM",
    "no_video_sds": "Video-SDS",
}
"""A variant's label -> what it runs without."""


def material_of(conf: MaterialConf) -> Material:
    """The checked material.

    Raises:
        InputError: E, nu or rho outside their range.
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
    )
    check_material(material)
    return material


def cell_size(mover: MPMConf, object_size: float) -> float:
    """Grid spacing dx [m]: relative to the object, or domain / grid."""
    if mover.cells_across is not None:
        return object_size / mover.cells_across
    assert mover.domain is not None and mover.grid is not None
    return mover.domain / mover.grid


def lies_still(config: Config) -> bool:
    """Whether the object's free motion is to stay where it is."""
    placement = config.scene.placement
    moving = any(placement.velocity) or any(placement.angular_velocity)
    return config.object.stable and placement.position[2] is None and not moving and config.scene.gravity[2] <= 0


def make_plan(config: Config) -> Plan:
    """Kept steps, omissions and checks of a config.

    Raises:
        InputError: a material or time step out of range, weights that do not exist, or a label that contradicts
            `ablation`.
    """
    material = material_of(config.material)
    steps: list[Step] = []
    omissions: list[Omission] = []
    checks: list[Check] = []
    without: list[str] = []

    stage, frames = config.stage, config.scene.frames
    mpm = stage.object if isinstance(stage.object, MPMConf) else None
    if mpm is None:
        without.append("no_mpm")
        omissions.append(Omission("MPM", "stage/object is constant_velocity", "importing Taichi, the simulation"))
        steps.append(Step("free_motion", "constant_velocity", "straight line from the initial velocity"))
    elif mpm.skip_rest and lies_still(config):
        because = "the object is stable, on the ground and at rest: it stays where it is (its elastic sag is left out)"
        omissions.append(Omission("free_motion", because, f"{frames - 1} frames of MPM"))
    else:
        steps.append(Step("free_motion", "mpm", "the object alone, from t = 0 to T"))

    motion = stage.motion
    if isinstance(motion, HMSDConf):
        _check_checkpoint(motion)
        start = f"from {'a sample of the prior' if motion.init.value == 'sample' else 'the standing pose'}"
        steps.append(Step("motion", "hmsd", f"{motion.iterations} iterations, CFG {motion.guidance:g}, {start}"))
    else:
        without.append("no_mdm")
        because = "stage/motion is none: the pose starts standing, j* and t* come from the scene"
        omissions.append(Omission("motion", because, "importing the motion prior and its text encoder"))

    attraction = stage.attraction
    attracts = isinstance(attraction, WindowedConf) and attraction.lambda_attr > 0
    distils = isinstance(motion, HMSDConf) and stage.coordinate.lambda_hmsd > 0
    terms = []
    if distils:
        terms.append(f"{stage.coordinate.lambda_hmsd:g} L_HMSD")
    if isinstance(attraction, WindowedConf) and attracts:
        terms.append(f"{attraction.lambda_attr:g} L_attr to the {attraction.target.value}")
    if not attracts:
        without.append("no_attraction")
        because = (
            f"stage/attraction is {AttractionKind.none.value}"
            if attraction.kind is AttractionKind.none
            else ("stage.attraction.lambda_attr is 0")
        )
        omissions.append(Omission("attraction", because, "the attraction loss"))
    if terms and stage.coordinate.iterations:
        detail = f"{stage.coordinate.iterations} iterations, {' + '.join(terms)}"
        steps.append(Step("coordinate", "adam", detail))
    else:
        omissions.append(Omission("coordinate", "there is nothing to optimise", "stage 2"))

    contact = stage.contact
    if isinstance(contact, ImpulseConf):
        where = "between frames too" if contact.between_frames else "at whole frames"
        detail = f"tau {contact.tau:g}, d {contact.distance:g} m, {where}"
        steps.append(Step("contact", ContactKind.impulse.value, detail))
        steps.append(Step("resimulate", stage.object.kind.value, "from t_c to T, when a contact pushes the object"))
    else:
        without.append("no_contact")
        omissions.append(Omission("contact", "stage/contact is none", "detection, impulse and re-simulation"))

    without.append("no_video_sds")
    not_built = "it is not implemented yet" if stage.refine.kind is RefineKind.video_sds else "stage/refine is none"
    omissions.append(Omission("refine", not_built, "the video prior, the renderer, stage 3"))

    simulates = any(step.implementation == "mpm" for step in steps)
    if mpm is not None and simulates:
        checks.extend(_mpm_checks(config, mpm, material))
    elif mpm is not None:
        omissions.append(Omission("MPM", "no kept step simulates", "importing Taichi"))

    order = list(PARTS)
    variant = "+".join(sorted(without, key=order.index)) or "full"
    if config.ablation is not Ablation.full and config.ablation.value not in without:
        raise InputError(
            f"ablation={config.ablation.value} contradicts the rest of the config, which runs with the "
            f"{PARTS[config.ablation.value]} (variant {variant}); drop one of the two"
        )
    return Plan(variant, tuple(steps), tuple(omissions), tuple(checks))


def _check_checkpoint(motion: HMSDConf) -> None:
    if motion.checkpoint is not None and not Path(motion.checkpoint).exists():
        raise InputError(
            f"stage.motion.checkpoint: no such file or folder: {motion.checkpoint}; "
            "stage.motion.checkpoint=null runs with the prior of the package"
        )


def _mpm_checks(config: Config, mpm: MPMConf, material: Material) -> list[Check]:
    dx = cell_size(mpm, config.object.size)
    placement, gravity = config.scene.placement, -config.scene.gravity[2]
    fall = math.sqrt(2 * max(gravity, 0.0) * (placement.position[2] or 0.0))
    speed = math.hypot(*placement.velocity) + fall
    limit = time_step_limit(material, dx, speed)
    dt = choose_time_step(material, dx, speed, dt=mpm.dt, fraction=mpm.limit_fraction)
    steps = config.scene.frames / config.scene.fps / dt
    across = config.object.size / dx
    return [
        Check("cfl", f"{cfl_number(material, dx, dt, speed):.2f}", f"dt {dt:.3g} s, limit {limit:.3g} s"),
        Check("resolution", f"{across:.1f}", f"cells of {dx:.3g} m across the object"),
        Check("steps", f"{steps:.0f}", "for the whole scene"),
    ]


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
