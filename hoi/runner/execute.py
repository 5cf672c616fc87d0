"""One composed config: check, plan, run, record. What is there already is not computed again."""

import fcntl
import hashlib
import os
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from omegaconf import DictConfig, OmegaConf

from hoi.config import Config
from hoi.config.validate import completed, to_config
from hoi.data import GaussianCloud, Plan, Run, State
from hoi.errors import InputError
from hoi.plan import check_complete, format_plan, make_plan
from hoi.reports import no_bar
from hoi.stages.render.none import NoVideo
from hoi.terminal.interrupt import gone_when_left

if TYPE_CHECKING:
    from hoi.runner.shelf import Shelf

RECORD, FAILED, LOCK = "run.mcap", "run.failed.mcap", ".lock"


def execute(composed: DictConfig, overrides: list[str], shelf: "Shelf | None" = None) -> list[Path]:
    """The run of a composed config, or its runs, one a seed.

    A folder that another process computes into is waited for.

    Args:
        shelf: where what it has in common with other runs is found and kept.

    Returns:
        the records; none of a plan alone.

    Raises:
        InputError: bad input; found by the plan, nothing is written.
        RunError: the run failed. Where a stage did, for either reason, what it had is in `run.failed.mcap`.
    """
    config = to_config(composed)
    plan = make_plan(config)
    print(format_plan(plan), flush=True)
    if config.plan_only:
        return []
    check_complete(plan)
    from hoi.runner.provenance import provenance

    with ExitStack() as held:
        to_do, records = [], []
        for each, of_seed in seeds(composed, config):
            facts = provenance(of_seed, overrides)
            path = Path(each.out) / RECORD
            records.append(path)
            if not already_there(each, path, facts["config_hash"]):
                held.enter_context(alone(path.parent))
                if not already_there(each, path, facts["config_hash"]):  # meanwhile
                    path.with_name(FAILED).unlink(missing_ok=True)  # of an earlier try
                    to_do.append((each, path, OmegaConf.to_yaml(of_seed, resolve=True), facts))
                    continue
            print(f"{path}: already computed with this config (overwrite=true computes it again)")
            if (video := path.with_suffix(".mp4")).exists():
                print(f"{video}: its video")
        if not to_do:
            return records
        from hoi.runner.jobs import Job, run
        from hoi.terminal.progress import bar

        jobs = [Job(*each) for each in to_do]
        run(jobs, plan, bar, shelf=shelf)
    for _, path, *_ in to_do:
        print(f"recorded {path}")
        if plan.keeps("render"):
            print(f"filmed {path.with_suffix('.mp4')}")
    return records


def run_one(config: Config, cloud: GaussianCloud | None, out: Path | None, progress: bool) -> Run:
    """One run from Python; see `hoi.api.run`."""
    from hoi.runner.jobs import Job, run
    from hoi.runner.provenance import provenance
    from hoi.runner.scene import load_object
    from hoi.terminal.progress import bar

    if config.seeds != 1:
        raise InputError("seeds", config.seeds, "1: call once a seed")
    config = replace(config, out=str(out or ""), render=config.render if out else NoVideo())
    if cloud is not None:  # what its shape is nobody has said: let it settle
        size = float(np.ptp(cloud.means, axis=0).max())
        config = replace(config, object=replace(config.object, size=size, stable=False, shape=None, path=None))
    plan = make_plan(config)
    check_complete(plan)
    structured = OmegaConf.structured(config)
    facts = provenance(structured, [])
    if cloud is not None:
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in vars(cloud).values()))
        facts["sha256.object"] = digest.hexdigest()
        facts["config_hash"] = hashlib.sha256((facts["config_hash"] + digest.hexdigest()).encode()).hexdigest()
    path = None if out is None else out / RECORD
    job = Job(config, path, OmegaConf.to_yaml(structured, resolve=True), facts, tells=progress)
    with ExitStack() as held:
        if path is not None:
            held.enter_context(alone(path.parent))
            if already_there(config, path, facts["config_hash"]):
                from hoi.record import read

                return read(path)
        thing = None if cloud is None else load_object(config, cloud)
        (done,) = run([job], plan, bar if progress else no_bar, thing)
    return done


