"""What a run will do, decided from the config alone, before anything heavy is imported.

A step that the scene does not need is left out, with the reason and what that saves in the plan and in the record.
An omission is exact or carries its error bound.
"""

import math
from pathlib import Path

from hoi.config import (
    Ablation,
    Approach,
    AttractionKind,
    Config,
    ContactModel,
    GeometricConf,
    HMSDConf,
    ImpulseConf,
    MaterialConf,
    MotionInit,
    MPMConf,
    RefineConf,
    RefineWhen,
    RenderBackend,
    VideoConf,
    VideoSDSConf,
    WindowConf,
    WindowedConf,
)
from hoi.data import Check, Material, Omission, Plan, Step
from hoi.errors import InputError, under
from hoi.mpm.stability import cfl_number, choose_time_step, time_step_limit
from hoi.video_prior.files import check_video_prior

PARTS = {
    "no_attraction": "the attraction",
    "no_contact": "the contact",
    "no_mdm": "the motion prior",
    "motion_from_file": "the motion from the sentence",
    "no_mpm": "the MPM",
    "no_video_sds": "stage 3",
    "geometric": "Video-SDS in stage 3",
}
"""A variant's label -> what it runs without. Geometric refinement is not w/o Video-SDS, where stage 2 is final."""

STARTS = {
    MotionInit.sample: "a sample of the prior",
    MotionInit.stand: "the standing pose",
    MotionInit.file: "the file",
}
"""What stage 1 starts from."""

NEVER_RIGID = frozenset({"drucker_prager", "fluid", "snow"})
"""Constitutive models of what does not move as one piece."""


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
        try:
            materials.append(material_of(region.material))
        except InputError as error:
            raise InputError(f"object.regions.{index}.{error}") from None
    return tuple(materials)


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
    x, y, z = config.scene.gravity
    falls = x or y or z > 0
    return config.object.stable and placement.position[2] is None and not moving and not falls


