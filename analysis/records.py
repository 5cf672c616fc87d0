"""The records below a folder, each read once, in NumPy alone: what metrics, tables and reports start from."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hoi import record
from hoi.data import Array, Run
from hoi.errors import InputError
from hoi.record.checks import Refused, check_finite

from .posing import joint_frames, posed_means

DONE, FAILED = "run.mcap", "run.failed.mcap"
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True, eq=False)
class Record:
    """One run, as its file has it. What takes time is worked out when it is first asked for."""

    path: Path
    run: Run

    @cached_property
    def config(self) -> dict[str, Any]:
        """The resolved config; empty where the record has none, as that of another system may.

        Raises:
            InputError: it is no YAML mapping.
        """
        try:
            config = yaml.load(self.run.config_yaml, _LOADER)  # safe: a safe loader makes plain values alone
        except (yaml.YAMLError, RecursionError) as error:
            raise InputError(f"{self.path}: config.yaml is no YAML: {' '.join(str(error).split())[:200]}") from error
        if config is None:
            return {}
        if not isinstance(config, dict):
            raise InputError(f"{self.path}: config.yaml is a {type(config).__name__}, must be a mapping")
        return config

    def conf(self, *keys: str, default: Any = None) -> Any:
        """A value of the config, `default` where it has none."""
        value: Any = self.config
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return default if value is None else value

    @cached_property
    def points(self) -> Array:
        """The person's points to look at [m], (T, M, 3).

        Raises:
            InputError: the record shows no person.
        """
        return record.posed_points(self.path)[0]

    @cached_property
    def joints(self) -> Array | None:
        """World positions of the person's joints [m], (T, 24, 3); None where there is no motion."""
        run = self.run
        return (
            None if run.scene is None or run.state.motion is None else joint_frames(run.scene.body, run.state.motion)[1]
        )

    @cached_property
    def skin(self) -> Array | None:
        """All of the person's Gaussians, posed [m], (T, N, 3); the points to look at where there is no motion to pose
        them by, None where there is no person."""
        run = self.run
        if run.scene is not None and run.state.motion is not None and len(run.scene.body.cloud):
            return posed_means(run.scene.body, run.state.motion)
        try:
            points = self.points
        except InputError:
            return None
        return points if points.shape[1] and np.isfinite(points).all() else None

    @cached_property
    def skin_joints(self) -> NDArray[np.intp] | None:
        """Which joint each of `skin` belongs to, (N,): argmax_k w_ik; None where there is no motion."""
        run = self.run
        if run.scene is None or run.state.motion is None:
            return None
        return run.scene.body.dominant_joints


def find(folder: Path) -> list[Path]:
    """The records below a folder, in order: those of finished and of failed runs; hidden folders are left out.

    Raises:
        InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    found = [*folder.rglob(DONE), *folder.rglob(FAILED)]
    return sorted(path for path in found if not any(part.startswith(".") for part in path.relative_to(folder).parts))


def load(path: Path) -> Record:
    """A record, read and checked.

    Raises:
        InputError: one line with the file: it is missing, unfinished, damaged, foreign or hostile.
    """
    run = record.read(path)
    if run.result.get("status") == "done":
        try:
            check_finite(run)
        except Refused as error:
            raise InputError(f"{path} is damaged: {error}") from error
    return Record(path, run)
