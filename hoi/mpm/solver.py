"""Runs the MLS-MPM of `hoi.mpm.kernels` from one state of the object to the next, in a window of the grid around it."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hoi.compute import Device, Precision, start_compiler, ti
from hoi.data import Array, Material, ObjectState, Plane, Push
from hoi.errors import InputError, RunError
from hoi.mpm import boundary, kernels
from hoi.mpm.collider import Collider, Partner, joined
from hoi.mpm.coupling import Coupling, fastest, no_parts
from hoi.mpm.damping import Damping, damping
from hoi.mpm.exchange import exchange
from hoi.mpm.law import PARAMETERS
from hoi.mpm.laws import LAWS
from hoi.mpm.materials import parameters
from hoi.mpm.stability import DEFAULT_FRACTION, STABLE_CFL, choose_time_step, diffusivity, stable_step
from hoi.mpm.state import centre_of_mass, check_state, energies

Spline = Literal["quadratic", "cubic"]

MARGIN = 2
"""Cells between the object and the rim of its window when the window is fitted; as many more if it moves fast."""
MAX_NODES = 2**25
"""Nodes of the largest window and its copies: 0.6 GB in float32."""
STEPS_A_LOOK = 32
"""Steps after which the time step and the window are chosen anew."""
EXCHANGE = 0.0005
"""How long a partner's own motion waits while its capsules push [s]."""
INSTANT = 1e-9
"""Times no further apart than this are one [s]."""
CONTACTS = {"coulomb": boundary.COULOMB, "slip": boundary.SLIP, "stick": boundary.STICK}
UNSTABLE_CFL = 1.15
"""Above the largest CFL number that was measured to be stable."""


@dataclass(frozen=True)
class Launch:
    """Some steps of one length in one window: what the kernels work on."""

    steps: int
    dt: float
    """[s]."""
    origin: NDArray[np.int64]
    """First node of the window, (3,)."""
    shape: NDArray[np.int64]
    """Its nodes along each axis, (3,)."""
    near: bool
    """Whether anything solid may be touched."""
    touching: bool
    """Whether it is now: the object does not fall freely."""
    coupled: bool
    """Whether the partner is near."""
    arrays: tuple[Any, ...]
    numbers: tuple[Any, ...]
    parts: Any
    body: Any


def set_status(status: Any, idle: bool = False) -> None:
    """Makes the status of a launch anew; `idle`: of one that does nothing."""
    fresh = np.zeros(4, dtype=np.int32)
    fresh[[kernels.AT_RIM, kernels.STOP]] = idle
    status.from_numpy(fresh)


def ground_plane(friction: float) -> Plane:
    """The half-space z < 0."""
    return Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "coulomb", friction)


@dataclass(frozen=True)
class SimulationResult:
    """What `simulate` returns; K is the number of requested times."""

    times: Array
    """As requested, from the start of the simulation [s], shape (K,)."""
    states: tuple[ObjectState, ...]
    """The state at each of the times."""
    com: Array
    """Centre of mass [m], shape (K, 3)."""
    com_velocity: Array
    """Its velocity [m/s], shape (K, 3)."""
    energy: Array
    """Kinetic, elastic and potential energy [J], shape (K, 3); see `hoi.mpm.state.energies`."""
    collider_impulse: Array
    """What the collider gave the object until then [N s], shape (K, 3)."""
    steps: int
    """Substeps done."""
    cfl: float
    """Largest (c + |v|) dt / dx met [-], c and |v| as of each look at the particles."""
    dt_least: float
    dt_most: float
    """Shortest and longest time step [s]."""
    refits: int
    """How often the window was fitted to the object."""
    compile_seconds: float
    """Compiling, or loading from Taichi's cache, and uploading [s]."""
    seconds: float
    """Everything else [s]."""

    @property
    def final(self) -> ObjectState:
        """The state at the last time."""
        return self.states[-1]


