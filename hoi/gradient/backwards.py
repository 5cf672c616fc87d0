"""Reverse mode through the explicit MPM: what a number that depends on later states owes to each cause before.

A `Recording` is a `Simulation` that remembers, so what is differentiated is the solver's own step. It keeps its state
at checkpoints; to go back, the steps between two of them are taken again and kept, and then taken backwards. With
checkpoints about sqrt(N) steps apart, memory grows as sqrt(N).

The steps themselves are held fast: their length where it was chosen (`dt` None), and the steps at which the window was
fitted, do not follow the causes. What the length of all steps together is worth is `Gradient.duration`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hoi.compute import ti
from hoi.data import Array, Material, ObjectState
from hoi.errors import InputError, RunError
from hoi.gradient.laws import BACKWARDS
from hoi.mpm import rigid
from hoi.mpm.damping import Damping
from hoi.mpm.law import lame
from hoi.mpm.solver import INSTANT, STEPS_A_LOOK, Launch, Simulation
from hoi.mpm.state import centre_of_mass


@dataclass(frozen=True)
class Cotangent:
    """The derivative of a number with respect to an object's state; None is 0."""

    positions: Array | None = None
    """Per metre, shape (P, 3)."""
    velocities: Array | None = None
    """Per m/s, shape (P, 3)."""
    affine: Array | None = None
    """Per 1/s, shape (P, 3, 3)."""
    deformation_gradient: Array | None = None
    """Shape (P, 3, 3)."""
    play: Array | None = None
    """Shape (P,)."""


@dataclass(frozen=True)
class MaterialGradient:
    """The derivative with respect to one material."""

    youngs_modulus: float
    """Per Pa."""
    poisson_ratio: float
    density: float
    """Per kg/m^3, volumes and step held."""
    rebound: float
    """With respect to the share of its speed that the material's loss leaves it; 0 where it is elastic."""


@dataclass(frozen=True)
class Gradient:
    """The derivative of a number with respect to all that a simulation starts from."""

    state: ObjectState
    """Where it starts."""
    masses: Array
    """[kg], shape (P,)."""
    moment: float
    """D, second moment of the spline's weights [m^2]."""
    positions: Array
    """Shape (P, 3)."""
    velocities: Array
    """Shape (P, 3)."""
    affine: Array
    """Shape (P, 3, 3)."""
    deformation_gradient: Array
    """Shape (P, 3, 3)."""
    play: Array | None
    """Shape (P,); None where nothing loses energy."""
    materials: tuple[MaterialGradient, ...]
    """One for each material."""
    friction: tuple[float, ...]
    """With respect to each plane's friction coefficient; without planes of one's own the only one is the ground's."""
    gravity: Array
    """Per m/s^2, shape (3,)."""
    duration: float
    """Per second that the simulation lasts longer, its steps all stretched alike."""

    @property
    def cotangent(self) -> Cotangent:
        """With respect to the state it starts from."""
        return Cotangent(self.positions, self.velocities, self.affine, self.deformation_gradient, self.play)

    @property
    def velocity(self) -> Array:
        """With respect to a velocity that all particles start with in addition, per m/s, (3,)."""
        return self.velocities.sum(axis=0)

    def spin(self, centre: ArrayLike | None = None) -> Array:
        """With respect to a spin in addition, per rad/s, (3,); `centre` [m] is the centre of mass if None."""
        centre = centre_of_mass(self.state.positions, self.masses) if centre is None else np.asarray(centre)
        return np.cross(self.state.positions - centre, self.velocities).sum(axis=0) + axial(self.affine.sum(axis=0))

    def impulse(self, point: ArrayLike) -> Array:
        """With respect to an impulse at `point` [m] that changes its motion as that of a rigid body, per N s, (3,)."""
        motion = rigid.fit(self.state, self.masses, self.moment)
        turn = np.linalg.solve(motion.inertia, self.spin(motion.com))
        return self.velocity / motion.mass + np.cross(turn, np.asarray(point) - motion.com)


@dataclass
class _Launch:
    """Steps of one length in one window."""

    steps: int
    dt: float
    origin: NDArray[np.int64]
    shape: NDArray[np.int64]
    near: bool
    touching: bool
    end: float = math.nan
    """The time after it [s]."""

    @property
    def nodes(self) -> int:
        return int(self.shape.prod())


