"""The object by the material point method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from omegaconf import MISSING

from hoi.errors import RunError, under
from hoi.mpm.laws import LAWS
from hoi.stages.contract import Draft, ObjectMover, Requirements, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Material, ObjectState, Scene, SceneObject
    from hoi.method.object_motion import Advanced, JointMover, Mover, World
    from hoi.mpm.collider import Collider, Partner
    from hoi.mpm.phases import Tally, Walk
    from hoi.reports import Stage


class Precision(StrEnum):
    float32 = "float32"
    float64 = "float64"


class Spline(StrEnum):
    quadratic = "quadratic"
    cubic = "cubic"


CRUSHED = "singular values of F at least 0.1 where it is crushed"
BOUNDS = {
    "fluid": "J at least 0.5", "snow": "hardening by 0.1 to 10", "von_mises": CRUSHED, "viscoplastic": CRUSHED,
    "drucker_prager": CRUSHED,
}  # fmt: skip
"""Of the method's, not the material's, by law."""


@option("stage/object", "mpm")
@dataclass
class MPM(ObjectMover):
    """The material point method."""

    yields = True

    cells_across: int | None = None
    """Grid cells across the object's largest extent; null when `domain` and `grid` are given."""
    domain: float | None = None
    """Edge of the whole domain [m]; with `grid`, the cell size is domain / grid."""
    grid: int | None = None
    """Cells along that edge."""
    dt: float | None = None
    """Time step [s]; null chooses it from the stability limit."""
    limit_fraction: float = MISSING
    """Fraction of the stability limit that a chosen dt takes [-]."""
    spline: Spline = MISSING
    """B-splines between particles and grid."""
    precision: Precision = MISSING
    """Of particles and grid."""
    damping: bool = MISSING
    """Solids lose energy so that they rebound with material.restitution; false: they are elastic, as in the paper."""
    air_density: float = MISSING
    """Of the air that slows a flight [kg/m^3]; 0: none."""
    drag_coefficient: float = MISSING
    """C_d: the air's force is C_d A rho v^2 / 2, A the mean silhouette of the object's hull [-]."""
    phases: bool = MISSING
    """Leave out the steps that the motion does not need: rest, and flight between contacts."""
    vibration_tolerance: float = MISSING
    """Amplitude of the vibration, and way crept, that `phases` may leave out, relative to the object's size [-]."""

    def cell(self, object_size: float) -> float:
        """Grid spacing dx [m]: relative to the object, or domain / grid."""
        if self.cells_across is not None:
            return object_size / self.cells_across
        assert self.domain is not None and self.grid is not None
        return self.domain / self.grid

    def check(self, config: Config, require: Requirements) -> None:
        own = require.of(self.key)
        own(0 < self.limit_fraction <= 1, "limit_fraction", self.limit_fraction, "in (0, 1]")
        own(self.vibration_tolerance >= 0, "vibration_tolerance", self.vibration_tolerance, "0 or more")
        own(self.air_density >= 0, "air_density", self.air_density, "0 or more [kg/m^3]")
        own(self.drag_coefficient >= 0, "drag_coefficient", self.drag_coefficient, "0 or more")
        own(self.dt is None or self.dt > 0, "dt", self.dt, "greater than 0 [s], or null")
        for name in ("cells_across", "grid", "domain"):
            value = getattr(self, name)
            own(value is None or value > 0, name, value, "greater than 0, or null")
        by_domain = (self.domain is None) == (self.grid is None)
        require(
            by_domain and (self.cells_across is None) != (self.domain is None),
            self.key,
            f"cells_across={self.cells_across}, domain={self.domain}, grid={self.grid}",
            "given either cells_across or both domain and grid",
        )

    def plan(self, config: Config, draft: Draft) -> None:
        if self.phases and config.lies_still():
            because = (
                "the object is stable, on the ground and at rest: it stays where it is (its elastic sag is left out)"
            )
            draft.omit("free_motion", because, f"{config.scene.frames - 1} frames of MPM")
        else:
            draft.run("free_motion", self.name, "the object alone, from t = 0 to T")

    def closing(self, config: Config, draft: Draft) -> None:
        if not any(step.implementation == self.name for step in draft.steps):
            saves = "the simulation" if config.render.compiles else "importing Taichi"
            draft.omit("MPM", "no kept step simulates", saves)
            return
        from hoi.mpm.damping import damping, rebound_of
        from hoi.mpm.stability import cfl_number, choose_time_step, time_step_limit

        materials, dx = draft.materials, self.cell(config.object.size)
        rebound = [rebound_of(m, config.object.size / dx) if self.damping else 1.0 for m in materials]
        stiffening = [damping(share).stiffening for share in rebound]
        placement, gravity = config.scene.placement, -config.scene.gravity[2]
        fall = math.sqrt(2 * max(gravity, 0.0) * (placement.position[2] or 0.0))
        speed = math.hypot(*placement.velocity) + fall
        limit = time_step_limit(materials, dx, speed, stiffening)
        with under(self.key, "dt"):
            dt = choose_time_step(materials, dx, speed, self.dt, self.limit_fraction, stiffening)
        cfl, steps = cfl_number(materials, dx, dt, speed), config.scene.frames / config.scene.fps / dt
        draft.check("cfl", f"{cfl:.2f}", f"dt {dt:.3g} s, limit {limit:.3g} s")
        draft.check("damping", *self._damping(materials, rebound))
        draft.check("resolution", f"{config.object.size / dx:.1f}", f"cells of {dx:.3g} m across the object")
        draft.check("steps", f"{steps:.0f}", "for the whole scene")
        bounds = sorted({name for m in materials if (name := BOUNDS.get(m.model))})
        if bounds:
            draft.check("bounds", "counted", f"{'; '.join(bounds)}: the record says how many particles met them")
        draft.check("phases", *self._phases({material.model for material in materials}))

    def _damping(self, materials: Sequence[Material], rebound: Sequence[float]) -> tuple[str, str]:
        """What a bounce leaves of the speed, and by what."""
        if not self.damping:
            return "none", "stage.object.damping is false: solids are elastic, restitution acts at the strike alone"
        own = [f"{m.name} {share:.2f}" for m, share in zip(materials, rebound, strict=True) if LAWS[m.model].springs]
        if not own:
            return "flow", "what flows loses energy by its flow, restitution acts at the strike alone"
        return "hysteresis", f"a bounce leaves of the speed, the grid's own loss aside: {', '.join(own)}"

    def _phases(self, models: set[str]) -> tuple[str, str]:
        """Whether steps may be left out, and at what cost."""
        if not self.phases:
            return "mpm", "stage.object.phases is false: every step is taken"
        loose = sorted(model for model in models if not LAWS[model].rigid)
        bound = f"up to {self.vibration_tolerance:g} of the size of vibration and creep left out"
        if loose:
            return "mpm, rest", f"{bound}; {', '.join(loose)} flies as one piece only until it is touched"
        air = "; the air slows flights alone: what it is worth elsewhere is in the record" if self.air_density else ""
        return (
            "mpm, flight, rolling, rest",
            f"rigid flight where no contact is possible, balls roll; {bound}{air}",
        )

    def mover(self, object_size: float, threads: int, device: str) -> Mover:
        from functools import partial

        return partial(advance, conf=self, size=object_size, threads=threads, device=device)

    def joint_mover(self, object_size: float, threads: int, device: str) -> JointMover:
        """Moves several objects that may touch, on cells that fit one of this size [m]."""
        from functools import partial

        return partial(advance_together, conf=self, size=object_size, threads=threads, device=device)


