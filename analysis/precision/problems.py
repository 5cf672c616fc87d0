"""Problems with known answers: what is simulated, what is true, and what else is measured of it.

| problem | what is known | its headline error |
| --- | --- | --- |
| flight | a thrown box: its centre of mass is on a parabola | centre of mass |
| spin | a bar that turns steadily, stretched by its own spin: exact at any stretch | orientation |
| bar | a free bar rings in its first longitudinal mode as thin bars do, with Rayleigh's lateral inertia | frequency |
| hertz | a ball touches a rigid ground for 2.87 (m^2 / (R E*^2 v))^(1/5), see `analysis.precision.hertz` | that time |
| waves | two standing waves at once in a plate, exact at finite strain: what the order is observed on | shape |

Waves and spin are manufactured without a body force. For nu = 0 the stress of fixed_corotated is P = 2 mu (F - R), and
while F = R diag(f_1(X_1), f_2(X_2), f_3(X_3)) each axis obeys rho u_tt = E u_XX (spin: = E u_XX + rho w^2 (X + u)) and
is free of traction where f_i = 1: linear equations with solutions in closed form, however large the strain.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import curve_fit

from hoi.compute import Precision
from hoi.data import Array, Material, ObjectState, Plane
from hoi.mpm.rigid import Flight, fit
from hoi.mpm.state import initial_state

from .bodies import ball, block
from .hertz import contact_time, hertz_path, hertz_share

GRAVITY = (0.0, 0.0, -9.81)
NOWHERE = (0.0, 0.0, 0.0)
FIELDS = ("com", "orientation", "shape", "position")


MOST = 4000
"""Particles that are compared, where every particle's answer is known."""


def picked(particles: Array) -> Array:
    """At most `MOST` of the particles (P, ...), drawn evenly at random, always the same."""
    count = len(particles)
    return particles if count <= MOST else particles[np.random.default_rng(0).permutation(count)[:MOST]]


@dataclass(frozen=True)
class Observed:
    """What is kept of one run at its K times."""

    times: Array
    points: Array
    """The M material points that are compared [m], shape (K, M, 3)."""
    com: Array
    """[m], shape (K, 3)."""
    com_velocity: Array
    """[m/s], shape (K, 3)."""
    volumes: Array
    """[m^3], shape (P,)."""
    start: ObjectState
    end: ObjectState