class Recording(Simulation):
    """A simulation that remembers enough to be taken backwards. Arguments are those of `Simulation`.

    Raises:
        InputError: also for what cannot be taken backwards: a law that flows or is not elastic, a collider, more than
            one thread, a GPU.
    """

    def __init__(self, state: ObjectState, volumes: Array, material: Material | Sequence[Material], **settings: Any):
        for each in (material,) if isinstance(material, Material) else material:
            if each.model not in BACKWARDS:
                raise InputError("material.model of a gradient", repr(each.model), f"one of {', '.join(BACKWARDS)}")
        if settings.get("collider") is not None:
            raise InputError("a gradient goes through planes alone; give the blow as an impulse, not as a collider")
        if settings.get("device", "cpu") != "cpu" or settings.get("threads", 1) != 1:
            raise InputError("a gradient is computed by one thread of a CPU; threads must be 1 and device cpu")
        self.launches: list[_Launch] = []
        self.checkpoints: dict[int, list[Array]] = {}
        """The state before some of the launches, by their number."""
        self.spacing = 1
        """Launches between checkpoints."""
        self.start = state
        super().__init__(state, volumes, material, **settings)

    def step_towards(self, until: float, span: float = math.inf) -> None:
        super().step_towards(until, span)
        self.launches[-1].end = self.time

    def _launch(self, launch: Launch, *, idle: bool = False) -> int:
        if idle:
            return super()._launch(launch, idle=True)
        if len(self.launches) % self.spacing == 0:
            self._checkpoint()
        done = super()._launch(launch)
        self.launches.append(_Launch(done, launch.dt, launch.origin, launch.shape, launch.near, launch.touching))
        return done

    def _checkpoint(self) -> None:
        if len(self.checkpoints) >= self.spacing * STEPS_A_LOOK:
            self.spacing *= 2
            self.checkpoints = {n: kept for n, kept in self.checkpoints.items() if n % self.spacing == 0}
            if len(self.launches) % self.spacing:
                return
        self.checkpoints[len(self.launches)] = [a.to_numpy() for a in (self.x, self.v, self.c, self.f, self.play)]

    @property
    def states_kept(self) -> int:
        """The most states of the particles that going back keeps at once: checkpoints, and steps between two."""
        return len(self.checkpoints) + 1 + max(sum(each.steps for each in part) for _, part in self._parts())

    def _parts(self) -> list[tuple[int, list[_Launch]]]:
        """The launches from each checkpoint to the next, with the checkpoint's number."""
        starts = sorted(self.checkpoints)
        ends = [*starts[1:], len(self.launches)]
        return [(start, self.launches[start:end]) for start, end in zip(starts, ends, strict=True)]

    def backwards(self, cotangents: Sequence[tuple[float, Cotangent]]) -> Gradient:
        """The gradient of a number, given its derivatives with respect to the states at some times.

        Args:
            cotangents: (time [s], derivative); each time one to which the simulation was advanced, or 0.

        Raises:
            InputError: a time that it was not advanced to, or a derivative of a wrong shape.
            RunError: the gradient is not finite.
        """
        ends = [launch.end for launch in self.launches]
        given: dict[int, list[Cotangent]] = {}
        for time, cotangent in cotangents:
            after = 0 if time == 0 else 1 + int(np.argmin(np.abs(np.subtract(ends, time)))) if ends else -1
            if after < 0 or (after and abs(ends[after - 1] - time) > INSTANT):
                raise InputError(f"a gradient starts from times that the simulation was advanced to, got {time:g} s")
            given.setdefault(after, []).append(cotangent)
        back = _Backwards(self)
        for start, part in reversed(self._parts()) if self.launches else ():
            back.replay(self.checkpoints[start], part)
            for number in reversed(range(len(part))):
                back.add(given.get(start + number + 1, ()))
                back.reverse(part[number], sum(launch.steps for launch in part[:number]))
        self.placed_at = None
        back.add(given.get(0, ()))
        return back.gradient()


