"""The process that runs of a sweep go through, one after the other: warm, and alone with what goes wrong in it.

It takes configs from a pipe that stays open, so that it learns when the sweep dies, and says in another why a run
failed. What a run has in common with those before it is not computed again (`hoi.runner.shelf`).
"""

import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
from typing import Any

from omegaconf import DictConfig

from hoi.errors import InputError, RunError
from hoi.terminal.program import lasting_console

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMEXPR_NUM_THREADS")
"""What libraries read when they are imported."""
MOST_RUNS = 40
"""After so many a process makes way for a new one, and so does what libraries keep in it."""


class Worker:
    """Such a process, seen from the sweep. It has so many threads and no more, whatever library asks."""

    def __init__(self, threads: int | None) -> None:
        self.threads, self.runs = threads, 0
        allowed = {} if threads is None else {name: str(threads) for name in THREADS}
        reading, writing = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hoi.runner.worker", str(writing)],
            stdin=subprocess.PIPE, pass_fds=[writing], env=os.environ | allowed, start_new_session=True,
        )  # fmt: skip
        os.close(writing)
        self._answers = os.fdopen(reading)

    @property
    def alive(self) -> bool:
        """Whether it can take another run."""
        return self._process.poll() is None and self.runs < MOST_RUNS

    def run(self, composed: DictConfig, overrides: list[str]) -> str:
        """Why the run failed; empty when it did not."""
        self.runs += 1
        try:
            assert self._process.stdin is not None
            self._process.stdin.write(pickle.dumps((composed, overrides)))
            self._process.stdin.flush()
            answer = self._answers.readline()
        except BrokenPipeError:
            answer = ""
        return json.loads(answer) if answer.endswith("\n") else _death(self._process.wait())

    def end(self) -> None:
        """Whatever it does."""
        self._process.kill()
        self._process.communicate()
        self._answers.close()


def _death(exitcode: int) -> str:
    """What a process that said nothing died of."""
    if exitcode >= 0:
        return f"the process of the run ended with exit code {exitcode}"
    name = signal.Signals(-exitcode).name
    out_of_memory = "; the system does so when memory runs out" if name == "SIGKILL" else ""
    return f"the process of the run was ended by {name}{out_of_memory}"


def one_line(error: Exception) -> str:
    """Its message."""
    return "; ".join(str(error).splitlines())


def main() -> None:
    """The process: runs until the sweep has no more."""
    from hoi.runner.execute import execute
    from hoi.runner.jobs import forget_peak_memory
    from hoi.runner.shelf import Shelf

    lasting_console()
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    at_work = threading.Event()
    threading.Thread(target=_take, args=[waiting, at_work], daemon=True).start()
    shelf = Shelf()
    while (wanted := waiting.get()) is not None:
        at_work.set()
        (composed, overrides), failure = wanted, ""
        forget_peak_memory()
        try:
            execute(composed, overrides, shelf)
        except (InputError, RunError) as error:
            failure = one_line(error)
        except Exception as error:  # a bug, or a library's: the other runs are to be done all the same
            traceback.print_exc()
            failure = f"{type(error).__name__}: {one_line(error)}"
        sys.stdout.flush()
        at_work.clear()
        os.write(int(sys.argv[1]), f"{json.dumps(failure)}\n".encode())


def _take(waiting: "queue.SimpleQueue[Any]", at_work: threading.Event) -> None:
    """Takes configs from the sweep, and ends this process when there is no sweep any more."""
    try:
        while True:
            waiting.put(pickle.load(sys.stdin.buffer))
    except EOFError:
        waiting.put(None)
        if at_work.is_set():
            os._exit(1)


if __name__ == "__main__":
    main()
