"""Hydra's basic sweeper, but that one failed run does not hide the others. Hydra looks for plugins in this package."""

import math
from collections.abc import Sequence
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper, BasicSweeperConf
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.core.utils import JobReturn

LATE = ("ablation", "stage", "render")
"""Keys of what acts late in a run: they vary fastest, so that runs with a beginning in common follow on each other."""


class HoiSweeper(BasicSweeper):
    """All combinations of what is listed, one run each; nothing is written but what the runs write."""

    def sweep(self, arguments: list[str]) -> Any:
        """The results of all runs.

        Raises:
            hoi.errors.RunError: some run failed, and it has been said which; or the launcher did.
        """
        from hoi.errors import RunError
        from hoi.runner.sweep import report

        assert self.launcher is not None and self.hydra_context is not None
        parser = OverridesParser.create(config_loader=self.hydra_context.config_loader)
        overrides = parser.parse_overrides([*self._parse_config(), *arguments])
        overrides.sort(key=_is_late)
        results: list[Sequence[JobReturn]] = []
        count = 0
        batches = self.split_arguments(overrides, self.max_batch_size)
        self._keep_together(sum(map(len, batches)), math.prod(_length(each) for each in overrides if _is_late(each)))
        for batch in batches:
            self.validate_batch_is_legal(batch)
            try:
                results.append(self.launcher.launch(batch, initial_job_idx=count))
            except Exception as error:  # a worker of its own was killed, the cluster refused, ...
                why = str(error).strip().partition("\n")[0]
                raise RunError(
                    f"the launcher stopped: {type(error).__name__}: {why}; the same command goes on from here"
                ) from error
            count += len(batch)
        report([result for batch in results for result in batch])
        return results

    def _keep_together(self, runs: int, alike: int) -> None:
        """Has joblib give so many runs that have a beginning in common to one worker, while there is work for all."""
        settings = getattr(self.launcher, "joblib", None)
        if settings is None or settings.get("batch_size") != "auto":
            return
        from joblib import effective_n_jobs

        settings["batch_size"] = min(alike, math.ceil(runs / effective_n_jobs(settings["n_jobs"])))


def _is_late(override: Override) -> bool:
    return override.get_key_element().startswith(LATE)


def _length(override: Override) -> int:
    """How many values it lists."""
    return sum(1 for _ in override.sweep_string_iterator()) if override.is_sweep_override() else 1


ConfigStore.instance().store(
    group="hydra/sweeper",
    name="hoi",
    node=BasicSweeperConf(_target_=f"{HoiSweeper.__module__}.{HoiSweeper.__name__}"),
    provider="hoi",
)