def simulate(
    state: ObjectState,
    volumes: Array,
    material: Material | Sequence[Material],
    *,
    times: Sequence[float] | Array,
    on_time: Callable[[], object] | None = None,
    **settings: Any,
) -> SimulationResult:
    """Advances the object and returns its state at each of `times`.

    The first interval, from 0 to times[0], may be of any length. Arguments are those of `Simulation`, and

    Args:
        times: increasing, from the start of the simulation [s]; 0 asks for the initial state.
        on_time: called when each of `times` is reached.

    Raises:
        InputError: a value that cannot be simulated.
        RunError: the simulation diverged.
    """
    times = _check_times(times)
    run = Simulation(state, volumes, material, **settings)
    started = time.perf_counter()
    states, given = [], []
    for until in times:
        run.advance(float(until))
        states.append(run.state())
        given.append(run.collider_impulse)
        if on_time is not None:
            on_time()
    masses = run.masses
    return SimulationResult(
        times=times,
        states=tuple(states),
        com=np.array([centre_of_mass(s.positions, masses) for s in states]),
        com_velocity=np.array([centre_of_mass(s.velocities, masses) for s in states]),
        energy=np.array([run.energies(s) for s in states]),
        collider_impulse=np.array(given),
        steps=run.steps,
        cfl=run.cfl,
        dt_least=run.dt_least,
        dt_most=run.dt_most,
        refits=run.refits,
        compile_seconds=run.compile_seconds,
        seconds=time.perf_counter() - started,
    )


