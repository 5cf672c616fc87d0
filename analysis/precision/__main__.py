"""Error against run time of the object's physics: `python -m analysis.precision [--quick] [-o runs/precision]`.

Problems with known answers and benchmark scenes, each computed in many ways; see `analysis.precision.problems`,
`.scenes`, `.run` for the ways and `.convergence` for the orders. Writes precision.csv, precision.md and precision.png.
"""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import NoReturn

from hoi.errors import InputError, RunError

DEFAULT_OUT = Path("runs/precision")


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"analysis.precision: {message}", file=sys.stderr)
        sys.exit(2)


def main() -> None:
    parser = Parser(prog="python -m analysis.precision", description="Error against run time of the object's physics.")
    parser.add_argument("-o", "--out", type=Path, default=DEFAULT_OUT, help=f"folder (default {DEFAULT_OUT})")
    parser.add_argument("--problems", help="names, separated by commas (default: all)")
    parser.add_argument("--quick", action="store_true", help="few and small variants of two problems")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each short variant (default 3)")
    parser.add_argument("--threads", type=int, default=1, help="of each run (default 1)")
    arguments = parser.parse_args()
    try:
        _study(arguments)
    except (InputError, OSError) as error:
        parser.error(str(error))
    except RunError as error:
        print(f"analysis.precision: {error}", file=sys.stderr)
        sys.exit(3)


def _study(arguments: argparse.Namespace) -> None:
    from analysis.precision import convergence, report, run
    from analysis.precision.problems import EXACT
    from analysis.precision.scenes import SCENES

    cores = os.cpu_count() or 1
    if arguments.repeats < 1:
        raise InputError(f"--repeats must be 1 or more, got {arguments.repeats}")
    if not 1 <= arguments.threads <= cores:
        raise InputError(f"--threads must be from 1 to the {cores} cores of this machine, got {arguments.threads}")
    known = {problem.__name__: problem for problem in (*EXACT, *SCENES)}
    default = "waves,punch" if arguments.quick else ",".join(known)
    names = (arguments.problems or default).split(",")
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"--problems must be of {', '.join(known)}, got {', '.join(unknown)}")
    problems = [known[name]() for name in dict.fromkeys(names)]
    arguments.out.mkdir(parents=True, exist_ok=True)

    began = time.perf_counter()
    orders = convergence.manufactured(arguments.quick) if "waves" in names else []
    table = run.study(
        problems, quick=arguments.quick, repeats=arguments.repeats, threads=arguments.threads, cores=cores
    )
    orders += convergence.by_grid(table)
    noted = report.facts(arguments.threads)
    paths = report.write(arguments.out, problems, table, orders, noted)
    for order in orders:
        print(f"order    {order.series} ({order.quantity}): {order.observed:.2f} {order.verdict}")
    print(f"{len(table)} runs in {time.perf_counter() - began:.0f} s")
    print(*paths, sep="\n")


if __name__ == "__main__":
    main()
