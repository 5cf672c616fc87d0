"""Where what can be computed again is kept: the user's cache folder, if there is one that can be written to.

A process may have no HOME, one that is read-only, or a user whom the system does not know (as in containers).
"""

import atexit
import functools
import os
import shutil
import tempfile
from pathlib import Path


def user_caches() -> Path | None:
    """XDG_CACHE_HOME, or else .cache at home, which is made if need be; None where it cannot be written to."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        if not folder.is_absolute():  # means nothing
            return None
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError, ValueError):  # RuntimeError: nobody knows where home is
        return None


@functools.cache
def caches() -> Path | None:
    """The same, or else a folder that goes when this process does; None where even that cannot be made."""
    if (folder := user_caches()) is not None:
        return folder
    try:
        made = Path(tempfile.mkdtemp(prefix="hoi-"))
    except OSError:
        return None
    owner = os.getpid()
    atexit.register(lambda: os.getpid() == owner and shutil.rmtree(made, ignore_errors=True))
    return made
