"""Runs the MLS-MPM of `hoi.mpm.kernels` from one state of the object to the next, in a window of the grid around it."""

import contextlib
import io
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray
from taichi.lang import impl
from taichi.lang.misc import is_arch_supported

from hoi.data import Array, Material, ObjectState
from hoi.errors import InputError, RunError
from hoi.mpm import kernels
from hoi.mpm.materials import lame_parameters, p_wave_speed
from hoi.mpm.stability import time_step_limit
from hoi.mpm.state import centre_of_mass, check_state, energies

Precision = Literal["float32", "float64"]
Device = Literal["cpu", "cuda"]

MARGIN = 2
"""Cells between the object and the rim of its window when the window is fitted."""
MAX_NODES = 2**25
"""Nodes of the largest window: 512 MiB in float32."""
STEPS_A_LOOK = 32
"""Steps launched in parallel mode before the host looks whether to stop."""


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
    steps: int
    """Substeps done."""
    cfl: float
    """Largest (c + |v|) dt / dx met [-], with the wave speed c at rest and |v| as of each look at the particles."""
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
    material: Material,
    *,
    dx: float,
    dt: float,
    times: Sequence[float] | Array,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
    ground: bool = True,
    precision: Precision = "float32",
    threads: int = 1,
    device: Device = "cpu",
    on_time: Callable[[], object] | None = None,
) -> SimulationResult:
    """Advances the object and returns its state at each of `times`.

    The first interval, from 0 to times[0], may be of any length. Each interval is cut into equal steps of at most `dt`,
    so that every time is met exactly. The step is not compared with its limit here (see `hoi.mpm.stability`): a run
    that blows up raises. A resumed run, simulate(final, ...), continues bit for bit.

    With one thread the same input gives the same bits. With more it does for the same number of threads, and differs
    in round-off from another number; on a GPU it differs in round-off from run to run.

    Args:
        state: where it starts; not changed.
        volumes: rest volume of each particle [m^3], shape (P,).
        material: density, elasticity and friction against the ground.
        dx: cell size [m].
        dt: largest time step [s].
        times: increasing, from the start of the simulation [s]; 0 asks for the initial state.
        gravity: [m/s^2], shape (3,).
        ground: whether the half-space z < 0 is solid, with Coulomb friction `material.ground_friction`.
        precision: of the arithmetic; positions are accumulated in float64 in both.
        threads: CPU threads.
        device: "cpu" or "cuda".
        on_time: called when each of `times` is reached.

    Raises:
        InputError: a value that cannot be simulated.
        RunError: the simulation diverged; names the frame (index into `times`) and a remedy.
    """
    check_state(state, volumes)
    times = _check_times(times)
    gravity = np.asarray(gravity, dtype=np.float64)
    if gravity.shape != (3,) or not np.isfinite(gravity).all():
        raise InputError(f"gravity must be three finite numbers [m/s^2], got {gravity.tolist()}")
    if not (math.isfinite(dt) and dt > 0):
        raise InputError(f"stage.object.dt must be positive and finite [s], got {dt:g}")
    time_step_limit(material, dx)

    started = time.perf_counter()
    _start_taichi(precision, threads, device)
    run = _Run(state, volumes, material, dx, gravity, ground, precision, threads, device)
    run.compile()
    compiled = time.perf_counter()

    states, now = [], 0.0
    for frame, until in enumerate(times):
        steps = math.ceil((until - now) / dt * (1 - 1e-9))
        if steps:
            run.advance(steps, (until - now) / steps, frame)
        now = until
        states.append(run.download(frame))
        if on_time is not None:
            on_time()
    masses = np.asarray(volumes) * material.density
    return SimulationResult(
        times=times,
        states=tuple(states),
        com=np.array([centre_of_mass(s.positions, masses) for s in states]),
        com_velocity=np.array([centre_of_mass(s.velocities, masses) for s in states]),
        energy=np.array([energies(s, volumes, material, dx, gravity) for s in states]),
        steps=run.steps,
        cfl=run.cfl,
        refits=run.refits,
        compile_seconds=compiled - started,
        seconds=time.perf_counter() - compiled,
    )


