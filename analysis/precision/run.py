"""Variants of how a problem is computed, and what each of them costs and gets wrong."""

import operator
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from hoi.compute import Precision
from hoi.data import Array, ObjectState
from hoi.errors import RunError
from hoi.mpm.phases import Surroundings, Walk, lowest_frequency, reach_of
from hoi.mpm.rigid import Flight, carry, fit
from hoi.mpm.solver import Simulation, Spline
from hoi.mpm.stability import DEFAULT_FRACTION
from hoi.mpm.state import centre_of_mass

from .bodies import vibration_tolerance
from .errors import compare, pareto_front, probe_weights
from .problems import FIELDS, Observed, Problem, picked

SHORT = 1.0
"""A run is repeated, for the median of its times, unless it takes longer than this [s]."""
FRACTIONS = (1.0, 0.5, 0.25, 0.125)
"""Shares of the time step limit that are compared."""
GAIN = 0.02
"""Share by which a slower run must be more exact to be on the front [-]."""
PROBE_CELLS = 6
"""The probes of a scene are the particles of its body at this many cells across."""


@dataclass(frozen=True)
class Variant:
    """One way to compute a problem."""

    kind: str
    """What it changes of the base: "base", "dt", "grid", "spline", "precision", "material" or a mover of `MOVERS`."""
    cells: int
    fraction: float = DEFAULT_FRACTION
    """Share of the time step limit."""
    spline: Spline = "quadratic"
    precision: Precision = "float32"
    model: str = ""
    """Constitutive model; "" for the problem's own."""

    @property
    def label(self) -> str:
        """What sets it apart, in a few words."""
        words = {
            "dt": f"dt {self.fraction:g} of limit",
            "grid": f"{self.cells} cells",
            "spline": f"{self.spline}, {self.cells} cells",
            "precision": self.precision,
            "material": self.model.replace("_", " "),
        }
        return words.get(self.kind, self.kind)


def variants(problem: Problem, quick: bool = False) -> list[Variant]:
    """The base and what is changed of it, one thing at a time; `quick` leaves out what is slow to run or to compile."""
    base = Variant("base", problem.base, precision=problem.precision)
    model = "fixed_corotated" if problem.material.model == "neo_hookean" else "neo_hookean"
    precision = "float32" if problem.precision == "float64" else "float64"
    everything = [
        base,
        *(replace(base, kind="dt", fraction=fraction) for fraction in FRACTIONS if fraction != DEFAULT_FRACTION),
        *(replace(base, kind="grid", cells=cells) for cells in problem.cells if cells != problem.base),
        *(replace(base, kind="spline", spline="cubic", cells=cells) for cells in problem.cells),
        replace(base, kind="precision", precision=precision),
        replace(base, kind="material", model=model),
        replace(base, kind="phases"),
        *(replace(base, kind=mover) for mover in STAND_INS),
    ]
    if not quick:
        return everything
    compiled = ("spline", "material")  # kernels of their own
    return [
        v for v in everything if v.cells <= problem.base and v.fraction >= DEFAULT_FRACTION and v.kind not in compiled
    ]


# --- running ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Timed:
    """One run: what was seen of it, and what it cost."""

    seen: Observed
    seconds: float
    """Without compiling; see `clock`."""
    steps: int
    particles: int


def run(problem: Problem, variant: Variant, threads: int = 1, dt: float | None = None) -> Timed:
    """Computes the problem once, with steps of `dt` [s] if that is given.

    Raises:
        RunError: it diverged.
    """
    dx = problem.size / variant.cells
    start, volumes = problem.body(dx)
    pick: Callable[[Array], Array] = picked
    if problem.motion is None:
        weights = probe_weights(start.positions, probes(problem))
        pick = partial(operator.matmul, weights)
    move = STAND_INS.get(variant.kind)
    if move is not None:
        began = clock(threads)
        states = move(problem, start, volumes)
        seconds, steps = clock(threads) - began, 0
    else:
        states, seconds, steps = _mpm(problem, variant, start, volumes, threads, dt)
    seen = Observed(
        times=problem.times,
        points=np.array([pick(state.positions) for state in states]),
        com=np.array([centre_of_mass(state.positions, volumes) for state in states]),
        com_velocity=np.array([centre_of_mass(state.velocities, volumes) for state in states]),
        volumes=volumes,
        start=start,
        end=states[-1],
    )
    return Timed(seen, seconds, steps, len(volumes))


def clock(threads: int) -> float:
    """[s]: of one thread its processor time, the same as wall time on an idle machine; of more wall time."""
    return time.process_time() if threads == 1 else time.perf_counter()


def probes(problem: Problem) -> Array:
    """The material points at which a scene's runs are compared [m], shape (M, 3)."""
    return problem.body(problem.size / PROBE_CELLS)[0].positions


def _mpm(
    problem: Problem, variant: Variant, start: ObjectState, volumes: Array, threads: int, dt: float | None
) -> tuple[list[ObjectState], float, int]:
    """States at the problem's times; seconds and steps that they took."""
    dx = problem.size / variant.cells

    def simulation(state: ObjectState, _: float) -> Simulation:
        return Simulation(
            state,
            volumes,
            replace(problem.material, model=variant.model or problem.material.model),
            dx=dx,
            dt=dt,
            fraction=variant.fraction,
            gravity=problem.gravity,
            planes=problem.planes,
            spline=variant.spline,
            precision=variant.precision,
            threads=threads,
        )

    masses = volumes * problem.material.density
    phases = variant.kind == "phases"
    walk = Walk(
        start,
        masses,
        simulation,
        end=float(problem.times[-1]),
        gravity=np.asarray(problem.gravity),
        surroundings=Surroundings(problem.planes, [reach_of(plane, dx) for plane in problem.planes]),
        size=problem.size,
        moment=dx**2 / 4,
        frequency=lowest_frequency(start.positions, masses, [problem.material]) if phases else None,
        tolerance=vibration_tolerance() if phases else None,
    )
    began = clock(threads)
    states = [walk.advance(float(until))[0] for until in problem.times]
    seconds = clock(threads) - began
    return states, seconds, walk.finish().steps