class Simulation:
    """An object on its way: its particles on the device, and the window of the grid around them.

    With one thread the same input gives the same bits. With more it does for the same number of threads, and differs
    in round-off from another number; on a GPU it differs in round-off from run to run. A simulation that starts from
    the state of another and steps to the same times continues it bit for bit.

    Args:
        state: where it starts; not changed.
        volumes: rest volume of each particle [m^3], shape (P,).
        material: what the object is made of, or what its regions are made of.
        region: index of each particle's material, shape (P,); None: all of the first.
        dx: cell size [m].
        dt: time step [s]; None chooses it every few steps from the fastest particle and the stiffest deformed state.
            Every interval is cut into equal steps of at most this, so that its end is met exactly.
        fraction: share of the stability limit that a chosen step takes, in (0, 1].
        rebound: share of its speed that each material's own loss leaves a body in a bounce [-], see `hoi.mpm.damping`;
            None: elastic.
        gravity: [m/s^2], shape (3,).
        planes: what is solid; None: the ground z = 0 with the first material's friction; () is empty space.
        collider: capsules that move through the grid; times count from the start of the simulation, or what carries
            them takes the opposite of what they give.
        spline: "quadratic" or "cubic".
        precision: of the arithmetic; positions are accumulated in float64 in both.
        threads: CPU threads.
        device: "cpu" or "cuda".

    `collider_impulse` (3,) [N s] is what the collider gave the object so far, `pushes` when, to `STEPS_A_LOOK` steps.

    Raises:
        InputError: a value that cannot be simulated, or a `dt` above the stability limit.
    """

    def __init__(
        self,
        state: ObjectState,
        volumes: Array,
        material: Material | Sequence[Material],
        *,
        dx: float,
        dt: float | None = None,
        fraction: float = DEFAULT_FRACTION,
        region: NDArray[np.integer[Any]] | None = None,
        rebound: Sequence[float] | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        planes: Sequence[Plane] | None = None,
        collider: Collider | Partner | None = None,
        spline: Spline = "quadratic",
        precision: Precision = "float32",
        threads: int = 1,
        device: Device = "cpu",
    ) -> None:
        check_state(state, volumes)
        self.materials = (material,) if isinstance(material, Material) else tuple(material)
        self.region = _check_region(region, len(volumes), len(self.materials))
        self.dampings = _check_rebound(rebound, self.materials)
        self.damped = any(damping.steepness for damping in self.dampings)
        self.volumes = np.asarray(volumes, dtype=np.float64)
        densities = np.array([material.density for material in self.materials])
        self.masses = self.volumes * densities[0 if self.region is None else self.region]
        self.gravity = np.asarray(gravity, dtype=np.float64)
        if self.gravity.shape != (3,) or not np.isfinite(self.gravity).all():
            raise InputError(f"gravity must be three finite numbers [m/s^2], got {self.gravity.tolist()}")
        speed = float(np.linalg.norm(state.velocities, axis=1).max())
        choose_time_step(self.materials, dx, speed, dt, fraction, [damping.stiffening for damping in self.dampings])
        if spline not in ("quadratic", "cubic"):
            raise InputError(f"mpm spline must be quadratic or cubic, got {spline!r}")
        self.dx, self.dt, self.fraction = dx, dt, fraction
        self.size = 3 if spline == "quadratic" else 4
        self.planes = [ground_plane(self.materials[0].ground_friction)] if planes is None else list(planes)
        for plane in self.planes:
            _check_plane(plane)
        self.collider = collider if isinstance(collider, Collider) else None
        self.partner = None if isinstance(collider, Collider) else collider
        self.time, self.steps, self.refits, self.cfl = 0.0, 0, 0, 0.0
        self.dt_least, self.dt_most = math.inf, 0.0
        self.collider_impulse = np.zeros(3)
        self.looked_at = -1
        """The step at which `seen_last` was true."""
        self.pushes: list[Push] = []

        started = time.perf_counter()
        start_compiler(precision, threads, device)
        self.on_gpu, self.threads = device == "cuda", 1 if device == "cuda" else threads
        self.serial = device == "cpu" and threads == 1
        self.real = ti.f32 if precision == "float32" else ti.f64
        self.tolerance = float(np.finfo(precision).eps)
        self._upload(state)
        nowhere = np.zeros(3, dtype=np.int64), np.ones(3, dtype=np.int64)
        self._launch(self._begin(1, 1.0, *nowhere), idle=True)  # compiles
        self._look()
        self.compile_seconds = time.perf_counter() - started

    def _upload(self, state: ObjectState) -> None:
        count, real = len(self.volumes), self.real
        self.x = _vectors(state.positions, ti.f64)
        self.v = _vectors(state.velocities, real)
        self.c = _vectors(_columns(state.affine), real)
        elastic = state.deformation_gradient if state.elastic is None else state.elastic
        self.f = _vectors(_columns(elastic), real)
        self.models = tuple(dict.fromkeys(material.model for material in self.materials))
        self.flows, self.keeps_total = kernels.flow(self.models), kernels.keep_total(self.models)
        self.total = _vectors(_columns(state.deformation_gradient) if self.keeps_total else np.zeros((1, 3)), real)
        hardening = np.zeros(count) if state.hardening is None else state.hardening
        self.hardening = _numbers(hardening if self.flows else np.zeros(1), real)
        play = np.zeros(count) if state.play is None else state.play
        self.play = _numbers(play if self.damped else np.zeros(1), real)
        self.mass, self.volume = _numbers(self.masses, real), _numbers(self.volumes, real)
        self.region_of = _numbers(np.zeros(1) if self.region is None else self.region, ti.i32)
        rows = [
            [*_padded(material), material.density, self.models.index(material.model), loss.least, loss.steepness]
            for material, loss in zip(self.materials, self.dampings, strict=True)
        ]
        self.parameters = _vectors(np.reshape(rows, (-1, 4)), real)
        self._new_grid(1)
        self.status = ti.ndarray(ti.i32, 4)
        self.given = ti.Vector.ndarray(4, real, self.threads)
        self.shares = 512 if self.on_gpu else self.threads
        self.seen = ti.Vector.ndarray(4, ti.f64, 2 * self.shares)
        self.none = ti.Vector.ndarray(4, real, 1)
        """Stands for no capsules, or no planes."""
        self.plane_rows = ti.Vector.ndarray(4, real, 2 * len(self.planes)) if self.planes else self.none
        self.placed_at = None
        self.no_parts = no_parts()
        if self.partner is not None:
            self.coupling = Coupling(self.partner, real)

    @property
    def memory(self) -> int:
        """Bytes of particles and grid."""
        arrays = (self.x, self.v, self.c, self.f, self.total, self.hardening, self.play, self.mass, self.volume,
                  self.region_of, self.grid, self.slope, self.touched)  # fmt: skip
        return sum(array.to_numpy().nbytes for array in arrays)

    def advance(self, until: float) -> None:
        """Steps until `until` [s], which is met exactly.

        Raises:
            RunError: the simulation diverged; names time, step and how many particles are to blame, and a remedy.
        """
        while self.time < until:
            self.step_towards(until)

    def step_towards(self, until: float, span: float = math.inf) -> None:
        """Some steps of equal length towards `until` [s], in one window, for about `span` at most [s].

        The length of the steps does not depend on `span`.
        """
        until = self.next_stop(until)
        left = until - self.time
        dt = self.longest_step()
        steps = max(math.ceil(left / dt * (1 - 1e-9)), 1)
        dt = left / steps
        at_once = min(steps, STEPS_A_LOOK, max(math.ceil(span / dt), 1) if span < left else steps)
        launch = self.prepare(at_once, dt)
        done = self._launch(launch)
        self.close(launch, done, until if done == steps else until - (steps - done) * dt)

    def next_stop(self, until: float) -> float:
        """`until` [s], or the collider's next time where that is sooner."""
        if self.collider is not None:
            until = min([until, *(t for t in self.collider.times if self.time + INSTANT < t < until - INSTANT)])
        return until

    def longest_step(self) -> float:
        """The longest step that it and its partner allow now [s]."""
        return min(self.time_step(), self._partner_step())

    def prepare(self, steps: int, dt: float, touching: bool = False) -> Launch:
        """What a launch of some steps of `dt` [s] works on; with a partner near they may be fewer.

        Args:
            touching: something beside what it knows of is in touch with the object, which so does not fall freely.

        Raises:
            RunError: `dt` is above the limit, or the object has come apart.
        """
        low, high, speed, wave_speed = self._look()
        cfl = (wave_speed + speed) * dt / self.dx
        self.cfl = max(self.cfl, cfl)
        if cfl > UNSTABLE_CFL:
            limit = self._limit(speed, wave_speed)
            raise RunError(
                self._message(
                    f"dt {dt:.3g} s is above the limit, which has fallen to {limit:.3g} s as the object moves "
                    f"at {speed:.3g} m/s and its waves at {wave_speed:.3g} m/s: use a smaller stage.object.dt, "
                    "or null to have it chosen"
                )
            )
        ahead = steps * dt
        path = (speed + float(np.linalg.norm(self.gravity)) * ahead) * ahead
        origin, shape = self._fit_window(low, high, path)
        near, touching = self._in_reach(low, high, path), touching or self._in_reach(low, high, 0.0)
        if self._partner_near(low, high, path, ahead):
            steps = min(steps, max(round(EXCHANGE / dt), 1))
            return self._begin(steps, dt, origin, shape, near=True, touching=True, coupled=True)
        return self._begin(steps, dt, origin, shape, near=near, touching=touching)

    def close(self, launch: Launch, done: int, now: float) -> None:
        """Counts the steps done of a launch that is over, which has led to the time `now` [s]."""
        given = self._finish(launch)
        if self.partner is not None:
            self.partner.advance(done * launch.dt)
        self.steps += done
        self.dt_least, self.dt_most = min(self.dt_least, launch.dt), max(self.dt_most, launch.dt)
        began, self.time = self.time, now
        if given.any():
            self.collider_impulse = self.collider_impulse + given
            self.pushes = joined([*self.pushes, Push(began, now, given)])

    def time_step(self) -> float:
        """The longest step that it would take now [s]: `dt`, or `fraction` of the limit."""
        _, _, speed, wave_speed = self._look()
        return self.fraction * self._limit(speed, wave_speed) if self.dt is None else self.dt

    def _limit(self, speed: float, wave_speed: float) -> float:
        """The largest stable step [s], should gravity alone add to the speed until the next look."""
        reach, signal = STABLE_CFL * self.dx, wave_speed + speed
        gain = STEPS_A_LOOK * float(np.linalg.norm(self.gravity))
        by_waves = 2 * reach / (signal + math.sqrt(signal**2 + 4 * gain * reach) + 1e-300)
        return min(stable_step(self.dx, reach / by_waves, diffusivity(material)) for material in self.materials)

    def state(self) -> ObjectState:
        """The state on the host, checked to be finite and not inverted.

        Raises:
            RunError: it is not.
        """
        elastic = _matrices(self.f)
        total = elastic
        if self.keeps_total:
            total = _matrices(self.total)
            if len(self.models) > 1:  # some regions may have no total
                keeps = np.array([LAWS[material.model].keeps_total for material in self.materials])
                total = np.where(keeps[self.region if self.region is not None else [0]][:, None, None], total, elastic)
        state = ObjectState(
            positions=np.ascontiguousarray(self.x.to_numpy()[:, :3]),
            velocities=np.ascontiguousarray(self.v.to_numpy()[:, :3]),
            affine=_matrices(self.c),
            deformation_gradient=total,
            elastic=elastic if self.keeps_total else None,
            hardening=self.hardening.to_numpy() if self.flows else None,
            play=self.play.to_numpy() if self.damped else None,
        )
        arrays = (state.positions, state.velocities, state.affine, total, elastic)
        finite = np.all([np.isfinite(a.reshape(len(a), -1)).all(axis=1) for a in arrays], axis=0)
        if not finite.all():
            raise RunError(self._diverged(f"{np.count_nonzero(~finite)} of {len(finite)} particles are not finite"))
        inverted = np.linalg.det(elastic) <= 0
        if inverted.any():
            raise RunError(self._diverged(
                f"{np.count_nonzero(inverted)} of {len(finite)} particles have turned inside out (det F <= 0)"
            ))  # fmt: skip
        return state

    def energies(self, state: ObjectState) -> Array:
        """Kinetic, elastic and potential energy of a state [J], shape (3,)."""
        spread = 1 / (4 if self.size == 3 else 3)
        return energies(state, self.volumes, self.materials, self.dx, self.gravity, self.region, spread, self.dampings)

    def bounds(self) -> tuple[Array, float]:
        """Corners of a box around the particles [m], shape (8, 3), and a bound of their speeds [m/s]."""
        low, high, speed, _ = self._look()
        return _corners(low, high), speed

    def _look(self) -> tuple[Array, Array, float, float]:
        """Bounding box of the particles [m], greatest speed of their nodes and wave speed [m/s]."""
        if self.looked_at == self.steps:
            return self.seen_last
        self.seen_last, self.looked_at = self._look_again(), self.steps
        return self.seen_last

    def _look_again(self) -> tuple[Array, Array, float, float]:
        kernels.look(self.shares, self.models, self.x, self.v, self.c, self.f, self.hardening, self.region_of,
                     self.parameters, self.seen, self.dx)  # fmt: skip
        seen = self.seen.to_numpy()
        low, high = seen[0::2], seen[1::2]
        if low[:, 3].max() >= kernels.NOT_FINITE:
            self.state()  # counts and raises
            raise RunError(self._diverged("a particle's speed or stress is beyond all bounds"))
        speed, wave_speed = np.sqrt(max(low[:, 3].max(), 0.0)), np.sqrt(max(high[:, 3].max(), 0.0))
        return low[:, :3].min(axis=0), high[:, :3].max(axis=0), float(speed), float(wave_speed)

    def _fit_window(self, low: Array, high: Array, path: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First node and shape of a window around this box, with room for the next `path` [m] or some of it."""
        margin = MARGIN + min(math.ceil(path / self.dx), MARGIN)
        first, last = (np.floor(bound / self.dx - 0.5 * (self.size - 2)) for bound in (low, high))
        shape = last - first + self.size + 2 * margin
        if shape.prod() * (self.threads + 1) > MAX_NODES or np.abs([first, last]).max() > 2**30:
            extent = np.array2string(high - low, precision=3)
            raise RunError(self._message(
                f"the object spans {extent} m, a window of {shape.prod():.3g} nodes of {self.dx:g} m where "
                f"{MAX_NODES // (self.threads + 1)} are allowed; use larger cells, or if it has come "
                "apart a smaller time step"
            ))  # fmt: skip
        shape = shape.astype(np.int64)
        if shape.prod() * (self.threads + 1) > self.grid.shape[0]:
            self._new_grid(int(1.2 * shape.prod()))
        first = first.astype(np.int64) - margin
        if self.planes and (self.placed_at is None or (first != self.placed_at).any()):
            self.place_planes(first)
            self.placed_at = first
        if shape.prod() != self.nodes:  # the copies begin elsewhere, and are to be clear
            self.grid.fill(0.0)
            self.slope.fill(0.0)
            self.nodes = shape.prod()
        self.refits += 1
        return first, shape

    def _in_reach(self, low: Array, high: Array, path: float) -> bool:
        """Whether anything solid may touch the nodes of particles in this box that move by `path` [m]."""
        if self.collider is not None and self.collider.times[0] <= self.time < self.collider.times[-1]:
            return True
        corners = _corners(low, high)
        reach = 0.5 * self.size * self.dx + path
        return any(((corners - plane.point) @ plane.normal).min() < reach for plane in self.planes)

    def _partner_step(self) -> float:
        """The longest step in which no capsule of the partner moves by more than half a cell [s]."""
        if self.partner is None:
            return math.inf
        return 0.5 * self.dx / max(fastest(self.partner), 1e-9)

    def _partner_near(self, low: Array, high: Array, path: float, seconds: float) -> bool:
        """Whether a capsule of the partner may reach nodes of particles in this box that move by `path` [m]."""
        if self.partner is None:
            return False
        reach = 0.5 * self.size * self.dx + path + 2 * fastest(self.partner) * seconds
        return self.coupling.choose(low, high, reach)

    def _begin(
        self, steps: int, dt: float, origin: NDArray[np.int64], shape: NDArray[np.int64], *, near: bool = False,
        touching: bool = False, coupled: bool = False,
    ) -> Launch:  # fmt: skip
        """A launch in this window; `coupled`: with the partner."""
        # Symplectic Euler carries v half a step late. Where gravity alone moves the centre of mass, taking that half
        # step out of each move lets free flight follow its parabola to round-off.
        drift = np.zeros(3) if touching else 0.5 * dt * dt * self.gravity
        if coupled:
            self.coupling.begin(origin * self.dx)
        capsules, parts, body = (
            (self.coupling.capsules, self.coupling.parts, self.coupling.body)
            if coupled else (self._capsules(origin), *self.no_parts)
        )  # fmt: skip
        arrays = (self.x, self.v, self.c, self.f, self.total, self.hardening, self.play, self.mass, self.volume,
                  self.region_of, self.parameters, self.grid, self.slope, self.plane_rows, capsules,
                  self.touched, self.given)  # fmt: skip
        numbers = (_vector(self.gravity), _vector(drift), dt, self.dx, 1 / self.dx, self.tolerance,
                   _vector(origin, int), _vector(shape, int))  # fmt: skip
        return Launch(steps, dt, origin, shape, near, touching, coupled, arrays, numbers, parts, body)

    def _launch(self, launch: Launch, *, idle: bool = False) -> int:
        """Does its steps, none if `idle`: how many were done."""
        set_status(self.status, idle)
        if self.serial:
            how = (launch.steps, int(launch.near), self.damped, self.size, self.models)
            kernels.advance_serial(*how, *launch.arrays, self.status, *launch.numbers, launch.coupled, launch.parts,
                                   launch.body)  # fmt: skip
        else:
            self.given.fill(0.0)
            for number in range(launch.steps):
                self.begin_step(launch, number, self.status)
                self.end_step(launch, number, self.status)
        return self.check_status(self.status)

    def begin_step(self, launch: Launch, number: int, status: Any) -> None:
        """p2g of step `number`, and the exchange with the partner."""
        how = self._how(launch, number)
        kernels.begin_step(*how, *launch.arrays, status, *launch.numbers)
        if launch.coupled:
            copies, capsules = how[3], launch.arrays[-3]
            exchange(copies, self.on_gpu, self.grid, self.touched, capsules, launch.parts, launch.body, launch.dt,
                     self.dx, launch.numbers[0], launch.numbers[-1])  # fmt: skip

    def end_step(self, launch: Launch, number: int, status: Any, last: bool = True) -> None:
        """The grid's update and g2p; `last`: of all objects that share the status."""
        kernels.end_step(int(last), *self._how(launch, number), *launch.arrays, status, *launch.numbers)

    def _how(self, launch: Launch, number: int) -> tuple[Any, ...]:
        shares, copies = (len(self.masses), 1) if self.on_gpu else (self.threads, self.threads)
        number = 0 if launch.coupled else number  # then the capsules move on with each step
        return number, int(launch.near), shares, copies, self.on_gpu, self.damped, self.size, self.models

    def _finish(self, launch: Launch) -> Array:
        """What capsules gave in a launch that is over [N s], (3,)."""
        if launch.coupled:
            return self.coupling.end(launch.origin * self.dx)
        return self.given.to_numpy()[:, :3].sum(axis=0) if launch.near else np.zeros(3)

    def check_status(self, status: Any) -> int:
        """How many steps of a launch were done.

        Raises:
            RunError: a particle of this object was inverted.
        """
        status = status.to_numpy()
        done = int(status[kernels.DONE])
        if status[kernels.INVERTED]:
            self.steps += done
            self.state()  # counts and raises; but at the brink the host may find det F > 0
            raise RunError(self._diverged("a particle has turned inside out (det F <= 0)"))
        return done

    def place_planes(self, origin: NDArray[np.int64]) -> None:
        """Writes the planes as `hold_to_planes` reads them."""
        rows, depth = [], boundary.plane_depth(self.materials) * self.dx
        for plane in self.planes:
            height = float((origin * self.dx - plane.point) @ plane.normal) + depth
            rows += [[*plane.normal, height], [CONTACTS[plane.contact], plane.friction, depth, 0.0]]
        _fill(self.plane_rows, np.reshape(rows, (-1, 4)))

    def _capsules(self, origin: NDArray[np.int64]) -> Any:
        """The capsules at the present time as `hold_to_capsules` reads them."""
        collider = self.collider
        if collider is None or not collider.times[0] <= self.time < collider.times[-1]:
            return self.none
        k = int(np.searchsorted(collider.times, self.time, side="right")) - 1
        span = collider.times[k + 1] - collider.times[k]
        share = (self.time - collider.times[k]) / span
        rows = []
        for j, radius in enumerate(collider.radii):
            ends, velocities = [], []
            for path in (collider.starts[:, j], collider.ends[:, j]):
                ends.append(path[k] + share * (path[k + 1] - path[k]) - origin * self.dx)
                velocities.append((path[k + 1] - path[k]) / span)
            rows += [[*ends[0], radius], [*ends[1], collider.friction], [*velocities[0], 0.0], [*velocities[1], 0.0]]
        return _vectors(np.array(rows), self.real)

    def _new_grid(self, nodes: int) -> None:
        self.grid = ti.Vector.ndarray(4, self.real, nodes * (self.threads + 1))
        self.slope = ti.Vector.ndarray(4, self.real, nodes * (self.threads + 1))
        self.slope.fill(0.0)
        self.touched = ti.ndarray(ti.i32, nodes)
        self.touched.fill(0)
        self.nodes = 0
        """Of the window that the grid is clear for."""

    def _message(self, what: str) -> str:
        return f"mpm phase, t = {self.time:.4g} s, step {self.steps}: {what}"

    def _diverged(self, what: str) -> str:
        return self._message(
            f"{what}; the simulation has diverged (CFL {self.cfl:.2g}): use a smaller time step, or a stiffer material "
            "if the impact is meant to be this hard"
        )


def _padded(material: Material) -> list[float]:
    """The numbers of a material's law as the kernels take them."""
    numbers = list(parameters(material))
    return numbers + [0.0] * (PARAMETERS - len(numbers))


def _corners(low: Array, high: Array) -> Array:
    return np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)