class _Run:
    """The particles on the device, and the window of the grid around them."""

    def __init__(
        self, state: ObjectState, volumes: Array, material: Material, dx: float, gravity: Array, ground: bool,
        precision: Precision, threads: int, device: Device,
    ) -> None:  # fmt: skip
        self.real = ti.f32 if precision == "float32" else ti.f64
        self.dx, self.wave_speed = dx, p_wave_speed(material)
        count = len(state.positions)
        self.x = _upload(ti.Vector.ndarray(3, ti.f64, count), state.positions)
        self.v = _upload(ti.Vector.ndarray(3, self.real, count), state.velocities)
        self.c = _upload(ti.Matrix.ndarray(3, 3, self.real, count), state.affine)
        self.f = _upload(ti.Matrix.ndarray(3, 3, self.real, count), state.deformation_gradient)
        self.volume = _upload(ti.ndarray(self.real, count), volumes)
        self.mass = _upload(ti.ndarray(self.real, count), volumes * material.density)
        self.status = ti.ndarray(ti.i32, 4)
        self.serial = device == "cpu" and threads == 1
        self.atomic = device == "cuda"
        self.chunks = count if self.atomic else threads
        self.copies = 1 if self.atomic else threads
        self.grid = self._new_grid(1)
        self.model, self.ground = material.model, ground
        self.gravity = gravity
        self.physics = (*lame_parameters(material), material.ground_friction, ti.Vector(gravity.tolist(), dt=ti.f64))
        self.tolerance = float(np.finfo(precision).eps)
        self.steps, self.refits, self.cfl = 0, 0, 0.0

    def compile(self) -> None:
        """Launches the kernel for no step at all."""
        self._launch(0, 0.0, np.zeros(3, dtype=np.int64), np.ones(3, dtype=np.int64))

    def advance(self, steps: int, dt: float, frame: int) -> None:
        """`steps` steps of `dt`; the window is fitted anew whenever a particle has come to its rim.

        Symplectic Euler carries v half a step late. Off the ground, where gravity alone moves the centre of mass, that
        half step is taken out before and put back after, so that free flight follows its parabola to round-off.
        """
        half_step = ti.Vector((0.5 * dt * self.gravity).tolist(), dt=ti.f64)
        origin, shape = self._fit_window(dt, frame)
        if self._in_flight(origin):
            kernels.add_velocity(self.v, -half_step)
        while steps > 0:
            done, inverted = self._launch(steps, dt, origin, shape)
            self.steps += done
            steps -= done
            if inverted:
                raise RunError(self._diverged(frame, "a particle turned inside out (det F <= 0)"))
            origin, shape = self._fit_window(dt, frame)
        if self._in_flight(origin):
            kernels.add_velocity(self.v, half_step)

    def _in_flight(self, origin: NDArray[np.int64]) -> bool:
        """Whether no particle touches a solid node; `origin` as just fitted."""
        return not self.ground or origin[2] + MARGIN >= 0

    def download(self, frame: int) -> ObjectState:
        """The state on the host, checked to be finite and not inverted."""
        state = ObjectState(self.x.to_numpy(), self.v.to_numpy(), self.c.to_numpy(), self.f.to_numpy())
        arrays = (state.positions, state.velocities, state.affine, state.deformation_gradient)
        if not all(np.isfinite(array).all() for array in arrays):
            raise RunError(self._diverged(frame, "a particle's state is not finite"))
        if not (np.linalg.det(state.deformation_gradient) > 0).all():
            raise RunError(self._diverged(frame, "a particle turned inside out (det F <= 0)"))
        return state

    def _fit_window(self, dt: float, frame: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        x, speed = self.x.to_numpy(), float(np.linalg.norm(self.v.to_numpy(), axis=1).max())
        if not (np.isfinite(x).all() and math.isfinite(speed)):
            raise RunError(self._diverged(frame, "a particle's state is not finite"))
        self.cfl = max(self.cfl, (self.wave_speed + speed) * dt / self.dx)
        if speed * dt > self.dx:
            raise RunError(self._diverged(frame, f"a particle at {speed:.3g} m/s crosses more than a cell per step"))
        low, high = (np.floor(bound / self.dx - 0.5) for bound in (x.min(axis=0), x.max(axis=0)))
        shape = high - low + 3 + 2 * MARGIN
        if shape.prod() > MAX_NODES or np.abs([low, high]).max() > 2**30:
            extent = np.array2string(x.max(axis=0) - x.min(axis=0), precision=3)
            raise RunError(
                f"frame {frame}: the object spans {extent} m, a window of {shape.prod():.3g} nodes of {self.dx:g} m "
                f"where {MAX_NODES} are allowed; use larger cells, or if it has come apart a smaller time step"
            )
        shape = shape.astype(np.int64)
        if shape.prod() * self.copies > self.grid.shape[0]:
            self.grid = self._new_grid(int(1.5 * shape.prod()))
        self.refits += 1
        return low.astype(np.int64) - MARGIN, shape

    def _launch(self, steps: int, dt: float, origin: NDArray[np.int64], shape: NDArray[np.int64]) -> tuple[int, bool]:
        """Up to `steps` steps in this window: how many were done, and whether a particle was found inverted."""
        self.status.fill(0)
        arrays = (self.x, self.v, self.c, self.f, self.mass, self.volume, self.grid, self.status)
        window = (ti.Vector(origin.tolist()), ti.Vector(shape.tolist()))
        numbers = (*self.physics, dt, self.dx, 1 / self.dx, self.tolerance, *window)
        if self.serial:
            kernels.advance_serial(steps, self.model, int(self.ground), *arrays, *numbers)
            status = self.status.to_numpy()
        else:
            launched = 0
            status = self.status.to_numpy()
            while launched < steps and not status[kernels.STOP]:
                for _ in range(min(STEPS_A_LOOK, steps - launched)):
                    kernels.step_parallel(
                        self.chunks, self.copies, self.atomic, self.model, int(self.ground), *arrays, *numbers
                    )
                    launched += 1
                status = self.status.to_numpy()
        return int(status[kernels.DONE]), bool(status[kernels.INVERTED])

    def _new_grid(self, nodes: int) -> Any:
        return ti.Vector.ndarray(4, self.real, nodes * self.copies)

    def _diverged(self, frame: int, what: str) -> str:
        return (
            f"frame {frame}, step {self.steps}: {what}; the simulation has diverged (CFL {self.cfl:.2g}): "
            "use a smaller time step, or a stiffer material if the impact is meant to be this hard"
        )


def _upload(array: Any, values: Array) -> Any:
    dtype = np.float64 if array.dtype == ti.f64 else np.float32
    array.from_numpy(np.ascontiguousarray(values, dtype=dtype))
    return array


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


def _start_taichi(precision: Precision, threads: int, device: Device) -> None:
    """Starts Taichi, unless it runs with just these settings: then its compiled kernels are kept."""
    real = {"float32": ti.f32, "float64": ti.f64}.get(precision)
    arch = {"cpu": ti.cpu, "cuda": ti.cuda}.get(device)
    if real is None:
        raise InputError(f"mpm precision must be float32 or float64, got {precision!r}")
    if arch is None:
        raise InputError(f"mpm device must be cpu or cuda, got {device!r}")
    if not (isinstance(threads, int) and threads >= 1):
        raise InputError(f"mpm threads must be a positive integer, got {threads!r}")
    if impl.get_runtime().prog is not None:
        config = impl.current_cfg()
        on_cpu = config.arch != ti.cuda
        if (on_cpu, config.default_fp, config.cpu_max_num_threads) == (device == "cpu", real, threads):
            return
    if device == "cuda" and not is_arch_supported(ti.cuda):
        raise InputError("mpm device is cuda, but Taichi finds no CUDA device; use cpu")
    with contextlib.redirect_stdout(io.StringIO()):  # ti.init prints the device it starts on
        ti.init(
            arch=arch, default_fp=real, default_ip=ti.i32, cpu_max_num_threads=threads, log_level=ti.ERROR,
            enable_fallback=False,
        )  # fmt: skip
