"""Rows of records, kept from one table to the next: a record is read again where it, or what reads it, has changed."""

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import hoi
from hoi.errors import InputError
from hoi.files import whole_file

NAME = "rows.json"
TAIL = 4096
"""Bytes of a record's end that tell it apart: its summary, with counts and offsets of all messages."""

Row = dict[str, object]


def identity(path: Path) -> str:
    """Of a record: its size, when it was last written, and its end; empty where it cannot be read."""
    try:
        facts = path.stat()
        with path.open("rb") as file:
            file.seek(max(facts.st_size - TAIL, 0))
            end = hashlib.sha256(file.read()).hexdigest()
    except OSError:
        return ""
    return f"{facts.st_size}-{facts.st_mtime_ns}-{end}"


def readers() -> str:
    """Of all code, as metrics call on most of it, and of the weights of those that are learned."""
    digest = hashlib.sha256()
    for folder in (Path(__file__).parent, Path(hoi.__file__).parent):
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.read_bytes())
        for file in sorted(folder.rglob("*.safetensors")):
            digest.update(f"{file.name} {file.stat().st_size} {file.stat().st_mtime_ns}".encode())
    return digest.hexdigest()


def load(folder: Path) -> dict[str, Row]:
    """Identity -> row, as `save` left them in the folder of a table; nothing where there are none of this code."""
    try:
        kept = json.loads((folder / NAME).read_text())
        if kept["readers"] != readers():
            return {}
        return {str(key): dict(row) for key, row in kept["rows"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}  # it saves time alone


def save(folder: Path, rows: dict[str, Row]) -> None:
    """Keep them for the next table; a folder that cannot be written to keeps none."""
    text = json.dumps({"readers": readers(), "rows": rows}, default=float)
    with suppress(InputError, OSError):
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(folder / NAME) as part:
            part.write_text(text)
