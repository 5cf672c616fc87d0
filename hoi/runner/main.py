"""The command line of a run: compose, and hand on to `hoi.runner.execute`. No science here.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1
    python -m hoi.run --config-dir sweeps --config-name ablations

Exit codes: 0 done; 2 bad input; 3 the run itself, or one of a sweep, failed; 130 interrupted.
"""

import os
import sys

import hydra
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, register
from hoi.config.compose import one_line
from hoi.errors import InputError, RunError
from hoi.runner.execute import execute, what_next
from hoi.runner.sweep import Ended, run_of_sweep
from hoi.terminal.interrupt import interruptible
from hoi.terminal.pipe import ENDED, until_unread


def main() -> None:
    """Entry point of `python -m hoi.run`, which is `hoi run`."""
    if sys.version_info < (3, 11):  # noqa: UP036 - what starts this may be any
        sys.exit(f"hoi needs Python 3.11 or newer, this is {sys.version.split()[0]}")
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors come to us instead of being printed with a traceback
    with interruptible(), until_unread():
        sys.exit(_compose_and_execute())


def _compose_and_execute() -> int:
    """All jobs of the command line; the exit code."""
    register()
    _share_config_store()
    code, this = 0, os.getpid()

    def job(composed: DictConfig) -> Ended | None:
        nonlocal code
        from hydra.core.hydra_config import HydraConfig

        settings = HydraConfig.get()
        overrides = list(settings.overrides.task)
        if settings.mode is not None and settings.mode.name == "MULTIRUN":
            return run_of_sweep(composed, overrides, this)
        try:
            if records := execute(composed, overrides):
                print(what_next(records))
        except (InputError, RunError) as error:
            print(f"hoi: {error}", file=sys.stderr)
            code = 2 if isinstance(error, InputError) else 3
        except BrokenPipeError:  # Hydra would tell of it; `until_unread` ends the program
            code = ENDED
        return None

    try:
        hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)()
    except RunError as error:
        print(f"hoi: {error}", file=sys.stderr)
        code = 3
    except (InputError, HydraException, OmegaConfBaseException) as error:
        print(f"hoi: {one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"hoi: {error.filename}: {error.strerror}", file=sys.stderr)
        code = 2
    return code


def _share_config_store() -> None:
    """Hydra copies its store of schemas, one for all, with every group that it looks into: a second of --help."""
    ConfigStore.__deepcopy__ = lambda self, memo: self  # pyright: ignore[reportAttributeAccessIssue]
