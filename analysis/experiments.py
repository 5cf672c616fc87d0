"""Experiments of which the world knows the outcome: drops, rolling, sliding, columns of sand, flight through air.

Each returns what was measured; `EXPERIMENTS` lists those of the page against reality, with the published numbers.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hoi.config.compose import config_of
from hoi.data import Array, Material, Plane
from hoi.method.object_motion import World, free_motion
from hoi.mpm.damping import rebound_of
from hoi.mpm.rigid import fit
from hoi.mpm.solver import Simulation
from hoi.mpm.state import initial_state
from hoi.objects.load import load_builtin, place
from hoi.plan import material_of
from hoi.reports import quiet

GRAVITY = 9.81
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Experiment:
    """A row of the page."""

    title: str
    unit: str
    published: tuple[float, float]
    """From, to; both the same where there is a single value."""
    source: str
    measure: Callable[[], float]
    tolerance: float = 0.0
    """What ours may be beside a single published value, relative [-]."""

    def agrees(self, value: float) -> bool:
        """Whether `value` is within what is published."""
        low, high = self.published
        return low - self.tolerance * abs(low) <= value <= high + self.tolerance * abs(high)


def drop(
    name: str, height: float, *, cells: int = 16, restitution: float | None = None, **changes: float
) -> tuple[float, float]:
    """A built-in object let go with its lowest point at `height` [m]: how high that comes back [m], and at which share
    of the speed of its landing it leaves the ground [-].

    Args:
        name: of the object, in conf/object.
        cells: of the grid, across it.
        restitution: another than its material's. changes: other fields of the material.
    """
    config = config_of(f"object={name}", f"stage.object.cells_across={cells}")
    material = material_of(config.material)
    material = replace(material, **changes, **({} if restitution is None else {"restitution": restitution}))
    size = config.object.size
    loaded = load_builtin(str(config.object.shape), config.stage.object.cell(size) / 2, size)
    thing = place(loaded, material, (0.0, 0.0, height + 0.5 * float(np.ptp(loaded.particles[:, 2]))))
    fps, fall = 200.0, math.sqrt(2 * height / GRAVITY)
    frames = round((1 + 1.2 * max(material.restitution, 0.2)) * fall * fps) + round(0.1 * fps)
    ground = Plane(np.zeros(3), UP, friction=material.ground_friction)
    world = World(thing, frames, fps, -GRAVITY * UP, (ground,))
    trajectory, _ = free_motion(world, config.stage.object.mover(thing.size, 1, "cpu"), quiet())
    speed = trajectory.com_velocity[:, 2]
    turned = int(np.argmax(speed > 0)) if (speed > 0).any() else len(speed) - 1
    again = turned + int(np.argmax(speed[turned:] < 0)) if (speed[turned:] < 0).any() else len(speed) - 1
    after = trajectory.positions[turned : again + 1, :, 2].min(axis=1)
    return float(after.max()), float(speed[turned : again + 1].max() / -speed.min())


def ball(size: float, cells: int) -> tuple[Array, Array]:
    """Particles (P, 3) [m] of a ball about the origin, 8 a cell, and their volumes (P,) [m^3]."""
    spacing = size / cells / 2
    axis = (np.arange(2 * cells) + 0.5) * spacing - size / 2
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    points = points[np.linalg.norm(points, axis=1) < size / 2]
    return points, np.full(len(points), spacing**3)


FOOTBALL = Material("football", "neo_hookean", 7e5, 0.3, 77.0, 0.85, 0.6)


def roll(slope: float = 0.0, speed: float = 1.0, *, cells: int = 16, seconds: float = 0.4) -> tuple[float, float]:
    """A football that rolls on level ground, gravity leaning by `slope` [rad]: omega R / v of its second half [-], and
    its acceleration over 5/7 g sin(slope) [-]; on no slope it starts rolling at `speed` [m/s], else from rest."""
    size = 0.22
    points, volumes = ball(size, cells)
    start = 0.0 if slope else speed
    lean = GRAVITY * np.array([math.sin(slope), 0.0, -math.cos(slope)])
    state = initial_state(points + 0.5 * size * UP, volumes * FOOTBALL.density, [start, 0, 0], [0, 2 * start / size, 0])
    run = Simulation(
        state, volumes, FOOTBALL, dx=size / cells, rebound=[rebound_of(FOOTBALL, cells)], gravity=lean,
        planes=[Plane(np.zeros(3), UP, friction=0.6)],
    )  # fmt: skip
    times, speeds, shares = np.linspace(seconds / 20, seconds, 20), [], []
    for time in times:
        run.advance(float(time))
        motion = fit(run.state(), run.masses, run.dx**2 / 4)
        speeds.append(motion.velocity[0])
        shares.append(motion.angular_velocity[1] * size / 2 / motion.velocity[0])
    pull = 5 / 7 * GRAVITY * math.sin(slope)
    return float(np.mean(shares[10:])), float(np.polyfit(times[5:], speeds[5:], 1)[0] / pull) if pull else math.nan


def slide(slope: float = 0.5, friction: float = 0.2, *, cells: int = 8) -> float:
    """The acceleration of a flat block that slides, gravity leaning by `slope` [rad], over g (sin - mu cos) [-]."""
    size = 0.4
    spacing = size / cells / 2
    along, high = (np.arange(2 * cells) + 0.5) * spacing, (np.arange(cells // 2) + 0.5) * spacing
    points = np.stack(np.meshgrid(along, along, high, indexing="ij"), -1).reshape(-1, 3)
    material = Material("block", "fixed_corotated", 1e6, 0.3, 500.0, 1.0, friction)
    lean = GRAVITY * np.array([math.sin(slope), 0.0, -math.cos(slope)])
    volumes = np.full(len(points), spacing**3)
    run = Simulation(
        initial_state(points, volumes, [0, 0, 0]), volumes, material, dx=size / cells, gravity=lean,
        planes=[Plane(np.zeros(3), UP, friction=friction)],
    )  # fmt: skip
    times, speeds = np.linspace(0.1, 0.4, 10), []
    for time in times:
        run.advance(float(time))
        speeds.append(run.masses @ run.state().velocities[:, 0] / run.masses.sum())
    law = GRAVITY * (math.sin(slope) - friction * math.cos(slope))
    return float(np.polyfit(times, speeds, 1)[0] / law)


def sand_column(aspect: float = 1.0, *, cells: int = 8) -> float:
    """Run-out (r_end - r_0) / r_0 of a column of dry sand of r_0 = 0.1 m, `aspect` times as high, let go [-].

    r_end holds all but a thousandth of the sand.
    """
    radius = 0.1
    sand = material_of(config_of("material=sand").material)
    spacing = radius / cells / 2
    across = (np.arange(4 * cells) + 0.5) * spacing - radius
    up = (np.arange(round(2 * cells * aspect)) + 0.5) * spacing
    points = np.stack(np.meshgrid(across, across, up, indexing="ij"), -1).reshape(-1, 3)
    points = points[np.hypot(points[:, 0], points[:, 1]) < radius]
    volumes = np.full(len(points), spacing**3)
    run = Simulation(initial_state(points, volumes, [0, 0, 0]), volumes, sand, dx=radius / cells)
    run.advance(6 * math.sqrt(radius * aspect / GRAVITY))
    reach = np.hypot(*run.state().positions[:, :2].T)
    return float(np.quantile(reach, 0.999) / radius - 1)


EXPERIMENTS: Sequence[Experiment] = (
    Experiment("football dropped from 2.0 m comes back to", "m", (1.25, 1.55),
               "FIFA Quality Programme for Footballs, rebound test on steel at 20 °C",
               lambda: drop("soccer_ball", 2.0)[0]),
    Experiment("basketball dropped from 1.8 m comes back to", "m", (0.96, 1.16),
               "FIBA Official Basketball Rules, Basketball Equipment: 1.2 to 1.4 m to its top",
               lambda: drop("basketball", 1.8)[0]),
    Experiment("rolling ball on level ground, ωR/v", "-", (1.0, 1.0), "rolling without slip",
               lambda: roll()[0], 0.02),
    Experiment("ball rolling down 20°, acceleration over 5/7 g sin θ", "-", (1.0, 1.0),
               "rigid ball, moment of inertia 2/5 m R²", lambda: roll(math.radians(20))[1], 0.03),
    Experiment("block sliding down, acceleration over g (sin θ - μ cos θ)", "-", (1.0, 1.0), "Coulomb friction",
               slide, 0.03),
    Experiment("run-out of a sand column as high as its radius", "r₀", (1.24, 1.24),
               "Lube et al. 2004, Axisymmetric collapses of granular columns, J. Fluid Mech. 508", sand_column, 0.1),
)  # fmt: skip
"""Those of materials; other modules add theirs by a tuple of their own (`analysis.reality`)."""