def advance(
    scene: Scene | World,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | Partner | None = None,
    *,
    conf: MPM,
    size: float,
    threads: int,
    device: str,
) -> Advanced:
    """The walk through the phases of the motion; see `hoi.method.object_motion.Mover`.

    Raises:
        RunError: the simulation cannot go on; says at which frame.
    """
    import numpy as np

    times = (np.asarray(stops) - start) / scene.fps
    walk = _walk(scene, state, start, float(times[-1]), collider, conf=conf, size=size, threads=threads, device=device)
    reached = []
    for time in times:
        try:
            reached.append(walk.advance(float(time)))
        except RunError as error:
            raise RunError(f"object at frame {start + walk.time * scene.fps:.2f}: {error}") from error
        stage.advance()
    return _advanced(scene, walk, reached, start, stage)


def advance_together(
    worlds: Sequence[World],
    states: Sequence[ObjectState],
    start: float,
    stops: Sequence[float],
    stage: Stage,
    colliders: Sequence[Collider | Partner | None] = (),
    held: Sequence[bool] = (),
    *,
    conf: MPM,
    size: float,
    threads: int,
    device: str,
) -> tuple[Advanced, ...]:
    """The walks of several objects; see `hoi.method.object_motion.JointMover`.

    Args:
        size: whose cells all of them share [m].

    Raises:
        InputError: the worlds have not one rate and one gravity.
        RunError: a simulation cannot go on; says at which frame.
    """
    import numpy as np

    from hoi.errors import InputError
    from hoi.mpm.bodies import Bodies

    first, count = worlds[0], len(worlds)
    for name in ("fps", "gravity"):
        for other in worlds[1:]:
            if not np.array_equal(getattr(other, name), getattr(first, name)):
                raise InputError(f"objects that move together must have one {name}, got {getattr(other, name)} beside "
                                 f"{getattr(first, name)}")  # fmt: skip
    times = (np.asarray(stops) - start) / first.fps
    walks = [
        _walk(world, state, start, float(times[-1]), collider, still, conf=conf, size=size, threads=threads,
              device=device)
        for world, state, collider, still in zip(
            worlds, states, colliders or [None] * count, held or [False] * count, strict=True
        )
    ]  # fmt: skip
    rubs = np.array([world.thing.material.ground_friction for world in worlds])
    bodies = Bodies(walks, np.sqrt(np.outer(rubs, rubs)), conf.cell(size))
    reached = []
    for time in times:
        try:
            reached.append(bodies.advance(float(time)))
        except RunError as error:
            now = min(walk.time for walk in walks)
            raise RunError(f"objects at frame {start + now * first.fps:.2f}: {error}") from error
        stage.advance()
    return tuple(
        _advanced(world, walk, [each[i] for each in reached], start, stage)
        for i, (world, walk) in enumerate(zip(worlds, walks, strict=True))
    )


