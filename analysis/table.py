"""The tables of a folder of runs, from their records alone: `python -m analysis.table runs [-o DIR] [--by scene]`.

Prints the tables and writes, by default into DIR = runs/table:

    runs.csv     one row a record, every number: the source of the rest
    table.csv    one row a variant: of each number mean, spread (standard deviation over the variant's runs, scenes and
                 seeds alike) and how many runs have it
    table.md, table.tex, table.html    the same to read, by topic, with the rows that the paper reports

Failed runs are counted with their reasons; a record that cannot be read is named and counted, and the table stands.
The same records give the same bytes. Neither torch nor taichi is imported. Exit codes: 0 done; 2 a record or a score
file could not be read (the tables are written all the same), or there is no record.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from hoi.errors import InputError
from hoi.terminal.program import program

from .learned.sidecar import SCORES, read_scores, sidecar_path

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
R = TypeVar("R")
KEYS = ["scene", "experiment", "variant"]
FACTS = [*KEYS, "seed", "status", "reason", "path", "config_hash"]
DONE, FAILED, UNREADABLE = "done", "failed", "unreadable"
ORDER = ("full", "no_attraction", "no_contact", "no_mdm", "no_mpm", "no_video_sds", "geometric", "motion_from_file")
"""Variants in tables; their combinations follow, then other systems by name."""
BASELINE = "baseline"
"""The experiment of other systems."""
TOGETHER = 8
"""With fewer records than this, one process reads them."""


def collect(folder: Path, jobs: int = 1, kept: Path | None = None) -> pd.DataFrame:
    """One row a record below `folder`: `FACTS`, then the metrics and learned scores, NaN where a run has none.

    A record that cannot be read is a row of status "unreadable", with the reason. A failed run whose folder also holds
    the finished run of the same config is superseded by it and has no row.

    Args:
        jobs: processes that read; the rows do not depend on it.
        kept: folder of an earlier table: records that have not changed since are not read again.

    Raises:
        InputError: no such folder, or no record in it.
    """
    import pandas as pd

    from . import kept_rows
    from .metrics import METRICS
    from .records import find

    files = find(folder)
    if not files:
        raise InputError(f"{folder}: no run.mcap below it")
    known = {} if kept is None else kept_rows.load(kept)
    identities = [kept_rows.identity(path) for path in files]
    unread = [path for path, identity in zip(files, identities, strict=True) if identity not in known]
    read = dict(zip(unread, each(partial(_row, folder), unread, jobs), strict=True))
    rows = [read.get(path) or known[identity] for path, identity in zip(files, identities, strict=True)]
    if kept is not None and unread:
        whole = zip(identities, rows, strict=True)
        kept_rows.save(kept, {identity: row for identity, row in whole if row["status"] != UNREADABLE})
    rows = [_scored(folder, path, row) for path, row in zip(files, rows, strict=True)]
    places = [(str(Path(str(row["path"])).parent), row["config_hash"]) for row in rows]
    done = {place for row, place in zip(rows, places, strict=True) if row["status"] == DONE}
    rows = [row for row, place in zip(rows, places, strict=True) if row["status"] != FAILED or place not in done]
    return pd.DataFrame(rows, columns=[*FACTS, *METRICS, *SCORES, "warning"])


def each(read: Callable[[T], R], items: Sequence[T], jobs: int) -> list[R]:
    """What `read` makes of each, in order, by so many processes where that is worth it."""
    if jobs > 1 and len(items) >= TOGETHER:
        with ProcessPoolExecutor(jobs) as pool:
            return list(pool.map(read, items, chunksize=2))
    return [read(item) for item in items]


def summarise(runs: pd.DataFrame, by: Sequence[str] = ()) -> pd.DataFrame:
    """One row a variant, in the order of `ORDER`.

    Args:
        runs: as `collect` gives them. by: columns that rows are apart by too, such as "scene".

    Returns:
        experiment and variant (and `by`), n runs that are done, failed, unreadable, reasons, and of each number
        KEY, KEY_sd (sample standard deviation over the runs, NaN for one) and KEY_n.
    """
    import pandas as pd

    from .metrics import METRICS

    keys, numbers = [*by, "experiment", "variant"], [*METRICS, *SCORES]
    rows = []
    for _, group in runs.groupby(keys, sort=False, dropna=False):
        counts, values = Counter(group["status"]), group.loc[group["status"] == DONE, numbers].astype(float)
        row: dict[str, object] = {key: group[key].iloc[0] for key in keys}
        row |= {"n": counts[DONE], FAILED: counts[FAILED], UNREADABLE: counts[UNREADABLE]}
        row["reasons"] = _reasons(group.loc[group["status"] == FAILED, "reason"].tolist())
        means, spreads, given = values.mean(), values.std(ddof=1), values.count()
        for key in numbers:
            row |= {key: means[key], f"{key}_sd": spreads[key], f"{key}_n": given[key]}
        rows.append(row)
    rows.sort(
        key=lambda row: ([str(row[key]) for key in by], *variant_place(str(row["experiment"]), str(row["variant"])))
    )
    return pd.DataFrame(rows)


def variant_place(experiment: str, variant: str) -> tuple[bool, bool, str, int, int, str]:
    """What variants are sorted by: ours, then other systems; by experiment; the named, their combinations, the rest."""
    parts = variant.split("+")
    known = all(part in ORDER for part in parts)
    first = ORDER.index(parts[0]) if known else len(ORDER)
    return experiment == BASELINE, variant == "", experiment, len(parts) if known else 99, first, variant


def _row(folder: Path, path: Path) -> dict[str, object]:
    """A record's row."""
    from hoi.record import read_metadata

    from .metrics import METRICS
    from .records import load

    row: dict[str, object] = dict.fromkeys(FACTS, "")
    row["path"] = path.relative_to(folder).as_posix()
    try:
        facts = read_metadata(path)
        row |= {key: facts.get(key, "") for key in (*KEYS, "seed", "config_hash")}
        if facts.get("status") != DONE:
            return row | {"status": FAILED, "reason": facts.get("outcome", "")}
        record = load(path)
        row |= {key: metric(record) for key, metric in METRICS.items()}
    except InputError as error:
        return _unreadable(row["path"], _told(error, folder))
    except Exception as error:  # a file that passes every check and still trips a metric must not take the table along
        reason = f"{path} is damaged: {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        return _unreadable(row["path"], _told(reason, folder))
    return row | {"status": DONE}