def what_next(records: list[Path]) -> str:
    """What one may do with them, in a line."""
    return f"next: hoi view {shlex.join(map(str, records[:2]))} (or hoi export, hoi strip, hoi video)"


def is_finished(composed: DictConfig) -> bool:
    """Whether `execute` has nothing to do.

    Raises:
        InputError: bad input, or the folder holds a run of another config.
    """
    from hoi.runner.provenance import config_hash

    each_seed = seeds(composed, to_config(composed))
    return all(already_there(each, Path(each.out) / RECORD, config_hash(of_seed)) for each, of_seed in each_seed)


def seeds(composed: DictConfig, config: Config) -> Iterator[tuple[Config, DictConfig]]:
    """The config of each seed: that of a run of this seed alone, in a folder of its own; as it is recorded."""
    composed = completed(composed)
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


def record_failure(composed: DictConfig, overrides: list[str], reason: str) -> None:
    """A `run.failed.mcap` that says why, of each seed that has left no record itself.

    For what ends without one: bad input, and a process that was killed. A config that cannot be read has one too, at
    the folder of its first seed.
    """
    from hoi.record import write
    from hoi.runner.provenance import provenance

    try:
        config = to_config(composed)
        variant, of_seeds = make_plan(config).variant, [of_seed for _, of_seed in seeds(composed, config)]
    except InputError:
        variant, of_seeds = str(composed.ablation), [composed]
    for of_seed in of_seeds:
        folder = Path(of_seed.out)
        with alone(folder):
            if (folder / RECORD).exists() or (folder / FAILED).exists():
                continue
            facts = provenance(of_seed, overrides)
            result = {"status": "failed", "outcome": reason, "variant": variant}
            plan = Plan(variant, (), (), ())
            text = OmegaConf.to_yaml(of_seed, resolve=True)
            write(Run(text, facts, result, plan, (), (), None, State()), folder / FAILED, plan_text="")


def already_there(config: Config, path: Path, config_hash: str) -> bool:
    """Whether the record at `path` is that of a finished run of this hash, which is not to be computed again.

    Raises:
        InputError: it is a run of another config, or no record.
    """
    if not path.exists() or config.overwrite:
        return False
    from hoi.record import read_metadata

    if read_metadata(path)["config_hash"] == config_hash:
        return True
    raise InputError(f"{path} holds a run of another config; choose another out=DIR or say overwrite=true")


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """No other process computes into `folder`, which is made, in here; a process that dies lets go of it.

    Raises:
        InputError: the folder cannot be written to.
    """
    path = folder / LOCK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _locked(path)
        for part in folder.glob("run*.part"):  # of a process that was killed
            part.unlink()
    except OSError as error:
        raise InputError(f"out: cannot write to {folder}: {error.strerror}") from error
    try:
        with gone_when_left(path):
            yield
    finally:
        os.close(lock)


def let_go(composed: DictConfig) -> None:
    """Remove the locks that a process which was killed has left, but not those that another one holds."""
    for _, of_seed in seeds(composed, to_config(composed)):
        path = Path(of_seed.out) / LOCK
        with suppress(OSError):  # there is none, or it is held
            lock = os.open(path, os.O_RDWR)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock).st_ino == path.stat().st_ino:
                    path.unlink()
            finally:
                os.close(lock)


def _locked(path: Path) -> int:
    """A file descriptor that holds the lock of the file that `path` names then."""
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print(f"{path.parent}: another process computes this run; waiting for it", flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            if os.fstat(lock).st_ino == path.stat().st_ino:
                return lock
        except FileNotFoundError:
            pass
        os.close(lock)  # of a file that its holder has removed