def _walk(
    scene: Scene | World,
    state: ObjectState,
    start: float,
    end: float,
    collider: Collider | Partner | None,
    held: bool = False,
    *,
    conf: MPM,
    size: float,
    threads: int,
    device: str,
) -> Walk:
    """The walk of an object from the frame `start` on, for `end` [s]."""
    from hoi.mpm.boundary import plane_depth
    from hoi.mpm.collider import Collider
    from hoi.mpm.damping import damping, rebound_of
    from hoi.mpm.phases import Surroundings, Walk, lowest_frequency, reach_of
    from hoi.mpm.rigid import air_drag
    from hoi.mpm.solver import Simulation

    thing, dx, planes = scene.thing, conf.cell(size), scene.planes
    if isinstance(collider, Collider):
        collider = replace(collider, times=collider.times - start / scene.fps)

    def simulation(state: ObjectState, now: float) -> Simulation:
        with under(conf.key, "dt"):
            return Simulation(
                state,
                thing.volumes,
                thing.materials,
                region=thing.region,
                rebound=rebound,
                dx=dx,
                dt=conf.dt,
                fraction=conf.limit_fraction,
                gravity=scene.gravity,
                planes=planes,
                collider=replace(collider, times=collider.times - now) if isinstance(collider, Collider) else collider,
                spline=conf.spline.value,
                precision=conf.precision.value,
                threads=threads,
                device="cuda" if device == "cuda" else "cpu",
            )

    rebound = [rebound_of(material, size / dx) if conf.damping else 1.0 for material in thing.materials]
    softest = min(damping(share).least for share in rebound)
    width = 3 if conf.spline is Spline.quadratic else 4  # nodes of a stencil along an axis
    reaches = [reach_of(plane, dx, width, plane_depth(thing.materials)) for plane in planes]
    whole = all(LAWS[material.model].rigid for material in thing.materials)
    return Walk(
        state,
        thing.masses,
        simulation,
        end=end,
        gravity=scene.gravity,
        surroundings=Surroundings(planes, reaches, collider, 0.5 * width * math.sqrt(3) * dx),
        size=thing.size,
        moment=dx**2 / (4 if width == 3 else 3),
        frequency=math.sqrt(softest) * lowest_frequency(thing.particles, thing.masses, thing.materials)
        if whole
        else None,
        tolerance=conf.vibration_tolerance if conf.phases else None,
        drag=air_drag(thing.particles, float(thing.masses.sum()), conf.air_density, conf.drag_coefficient),
        held=held,
    )