def _scored(folder: Path, path: Path, row: dict[str, object]) -> dict[str, object]:
    """The row of the record at `path`, with its learned scores."""
    row = row | {"path": path.relative_to(folder).as_posix()}
    if row["status"] != DONE:
        return row
    try:
        return row | (read_scores(path) if sidecar_path(path).is_file() else {})
    except InputError as error:
        return row | {"warning": _told(error, folder)}


def _unreadable(path: object, reason: str) -> dict[str, object]:
    return {**dict.fromkeys(FACTS, ""), "path": path, "status": UNREADABLE, "reason": reason}


def _told(error: object, folder: Path) -> str:
    """A message with paths as they are below the folder, so that a table says the same wherever it is made."""
    return str(error).replace(f"{folder.as_posix().rstrip('/')}/", "")


def _reasons(texts: list[str]) -> str:
    counts = sorted(Counter(texts).items())
    return "; ".join(f"{count} x {text}" if count > 1 else text for text, count in counts)


def main(arguments: list[str] | None = None, say: Callable[[str], None] = print) -> int:
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}.table",
        description="The tables of a folder of runs: every metric of every variant, as Markdown, CSV and more.",
        epilog="example: %(prog)s runs --by scene",
    )
    parser.add_argument("folder", type=Path, nargs="?", default=Path("runs"))
    parser.add_argument("-o", "--out", type=Path, help="folder for the tables; default: table in the folder of runs")
    parser.add_argument("--by", action="append", choices=["scene", "seed"], default=[], help="a row for each, too")
    parser.add_argument("--mos", type=Path, metavar="CSV", help="opinion scores of ours, from analysis.study score")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes that read records")
    options = parser.parse_args(arguments)
    from .study.opinions import read_opinions
    from .writers import as_text, shown, write_tables

    try:
        out = options.out or options.folder / "table"
        runs = collect(options.folder, options.jobs, kept=out)
        opinions = None if options.mos is None else read_opinions(options.mos)
        summary = summarise(runs, options.by)
        files = write_tables(out, runs, summary, options.by, opinions)
    except (InputError, OSError) as error:
        print(f"analysis.table: {error}", file=sys.stderr)
        return 2
    say(as_text(shown(summary, options.by, opinions)))
    wrong = runs.loc[runs["status"] == UNREADABLE, "reason"].tolist() + runs["warning"].dropna().tolist()
    for line in wrong:
        print(f"analysis.table: {line}", file=sys.stderr)
    counts = Counter(runs["status"])
    said = ", ".join(f"{counts[status]} {status}" for status in (DONE, FAILED, UNREADABLE))
    say(f"{len(runs)} records ({said}): {', '.join(file.name for file in files)} in {files[0].parent}")
    return 2 if wrong else 0


if __name__ == "__main__":
    program(main)