def make_plan(config: Config) -> Plan:
    """Kept steps, omissions and checks of a config.

    Raises:
        InputError: a material or time step out of range, weights that do not exist, or a label that contradicts
            `ablation`.
    """
    materials = materials_of(config)
    steps: list[Step] = []
    omissions: list[Omission] = []
    checks: list[Check] = []
    without: list[str] = []

    stage, frames = config.stage, config.scene.frames
    mpm = stage.object if isinstance(stage.object, MPMConf) else None
    video = config.render if isinstance(config.render, VideoConf) else None
    needs_taichi = video is not None and video.backend is RenderBackend.taichi
    if mpm is None:
        without.append("no_mpm")
        saves = "the simulation" if needs_taichi else "importing Taichi, the simulation"
        omissions.append(Omission("MPM", "stage/object is constant_velocity", saves))
        steps.append(Step("free_motion", "constant_velocity", "straight line from the initial velocity"))
    elif mpm.phases and lies_still(config):
        because = "the object is stable, on the ground and at rest: it stays where it is (its elastic sag is left out)"
        omissions.append(Omission("free_motion", because, f"{frames - 1} frames of MPM"))
    else:
        steps.append(Step("free_motion", "mpm", "the object alone, from t = 0 to T"))

    motion = stage.motion
    if isinstance(motion, HMSDConf):
        _check_files(motion)
        start = STARTS[motion.init]
        if motion.init is MotionInit.file:
            without.append("motion_from_file")
            start = f"{start} {motion.path}"
        if motion.iterations > 0 or motion.init is MotionInit.sample:
            detail = f"{motion.iterations} iterations, CFG {motion.guidance:g}, from {start}"
            steps.append(Step("motion", "hmsd", detail))
        else:
            where = "in L_HMSD of stage 2 alone" if uses_prior(config) else "nowhere"
            steps.append(Step("motion", motion.init.value, f"{start}, as it is; the motion prior is used {where}"))
        if not uses_prior(config):
            without.append("no_mdm")
            because = "neither stage 1 nor stage 2 distils from it"
            omissions.append(Omission("motion prior", because, "importing it and its text encoder"))
    else:
        without.append("no_mdm")
        because = "stage/motion is none: the pose starts standing, j* and t* come from the scene"
        omissions.append(Omission("motion", because, "importing the motion prior and its text encoder"))

    attraction = stage.attraction
    terms = []
    if distils_in_stage_2(config):
        terms.append(f"{stage.coordinate.lambda_hmsd:g} L_HMSD")
    if isinstance(attraction, WindowedConf) and attracts(config):
        terms.append(f"{attraction.lambda_attr:g} L_attr to the {attraction.target.value}")
    if distils_in_stage_2(config) and stage.coordinate.lambda_feet > 0:
        terms.append(f"{stage.coordinate.lambda_feet:g} L_feet")
    if not attracts(config):
        without.append("no_attraction")
        because = (
            f"stage/attraction is {AttractionKind.none.value}"
            if attraction.kind is AttractionKind.none
            else ("stage.attraction.lambda_attr is 0")
        )
        omissions.append(Omission("attraction", because, "the attraction loss"))
    if terms and stage.coordinate.iterations:
        detail = f"{stage.coordinate.iterations} iterations, {' + '.join(terms)}"
        if approaches(config):
            detail += f", the person placed and turned to the object ({config.scene.approach.value})"
        steps.append(Step("coordinate", "adam", detail))
    else:
        omissions.append(Omission("coordinate", "there is nothing to optimise", "stage 2"))

    contact = stage.contact
    if isinstance(contact, ImpulseConf):
        where = "between frames too" if contact.between_frames else "at whole frames"
        detail = f"tau {contact.tau:g}, d {contact.distance:g} m, {where}"
        steps.append(Step("contact", contact.model.value, detail))
        since = "from t_c to T"
        if contact.model is ContactModel.collider:
            since = "from when the limb is last clear of it to T, the limb a moving obstacle"
        steps.append(Step("resimulate", stage.object.kind.value, f"{since}, when a contact pushes the object"))
    else:
        without.append("no_contact")
        omissions.append(Omission("contact", "stage/contact is none", "detection, impulse and re-simulation"))

    refine = stage.refine
    left_out = _no_refinement(refine)
    if isinstance(refine, WindowConf) and left_out is None:
        if isinstance(refine, GeometricConf):
            without.append("geometric")
        steps.append(_refinement(refine, isinstance(contact, ImpulseConf)))
    else:
        without.append("no_video_sds")
        omissions.append(Omission("refine", left_out or "", "the video prior, stage 3"))

    if video is not None:
        detail = (
            f"{frames} pictures of {video.width}x{video.height}, view {video.view.value}, to run.mp4 and the record"
        )
        steps.append(Step("render", video.backend.value, detail))
    else:
        omissions.append(Omission("render", "render is none", "the pictures, the encoder, run.mp4"))

    simulates = any(step.implementation == "mpm" for step in steps)
    if mpm is not None and simulates:
        checks.extend(_mpm_checks(config, mpm, materials))
        checks.append(_phases_check(mpm, materials))
    elif mpm is not None:
        saves = "the simulation" if needs_taichi else "importing Taichi"
        omissions.append(Omission("MPM", "no kept step simulates", saves))

    checks.extend(_scene_checks(config, materials))
    order = list(PARTS)
    variant = "+".join(sorted(without, key=order.index)) or "full"
    if config.ablation is not Ablation.full and config.ablation.value not in without:
        raise InputError(
            f"ablation={config.ablation.value} contradicts the rest of the config, which runs with "
            f"{PARTS[config.ablation.value]} (variant {variant}); drop one of the two"
        )
    return Plan(variant, tuple(steps), tuple(omissions), tuple(checks))


def distils_in_stage_2(config: Config) -> bool:
    """Whether L_HMSD is a term of stage 2."""
    coordinate = config.stage.coordinate
    return isinstance(config.stage.motion, HMSDConf) and coordinate.lambda_hmsd > 0 and coordinate.iterations > 0


def attracts(config: Config) -> bool:
    """Whether L_attr is a term of stage 2."""
    attraction = config.stage.attraction
    return isinstance(attraction, WindowedConf) and attraction.lambda_attr > 0


def approaches(config: Config) -> bool:
    """Whether the object's place decides where the person starts (see `hoi.config.SceneConf.approach`)."""
    return isinstance(config.stage.motion, HMSDConf) and attracts(config) and config.scene.approach is not Approach.none


