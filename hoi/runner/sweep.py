"""The runs of a sweep, whatever launches them: each in a process of its own, so that its end, whatever it is, is one
line and one record, and no concern of the others.
"""

import atexit
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from hydra.core.utils import JobReturn
from omegaconf import DictConfig

from hoi.errors import InputError, RunError
from hoi.runner.execute import execute, is_finished, let_go, record_failure
from hoi.terminal.program import lasting_console

WATCH = 1.0
"""How often a worker looks whether its sweep is still there [s]."""

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""What libraries read when they are imported."""


@dataclass(frozen=True)
class Ended:
    """How a run of a sweep ended."""

    out: str
    """Its folder."""
    failure: str = ""
    """Why it failed, in one line; empty when it is done."""
    planned: bool = False
    """Whether its plan was printed, and no more."""


def run_of_sweep(composed: DictConfig, overrides: list[str], sweep: int) -> Ended:
    """A composed config, run in a process of its own; a failure is recorded and returned, never raised.

    Args:
        sweep: the process that the sweep was started as; its workers on this machine end with it.
    """
    try:
        if composed.plan_only or is_finished(composed):
            execute(composed, overrides)
            return Ended(composed.out, planned=bool(composed.plan_only))
        failure = _in_own_process(composed, overrides, sweep)
    except (InputError, RunError) as error:
        failure = _line(error)
    if failure and not composed.plan_only:
        try:
            record_failure(composed, overrides, failure)
        except (InputError, RunError) as error:
            failure = f"{failure}; it could not be recorded: {_line(error)}"
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


def _in_own_process(composed: DictConfig, overrides: list[str], sweep: int) -> str:
    """Why it failed; empty when it did not.

    The process takes its config from a pipe that stays open, so that it learns when this one dies, and says in another
    why it failed. It has the threads of its config and no more, whatever library asks.
    """
    if multiprocessing.current_process().name.startswith("Loky"):  # a worker of joblib
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the sweep's to handle
        _leave_without(sweep)
        _watch(sweep)
    threads = {} if composed.threads is None else {name: str(composed.threads) for name in THREADS}
    reading, writing = os.pipe()
    process = subprocess.Popen(
        [sys.executable, "-m", "hoi.runner.sweep", str(writing)],
        stdin=subprocess.PIPE, pass_fds=[writing], env=os.environ | threads, start_new_session=True,
    )  # fmt: skip
    os.close(writing)
    try:
        with os.fdopen(reading) as answer:
            assert process.stdin is not None
            process.stdin.write(pickle.dumps((composed, overrides)))
            process.stdin.flush()
            return answer.read() or _death(process.wait())
    except BrokenPipeError:
        return _death(process.wait())
    finally:
        process.kill()
        process.wait()
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


def _death(exitcode: int) -> str:
    """What a run that said nothing died of; empty for one that is done."""
    if exitcode >= 0:
        return f"the process of the run ended with exit code {exitcode}" if exitcode else ""
    name = signal.Signals(-exitcode).name
    out_of_memory = "; the system does so when memory runs out" if name == "SIGKILL" else ""
    return f"the process of the run was ended by {name}{out_of_memory}"


def _line(error: Exception) -> str:
    return "; ".join(str(error).splitlines())


def main() -> None:
    """The process of one run."""
    lasting_console()
    composed, overrides = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_sweep, daemon=True).start()
    failure = ""
    try:
        execute(composed, overrides)
    except (InputError, RunError) as error:
        failure = _line(error)
    except Exception as error:  # a bug, or a library's: the other runs are to be done all the same
        traceback.print_exc()
        failure = f"{type(error).__name__}: {_line(error)}"
    sys.stdout.flush()
    os.write(int(sys.argv[1]), failure.encode(errors="backslashreplace"))
    atexit._run_exitfuncs()
    os._exit(0)  # the thread that waits for the end of stdin would hold up Python's own


def _end_with_sweep() -> None:
    """Ends this process when the one that started it dies."""
    sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    main()
