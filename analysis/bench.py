"""Seconds by stage of a scene, from recorded runs: `python -m analysis.bench [--runs 3] [-- overrides]`.

Each run is a process of its own; the first warms the caches (compiled kernels, prompt features) and is not counted.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command, sheets

if TYPE_CHECKING:
    import pandas as pd


def measure(runs: int, overrides: list[str]) -> pd.DataFrame:
    """One row a stage: median, least and most seconds over `runs` runs, and iterations; then total, share of the
    object's time steps that its phases left out, and memory.

    Raises:
        InputError: a run did not end well.
    """
    import pandas as pd

    from hoi.record import read

    rows: list[dict[str, float | str]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(runs + 1):
            out = Path(folder) / str(number)
            command = [sys.executable, "-m", "hoi.run", *overrides, f"out={out}"]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode != 0:
                raise InputError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.strip()[-300:]}")
            if number == 0:
                continue
            run = read(out / "run.mcap")
            rows += [{"stage": r.stage, "seconds": r.seconds, "iterations": r.iterations} for r in run.reports]
            rows.append({"stage": "total", "seconds": float(run.result["seconds"]), "iterations": 0})
            steps, left_out = (sum(r.numbers.get(n, 0.0) for r in run.reports) for n in ("steps", "steps_left_out"))
            if steps:
                share = 100 * left_out / (steps + left_out)
                rows.append({"stage": "object's steps left out [%]", "seconds": share, "iterations": int(steps)})
            rows.append({"stage": "peak memory [MB]", "seconds": float(run.result["peak_memory_mb"]), "iterations": 0})
    grouped = pd.DataFrame(rows).groupby("stage", sort=False)
    table = grouped["seconds"].agg(["median", "min", "max"])
    table["iterations"] = grouped["iterations"].max()
    return table.reset_index()


@command.exit_code("analysis.bench")
def main() -> None:
    parser = command.parser(
        "analysis.bench",
        "Seconds by stage of a scene, from recorded runs.",
        "--runs 3 -- scene=kick_soccer_ball",
    )
    parser.add_argument("--runs", type=int, default=3, help="counted runs (default 3)")
    parser.add_argument("overrides", nargs="*", help="config overrides, as for hoi.run")
    arguments = parser.parse_args()
    table = measure(max(arguments.runs, 1), arguments.overrides)
    print(f"{' '.join(arguments.overrides) or 'default scene'}: {arguments.runs} runs, {os.cpu_count()} CPU cores")
    print(sheets.plain(table))


if __name__ == "__main__":
    program(main)
