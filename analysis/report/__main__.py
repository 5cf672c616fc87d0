"""One HTML page of a folder of runs: `python -m analysis.report [runs] [-o runs/report.html]`.

Tables, pictures at contact, plots; of each run its filmstrip, video, plan (kept and left-out steps), time by stage,
numbers, command; failures with their reasons; and what lies in FOLDER/precision, FOLDER/stability and, with --study,
the user study. All of it is inside the one file. The same records give the same bytes. Exit codes: 0 done; 2 a record
or score file could not be read (the page is written all the same), or there is no record.
"""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.program import program

LIMIT = 200
"""Megabytes of pictures and videos."""


def main(arguments: list[str] | None = None, say: Callable[[str], None] = print) -> int:
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}",
        description="One HTML page of a folder of runs: tables, filmstrips, videos, plans, timings.",
        epilog="example: %(prog)s runs -o runs/report.html",
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("runs"))
    parser.add_argument("-o", "--out", type=Path, metavar="HTML", help="default: report.html in the folder of runs")
    parser.add_argument("--study", type=Path, metavar="DIR", help="what analysis.study score -o DIR wrote")
    parser.add_argument("--no-videos", action="store_true", help="filmstrips alone: a much smaller page")
    parser.add_argument("--limit-mb", type=int, default=LIMIT, metavar="N", help=f"of pictures and videos ({LIMIT})")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes that read records")
    options = parser.parse_args(arguments)
    from .make import make

    out = options.out or options.folder / "report.html"
    try:
        count, wrong = make(options.folder, out, options.study, not options.no_videos, options.limit_mb, options.jobs)
    except (InputError, RunError, OSError) as error:
        print(f"analysis.report: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    for line in wrong:
        print(f"analysis.report: {line}", file=sys.stderr)
    say(f"{count} records in {out} ({out.stat().st_size / 1e6:.1f} MB)")
    return 2 if wrong else 0


if __name__ == "__main__":
    program(main)
