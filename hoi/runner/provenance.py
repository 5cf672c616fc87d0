"""What a record says of where it comes from: config hash, versions, device, input files."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from hoi.compute import compiler

NOT_HASHED = ("out", "overwrite", "plan_only", "seeds")
"""Keys that do not change what is computed (of `seeds`: but for rounding)."""
FILES = ("path", "skinning", "checkpoint")
"""Keys whose values are files or folders, wherever they stand."""


def config_hash(composed: DictConfig) -> str:
    """sha256 over the resolved config and hoi's version."""
    values: Any = OmegaConf.to_container(composed, resolve=True, enum_to_str=True)
    kept = {key: value for key, value in values.items() if key not in NOT_HASHED}
    text = json.dumps([version("hoi"), kept], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def provenance(composed: DictConfig, overrides: list[str]) -> dict[str, str]:
    """Facts known before the run starts, as text."""
    facts = {
        "seed": str(composed.seed),
        "config_hash": config_hash(composed),
        "overrides": " ".join(o for o in overrides if not o.startswith("out=")),
        "scene": composed.scene.name,
        "ablation": composed.ablation.value,
        "experiment": composed.experiment,
        "git": git_state(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": str(os.cpu_count()),
        "threads": str(composed.threads or os.cpu_count()),
        "device": composed.device.value,
    }
    packages = ("hoi", "torch", compiler(), "numpy", "scipy", "mcap", "av", "hydra-core", "omegaconf", "transformers")
    facts.update({f"version.{name}": version(name) for name in packages})
    inputs = dict(_files(OmegaConf.to_container(composed, resolve=True)))
    human = inputs.get("human.path")
    if human is not None and human.is_dir():  # an avatar's folder
        inputs["human.path"] = human / "gaussians.ply"
        inputs.setdefault("human.skinning", human / "skinning.npz")
    return facts | {f"sha256.{name}": digest(path) for name, path in inputs.items() if path.exists()}


def _files(values: Any, key: str = "") -> Iterator[tuple[str, Path]]:
    """Dotted key and path of every file or folder that a config names."""
    for name, value in values.items() if isinstance(values, dict) else ():
        if name in FILES and isinstance(value, str):
            yield f"{key}{name}", Path(value)
        yield from _files(value, f"{key}{name}.")


def digest(path: Path) -> str:
    """sha256 of a file's bytes; of a folder, of the relative paths and digests of its files, in order."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted(file for file in path.rglob("*") if file.is_file())
    lines = [f"{digest(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def git_state() -> str:
    """Commit of the checkout hoi runs from, with "+dirty" when it has changes; empty for an installed package."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""

    def git(*words: str) -> str:
        command = ["git", "--no-optional-locks", "-C", str(root), *words]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

    return git("rev-parse", "HEAD") + ("+dirty" if git("status", "--porcelain", "--untracked-files=no") else "")
