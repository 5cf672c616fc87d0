"""What a gradient costs: `python -m analysis.gradient_bench [--particles 1000 5000] [--steps 512]`.

The ball of `analysis.mpm_bench`, falling onto the ground, with its steps and then the gradient of where it is: the
processor's time of both together over that of the steps alone, in turns. And how many states are kept at once.
"""

import resource
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command, sheets
from .mpm_bench import DT, DX, MATERIAL, radius_of

TURNS = 3
REBOUND = 0.8


def measure(particles: int, steps: int, model: str, precision: str, damped: bool) -> dict[str, float | str]:
    """One row of the table; a first turn, which compiles, does not count."""
    from hoi.gradient.backwards import Cotangent, Recording
    from hoi.mpm.solver import Simulation
    from hoi.mpm.state import initial_state

    rng, radius = np.random.default_rng(0), radius_of(particles)
    points = rng.uniform(-1, 1, (3 * particles, 3))
    points = points[(points**2).sum(axis=1) < 1][:particles] * radius + [0, 0, 1.02 * radius]
    volumes = np.full(len(points), DX**3 / 8)
    state, end = initial_state(points, volumes, [0.5, 0, -2]), steps * DT
    settings: dict[str, Any] = {"dx": DX, "dt": DT, "precision": precision, "rebound": [REBOUND] if damped else None}
    material = replace(MATERIAL, model=model)
    forward, both, kept = [], [], 0
    for _ in range(1 + TURNS):
        plain = Simulation(state, volumes, material, **settings)
        run = Recording(state, volumes, material, **settings)
        began = process_time()
        plain.advance(end)
        forward.append(process_time() - began)
        began = process_time()
        run.advance(end)
        run.backwards([(end, Cotangent(positions=np.ones_like(points)))])
        both.append(process_time() - began)
        kept = run.states_kept
    return {
        "law": f"{model}{', loses energy' if damped else ''}", "precision": precision, "particles": len(points),
        "steps": steps, "forward ms/step": 1e3 * float(np.median(forward[1:])) / steps,
        "gradient / forward": float(np.median(np.divide(both, forward)[1:])), "states kept": kept,
        "peak memory [MB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


@command.exit_code("analysis.gradient_bench")
def main() -> None:
    parser = command.parser(
        "analysis.gradient_bench",
        "What a gradient through the MPM costs beside its forward pass, and what it keeps.",
        "--particles 1000 5000 --steps 256",
    )
    parser.add_argument("--particles", type=int, nargs="+", default=[1000, 5000])
    parser.add_argument("--steps", type=int, nargs="+", default=[512])
    parser.add_argument("--models", nargs="+", default=["neo_hookean", "fixed_corotated"])
    parser.add_argument("--precision", nargs="+", default=["float32"], choices=["float32", "float64"])
    parser.add_argument("--elastic", action="store_true", help="nothing loses energy")
    arguments = parser.parse_args()
    import pandas as pd

    if min(*arguments.particles, *arguments.steps, 10**9) < 1:
        raise InputError("--particles and --steps must be 1 or more")
    rows = [
        measure(particles, steps, model, precision, not arguments.elastic)
        for precision in arguments.precision
        for model in arguments.models
        for particles in arguments.particles
        for steps in arguments.steps
    ]
    print(sheets.plain(pd.DataFrame(rows)))


if __name__ == "__main__":
    program(main)
