"""`run.learned.json`: what the models said of the record beside it. Reading needs neither torch nor the models."""

import json
import math
import os
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path

from hoi.errors import InputError


@dataclass(frozen=True)
class Score:
    """One column of a table; higher is better."""

    title: str
    model: str
    """Which of the models gives it, a key of `Sidecar.models`."""
    least: float
    most: float = 1.0


SCORES = {
    "viclip": Score("ViCLIP similarity to the scene prompt [-]", "viclip", -1),
    "viclip_motion": Score("ViCLIP similarity to the motion prompt [-]", "viclip", -1),
    "vqa_yes": Score("VQA physics, P(Yes) [-]", "vqa", 0),
    "vqa_yes_no": Score("VQA physics, P(Yes) / (P(Yes) + P(No)) [-]", "vqa", 0),
}
MODELS = ("viclip", "vqa")


@dataclass(frozen=True)
class Sidecar:
    """The scores of one record."""

    record: str
    """`hoi.record.message_digest` of the record."""
    scores: dict[str, float] = field(default_factory=dict)
    """By key of `SCORES`; only what has been computed."""
    models: dict[str, str] = field(default_factory=dict)
    """Which weights and settings gave them, by name of `MODELS`."""


def sidecar_path(record: Path) -> Path:
    """Where the scores of a record stand: `run.learned.json` beside `run.mcap`."""
    return record.with_suffix(".learned.json")


def read_scores(record: Path) -> dict[str, float]:
    """The scores of a record by key of `SCORES`; empty when it has none.

    Raises:
        InputError: the file is malformed, or belongs to another record.
    """
    from hoi.record import message_digest

    sidecar = read(sidecar_path(record))
    if sidecar is None:
        return {}
    if sidecar.record != message_digest(record):
        raise InputError(f"{sidecar_path(record)} has the scores of another record than {record.name}; score it again")
    return sidecar.scores


def read(path: Path) -> Sidecar | None:
    """The file as it stands; None when there is none.

    Raises:
        InputError: it is malformed.
    """
    try:
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict) or set(content) != {"record", "scores", "models"}:
        raise InputError(f"{path} must be an object of record, scores and models")
    record, scores, models = content["record"], content["scores"], content["models"]
    if not (isinstance(record, str) and isinstance(scores, dict) and isinstance(models, dict)):
        raise InputError(f"{path}: record must be a text, scores and models objects")
    for name, model in models.items():
        if name not in MODELS or not isinstance(model, str):
            raise InputError(f"{path}: models.{name} must be a text, and one of {', '.join(MODELS)}")
    return Sidecar(record, {key: _checked(key, value, models, path) for key, value in scores.items()}, models)


def write(path: Path, sidecar: Sidecar) -> None:
    """Whole or not at all; the same scores give the same bytes.

    Raises:
        InputError: the folder cannot be written to.
    """
    text = json.dumps(asdict(sidecar), indent=2, sort_keys=True, allow_nan=False) + "\n"
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".learned") as folder:
            part = Path(folder) / path.name
            part.write_text(text, "utf-8")
            os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error


def _checked(key: str, value: object, models: dict[str, str], path: Path) -> float:
    score = SCORES.get(key)
    if score is None:
        raise InputError(f"{path}: scores.{key} is none of {', '.join(SCORES)}")
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not score.least <= number <= score.most:
        said = f"{value!r:.40}"
        raise InputError(f"{path}: scores.{key} is {said}, must be a number from {score.least:g} to {score.most:g}")
    if score.model not in models:
        raise InputError(f"{path}: scores.{key} is there, but not models.{score.model}, which gave it")
    return float(number)