def _vectors(values: Array, dtype: Any) -> Any:
    """Rows of three or four as vectors of four on the device."""
    array = ti.Vector.ndarray(4, dtype, len(values))
    _fill(array, values)
    return array


def _fill(array: Any, values: Array) -> None:
    padded = np.zeros((len(values), 4), dtype=np.float64 if array.dtype == ti.f64 else np.float32)
    padded[:, : values.shape[1]] = values
    array.from_numpy(padded)


def _numbers(values: ArrayLike, dtype: Any) -> Any:
    kinds = {ti.f64: np.float64, ti.f32: np.float32, ti.i32: np.int32}
    array = ti.ndarray(dtype, len(np.atleast_1d(values)))
    array.from_numpy(np.ascontiguousarray(values, dtype=kinds[dtype]))
    return array


def _columns(matrices: Array) -> Array:
    """The columns (3 P, 3) of matrices (P, 3, 3)."""
    return np.swapaxes(matrices, -1, -2).reshape(-1, 3)


def _matrices(columns: Any) -> Array:
    """The inverse of `_columns`, from the device."""
    return np.ascontiguousarray(np.swapaxes(columns.to_numpy()[:, :3].reshape(-1, 3, 3), -1, -2))


def _vector(values: Any, dtype: Any = float) -> Any:
    return ti.Vector([dtype(value) for value in values] + [dtype(0)])


