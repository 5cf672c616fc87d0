"""The command line of a run: compose, and hand on to `hoi.runner.execute`. No science here.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1
    python -m hoi.run "a person kicks the ball with the left foot"
    python -m hoi.run --config-dir sweeps --config-name ablations

Exit codes: 0 done; 2 bad input; 3 the run itself, or one of a sweep, failed; 130 interrupted.
"""

import os
import sys

import hydra
from hydra._internal.hydra import Hydra
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, register
from hoi.config.compose import one_line, raised_by_hydra, settled
from hoi.errors import InputError, RunError
from hoi.runner.arguments import arguments
from hoi.runner.execute import execute, what_next
from hoi.runner.sweep import Ended, Sweep, run_of_sweep
from hoi.terminal.program import program

OUR_SWEEPERS = "hydra_plugins.hoi_"
"""They report what failed; others know nothing of it."""


def main() -> None:
    """Entry point of `python -m hoi.run`, which is `hoi run`."""
    if sys.version_info < (3, 11):  # noqa: UP036 - what starts this may be any
        sys.exit(f"hoi needs Python 3.11 or newer, this is {sys.version.split()[0]}")
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors come to us instead of being printed with a traceback
    program(_compose_and_execute)


def _compose_and_execute() -> int:
    """All jobs of the command line; the exit code."""
    code = 0

    def job(composed: DictConfig) -> Ended | None:
        nonlocal code
        from hydra.core.hydra_config import HydraConfig

        settings = HydraConfig.get()
        overrides, composed = list(settings.overrides.task), settled(composed)
        if settings.mode is not None and settings.mode.name == "MULTIRUN":
            ended = run_of_sweep(composed, overrides, sweep)
            if ended.failure and not settings.sweeper._target_.startswith(OUR_SWEEPERS):
                raise RunError(f"{ended.out}: {ended.failure}")  # nobody else would say so
            return ended
        try:
            if records := execute(composed, overrides):
                print(what_next(records))
        except (InputError, RunError) as error:
            print(f"hoi: {error}", file=sys.stderr)
            code = 2 if isinstance(error, InputError) else 3
        return None

    try:
        sweep = Sweep()
        sys.argv[1:] = arguments(sys.argv[1:])
        register()
        _share_config_store()
        Hydra.get_mode = _mode  # pyright: ignore[reportAttributeAccessIssue]
        hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)()
    except RunError as error:
        print(f"hoi: {error}", file=sys.stderr)
        code = 3
    except (InputError, HydraException, OmegaConfBaseException) as error:
        print(f"hoi: {one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        where = error.filename or "the folder that this was started in"  # it may be gone
        print(f"hoi: {where}: {error.strerror}", file=sys.stderr)
        code = 2
    except Exception as error:
        if not raised_by_hydra(error):
            raise
        print(f"hoi: {one_line(error)}", file=sys.stderr)
        code = 2
    return code


def _mode(hydra: Hydra, config_name: str | None, overrides: list[str]) -> RunMode | None:
    """Whether the config asks for a sweep. Hydra's own takes a sweep's that cannot be composed for a single run's,
    and only says that its lists are ambiguous."""
    loaded = hydra.config_loader.load_configuration(
        config_name, overrides, RunMode.MULTIRUN, from_shell=False, validate_sweep_overrides=False
    )
    return loaded.hydra.mode


def _share_config_store() -> None:
    """Hydra copies its store of schemas, one for all, with every group that it looks into: a second of --help."""
    ConfigStore.__deepcopy__ = lambda self, memo: self  # pyright: ignore[reportAttributeAccessIssue]
