"""Answers and keys from files that other people sent: every value is checked, whatever is wrong is said in one line."""

import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from hoi.errors import InputError

from .make import ANSWERS_FORMAT, KEY_FORMAT, LABELS
from .questions import CODE, COLUMNS, QUESTIONS, SCALE

LARGEST = 16 << 20
"""Bytes a file may have."""
RATINGS = tuple(question.key for question in QUESTIONS)


@dataclass(frozen=True)
class Key:
    """Which video is whose."""

    study: str
    videos: dict[str, dict[str, str]]
    """By the video's name on the page: scene, experiment, variant, seed."""


def read_key(path: Path) -> Key:
    """The key that `make` wrote.

    Raises:
        InputError: no such file, or not a key.
    """
    found = _json(path)
    if not isinstance(found, dict) or found.get("format") != KEY_FORMAT:
        raise InputError(f"{path} is not the key of a study ({KEY_FORMAT})")
    study, videos = found.get("study"), found.get("videos")
    if not isinstance(study, str) or not isinstance(videos, dict) or not videos:
        raise InputError(f"{path}: a key has study and videos")
    for name, video in videos.items():
        if not isinstance(video, dict) or not all(isinstance(video.get(label), str) for label in LABELS):
            raise InputError(f"{path}: video {_shown(name)} lacks one of {', '.join(LABELS)}")
    return Key(study, {name: {label: video[label] for label in LABELS} for name, video in videos.items()})


def read_answers(paths: Sequence[Path], key: Key) -> pd.DataFrame:
    """One row a rated video, columns `COLUMNS`, in the order of the files.

    JSON and CSV as the page saves them. Rows count from 1; in CSV the header is row 1, as spreadsheets count.

    Raises:
        InputError: a file or a row that is not an answer to this study, or that rates a video for the second time.
    """
    seen: dict[tuple[str, str], str] = {}
    rows = []
    for path in paths:
        before = len(rows)
        for where, row in _csv_rows(path) if path.suffix.lower() == ".csv" else _json_rows(path):
            rows.append(_checked(row, where, key))
            rating = (rows[-1]["rater"], rows[-1]["video"])
            if rating in seen:
                raise InputError(f"{where}: rater {rating[0]} has rated video {rating[1]} before, in {seen[rating]}")
            seen[rating] = where
        if len(rows) == before:
            raise InputError(f"{path} has no answers")
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _checked(row: dict[str, Any], where: str, key: Key) -> dict[str, Any]:
    if row["study"] != key.study:
        raise InputError(f"{where}: study is {_shown(row['study'])}, the key is of {key.study}")
    if not isinstance(row["rater"], str) or not re.fullmatch(CODE, row["rater"]):
        raise InputError(f"{where}: rater is {_shown(row['rater'])}, allowed are 1 to 32 letters, digits, - and _")
    if not isinstance(row["video"], str) or row["video"] not in key.videos:
        raise InputError(f"{where}: video is {_shown(row['video'])}, which the key does not have")
    for name, top in (("position", len(key.videos)), *((name, SCALE[-1]) for name in RATINGS)):
        if type(row[name]) is not int or not 1 <= row[name] <= top:
            raise InputError(f"{where}: {name} is {_shown(row[name])}, allowed are 1 to {top}")
    return row


def _csv_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    reader = csv.reader(io.StringIO(_text(path), newline=""), strict=True)
    number = 0
    try:
        for number, cells in enumerate(reader, start=1):
            where = f"{path} row {number}"
            if number == 1 and tuple(cells) != COLUMNS:
                raise InputError(f"{where}: the header is {_shown(','.join(cells))}, it should be {','.join(COLUMNS)}")
            if number == 1 or not cells:
                continue
            if len(cells) != len(COLUMNS):
                raise InputError(f"{where}: {len(cells)} cells where {len(COLUMNS)} should be")
            row: dict[str, Any] = dict(zip(COLUMNS, cells, strict=True))
            for name in ("position", *RATINGS):
                if re.fullmatch(r"[0-9]{1,9}", row[name]):
                    row[name] = int(row[name])
            yield where, row
    except csv.Error as error:
        raise InputError(f"{path} row {number + 1}: {error}") from error


def _json_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    found = _json(path)
    if not isinstance(found, dict) or found.get("format") != ANSWERS_FORMAT:
        raise InputError(f"{path} is not a file of answers ({ANSWERS_FORMAT})")
    if not isinstance(found.get("answers"), list):
        raise InputError(f"{path}: answers should be a list")
    for number, answer in enumerate(found["answers"], start=1):
        where = f"{path} row {number}"
        if not isinstance(answer, dict) or set(answer) != set(COLUMNS[2:]):
            raise InputError(f"{where}: {_shown(answer)} should have {', '.join(COLUMNS[2:])}")
        yield where, {"study": found.get("study"), "rater": found.get("rater"), **answer}


def _json(path: Path) -> Any:
    """Parsed so that no number can hurt: what is not a small integer stays text, and is refused as such later."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({name for name, _ in pairs}) != len(pairs):
            raise ValueError("a name stands twice in one object")
        return dict(pairs)

    def small(text: str) -> int | str:
        return int(text) if len(text) < 10 else text

    text = _text(path)
    try:
        return json.loads(text, parse_int=small, parse_float=str, parse_constant=str, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON: {' '.join(str(error).split())[:120]}") from error


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path} has {path.stat().st_size} bytes; at most {LARGEST} are read")
        return path.read_text(encoding="utf-8-sig")  # spreadsheets put a byte order mark before a CSV
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not text in UTF-8 (byte {error.start})") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def _shown(value: object) -> str:
    """A foreign value in a message: on one line, escaped, not long."""
    text = ascii(value)
    return text if len(text) <= 40 else text[:37] + "..."