def _advanced(
    scene: Scene | World, walk: Walk, reached: Sequence[tuple[ObjectState, str]], start: float, stage: Stage
) -> Advanced:
    """What a walk that is over has come to, its states and phases at the stops."""
    import numpy as np

    from hoi.method.object_motion import Advanced, rigid_energy
    from hoi.mpm.collider import joined

    states, phases = zip(*reached, strict=True)
    tally = walk.finish()
    _count(stage.numbers, tally)
    at_bounds = max(_clamped(scene.thing, state) for state in states)
    stage.numbers["clamped"] = max(stage.numbers.get("clamped", 0.0), at_bounds)
    energy = [walk.simulation.energies(s) if walk.simulated else rigid_energy(scene, s) for s in states]
    pushes = tuple(joined(tally.pushes, start / scene.fps))
    return Advanced(states, np.array(energy).reshape(-1, 3), phases, pushes)


def _clamped(thing: SceneObject, state: ObjectState) -> float:
    """How many particles are at a bound of the method's; see `hoi.mpm.materials.clamped`."""
    import numpy as np

    from hoi.mpm.materials import clamped

    f = state.deformation_gradient if state.elastic is None else state.elastic
    hardening = np.zeros(len(f)) if state.hardening is None else state.hardening
    return float(sum(
        clamped(material, f[own], hardening[own]).sum()
        for index, material in enumerate(thing.materials)
        for own in [slice(None) if thing.region is None else thing.region == index]
    ))  # fmt: skip


def _count(numbers: dict[str, float], tally: Tally) -> None:
    """Adds what a walk did and left out to the stage's report; a stage may walk more than once."""
    adds = {
        "steps": tally.steps,
        "steps_left_out": round(tally.steps_left_out),
        "phase_changes": tally.changes,
        **{f"seconds_{phase}": seconds for phase, seconds in tally.seconds.items()},
        "energy_left_out": tally.energy,
        "compile_seconds": tally.compile_seconds,
        "drag_left_out": tally.drag_left_out,
    }
    greatest = {
        "vibration_left_out": tally.vibration,
        "cfl": tally.cfl,
        "dt_most": tally.dt_most,
    }
    numbers.update({name: numbers.get(name, 0.0) + value for name, value in adds.items()})
    numbers.update({name: max(numbers.get(name, 0.0), value) for name, value in greatest.items()})
    if tally.steps:
        numbers["dt_least"] = min(numbers.get("dt_least", math.inf), tally.dt_least)
