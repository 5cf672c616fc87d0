"""The runs of a sweep, whatever launches them: in a process beside it, so that the end of a run, whatever it is, is one
line and one record, and no concern of the others.
"""

import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

from hydra.core.utils import JobReturn
from omegaconf import DictConfig

from hoi.errors import InputError, RunError
from hoi.runner.execute import execute, is_finished, let_go, record_failure
from hoi.runner.worker import Worker, one_line

WATCH = 1.0
"""How often a worker looks whether its sweep is still there [s]."""

_WORKERS: list[Worker] = []
"""The one that runs of this process go through, once there is one."""


@dataclass(frozen=True)
class Ended:
    """How a run of a sweep ended."""

    out: str
    """Its folder."""
    failure: str = ""
    """Why it failed, in one line; empty when it is done."""
    planned: bool = False
    """Whether its plan was printed, and no more."""


@dataclass(frozen=True)
class Sweep:
    """What was started on the command line."""

    process: int = field(default_factory=os.getpid)
    """Its workers on this machine end with it."""
    folder: str = field(default_factory=os.getcwd)
    """Where it was started: the folders of its runs are named from there, on other machines too."""


def run_of_sweep(composed: DictConfig, overrides: list[str], sweep: Sweep) -> Ended:
    """A composed config, run in a process beside this one; a failure is recorded and returned, never raised."""
    try:
        os.chdir(sweep.folder)  # a worker of Ray starts elsewhere
    except OSError as error:
        return Ended(composed.out, f"{socket.gethostname()} does not see {sweep.folder}: {error.strerror}")
    try:
        if composed.plan_only or is_finished(composed):
            execute(composed, overrides)
            return Ended(composed.out, planned=bool(composed.plan_only))
        failure = _in_own_process(composed, overrides, sweep)
    except (InputError, RunError) as error:
        failure = one_line(error)
    if failure and not composed.plan_only:
        try:
            record_failure(composed, overrides, failure)
        except (InputError, RunError) as error:
            failure = f"{failure}; it could not be recorded: {one_line(error)}"
    return Ended(composed.out, failure)


def report(results: Sequence[JobReturn]) -> None:
    """Say of each run that failed why.

    Raises:
        RunError: there is one.
    """
    ended = [run for result in results if isinstance(run := result.return_value, Ended)]
    failed = [run for run in ended if run.failure]
    for run in failed:
        print(f"hoi: {run.out}: {run.failure}", file=sys.stderr)
    if failed:
        raise RunError(f"{len(failed)} of {len(ended)} runs failed; the same command tries them again, and no others")
    if ended and all(run.planned for run in ended):
        print(f"the plans of {len(ended)} runs; none of them was run")
    elif ended:
        print(f"all {len(ended)} runs of the sweep are done")


def _in_own_process(composed: DictConfig, overrides: list[str], sweep: Sweep) -> str:
    """Why it failed; empty when it did not. The process is that of earlier runs of this one, if it is still fit."""
    if multiprocessing.current_process().name.startswith("Loky"):  # a worker of joblib
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the sweep's to handle
        _leave_without(sweep.process)
        _watch(sweep.process)
    for worker in list(_WORKERS):
        if not worker.alive or worker.threads != composed.threads:
            _WORKERS.remove(worker)
            worker.end()
    if not _WORKERS:
        _WORKERS.append(Worker(composed.threads))
    (worker,) = _WORKERS
    try:
        return worker.run(composed, overrides)
    except BaseException:  # an interrupt: what it does is wanted no more
        _WORKERS.remove(worker)
        worker.end()
        raise
    finally:
        let_go(composed)


@cache
def _watch(sweep: int) -> None:
    """Looks now and then, from now on, whether the sweep is still there."""

    def watch() -> None:
        while True:
            time.sleep(WATCH)
            _leave_without(sweep)

    threading.Thread(target=watch, daemon=True).start()


def _leave_without(sweep: int) -> None:
    """Ends this process if the sweep has been killed: it leaves nobody at work."""
    if os.getppid() != sweep:
        os._exit(1)
