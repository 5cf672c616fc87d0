"""Milliseconds a step of the object's MPM: `python -m analysis.mpm_bench [--particles 5000 20000] [--peer PYTHON]`.

An elastic ball on cells of 2/64 m, 8 particles a cell, E 1e7, nu 0.45, 1000 kg/m^3, dt 4e-5, falling freely. Genesis is
measured beside it, on all cores as it always runs, where it is installed: here, or in the Python that --peer names.
"""

import math
import os
from collections.abc import Callable

import numpy as np

from hoi.data import Material
from hoi.errors import InputError
from hoi.terminal.program import program

from . import command
from .command import timed

DX, DT = 2 / 64, 4e-5
MATERIAL = Material("bench", "fixed_corotated", 1e7, 0.45, 1000.0, 0.6, 0.5)
STEPS, TURNS = 64, 8


def radius_of(particles: int) -> float:
    """Of a ball of so many particles, 8 a cell [m]."""
    return (particles * DX**3 / 8 * 3 / (4 * math.pi)) ** (1 / 3)


def milliseconds_a_step(step: Callable[[int], object], steps: int = STEPS) -> float:
    """Median over `TURNS` turns of `steps` steps [ms], after one turn that does not count; step(n) does n steps."""
    return 1e3 / steps * float(np.median(timed(lambda: step(steps), TURNS)))


def measure(particles: int, model: str, threads: int, precision: str, device: str) -> dict[str, float | str]:
    """One row of the table: this solver."""
    from dataclasses import replace

    from hoi.mpm.solver import Simulation
    from hoi.mpm.state import initial_state

    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (3 * particles, 3))
    points = points[(points**2).sum(axis=1) < 1][:particles] * radius_of(particles) + [0, 0, 1]
    volumes = np.full(len(points), DX**3 / 8)
    run = Simulation(
        initial_state(points, volumes, [0, 0, 0]), volumes, replace(MATERIAL, model=model), dx=DX, dt=DT, planes=(),
        threads=threads, precision=precision, device=device,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    ms = milliseconds_a_step(lambda steps: run.advance(run.time + steps * DT))
    where = device if device == "cuda" else "1 thread" if threads == 1 else f"{threads} threads"
    what = f"hoi {model} {precision} {where}"
    return row(what, len(points), ms) | {"bytes/particle": run.memory / len(points)}


def measure_genesis(particles: int) -> dict[str, float | str]:
    """One row of the table: Genesis, in this interpreter."""
    import genesis as gs  # pyright: ignore[reportMissingImports]

    gs.init(backend=gs.cpu, logging_level="error", precision="32")
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=DT, substeps=1),
        mpm_options=gs.options.MPMOptions(
            dt=DT, lower_bound=(-1, -1, -0.5), upper_bound=(1, 1, 1.5), grid_density=1 / DX, particle_size=DX / 2
        ),
        show_viewer=False,
    )
    ball = scene.add_entity(
        morph=gs.morphs.Sphere(pos=(0, 0, 0.5), radius=radius_of(particles)),
        material=gs.materials.MPM.Elastic(E=1e7, nu=0.45, rho=1000.0),
    )
    scene.build()

    def step(steps: int) -> None:
        for _ in range(steps):
            scene.step()

    return row(f"Genesis {gs.__version__}", ball.n_particles, milliseconds_a_step(step, steps=16))


def row(solver: str, particles: int, ms: float) -> dict[str, float | str]:
    return {"solver": solver, "particles": particles, "ms/step": ms, "M particle-steps/s": particles / ms / 1e3}


@command.exit_code("analysis.mpm_bench")
def main() -> None:
    parser = command.parser(
        "analysis.mpm_bench",
        "Milliseconds a step of the MPM, by particles, threads and material model.",
        "--particles 5000 20000 --threads 1 2",
    )
    parser.add_argument("--particles", type=int, nargs="+", default=[5000, 20000, 100000])
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--models", nargs="+", default=["neo_hookean", "fixed_corotated"])
    parser.add_argument("--precision", nargs="+", default=["float32"], choices=["float32", "float64"])
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    command.add_peer(parser, "genesis", "Genesis")
    arguments = parser.parse_args()
    import pandas as pd  # not at the top: the peer's interpreter may not have it

    from . import sheets

    rows = []
    if min(*arguments.particles, *arguments.threads, 10**9) < 1:
        raise InputError("--particles and --threads must be 1 or more")
    for particles in arguments.particles:
        rows += [
            measure(particles, model, threads, precision, arguments.device)
            for threads in (arguments.threads if arguments.device == "cpu" else [1])
            for model in arguments.models
            for precision in arguments.precision
        ]
        if arguments.peer is not None:
            call = f"mpm_bench.measure_genesis({particles})"
            says = f"--peer {arguments.peer}: Genesis failed there: {{}}".format
            rows.append(command.called_in(arguments.peer, call, says))
    table = pd.DataFrame(rows)
    if arguments.peer is None:
        print("Genesis is not installed here; --peer PYTHON names an interpreter that has it")
    else:
        theirs = table[table["solver"].str.startswith("Genesis")].set_index("particles")["ms/step"]
        nearest = [theirs.iloc[np.abs(theirs.index - n).argmin()] for n in table["particles"]]
        table["times as fast"] = np.array(nearest) / table["ms/step"]
    print(f"{os.cpu_count()} CPU cores")
    print(sheets.plain(table))


if __name__ == "__main__":
    program(main)
