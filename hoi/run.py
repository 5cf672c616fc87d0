"""The front door: compose, check, plan, run, record. No science here.

    python -m hoi.run scene=kick_soccer_ball ablation=no_mpm seed=1

Exit codes: 0 done; 2 bad input; 3 the run itself failed; 130 interrupted.
"""

import os
import sys
from collections.abc import Iterator
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
    """The run of a composed config, or its runs, one a seed.

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

    to_do = []
    for each, of_seed in _seeds(composed, config):
        facts = provenance(each, of_seed, overrides)
        path = Path(each.out) / "run.mcap"
        if not _already_there(each, path, facts["config_hash"]):
            to_do.append((each, path, OmegaConf.to_yaml(of_seed, resolve=True), facts))
            continue
        print(f"{path}: already computed with this config (overwrite=true computes it again)")
        if (video := path.with_suffix(".mp4")).exists():
            print(f"{video}: its video")
    if not to_do:
        return
    for _, path, *_ in to_do:
        _make_folder(path.parent)
    from hoi.pipeline import Job, run

    jobs = [Job(*each) for each in to_do]
    run(jobs, plan)
    for job in jobs:
        print(f"recorded {job.path}")
        if plan.keeps("render"):
            print(f"filmed {job.path.with_suffix('.mp4')}")


def _seeds(composed: DictConfig, config: Config) -> Iterator[tuple[Config, DictConfig]]:
    """The config of each seed: that of a run of this seed alone, in a folder of its own."""
    if config.seeds == 1:
        yield config, composed
        return
    numbers = range(config.seed, config.seed + config.seeds)
    folders = {number: str(OmegaConf.merge(composed, {"seed": number}).out) for number in numbers}
    if len(set(folders.values())) < len(numbers):  # `out` does not name the seed
        folders = {number: f"{config.out}/s{number}" for number in numbers}
    for number, folder in folders.items():
        of_seed = OmegaConf.merge(composed, {"seed": number, "seeds": 1, "out": folder})
        assert isinstance(of_seed, DictConfig)
        yield to_config(of_seed), of_seed


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


def one_line(error: BaseException) -> str:
    """Hydra's and OmegaConf's messages without their stack of context lines."""
    message = str(error).partition("Config search path")[0]
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    cause = error.__cause__ or error.__context__
    if isinstance(error, HydraException) and isinstance(cause, OmegaConfBaseException):
        return one_line(cause)
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
        print(f"hoi: {one_line(error)}", file=sys.stderr)
        code = 2
    except OSError as error:
        print(f"hoi: {error.filename}: {error.strerror}", file=sys.stderr)
        code = 2
    return code


if __name__ == "__main__":
    main()