@dataclass(frozen=True)
class Problem:
    """A setup for any resolution, with its answer."""

    name: str
    title: str
    headline: str
    """The error that it is judged by: one of FIELDS, or a key of `measure`."""
    size: float
    """Largest extent of the object [m]; a cell is size / cells."""
    material: Material
    body: Callable[[float], tuple[ObjectState, Array]]
    """dx -> state at time 0, volumes (P,)."""
    times: Array
    """At which it is looked at [s], shape (K,)."""
    cells: tuple[int, ...]
    """Resolutions, coarse to fine, cells across `size`; the middle one is the base of the other variants."""
    motion: Callable[[Array, Array], Array] | None = None
    """Where the points (M, 3) of time 0 are at times (K,): exact, (K, M, 3). None: known from a finer run only."""
    known: tuple[str, ...] = FIELDS
    """Of FIELDS, those that `motion` is exact for."""
    measure: Callable[["Observed", "Problem"], dict[str, float]] | None = None
    """Further numbers; relative errors where their name is the headline."""
    gravity: tuple[float, float, float] = GRAVITY
    planes: tuple[Plane, ...] = ()
    precision: Precision = "float32"
    notes: dict[str, float] = field(default_factory=dict)
    """Numbers of the setup, for the report."""

    @property
    def base(self) -> int:
        """Cells across of the base variant."""
        return self.cells[len(self.cells) // 2]


# --- flight ----------------------------------------------------------------------------------------------------------


def flight() -> Problem:
    """A soft box is thrown, tumbling; the answer is the rigid body's flight, so that its shape is known to strain."""
    material = Material("soft", "fixed_corotated", 1e5, 0.3, 200.0, 0.5, 0.5)

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = block((0.4, 0.2, 0.1), dx)
        return initial_state(points + np.array([0, 0, 1]), volumes, (1.0, 2.0, 3.0), (1.0, 3.0, 2.0)), volumes

    def motion(points: Array, times: Array) -> Array:
        state, volumes = body(0.05)  # rotation and parabola do not depend on how finely it is filled
        free = Flight(fit(state, volumes, 0.0), GRAVITY)
        return np.array([(points - [0, 0, 1]) @ free.rotation(t).T + free.com(t) for t in times])

    times = np.linspace(0, 0.1, 11)[1:]
    return Problem("flight", "free flight", "com", 0.4, material, body, times, (8, 12, 16), motion, ("com",))


# --- spin ------------------------------------------------------------------------------------------------------------


def spin() -> Problem:
    """A bar turns steadily about a short axis: along both others x = sin(k X) / (k cos(k a)), k = w sqrt(rho / E).

    Started unstretched instead, a bar of half length a lags behind w t by 0.8 (w a / c)^2 of it, c = sqrt(E / rho): its
    moment of inertia grows by twice the mean stretch 0.4 (w a / c)^2.
    """
    material = Material("stiff", "fixed_corotated", 1e7, 0.0, 1000.0, 0.5, 0.5)
    extent, rate = (0.4, 0.1, 0.1), 16.0
    k = rate / np.sqrt(material.youngs_modulus / material.density)
    ends = np.array([np.cos(k * extent[0] / 2), np.cos(k * extent[1] / 2), 1.0])

    def body(dx: float) -> tuple[ObjectState, Array]:
        rest, volumes = block(extent, dx)
        turning = k * np.array([1.0, 1.0, 0.0])
        points = np.where(turning > 0, np.sin(k * rest) / (k * ends), rest)
        state = initial_state(points, volumes, (0, 0, 0), (0, 0, rate))
        stretch = np.cos(turning * rest) / ends
        return ObjectState(points, state.velocities, state.affine, stretch[:, None] * np.eye(3)), volumes

    def motion(points: Array, times: Array) -> Array:
        c, s, o = np.cos(rate * times), np.sin(rate * times), np.ones(len(times))
        turn = np.moveaxis(np.array([[c, -s, 0 * o], [s, c, 0 * o], [0 * o, 0 * o, o]]), -1, 0)
        return points @ np.swapaxes(turn, -1, -2)

    def drift(seen: Observed, _: Problem) -> dict[str, float]:
        before, after = (spin_momentum(state) for state in (seen.start, seen.end))
        return {"angular momentum": float(np.linalg.norm(after - before) / np.linalg.norm(before))}

    times = np.linspace(0, np.pi / 2 / rate, 21)[1:]
    lag = 0.8 * (k * extent[0] / 2) ** 2 * np.pi / 2
    notes = {"stretch at the middle": 1 / ends[0] - 1, "lag if it started unstretched [rad]": float(lag)}
    return Problem(
        "spin", "steady spin", "orientation", 0.4, material, body, times, (8, 12, 16), motion, FIELDS, drift, NOWHERE,
        notes=notes,
    )  # fmt: skip


def spin_momentum(state: ObjectState) -> Array:
    """sum r x v about the centre of particles of equal mass: what the particles' own motion carries."""
    r = state.positions - state.positions.mean(axis=0)
    return np.cross(r, state.velocities.astype(np.float64)).sum(axis=0)


# --- bar -------------------------------------------------------------------------------------------------------------


def bar() -> Problem:
    """u_x = A cos(k x) sin(w t), u_y,z = nu k y,z A sin(k x) sin(w t), w = k sqrt(E/rho) / sqrt(1 + nu^2 k^2 b^2 / 6).

    k = pi / L; b is the edge of the square section. E is a thin bar's modulus: c = sqrt(E / rho), not that of P-waves.
    The root is Rayleigh's correction (Love, Mathematical Theory of Elasticity, 278), good to 1e-5 here.
    """
    material = Material("rubber", "neo_hookean", 1e5, 0.3, 1000.0, 0.5, 0.5)
    length, edge, amplitude = 1.0, 0.125, 1e-3
    k, nu = np.pi / length, material.poisson_ratio
    thin = k * np.sqrt(material.youngs_modulus / material.density)
    w = thin / np.sqrt(1 + nu**2 * k**2 * edge**2 / 6)

    def mode(points: Array) -> Array:
        along = k * (points[:, 0] + length / 2)
        across = nu * k * np.sin(along)
        return amplitude * np.column_stack([np.cos(along), across * points[:, 1], across * points[:, 2]])

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = block((length, edge, edge), dx)
        along = k * (points[:, 0] + length / 2)
        affine = np.zeros((len(points), 3, 3))
        affine[:, 0, 0] = -amplitude * w * k * np.sin(along)
        affine[:, 1, 1] = affine[:, 2, 2] = -nu * affine[:, 0, 0]
        affine[:, 1:, 0] = (amplitude * w * nu * k**2 * np.cos(along))[:, None] * points[:, 1:]
        state = initial_state(points, volumes, (0, 0, 0))
        return ObjectState(points, w * mode(points), affine, state.deformation_gradient), volumes

    def motion(points: Array, times: Array) -> Array:
        return points + np.sin(w * times)[:, None, None] * mode(points)

    def ring(seen: Observed, _: Problem) -> dict[str, float]:
        start = picked(seen.start.positions)
        shape = mode(start)
        moved = ((seen.points - start) * shape).sum(axis=(1, 2)) / (shape**2).sum()
        if np.abs(moved).max() < 0.5:
            return {"frequency": 1.0}  # it does not ring at all
        (_, decay, rate), _ = curve_fit(
            lambda t, a, decay, rate: a * np.exp(-decay * t) * np.sin(rate * t), seen.times, moved, (1.0, 0.0, w)
        )
        return {"frequency": abs(rate / w - 1), "damping ratio": decay / rate}

    times = np.linspace(0, 4 * np.pi / w, 61)[1:]
    notes = {"frequency [Hz]": w / (2 * np.pi), "c / 2L [Hz]": thin / (2 * np.pi)}
    return Problem(
        "bar", "ringing bar", "frequency", length, material, body, times, (8, 16, 32), motion, FIELDS, ring, NOWHERE,
        notes=notes,
    )  # fmt: skip


# --- hertz -----------------------------------------------------------------------------------------------------------

LEVEL = 0.9
"""Contact is timed between the speeds -LEVEL v and LEVEL v', where the force is steep: not by its faint ends."""


def hertz() -> Problem:
    """A ball comes down at 0.02 c* on the frictionless ground: quasi-static, as Hertz's theory has it.

    With c* = sqrt(E*/rho) its compression is delta/R = (5 pi/4 (v/c*)^2)^(2/5) = 0.076 and its contact spans 0.27 R;
    the theory wants that small, and is good to a few per cent here. Contact lasts as long as a wave takes for 6
    diameters, so that hardly any energy stays in it as vibration: the restitution is 1 within about a hundredth.
    """
    material = Material("rubber", "neo_hookean", 1e5, 0.3, 1000.0, 0.5, 0.0)
    radius = 0.5
    effective = material.youngs_modulus / (1 - material.poisson_ratio**2)
    v = 0.02 * np.sqrt(effective / material.density)
    mass = 4 / 3 * np.pi * radius**3 * material.density
    duration = contact_time(mass, radius, effective, v)
    compression = (15 * mass * v**2 / (16 * effective * np.sqrt(radius))) ** 0.4
    gap = 0.1 * compression
    start, share = gap / v, hertz_share(LEVEL)

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = ball(radius, dx)
        return initial_state(points + np.array([0, 0, radius + gap]), volumes, (0, 0, -v)), volumes

    def bounce(seen: Observed, _: Problem) -> dict[str, float]:
        up = seen.com_velocity[:, 2]
        leaves = up[-1]
        if leaves <= 0:
            return {"contact time": 1.0, "restitution": 0.0}  # it does not bounce at all
        first, last = (_crossing(seen.times, up, level) for level in (-LEVEL * v, LEVEL * leaves))
        lasted = (last - first) / share
        return {"contact time": abs(lasted / duration - 1), "lasts longer by": lasted / duration - 1,
                "restitution": leaves / v}  # fmt: skip

    def motion(points: Array, times: Array) -> Array:
        return points + hertz_path(times - start, duration, compression, v)[:, None, None] * [0, 0, 1]

    times = np.linspace(0, start + 2 * duration, 161)[1:]
    notes = {"contact time [s]": duration, "delta / R": compression / radius, "a / R": np.sqrt(compression / radius)}
    plane = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "slip")
    return Problem(
        "hertz", "Hertz bounce", "contact time", 1.0, material, body, times, (8, 16, 24), motion, ("com",), bounce,
        NOWHERE, (plane,), notes=notes,
    )  # fmt: skip