def _constant_velocity(problem: Problem, start: ObjectState, volumes: Array) -> list[ObjectState]:
    velocity = centre_of_mass(start.velocities, volumes)
    velocities = np.tile(velocity, (len(volumes), 1))
    return [replace(start, positions=start.positions + t * velocity, velocities=velocities) for t in problem.times]


def _ballistic(problem: Problem, start: ObjectState, volumes: Array) -> list[ObjectState]:
    flight = Flight(fit(start, volumes, 0.0), problem.gravity)
    return [carry(flight, start, float(t)) for t in problem.times]


STAND_INS: dict[str, Callable[[Problem, ObjectState, Array], list[ObjectState]]] = {
    "constant velocity": _constant_velocity,
    "ballistic rigid body": _ballistic,
}
"""Motions that need no simulation, and know nothing of contact."""


# --- judging ---------------------------------------------------------------------------------------------------------


def reference(problem: Problem, quick: bool, threads: int) -> Timed:
    """A scene twice as fine as its finest variant, with a quarter of that one's time step, in float64.

    Each transfer damps, so a finer step alone would not make it truer: of the error of the finest variant it keeps
    about a quarter, 2^-4 by its grid times 4 by its step.
    """
    finest = problem.base if quick else problem.cells[-1]
    return run(problem, Variant("reference", 2 * finest, DEFAULT_FRACTION / 2, precision="float64"), threads)


def judge(problem: Problem, seen: Observed, truth: Observed | None) -> dict[str, float]:
    """All errors of a run; `truth` is the reference of a problem without exact motion."""
    if problem.motion is not None:
        points = problem.motion(picked(seen.start.positions), problem.times)
        exact = problem.motion(seen.start.positions, problem.times)
        com = np.einsum("p,kpi->ki", seen.volumes / seen.volumes.sum(), exact)
    else:
        assert truth is not None
        points, com = truth.points, truth.com
    errors = asdict(compare(seen.points, points, seen.com, com, problem.size))
    numbers = {name: errors[name] if name in problem.known else float("nan") for name in FIELDS}
    return numbers | (problem.measure(seen, problem) if problem.measure else {})


def study(
    problems: Sequence[Problem], *, quick: bool = False, repeats: int = 3, threads: int = 1, cores: int = 1,
    say: Callable[[str], object] = print,
) -> pd.DataFrame:  # fmt: skip
    """One row a variant of each problem: its settings, median seconds, errors, and whether it is on the Pareto front.

    Args:
        problems: what to compute.
        quick: leave out the slow variants, and hold scenes against the base at half the cell size.
        repeats: runs of each short variant.
        threads: of each variant.
        cores: threads of the references, whose time does not count.
        say: told of each variant as it is done.
    """
    truths = {}
    for problem in problems:
        if problem.motion is None:
            done = reference(problem, quick, cores)
            truths[problem.name] = done.seen
            say(f"{problem.name:8} reference: {done.particles} particles, {done.steps} steps, {done.seconds:.1f} s")
    jobs = [(problem, variant) for problem in problems for variant in variants(problem, quick)]
    # Taichi starts anew, and loads its kernels again, whenever the precision changes
    rows = []
    for problem, variant in sorted(jobs, key=lambda job: job[1].precision, reverse=True):
        row = {"problem": problem.name, "kind": variant.kind, "variant": variant.label} | asdict(variant)
        row |= {"model": variant.model or problem.material.model, "headline": problem.headline}
        try:
            row |= _measured(problem, variant, truths.get(problem.name), repeats, threads)
        except RunError as error:
            row["failed"] = str(error)
        rows.append(row)
        say("{problem:8} {variant:24} {seconds:9.3g} s  error {error:.2e}".format(**{"seconds": 0, "error": 0} | row))
    table = with_front(pd.DataFrame(rows), "problem")
    order = {problem.name: index for index, problem in enumerate(problems)}
    return table.sort_values("problem", key=lambda column: column.map(order), kind="stable").reset_index(drop=True)


def with_front(table: pd.DataFrame, by: str) -> pd.DataFrame:
    """The table, and in "front" whether a row is on the Pareto front of those that are the same in column `by`."""
    table["front"] = False
    for _, group in table.groupby(by):
        table.loc[group.index, "front"] = pareto_front(group["seconds"].to_numpy(), group["error"].to_numpy(), GAIN)
    return table


def _measured(
    problem: Problem, variant: Variant, truth: Observed | None, repeats: int, threads: int
) -> dict[str, float | int]:
    runs = [run(problem, variant, threads)]
    while len(runs) < repeats and runs[0].seconds < SHORT:
        runs.append(run(problem, variant, threads))
    first = runs[0]
    numbers = judge(problem, first.seen, truth)
    seconds = float(np.median([r.seconds for r in runs]))
    row = {"particles": first.particles, "steps": first.steps, "seconds": seconds, "repeats": len(runs)}
    return row | numbers | {"error": numbers.get(problem.headline, float("nan"))}