def _check_region(region: Any, count: int, materials: int) -> NDArray[np.int32] | None:
    if region is None:
        return None
    region = np.asarray(region)
    if region.shape != (count,) or region.min() < 0 or region.max() >= materials:
        raise InputError(
            f"mpm region must be {count} indices below {materials}, got shape {region.shape}, "
            f"from {region.min()} to {region.max()}"
        )
    return region.astype(np.int32)


def _check_rebound(rebound: Sequence[float] | None, materials: Sequence[Material]) -> tuple[Damping, ...]:
    if rebound is None:
        return tuple(Damping() for _ in materials)
    if len(rebound) != len(materials) or not all(0 < share <= 1 for share in rebound):
        raise InputError(f"mpm rebound must be {len(materials)} numbers in (0, 1], got {list(rebound)}")
    return tuple(damping(share) for share in rebound)


def _check_plane(plane: Plane) -> None:
    if plane.contact not in CONTACTS:
        raise InputError(f"plane contact must be one of {', '.join(CONTACTS)}, got {plane.contact!r}")
    if not (np.isfinite(plane.point).all() and abs(np.linalg.norm(plane.normal) - 1) < 1e-6):
        raise InputError(f"plane must have a finite point and a unit normal, got {plane.point} and {plane.normal}")
    if not (math.isfinite(plane.friction) and plane.friction >= 0):
        raise InputError(f"plane friction must be 0 or more, got {plane.friction:g}")


def _check_times(times: Sequence[float] | Array) -> Array:
    times = np.asarray(times, dtype=np.float64)
    if (
        times.ndim != 1
        or len(times) == 0
        or not np.isfinite(times).all()
        or times[0] < 0
        or (np.diff(times) <= 0).any()
    ):
        raise InputError(f"mpm times must be a list of increasing times from 0 on [s], got {times.tolist()}")
    return times
