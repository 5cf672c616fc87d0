"""The front door: compose, check, plan, run, record. No science here.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1

Exit codes: 0 done; 2 bad input; 3 the run itself failed; 130 interrupted.
"""

import os
import sys
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from hoi.config import CONF, Config, register
from hoi.errors import InputError, RunError
from hoi.interrupt import interruptible
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


def main() -> None:
    """Entry point of `python -m hoi.run` and of the `hoi` command."""
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        sys.exit(f"hoi needs Python 3.11 to 3.13 (what taichi has wheels for), this is {sys.version.split()[0]}")
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors come to us instead of being printed with a traceback
    with interruptible():
        sys.exit(_compose_and_execute())


def _compose_and_execute() -> int:
    """All jobs of the command line; the exit code."""
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
    except RunError as error:
        print(f"hoi: {error}", file=sys.stderr)
        code = 3
    except (InputError, HydraException, OmegaConfBaseException) as error:
        print(f"hoi: {_one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"hoi: {error.filename}: {error.strerror}", file=sys.stderr)
        code = 2
    return code


if __name__ == "__main__":
    main()
