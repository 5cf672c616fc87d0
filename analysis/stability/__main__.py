"""A grid of extreme cases of the object's MPM and of the person who strikes it, and whether it holds in each.

    python -m analysis.stability [-o FOLDER] [--jobs N] [--quick] [--family NAME]
    python -m analysis.stability --case ID

Writes stability.csv (one row a case) and stability.png (the map). Exit codes: 0 all cases hold; 1 some do not;
2 bad arguments; 130 interrupted, with the cases not run marked so.
"""

import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from hoi.errors import InputError
from hoi.terminal.program import program

from .. import command
from . import blows
from .blows import BLOWS, Blow
from .cases import CASES, Case, quick
from .verdict import Verdict


@command.exit_code("analysis.stability")
def main(arguments: Sequence[str] | None = None) -> int:
    parser = command.parser(
        "analysis.stability",
        "Extreme cases of the object's MPM and of the person who strikes it, and whether it holds: a table and a map.",
        "--quick -o runs/stability",
    )
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/stability"), help="folder for the CSV and the map")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    parser.add_argument("--quick", action="store_true", help="a few dozen cases")
    parser.add_argument("--family", help="only the cases of this family, or of those that begin so")
    parser.add_argument("--case", metavar="ID", help="run one case here and print its numbers")
    options = parser.parse_args(arguments)
    if options.jobs < 1:
        parser.error(f"--jobs must be 1 or more, got {options.jobs}")
    if options.case is not None:
        return _one(options.case)
    return _all(_selected(options.family, options.quick), options.jobs, options.out)


def _selected(family: str | None, only_quick: bool) -> list[Case | Blow]:
    cases = [*quick(), *blows.quick()] if only_quick else [*CASES.values(), *BLOWS.values()]
    chosen = [case for case in cases if family is None or case.family.startswith(family)]
    if not chosen:
        raise InputError(f"--family must be one of {', '.join(sorted({case.family for case in cases}))}, got {family}")
    return chosen


def _one(name: str) -> int:
    from .workers import verdict_of

    case = CASES.get(name) or BLOWS.get(name)
    if case is None:
        raise InputError(f"--case must be the id of a case, see the first column of stability.csv, got {name!r}")
    verdict = verdict_of(case)
    for key, value in (asdict(case) | asdict(verdict)).items():
        print(f"{key:22}{value:.6g}" if isinstance(value, float) else f"{key:22}{value}")
    return int(not verdict.good)


def _all(cases: list[Case | Blow], jobs: int, folder: Path) -> int:
    import pandas as pd

    from .chart import draw
    from .workers import run_all

    folder.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    results = {case.id: (case, Verdict("not run")) for case in cases}
    interrupted = False
    try:
        _say(f"0 of {len(cases)} cases\r")
        for done, (case, verdict) in enumerate(run_all(cases, jobs), start=1):
            results[case.id] = case, verdict
            if not verdict.good:
                _say(f"{case.id}: {verdict.reason}\n")
            _say(f"{done} of {len(cases)} cases\r")
    except KeyboardInterrupt:
        interrupted = True
    _say(" " * 40 + "\r")
    table = pd.DataFrame([asdict(case) | asdict(verdict) for case, verdict in results.values()])
    table.to_csv(folder / "stability.csv", index=False)
    draw(results, folder / "stability.png")
    counts = Counter(verdict.verdict for _, verdict in results.values())
    left = f", {counts['not run']} not run: interrupted" if interrupted else ""
    print(
        f"{len(cases)} cases: {counts['held']} held, {counts['refused']} refused as they must be, {counts['stopped']} "
        f"stopped as they may, {counts['failed']} failed{left}; "
        f"{time.perf_counter() - started:.0f} s with {jobs} processes"
    )
    print(folder / "stability.csv", folder / "stability.png", sep="\n")
    return 130 if interrupted else int(counts["failed"] > 0)


def _say(text: str) -> None:
    print(text, end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    program(main)
