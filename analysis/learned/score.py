"""All records of a folder, one model at a time: loaded once, freed before the next; one video in memory at a time."""

import gc
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import torch

from hoi.errors import InputError, RunError
from hoi.record import message_digest

from .. import records
from . import sidecar
from .frames import Clip, load
from .sidecar import SCORES, Sidecar, sidecar_path


class ModelFiles(Protocol):
    """A model that is on disk and not loaded yet."""

    @property
    def identity(self) -> str: ...

    def load(self, device: torch.device) -> Callable[[Clip], dict[str, float]]: ...


@dataclass(frozen=True)
class Tally:
    """What became of the records."""

    scored: int = 0
    kept: int = 0
    """Had the scores of these very models already."""
    skipped: int = 0


def find_records(folder: Path) -> list[Path]:
    """Finished runs below a folder, in order.

    Raises:
        InputError: there is none, or no such folder.
    """
    files = [path for path in records.find(folder) if path.name == records.DONE]
    if not files:
        raise InputError(f"{folder}: no {records.DONE} below it")
    return files


def score(paths: list[Path], name: str, files: ModelFiles, device: torch.device, again: bool = False) -> Tally:
    """Write one model's scores of each record beside it. A record that cannot be scored is named on stderr.

    Args:
        name: of the model, a key of `Sidecar.models`.
        again: also of records that have this model's scores.

    Raises:
        InputError: the model cannot be loaded.
        RunError: the GPU's memory does not suffice.
    """
    identity = files.identity
    todo: list[tuple[Path, Sidecar]] = []
    tally = Tally()
    for record in paths:
        try:
            known = current(record)
        except InputError as error:
            tally = _skip(tally, error)
            continue
        if known.models.get(name) == identity and not again:
            tally = replace(tally, kept=tally.kept + 1)
        else:
            todo.append((record, known))
    if not todo:
        return tally
    scorer = files.load(device)
    try:
        for record, known in todo:
            try:
                scores = scorer(load(record))
            except (InputError, RunError) as error:
                tally = _skip(tally, error if str(record) in str(error) else f"{record}: {error}")
                continue
            sidecar.write(sidecar_path(record), with_scores(known, name, identity, scores))
            tally = replace(tally, scored=tally.scored + 1)
            print(f"{record}: " + ", ".join(f"{key} {value:.4f}" for key, value in scores.items()), flush=True)
    except torch.cuda.OutOfMemoryError as error:
        raise RunError(f"--{name}: the GPU has too little memory left; take --device cpu or a smaller model") from error
    finally:
        del scorer
        gc.collect()
        if device.type == "cuda":
            torch.cuda.empty_cache()
    return tally


def current(record: Path) -> Sidecar:
    """What is known of a record: its sidecar, or an empty one where that is absent, damaged or another record's.

    Raises:
        InputError: the record cannot be read.
    """
    digest = message_digest(record)
    try:
        known = sidecar.read(sidecar_path(record))
    except InputError:
        known = None  # it is replaced as a whole
    return known if known is not None and known.record == digest else Sidecar(digest)


def with_scores(known: Sidecar, name: str, identity: str, scores: dict[str, float]) -> Sidecar:
    """The same with this model's scores, in place of what it had of that model."""
    others = {key: value for key, value in known.scores.items() if SCORES[key].model != name}
    return Sidecar(known.record, others | scores, known.models | {name: identity})


def _skip(tally: Tally, reason: object) -> Tally:
    print(f"skipped: {reason}", file=sys.stderr)
    return replace(tally, skipped=tally.skipped + 1)
