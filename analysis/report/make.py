"""From a folder of runs to the page."""

from functools import partial
from pathlib import Path

from hoi.errors import InputError
from hoi.files import whole_file

from ..study.opinions import read_opinions
from ..table import UNREADABLE, collect, each
from .extras import read_extra
from .page import build
from .shown import Shown, look


def make(
    folder: Path,
    out: Path,
    study: Path | None = None,
    videos: bool = True,
    limit: int = 200,
    jobs: int = 1,
) -> tuple[int, list[str]]:
    """Write the page, with at most `limit` megabytes of pictures and videos.

    Returns:
        how many records stand in it, and what could not be read.

    Raises:
        InputError: no record, a study without scores, or the page cannot be written there.
    """
    if limit < 0:
        raise InputError(f"--limit-mb {limit}: 0 or more is allowed")
    runs = collect(folder, jobs)
    opinions = None if study is None else read_opinions(study / "study.csv")
    rows = runs.to_dict("records")
    shown = each(partial(_look, folder), list(enumerate(rows, 1)), jobs)
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
