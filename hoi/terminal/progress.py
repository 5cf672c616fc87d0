"""One progress bar a stage."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from hoi.reports import Advance


@contextmanager
def bar(name: str, total: int) -> Iterator[Advance]:
    """On stderr; whole when the block ends without an error."""
    interval = 0.1 if sys.stderr.isatty() else 10.0  # a log file wants a line, not a film
    with tqdm(total=total, desc=f"{name:>12}", mininterval=interval, dynamic_ncols=True) as shown:
        yield shown.update
        shown.update(total - shown.n)