class _Backwards:
    """The arrays on the device that going back needs."""

    def __init__(self, run: Recording) -> None:
        self.run, count, real = run, len(run.volumes), run.real
        parts = run._parts()
        self.room = max((launch.nodes for launch in run.launches), default=1)
        steps = max((sum(launch.steps for launch in part) for _, part in parts), default=0)
        vectors = ti.Vector.ndarray
        plays = (steps + 1) * count if run.damped else 1
        self.kept = [
            vectors(4, ti.f64, (steps + 1) * count), vectors(4, real, (steps + 1) * count),
            *(vectors(4, real, 3 * (steps + 1) * count) for _ in range(2)), ti.ndarray(real, plays),
            vectors(4, real, max(steps, 1) * self.room),
            vectors(4, real, max(steps, 1) * self.room if run.planes else 1),
        ]  # fmt: skip
        self.state = [vectors(4, ti.f64, count), vectors(4, real, count), *(vectors(4, real, 3 * count) for _ in "cf"),
                      ti.ndarray(real, count if run.damped else 1)]  # fmt: skip
        self.grid, self.slope = (vectors(4, real, 2 * self.room) for _ in range(2))
        self.touched, self.status = ti.ndarray(ti.i32, self.room), ti.ndarray(ti.i32, 4)
        self.on_grid = [vectors(4, real, self.room) for _ in range(2)]
        self.on_state = [vectors(4, ti.f64, count), vectors(4, real, count), vectors(4, real, 3 * count),
                         vectors(4, real, 3 * count), ti.ndarray(real, count if run.damped else 1)]  # fmt: skip
        sizes = (count, 4 * len(run.materials), max(len(run.planes), 1), 4)
        self.sums = [ti.ndarray(ti.f64, size) for size in sizes]
        for array in (self.touched, self.status, *self.on_state, *self.sums):
            array.fill(0)
        self.stretched = 0.0
        """What it is worth to stretch all steps by a share."""

    def _shared(self, launch: _Launch, slot: int) -> tuple[Any, ...]:
        run = self.run
        return (launch.steps, slot, self.room, int(launch.near), run.damped, run.size, run.models)

    def _place(self, launch: _Launch) -> None:
        if self.run.planes:
            self.run.place_planes(launch.origin)

    def _numbers(self, launch: _Launch) -> tuple[Any, ...]:
        run = self.run
        return (launch.dt, run.dx, 1 / run.dx, run.tolerance, _four(launch.origin, int), _four(launch.shape, int))

    def replay(self, checkpoint: list[Array], launches: Sequence[_Launch]) -> None:
        """Takes the steps of `launches` again, and keeps them."""
        from hoi.gradient import kernels

        run, slot = self.run, 0
        for array, values in zip(self.state, checkpoint, strict=True):
            array.from_numpy(values)
        for launch in launches:
            self._place(launch)
            for array in (self.grid, self.slope):
                array.fill(0.0)  # the copies begin elsewhere in another window, and are to be clear
            drift = np.zeros(3) if launch.touching else 0.5 * launch.dt**2 * run.gravity
            kernels.replay(
                *self._shared(launch, slot), *self.state[:4], run.total, run.hardening, self.state[4], run.mass,
                run.volume, run.region_of, run.parameters, self.grid, self.slope, run.plane_rows, run.none,
                self.touched, self.status, *self.kept, _four(run.gravity), _four(drift), *self._numbers(launch),
            )  # fmt: skip
            slot += launch.steps

    def reverse(self, launch: _Launch, slot: int) -> None:
        """Takes the steps of `launch`, which begin in `slot`, backwards."""
        from hoi.gradient import kernels

        run = self.run
        self._place(launch)
        before = self.sums[3].to_numpy()[kernels.ON_TIME]
        kernels.reverse(
            *self._shared(launch, slot), run.mass, run.volume, run.region_of, run.parameters, run.plane_rows,
            *self.kept, self.grid, *self.on_grid, *self.on_state, *self.sums, _four(run.gravity),
            int(not launch.touching), *self._numbers(launch),
        )  # fmt: skip
        self.stretched += launch.dt * (self.sums[3].to_numpy()[kernels.ON_TIME] - before)

    def add(self, cotangents: Sequence[Cotangent]) -> None:
        """Adds what the state that it has come back to is worth by itself."""
        count = len(self.run.volumes)
        for cotangent in cotangents:
            for array, (name, values) in zip(self.on_state, vars(cotangent).items(), strict=True):
                if values is None or (name == "play" and not self.run.damped):
                    continue
                shape = (count, *([] if name == "play" else [3] if name in ("positions", "velocities") else [3, 3]))
                if np.shape(values) != shape:
                    raise InputError(f"gradient: {name} must have shape {shape}, got {np.shape(values)}")
                sum = array.to_numpy()
                if name == "play":
                    sum += values
                else:
                    sum[:, :3] += values if len(shape) == 2 else _columns(values)
                array.from_numpy(sum)

    def gradient(self) -> Gradient:
        """What has been gathered, told by the causes."""
        run = self.run
        x, v, c, f = (array.to_numpy()[:, :3].astype(np.float64) for array in self.on_state[:4])
        on_mass, on_material, on_friction, on_world = (array.to_numpy() for array in self.sums)
        if not all(np.isfinite(a).all() for a in (x, v, c, f, on_mass, on_material, on_friction, on_world)):
            raise RunError(f"the gradient over {run.steps} steps, {run.time:.4g} s, is not finite: the motion "
                           "amplifies a change beyond all bounds; use less time, smaller steps or float64")  # fmt: skip
        region = np.zeros(len(x), dtype=int) if run.region is None else run.region
        by_density = np.bincount(region, weights=on_mass * run.volumes, minlength=len(run.materials))
        materials = tuple(
            _by_material(material, loss, row, float(density))
            for material, loss, row, density in zip(
                run.materials, run.dampings, on_material.reshape(-1, 4), by_density, strict=True
            )
        )
        return Gradient(
            state=run.start,
            masses=run.masses,
            moment=run.dx**2 / (4 if run.size == 3 else 3),
            positions=x,
            velocities=v,
            affine=_matrices(c),
            deformation_gradient=_matrices(f),
            play=self.on_state[4].to_numpy().astype(np.float64) if run.damped else None,
            materials=materials,
            friction=tuple(on_friction.tolist()[: len(run.planes)]),
            gravity=on_world[:3],
            duration=self.stretched / run.time if run.time else 0.0,
        )