def uses_prior(config: Config) -> bool:
    """Whether the motion prior is needed, in stage 1 or in stage 2."""
    motion = config.stage.motion
    if not isinstance(motion, HMSDConf):
        return False
    return motion.init is MotionInit.sample or motion.iterations > 0 or distils_in_stage_2(config)


def _check_files(motion: HMSDConf) -> None:
    if motion.path is not None and not Path(motion.path).is_file():
        raise InputError(f"stage.motion.path: no such file: {motion.path}")
    if motion.checkpoint is not None and not Path(motion.checkpoint).exists():
        raise InputError(
            f"stage.motion.checkpoint: no such file or folder: {motion.checkpoint}; "
            "stage.motion.checkpoint=null runs with the prior of the package"
        )


def _no_refinement(refine: RefineConf) -> str | None:
    """Why there is no stage 3; None where there is one.

    Raises:
        InputError: the video prior's weights are missing.
    """
    if not isinstance(refine, WindowConf):
        return f"stage/refine is {refine.kind.value}: the output of stage 2 is final"
    if isinstance(refine, VideoSDSConf):
        with under("stage.refine"):
            check_video_prior(refine.prior, refine.checkpoint)
    return None


def _refinement(refine: WindowConf, has_contact: bool) -> Step:
    """Stage 3 as a step."""
    needed = f" where a limb is more than {refine.tolerance:g} m deep in the object"
    detail = (
        f"{refine.iterations} iterations on theta within {refine.half_width:g} frames of "
        f"{'t_c' if has_contact else 't*'}{needed if refine.when is RefineWhen.needed else ''}"
    )
    if isinstance(refine, VideoSDSConf):
        detail = f"{detail}, CFG {refine.guidance:g}, {refine.prior.value} {refine.checkpoint or 'in the package'}"
        if refine.lambda_geometry > 0:
            detail = f"{detail}, + {refine.lambda_geometry:g} L_geometry"
    return Step("refine", refine.kind.value, detail)


def _mpm_checks(config: Config, mpm: MPMConf, materials: tuple[Material, ...]) -> list[Check]:
    dx = cell_size(mpm, config.object.size)
    placement, gravity = config.scene.placement, -config.scene.gravity[2]
    fall = math.sqrt(2 * max(gravity, 0.0) * (placement.position[2] or 0.0))
    speed = math.hypot(*placement.velocity) + fall
    limit = time_step_limit(materials, dx, speed)
    dt = choose_time_step(materials, dx, speed, dt=mpm.dt, fraction=mpm.limit_fraction)
    steps = config.scene.frames / config.scene.fps / dt
    across = config.object.size / dx
    return [
        Check("cfl", f"{cfl_number(materials, dx, dt, speed):.2f}", f"dt {dt:.3g} s, limit {limit:.3g} s"),
        Check("resolution", f"{across:.1f}", f"cells of {dx:.3g} m across the object"),
        Check("steps", f"{steps:.0f}", "for the whole scene"),
    ]


def _phases_check(mpm: MPMConf, materials: tuple[Material, ...]) -> Check:
    """Whether steps of the MPM may be left out, and at what cost."""
    if not mpm.phases:
        return Check("phases", "mpm", "stage.object.phases is false: every step is taken")
    loose = sorted({material.model for material in materials} & NEVER_RIGID)
    bound = f"up to {mpm.vibration_tolerance:g} of the size of vibration and creep left out"
    if loose:
        return Check("phases", "mpm, rest", f"{bound}; {', '.join(loose)} flies as one piece only until it is touched")
    return Check("phases", "mpm, flight, rest", f"exact rigid flight where no contact is possible; {bound}")


def _scene_checks(config: Config, materials: tuple[Material, ...]) -> list[Check]:
    """What is beside the ground and the object's own material."""
    checks = []
    if config.scene.planes or not config.scene.ground:
        walls = config.scene.planes or []
        names = ["the ground"] if config.scene.ground else []
        names += [f"{wall.contact.value} at {wall.point} facing {wall.normal}" for wall in walls]
        checks.append(Check("planes", str(len(names)), "; ".join(names) or "empty space"))
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
