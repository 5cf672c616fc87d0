"""Recorded runs -> a page on which people rate their videos blindly, and the key that says which video is whose."""

import hashlib
import html
import json
import os
import random
import secrets
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from hoi.errors import InputError
from hoi.record import read_metadata

from ..report.media import data_uri
from .questions import CODE, COLUMNS, QUESTIONS, SCALE
from .videos import anonymise

KEY_FORMAT = "hoi.study.key/1"
ANSWERS_FORMAT = "hoi.study.answers/1"
LABELS = ("scene", "experiment", "variant", "seed")
TEMPLATE = Path(__file__).parent


@dataclass(frozen=True)
class Clip:
    """A video, and whose it is."""

    video: Path
    scene: str
    experiment: str
    variant: str
    """The system: one of ours, or the name of an ingested one."""
    seed: str


@dataclass(frozen=True)
class Study:
    name: str
    page: Path
    key: Path
    clips: tuple[Clip, ...]

    def __str__(self) -> str:
        count = Counter(clip.variant for clip in self.clips)
        variants = ", ".join(f"{variant} {number}" for variant, number in sorted(count.items()))
        return f"study {self.name}: {len(self.clips)} videos ({variants})\npage {self.page}\nkey  {self.key}"


def find_clips(folders: Sequence[Path]) -> tuple[list[Clip], list[Path]]:
    """The finished records below `folders` that have a `run.mp4` beside them, and those that have none.

    Raises:
        InputError: a record cannot be read or lacks a label, or there is no video at all.
    """
    records = sorted({file.resolve(): file for folder in folders for file in folder.rglob("run.mcap")}.values())
    clips, without = [], []
    for record in records:
        video = record.with_suffix(".mp4")
        if not video.is_file():
            without.append(record)
            continue
        labels = read_metadata(record)
        for label in LABELS:
            if label not in labels:
                raise InputError(f"{record} does not say its {label}")
        clips.append(Clip(video, *(labels[label] for label in LABELS)))
    if not clips:
        below = ", ".join(map(str, folders))
        raise InputError(f"{below}: no run.mcap with a run.mp4 beside it ({len(without)} without a video)")
    return clips, without


def make(clips: Sequence[Clip], out: Path, key: Path | None = None, seed: int | None = None) -> Study:
    """Write the page and its key.

    Args:
        out: A folder, which gets `index.html` and `videos/`; or a file `*.html` with the videos inside.
        key: Where the key goes; by default `<out>.key.json`, beside the page.
        seed: Of the videos' names; by default one that nobody can guess. It stands in the key.

    Raises:
        InputError: the place is taken or cannot be written, the key would be part of the page, or a video is none.
    """
    single = out.suffix.lower() == ".html"
    key = key or out.with_name(f"{out.stem if single else out.name}.key.json")
    if key.resolve().is_relative_to(out.resolve()):
        raise InputError(f"key {key} would be part of the page {out}, which raters get; put it elsewhere")
    for place in (out, key):
        if place.exists() and not (place.is_dir() and not any(place.iterdir())):
            raise InputError(f"{place} exists; a study is not overwritten, for its answers would lose their key")
    seed = secrets.randbits(64) if seed is None else seed
    draw = random.Random(seed)
    ids = [f"{draw.getrandbits(48):012x}" for _ in clips]
    if len(set(ids)) != len(ids):
        raise InputError(f"seed {seed} gives two videos one name; take another")
    named = dict(sorted(zip(ids, clips, strict=True)))  # the order of names, so that no other order shows
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as folder:
            return _build(named, seed, out, key, Path(folder), single)
    except OSError as error:
        raise InputError(f"cannot write {error.filename or out}: {error.strerror}") from error


def _build(named: dict[str, Clip], seed: int, out: Path, key: Path, folder: Path, single: bool) -> Study:
    """Make all of it in `folder`, then move it to its place."""
    page = folder / "page"
    (page / "videos").mkdir(parents=True)
    files = {name: page / "videos" / f"{name}.mp4" for name in named}
    for name, clip in named.items():
        anonymise(clip.video, files[name])
    digests = {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
    study = hashlib.sha256(json.dumps([seed, digests, [asdict(q) for q in QUESTIONS]]).encode()).hexdigest()[:12]
    sources = {
        name: data_uri("video/mp4", file.read_bytes()) if single else f"videos/{file.name}"
        for name, file in files.items()
    }
    (page / "index.html").write_text(_page(study, sources), encoding="utf-8")
    videos = {
        name: {label: getattr(clip, label) for label in LABELS} | {"video": str(clip.video), "sha256": digests[name]}
        for name, clip in named.items()
    }
    text = json.dumps({"format": KEY_FORMAT, "study": study, "seed": seed, "videos": videos}, indent=1)
    key.parent.mkdir(parents=True, exist_ok=True)
    key.write_text(text + "\n", encoding="utf-8")
    if single:
        os.replace(page / "index.html", out)
    else:
        if out.exists():
            out.rmdir()
        shutil.move(page, out)
    return Study(study, out if single else out / "index.html", key, tuple(named.values()))


def _page(study: str, sources: dict[str, str]) -> str:
    facts = {
        "format": ANSWERS_FORMAT,
        "study": study,
        "questions": [asdict(question) for question in QUESTIONS],
        "scale": SCALE,
        "columns": COLUMNS,
        "code": CODE,
        "videos": [{"id": name, "src": source} for name, source in sources.items()],
    }
    parts = {
        "{{code}}": html.escape(CODE, quote=True),
        "{{css}}": (TEMPLATE / "page.css").read_text(encoding="utf-8"),
        "{{js}}": (TEMPLATE / "page.js").read_text(encoding="utf-8"),
        "{{study}}": json.dumps(facts).replace("<", "\\u003c"),
    }
    text = (TEMPLATE / "page.html").read_text(encoding="utf-8")
    for place, content in parts.items():
        text = text.replace(place, content)
    return text