def _crossing(times: Array, values: Array, level: float) -> float:
    """When `values` first rise through `level` [s]; nan when they do not."""
    above = np.flatnonzero(values > level)
    if len(above) == 0 or above[0] == 0:
        return float("nan")
    i = above[0]
    return float(np.interp(level, values[i - 1 : i + 1], times[i - 1 : i + 1]))


# --- waves -----------------------------------------------------------------------------------------------------------


def waves(strain: float = 0.15, phase: float = 0.0) -> Problem:
    """u_i = A_i cos(k_i X_i) sin(w_i t + phase), k_i = pi / L_i, w_i = k_i c, along both edges of a plate.

    It runs for one period of the longer edge. The plate is two cells thick at every resolution, as nothing varies
    across it.

    Args:
        strain: largest, along each edge [-].
        phase: at the start [rad]; 0 starts it without strain.
    """
    material = Material("jelly", "fixed_corotated", 1e5, 0.0, 1000.0, 0.5, 0.5)
    edges = np.array([1.0, 0.5])
    k = np.pi / edges
    w, amplitude = k * np.sqrt(material.youngs_modulus / material.density), strain / k

    def body(dx: float) -> tuple[ObjectState, Array]:
        rest, volumes = block((edges[0], edges[1], 2 * dx), dx)
        along = k * (rest[:, :2] + edges / 2)
        points, velocities = rest.copy(), np.zeros_like(rest)
        points[:, :2] += amplitude * np.cos(along) * np.sin(phase)
        velocities[:, :2] = amplitude * w * np.cos(along) * np.cos(phase)
        stretch, rate = np.ones_like(rest), np.zeros_like(rest)
        stretch[:, :2] -= strain * np.sin(along) * np.sin(phase)
        rate[:, :2] = -strain * w * np.sin(along) * np.cos(phase) / stretch[:, :2]
        return ObjectState(points, velocities, rate[:, None] * np.eye(3), stretch[:, None] * np.eye(3)), volumes

    def motion(points: Array, times: Array) -> Array:
        rest = points[:, :2].copy()
        for _ in range(60 if phase else 0):  # the material point that is at `points` at the start; a contraction
            rest = points[:, :2] - amplitude * np.cos(k * (rest + edges / 2)) * np.sin(phase)
        moved = np.repeat(points[None], len(times), axis=0)
        moved[:, :, :2] = (
            rest + amplitude * np.cos(k * (rest + edges / 2)) * np.sin(w * times[:, None] + phase)[:, None]
        )
        return moved

    times = np.linspace(0, 2 * np.pi / w[0], 17)[1:]
    return Problem(
        "waves", "finite waves, manufactured", "shape", 1.0, material, body, times, (8, 16, 32), motion, FIELDS, None,
        NOWHERE, precision="float64",
    )  # fmt: skip


EXACT = (flight, spin, bar, hertz, waves)
