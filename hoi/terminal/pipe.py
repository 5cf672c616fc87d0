"""`| head`: a reader of standard output that has seen enough ends the program, and not with an error message."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

ENDED = 128 + signal.SIGPIPE
"""The exit code that shells give to a program that ends so."""


@contextmanager
def until_unread() -> Iterator[None]:
    """What is printed in here is written out; where nobody reads any more, the program ends."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at its end
        sys.exit(ENDED)
