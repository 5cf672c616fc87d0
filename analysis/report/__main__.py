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
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from analysis.report.extras import read_extra, read_opinions
from analysis.report.page import build
from analysis.report.shown import Shown, look
from analysis.table import TOGETHER, UNREADABLE, collect
from hoi.errors import InputError, RunError
from hoi.render.encode import whole_file

LIMIT = 200
"""Megabytes of pictures and videos."""


def make(
    folder: Path,
    out: Path,
    study: Path | None = None,
    videos: bool = True,
    limit: int = LIMIT,
    jobs: int = 1,
) -> tuple[int, list[str]]:
    """Write the page; how many records stand in it, and what could not be read.

    Raises:
        InputError: no record, a study without scores, or the page cannot be written there.
    """
    if limit < 0:
        raise InputError(f"--limit-mb {limit}: 0 or more is allowed")
    runs = collect(folder, jobs)
    opinions = None if study is None else read_opinions(study)
    rows = runs.to_dict("records")
    looks = partial(_look, folder)
    if jobs > 1 and len(rows) >= TOGETHER:
        with ProcessPoolExecutor(jobs) as pool:
            shown = list(pool.map(looks, enumerate(rows, 1), chunksize=2))
    else:
        shown = [looks(numbered) for numbered in enumerate(rows, 1)]
    extras = [
        read_extra("precision", "Precision against run time", "make precision", folder / "precision"),
        read_extra("stability", "Stability", "make stability", folder / "stability"),
        read_extra(
            "study", "User study", "python -m analysis.study score ANSWERS --key KEY -o DIR (then --study DIR)", study
        ),
    ]
    page = build(runs, shown, extras, opinions, videos, limit * 10**6)
    out.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(out) as part:
        part.write_bytes(page.encode("utf-8", "replace"))
    wrong = [str(row["reason"]) for row in rows if row["status"] == UNREADABLE]
    return len(rows), wrong + [str(text) for text in runs["warning"].dropna()]


def _look(folder: Path, numbered: tuple[int, dict]) -> Shown:
    return look(folder, numbered[1], f"run-{numbered[0]}")


def main(arguments: list[str] | None = None, say: Callable[[str], None] = print) -> int:
    parser = argparse.ArgumentParser(prog="python -m analysis.report", description="One HTML page of a folder of runs.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("runs"))
    parser.add_argument("-o", "--out", type=Path, metavar="HTML", help="default: report.html in the folder of runs")
    parser.add_argument("--study", type=Path, metavar="DIR", help="what analysis.study score -o DIR wrote")
    parser.add_argument("--no-videos", action="store_true", help="filmstrips alone: a much smaller page")
    parser.add_argument("--limit-mb", type=int, default=LIMIT, metavar="N", help=f"of pictures and videos ({LIMIT})")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes that read records")
    options = parser.parse_args(arguments)
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
    sys.exit(main())