def differentiate(
    loss: Callable[[tuple[ObjectState, ...]], tuple[float, Sequence[Cotangent]]], state: ObjectState, volumes: Array,
    material: Material | Sequence[Material], *, times: Sequence[float] | Array, **settings: Any,
) -> tuple[float, Gradient]:  # fmt: skip
    """A number that depends on the states at `times`, and its gradient.

    Args:
        loss: (the states) -> (the number, its derivatives with respect to each of them).
        state, volumes, material, settings: those of `Simulation`.
        times: increasing [s].

    Raises:
        InputError: a value that cannot be simulated, or not backwards.
        RunError: the simulation diverged, or its gradient did.
    """
    run = Recording(state, volumes, material, **settings)
    states = []
    for time in times:
        run.advance(float(time))
        states.append(run.state())
    value, cotangents = loss(tuple(states))
    return value, run.backwards(list(zip((float(time) for time in times), cotangents, strict=True)))


def _by_material(material: Material, loss: Damping, row: Array, density: float) -> MaterialGradient:
    """From what mu, lambda, s_min and k are worth."""
    e, nu = material.youngs_modulus, material.poisson_ratio
    mu, lam = lame(material)
    on_mu, on_lam, on_least, on_steepness = row.tolist()
    by_nu = e * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2
    rebound = 0.0
    if k := loss.steepness:  # s_min = e^2 / 2, and k as 1 + k (exp((s_min - 1) / k) - 1) = e^2 says
        share, z = math.sqrt(2 * loss.least), (loss.least - 1) / k
        by_share = share * (2 - math.exp(z)) / (math.expm1(z) - z * math.exp(z))
        rebound = on_least * share + on_steepness * by_share
    return MaterialGradient(
        (on_mu * mu + on_lam * lam) / e, on_lam * by_nu - on_mu * mu / (1 + nu), density, rebound
    )  # fmt: skip


def axial(m: Array) -> Array:
    """a with m : [w]_x = a . w."""
    return np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def _columns(matrices: Array) -> Array:
    return np.swapaxes(matrices, 1, 2).reshape(-1, 3)


def _matrices(columns: Array) -> Array:
    return np.ascontiguousarray(np.swapaxes(columns.reshape(-1, 3, 3), -1, -2))


def _four(values: Any, dtype: Any = float) -> Any:
    return ti.Vector([dtype(value) for value in values] + [dtype(0)])
