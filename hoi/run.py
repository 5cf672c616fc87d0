"""The front door: compose, check, plan, run, record. No science here.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1

Exit codes: 0 done; 2 bad input; 3 the run itself failed; 130 interrupted.
"""

import os
import signal
import sys
import threading
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, Config, register
from hoi.errors import InputError, RunError
from hoi.plan import format_plan, make_plan
from hoi.validate import to_config


def execute(composed: DictConfig, overrides: list[str]) -> None:
    """One run from its composed config.

    Raises:
        InputError: bad input, before anything is written.
        RunError: the run failed; what it had is in `run.failed.mcap`.
    """
    config = to_config(composed)
    plan = make_plan(config)
    print(format_plan(plan), flush=True)
    if config.plan_only:
        return
    from hoi.provenance import provenance

    facts = provenance(config, composed, overrides)
    path = Path(config.out) / "run.mcap"
    video = path.with_suffix(".mp4")
    if _already_there(config, path, facts["config_hash"]):
        print(f"{path}: already computed with this config (overwrite=true computes it again)")
        if video.exists():
            print(f"{video}: its video")
        return
    _make_folder(path.parent)
    from hoi.pipeline import run

    run(config, plan, path, OmegaConf.to_yaml(composed, resolve=True), facts)
    print(f"recorded {path}")
    if plan.keeps("render"):
        print(f"filmed {video}")


def _already_there(config: Config, path: Path, config_hash: str) -> bool:
    if not path.exists() or config.overwrite:
        return False
    from hoi.record import read_metadata

    if read_metadata(path)["config_hash"] == config_hash:
        return True
    raise InputError(f"{path} holds a run of another config; choose another out=DIR or say overwrite=true")


def _make_folder(folder: Path) -> None:
    probe = folder / f".write-test-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"out: cannot write to {folder}: {error.strerror}") from error


def _one_line(error: BaseException) -> str:
    """Hydra's and OmegaConf's messages without their stack of context lines."""
    message = str(error).partition("Config search path")[0]
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    cause = error.__cause__ or error.__context__
    if isinstance(error, HydraException) and isinstance(cause, OmegaConfBaseException):
        return _one_line(cause)
    key = getattr(error, "full_key", None)
    text = " ".join(line for line in lines if not line.startswith(("full_key:", "object_type=", "reference_type=")))
    return f"{key}: {text}" if key and key not in text else text


GRACE = 3.0
"""How long an interrupted run has to clean up before it is ended [s]."""


def end_when_interrupted() -> None:
    """From now on Ctrl-C ends the process with 130, also where a library swallows the KeyboardInterrupt.

    Some do while they are imported. A process that was started to ignore the signal goes on ignoring it.
    """

    def interrupt(*_: object) -> None:
        watchdog = threading.Timer(GRACE, leave_interrupted)
        watchdog.daemon = True
        watchdog.start()
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)


def leave_interrupted() -> NoReturn:
    """Ends the process at once: at its end Python may raise the signal again, and change the exit code."""
    print("hoi: interrupted, nothing recorded", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(130)


def main() -> None:
    """Entry point of `python -m hoi.run` and of the `hoi` command."""
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        sys.exit(f"hoi needs Python 3.11 to 3.13 (what taichi has wheels for), this is {sys.version.split()[0]}")
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors come to us instead of being printed with a traceback
    end_when_interrupted()
    register()
    code = 0

    def job(composed: DictConfig) -> None:
        nonlocal code
        from hydra.core.hydra_config import HydraConfig

        settings = HydraConfig.get()
        try:
            execute(composed, list(settings.overrides.task))
        except (InputError, RunError) as error:
            if settings.mode is not None and settings.mode.name == "MULTIRUN":
                raise  # the sweeper reports it and goes on with the other jobs
            print(f"hoi: {error}", file=sys.stderr)
            code = 2 if isinstance(error, InputError) else 3

    try:
        hydra.main(version_base="1.3", config_path=str(CONF), config_name="config")(job)()
    except KeyboardInterrupt:
        leave_interrupted()
    except RunError as error:
        print(f"hoi: {error}", file=sys.stderr)
        code = 3
    except (InputError, HydraException, OmegaConfBaseException) as error:
        print(f"hoi: {_one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"hoi: {error.filename}: {error.strerror}", file=sys.stderr)
        code = 2
    sys.exit(code)


if __name__ == "__main__":
    main()
