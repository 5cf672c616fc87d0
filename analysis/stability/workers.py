"""Runs many cases in processes of their own: Taichi is one per process, and a crash there is one case's failure."""

import multiprocessing
import queue
import signal
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from itertools import groupby

from .blow_trial import verdict_of as judged_blow
from .blows import Blow
from .cases import Case
from .trial import attempt
from .verdict import Verdict, judge

TIME_LIMIT = 120.0
"""A case that has not come back by then has hung [s]."""
BATCH = 12
"""Cases of one compile key handed to a worker at once: compiling takes longer than most cases."""


def verdict_of(case: Case | Blow) -> Verdict:
    """Runs and judges one case in this process."""
    return judged_blow(case) if isinstance(case, Blow) else judge(attempt(case))


def run_all(cases: Iterable[Case | Blow], jobs: int) -> Iterator[tuple[Case | Blow, Verdict]]:
    """Each case with its verdict as it comes, from `jobs` processes; leaving the loop early kills them."""
    cases = list(cases)
    batches: queue.SimpleQueue[list[Case | Blow]] = queue.SimpleQueue()
    for batch in _batches(cases):
        batches.put(batch)
    done: queue.SimpleQueue[tuple[Case | Blow, Verdict]] = queue.SimpleQueue()
    stop = threading.Event()
    for _ in range(jobs):
        threading.Thread(target=_work, args=(batches, done, stop), daemon=True).start()
    try:
        for _ in cases:
            yield done.get()
    finally:
        stop.set()
        for process in multiprocessing.active_children():
            process.kill()


def _batches(cases: Iterable[Case | Blow]) -> list[list[Case | Blow]]:
    """Runs of cases that share compiled kernels, the most work first so that no worker is left with it at the end."""
    batches = []
    for _, group in groupby(sorted(cases, key=lambda case: case.compile_key), key=lambda case: case.compile_key):
        members = sorted(group, key=lambda case: case.particles, reverse=True)
        batches += [members[start : start + BATCH] for start in range(0, len(members), BATCH)]
    return sorted(batches, key=lambda batch: batch[0].particles > 5000, reverse=True)


def _work(
    batches: "queue.SimpleQueue[list[Case | Blow]]",
    done: "queue.SimpleQueue[tuple[Case | Blow, Verdict]]",
    stop: threading.Event,
) -> None:
    """One worker's thread: batch after batch in one process, which is replaced when it dies."""
    executor = _process()
    with suppress(queue.Empty):
        while batch := batches.get_nowait():
            for case in batch:
                if stop.is_set():
                    return
                try:
                    verdict = executor.submit(verdict_of, case).result(TIME_LIMIT)
                except (BrokenProcessPool, TimeoutError) as error:
                    hung = isinstance(error, TimeoutError)
                    verdict = Verdict("failed", f"no end after {TIME_LIMIT:g} s" if hung else "the process died")
                    executor.shutdown(wait=False, cancel_futures=True)
                    executor = _process()
                done.put((case, verdict))


def _process() -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=context, initializer=signal.signal,
                               initargs=(signal.SIGINT, signal.SIG_IGN))  # fmt: skip
