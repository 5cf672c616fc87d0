"""Results of stages that runs share: two runs whose settings differ in later stages alone go the same way up to there.

What a stage depends on is the whole config but for what acts after it, the stages that the plan keeps up to it, the
seeds of its batch, hoi and the machine's part in rounding. So what is found is what would be computed, to the bit.
"""

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from hoi.compute import compiler
from hoi.config import Config
from hoi.data import Plan
from hoi.method.optimization import Recall
from hoi.runner.provenance import FILES

MOTION = (
    "human", "stage.motion", "device", "threads", "scene.name", "scene.motion_prompt", "scene.acts",
    "scene.frames", "scene.fps", "scene.approach",
)  # fmt: skip
"""Keys of the config that the motion of stage 1 depends on: it is made without an object."""
LATER = {
    "free motion": ("stage.motion", "stage.attraction", "stage.coordinate", "stage.contact", "stage.refine"),
    "coordinate": ("stage.contact", "stage.refine"),
    "resimulate": ("stage.refine",),
}
"""Keys that the other steps know nothing of."""
NEVER = ("seed", "seeds", "out", "overwrite", "plan_only", "experiment", "ablation", "human_points", "render")
"""Keys that no step depends on, or the seeds, which are said apart."""
STEPS = {
    "free motion": ("free_motion",),
    "motion": ("motion",),
    "coordinate": ("free_motion", "motion", "approach", "coordinate"),
    "resimulate": ("free_motion", "motion", "approach", "coordinate", "contact", "resimulate", "react"),
}
"""The steps of the plan that each depends on."""
USES = {"free motion": (), "motion": ("motion_prior",)}
"""What of `Plan.uses` they depend on; the others on all."""
KEPT = 24
"""Results that are kept in memory: of about six walks."""


def key_of(step: str, config: Config, plan: Plan, seeds: Sequence[int]) -> str:
    """sha256 of all that the step's result depends on."""
    values: Any = OmegaConf.to_container(OmegaConf.structured(config), resolve=True, enum_to_str=True)
    facts = dict(_flat(values)) | {f"{option.key}.": option.name for option in config.options}
    facts = {key: fact for key, fact in facts.items() if _concerns(key, step)}
    files = [_state(Path(fact)) for key, fact in facts.items() if key.rpartition(".")[2] in FILES and fact]
    kept = [(each.name, each.implementation) for each in plan.steps if each.name in STEPS[step]]
    uses = sorted(set(plan.uses) & set(USES.get(step, plan.uses)))
    versions = [version("hoi"), version("torch"), version(compiler())]
    text = json.dumps([versions, step, list(seeds), kept, uses, facts, files], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and their values."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _concerns(key: str, step: str) -> bool:
    """Whether the step depends on that key."""
    only, but = (MOTION, ()) if step == "motion" else (None, (*NEVER, *LATER[step]))
    return (only is None or _under(key, only)) and not _under(key, but)


def _under(key: str, owners: Sequence[str]) -> bool:
    return any(key == owner or key.startswith(f"{owner}.") for owner in owners)


def _state(path: Path) -> list[tuple[str, int, int]]:
    """Of a file, or of all in a folder: names, sizes and times of last change."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    facts = [(str(file), file.stat()) for file in files if file.is_file()]
    return [(name, stat.st_size, stat.st_mtime_ns) for name, stat in facts]


class Shelf:
    """Results in memory; the oldest go first."""

    def __init__(self, most: int = KEPT) -> None:
        self._most, self._kept = most, OrderedDict[str, Any]()

    def recall(self, config: Config, plan: Plan, seeds: Sequence[int]) -> Recall:
        """Finds here what walks of this config need, and keeps here what they compute."""

        def recalled(step: str, compute: Callable[[], Any]) -> tuple[Any, bool]:
            key = key_of(step, config, plan, seeds)
            known = key in self._kept
            if not known:
                self._kept[key] = compute()
            self._kept.move_to_end(key)
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
            return self._kept[key], known

        return recalled
