"""What an object is made of, from how it moved: `python -m analysis.fit runs/.../run.mcap [-o FOLDER]`.

The record's object, after the last contact with a limb, is moved again with other materials until it moves as recorded:
E, nu, restitution and friction, and the velocity and spin with which it starts. Compared are its centre and its mean
deformation (the affine map nearest to all of its particles), frame by frame: linear in the positions, and little
troubled by noise. Residuals are many and causes few, so the Jacobian is one of differences, a walk a cause; a gradient
in reverse (`hoi.gradient`) pays where it is the other way round (`analysis.spread`).

Standard errors are those of Gauss and Newton, s^2 (J^T J)^-1. Where one of them is too large the motion cannot tell,
and the value is left as it was. Motion tells E / density alone: the density is taken as given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hoi.data import Array, Material, Plane
from hoi.errors import InputError, RunError
from hoi.terminal.program import program

from . import command

NAMES: tuple[str, ...] = ("youngs_modulus", "poisson_ratio", "restitution", "ground_friction")
TELLS: dict[str, float] = {"youngs_modulus": 0.5, "poisson_ratio": 0.1, "restitution": 0.1, "ground_friction": 0.1}
"""Standard error from which on the motion does not tell: of E as a share, of the others as they are."""
LOW = (math.log(1e3), 0.0, 0.2, 0.0)
HIGH = (math.log(1e9), 0.45, 1.0, 1.5)
STEPS = (0.1, 0.03, 0.03, 0.03, *3 * (0.01,), *3 * (0.05,))
"""Of the differences: log E, nu, e, mu, m/s, rad/s."""
RESTITUTIONS, FRICTIONS = (0.4, 0.6, 0.8, 0.95), (0.1, 0.3, 0.6)
"""Where it begins, beside the starts of E."""
BEST = 2
"""So many of the beginnings are followed."""
SOON = 0.2
"""[s]."""
MOST_TURNS = 8
"""Of Gauss and Newton, from each start."""
TOLERANCE = 0.005
"""Vibration that a walk leaves out, relative to the size."""


@dataclass(frozen=True)
class Clip:
    """A body on its way."""

    observed: Array
    """Its particles [m], (T, P, 3)."""
    rest: Array
    """The same at rest, in any pose, (P, 3)."""
    volume: float
    """Of the body [m^3]."""
    fps: float
    gravity: Array
    planes: tuple[Plane, ...]
    cells: int = 10
    """Of the grid, across the body."""
    drag: float = 0.0
    """k of `hoi.mpm.rigid.Flight` [1/m]."""

    @property
    def size(self) -> float:
        return float(np.ptp(self.rest, axis=0).max())


@dataclass(frozen=True)
class Fit:
    """What was found."""

    material: Material
    """With what the motion tells; the rest is as it was given."""
    values: dict[str, float]
    """By field of the material: best value, told or not."""
    errors: dict[str, float]
    """Standard errors, of E as a share; infinite where nothing depends on it."""
    velocity: Array
    """At the first frame [m/s], (3,)."""
    velocity_error: Array
    spin: Array
    """[rad/s], (3,)."""
    misfit: float
    """Root mean square of what is left [m]."""
    touches: bool
    """Whether anything touched it."""

    def told(self, name: str) -> bool:
        return self.errors[name] <= TELLS[name]


def features(clip: Clip, positions: Array) -> Array:
    """Centre, and mean deformation times the radius of gyration [m]: (..., 12) of (..., P, 3)."""
    arms = clip.rest - clip.rest.mean(axis=0)
    centre = positions.mean(axis=-2)
    spread = arms.T @ arms
    deformation = np.einsum("...pi,pj->...ij", positions - centre[..., None, :], arms) @ np.linalg.inv(spread)
    radius = math.sqrt(np.trace(spread) / len(arms))
    return np.concatenate([centre, radius * deformation.reshape(*centre.shape[:-1], 9)], axis=-1)


def start_of(clip: Clip) -> tuple[Array, Array, Array]:
    """Rotation (3, 3) from `rest`, velocity and spin of the first frame: from the poses of the first two."""
    arms = clip.rest - clip.rest.mean(axis=0)
    turns = [Rotation.align_vectors(x - x.mean(axis=0), arms)[0] for x in clip.observed[:2]]
    centres = clip.observed[:2].mean(axis=1)
    velocity = (centres[1] - centres[0]) * clip.fps - 0.5 * clip.gravity / clip.fps
    return turns[0].as_matrix(), velocity, (turns[1] * turns[0].inv()).as_rotvec() * clip.fps


def moved(clip: Clip, material: Material, velocity: Array, spin: Array, turn: Array) -> tuple[Array, bool]:
    """Particles at the frames (T, P, 3), and whether anything touched the body.

    Raises:
        RunError: the simulation diverged.
    """
    from hoi.mpm.damping import rebound_of
    from hoi.mpm.phases import Surroundings, Walk, lowest_frequency, reach_of
    from hoi.mpm.solver import Simulation
    from hoi.mpm.state import initial_state

    dx, count = clip.size / clip.cells, len(clip.rest)
    positions = (clip.rest - clip.rest.mean(axis=0)) @ turn.T + clip.observed[0].mean(axis=0)
    volumes = np.full(count, clip.volume / count)
    masses = volumes * material.density
    planes = [replace(plane, friction=material.ground_friction) for plane in clip.planes]
    rebound = [rebound_of(material, clip.cells)]
    reaches = [reach_of(plane, dx) for plane in planes]
    touched = False

    def simulation(state, now):
        nonlocal touched
        touched |= bool(Surroundings(planes, reaches).touched(state.positions))
        return Simulation(state, volumes, material, dx=dx, rebound=rebound, gravity=clip.gravity, planes=planes)

    walk = Walk(
        initial_state(positions, masses, velocity, spin), masses, simulation, end=len(clip.observed) / clip.fps,
        gravity=clip.gravity, surroundings=Surroundings(planes, reaches), size=clip.size, moment=dx**2 / 4,
        frequency=lowest_frequency(positions, masses, [material]), tolerance=TOLERANCE, drag=clip.drag,
    )  # fmt: skip
    states = [walk.advance(frame / clip.fps)[0].positions for frame in range(len(clip.observed))]
    touched |= any(Surroundings(planes, reaches).touched(x) for x in states)
    return np.stack(states), touched


def horizon(clip: Clip) -> int:
    """Frames until `SOON` after a plane is first within a cell of the body; all where none is."""
    low = clip.size / clip.cells
    for frame, x in enumerate(clip.observed):
        if any(((x - plane.point) @ plane.normal).min() < low for plane in clip.planes):
            return min(frame + max(math.ceil(SOON * clip.fps), 3), len(clip.observed))
    return len(clip.observed)


def fit(clip: Clip, material: Material, starts: Sequence[float] = (0.3, 3.0)) -> Fit:
    """What moves the body as it was seen to move.

    Args:
        material: law and density, and where to begin.
        starts: E to begin with, over the material's; with each, restitutions and frictions all over their ranges.

    Raises:
        InputError: fewer than three frames, or a law that does not spring back.
        RunError: no start could be simulated.
    """
    from hoi.mpm.laws import LAWS

    if len(clip.observed) < 3:
        raise InputError(f"a fit needs 3 frames or more after the contact, got {len(clip.observed)}")
    if not LAWS[material.model].springs:
        raise InputError("material.model of a fit", repr(material.model), "an elastic solid that springs back")
    turn, velocity, spin = start_of(clip)
    seen = features(clip, clip.observed)
    touched = False

    def residuals(x: Array, frames: int) -> Array:
        nonlocal touched
        part = replace(clip, observed=clip.observed[:frames])
        try:
            made, touches = moved(part, _material(material, x), x[4:7], x[7:10], turn)
        except RunError:  # such a material cannot be stepped: as bad as a body's size in each number
            return np.full(seen[:frames].size, clip.size)
        touched |= touches
        return (features(clip, made) - seen[:frames]).ravel()

    low, high = np.array([*LOW, *6 * (-np.inf,)]), np.array([*HIGH, *6 * (np.inf,)])

    def jacobian(x: Array, frames: int) -> Array:
        here, columns = residuals(x, frames), []
        for cause, step in enumerate(STEPS):
            there = x.copy()
            there[cause] += step if x[cause] + step < high[cause] else -step
            columns.append((residuals(there, frames) - here) / (there[cause] - x[cause]))
        return np.stack(columns, axis=1)

    scale = np.array([1.0, 0.1, 0.1, 0.1, *3 * (0.1,), *3 * (1.0,)])
    begun = [
        np.clip([math.log(share * material.youngs_modulus), material.poisson_ratio, e, mu, *velocity, *spin],
                low + 1e-6, high - 1e-6)
        for share in starts for e in RESTITUTIONS for mu in FRICTIONS
    ]  # fmt: skip
    first = horizon(clip)
    begun.sort(key=lambda x: float((residuals(x, first) ** 2).sum()))
    ends = []
    for x in begun[:BEST]:
        found = None
        for frames in (first, len(seen)):  # beyond the first contact misfits have many valleys
            start = x if found is None else np.clip(found.x, low + 1e-6, high - 1e-6)
            found = least_squares(residuals, start, jacobian, (low, high), x_scale=scale, ftol=1e-4, xtol=1e-4,  # pyright: ignore[reportArgumentType]
                                  max_nfev=MOST_TURNS, args=(frames,))  # fmt: skip
        ends.append(found)
    best = min(ends, key=lambda found: found.cost)
    if np.all(best.fun == clip.size):
        raise RunError("none of the materials tried could be simulated; try others with --starts")
    s = math.sqrt(2 * best.cost / max(seen.size - len(STEPS), 1))
    return _told(material, best.x, _errors(best.jac, s), s, touched)


def _errors(jacobian: Array, s: float) -> Array:
    """Standard errors; infinite of what nothing depends on."""
    size = np.linalg.norm(jacobian, axis=0)
    sees = size > 1e-9 * size.max()
    errors = np.full(len(size), np.inf)
    scaled = jacobian[:, sees] / size[sees]
    errors[sees] = s * np.sqrt(np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-12))) / size[sees]
    return errors


def _material(material: Material, x: Array) -> Material:
    return replace(material, youngs_modulus=math.exp(x[0]), **dict(zip(NAMES[1:], x[1:4].tolist(), strict=True)))


def _told(material: Material, x: Array, errors: Array, misfit: float, touches: bool) -> Fit:
    best = _material(material, x)
    values = {name: getattr(best, name) for name in NAMES}
    named = dict(zip(NAMES, errors[:4].tolist(), strict=True))
    told = {name: value for name, value in values.items() if named[name] <= TELLS[name]}
    return Fit(replace(material, **told), values, named, x[4:7], errors[4:7], x[7:10], misfit, touches)


def words(found: Fit) -> list[str]:
    """The fit, a line a value."""
    lines = []
    for name in NAMES:
        error = found.errors[name] * (found.values[name] if name == "youngs_modulus" else 1)
        if found.told(name):
            lines.append(f"{name}: {found.values[name]:.4g} +- {error:.2g}")
        elif not found.touches:
            lines.append(f"{name}: this motion cannot tell: nothing touches the object")
        else:
            lines.append(f"{name}: this motion cannot tell: {found.values[name]:.3g} +- {error:.2g}")
    lines.append(f"velocity: {found.velocity.round(4).tolist()} +- {found.velocity_error.round(4).tolist()} m/s")
    lines.append(f"spin: {found.spin.round(3).tolist()} rad/s")
    lines.append(f"misfit: {1000 * found.misfit:.2g} mm")
    return lines


def yaml_of(found: Fit, source: str) -> str:
    """A material that runs."""
    neutral = {field.name: field.default for field in fields(Material)}
    lines = [f"# Fitted to {source}.", *(f"# {line}" for line in words(found)), "defaults:",
             "  - /schema/material@_here_"]  # fmt: skip
    for name, value in vars(found.material).items():
        if value != neutral[name]:
            lines.append(f"{name}: {value if isinstance(value, str) else f'{float(value):.6e}'}")
    return "\n".join(lines) + "\n"


def clip_of(path: Path, particles: int, cells: int, first: int | None) -> tuple[Clip, Material]:
    """The object of a record from frame `first` on, or from the first after its last contact.

    Raises:
        InputError: it has no object on its way, or one of several materials.
    """
    from hoi.mpm.rigid import air_drag

    from .records import Undefined, load

    record = load(path)
    try:
        scene, trajectory = record.scene, record.trajectory
    except Undefined as error:
        raise InputError(f"{path}: it records no object on its way") from error
    thing = scene.thing
    if len(thing.materials) > 1:
        raise InputError(f"{path}: its object is of {len(thing.materials)} materials; a fit takes one")
    if first is None:
        contact = record.run.state.contact
        last = max((c.frame + c.duration * scene.fps for c in contact.contacts), default=0.0) if contact else 0.0
        first = math.ceil(last)
    chosen = np.random.default_rng(0).permutation(len(thing.particles))[:particles]
    air, coefficient = (float(record.conf("stage", "object", key, default=0.0))
                        for key in ("air_density", "drag_coefficient"))  # fmt: skip
    drag = air_drag(thing.particles, float(thing.masses.sum()), air, coefficient)
    clip = Clip(trajectory.positions[first:, chosen].astype(np.float64), thing.particles[chosen].astype(np.float64),
                float(thing.volumes.sum()), scene.fps, scene.gravity, tuple(scene.planes), cells, drag)  # fmt: skip
    return clip, thing.material


@command.exit_code("analysis.fit")
def main() -> None:
    parser = command.parser(
        "analysis.fit",
        "What a recorded object is made of, from how it moved, and how sure that is.",
        "runs/kick_soccer_ball/laptop/full/s0/run.mcap -o runs/fit",
    )
    parser.add_argument("record", type=Path, help="an MCAP record")
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/fit"), help="folder of the material")
    parser.add_argument("--name", default="fitted", help="of the material")
    parser.add_argument("--first", type=int, help="frame to begin with (default: after the last contact)")
    parser.add_argument("--particles", type=int, default=800, help="of the object's (default 800)")
    parser.add_argument("--cells", type=int, default=10, help="of the grid across the object (default 10)")
    parser.add_argument("--starts", type=float, nargs="+", default=[0.3, 3.0], help="shares of the record's own E")
    arguments = parser.parse_args()
    if arguments.particles < 8 or arguments.cells < 2 or not all(share > 0 for share in arguments.starts):
        raise InputError("--particles must be 8 or more, --cells 2 or more, --starts above 0")
    clip, material = clip_of(arguments.record, arguments.particles, arguments.cells, arguments.first)
    found = fit(clip, replace(material, name=arguments.name), arguments.starts)
    print("\n".join(words(found)))
    folder = arguments.out / "material"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{arguments.name}.yaml"
    file.write_text(yaml_of(found, arguments.record.name))
    print(file)


if __name__ == "__main__":
    program(main)
