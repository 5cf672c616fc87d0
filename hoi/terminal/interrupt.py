"""Ctrl-C, whatever the libraries make of it."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

GRACE = 3.0
"""How long an interrupted program has to clean up before it is ended [s]."""

_temporary: set[Path] = set()


@contextmanager
def gone_when_left(path: Path) -> Iterator[None]:
    """The file `path` is removed at the end of the block, also where an interrupt ends the process within it."""
    _temporary.add(path)
    try:
        yield
    finally:
        _temporary.discard(path)
        path.unlink(missing_ok=True)


@contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C in here ends the process with 130.

    Also where a library, while it is imported, swallows the KeyboardInterrupt or makes another error of it. A process
    that was started to ignore the signal goes on ignoring it.
    """
    interrupted = False

    def interrupt(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        watchdog = threading.Timer(GRACE, _leave)
        watchdog.daemon = True
        watchdog.start()
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except BaseException:
        if interrupted:
            _leave()
        raise


def _leave() -> NoReturn:
    """Ends the process at once: at its end Python may raise the signal again, and change the exit code."""
    for path in tuple(_temporary):
        with suppress(OSError):
            path.unlink()
    print("hoi: interrupted; what was not finished is not recorded", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(130)
