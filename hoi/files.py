"""Files and folders written whole or not at all, and where those of the package are."""

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hoi.errors import InputError, RunError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors that are the disk's, and not those of the path."""
CONF = Path(__file__).parent / "conf"
"""The folder of the configs that come with hoi."""
if not CONF.is_dir():  # a checkout: the folder stands beside the package, a wheel carries it inside
    CONF = Path(__file__).parents[1] / "conf"


def check_downloaded(path: Path, said: str = "") -> None:
    """Raises InputError where a file is a web page or a pointer that was saved in the place of what was meant."""
    try:
        with path.open("rb") as file:
            start = file.read(512).lstrip().lower()
    except OSError:
        return  # whoever reads it says so
    if start.startswith((b"<!doctype", b"<html", b"<?xml", b"<head")):
        what = "a web page, not the file that it speaks of; download it again, perhaps logged in"
    elif start.startswith(b"version https://git-lfs"):
        what = "a pointer of Git LFS, not the file itself; git lfs pull fetches it"
    else:
        return
    raise InputError(f"{said}{path} is {what}")


@contextmanager
def whole_file(path: Path, remedy: str = "", elsewhere: str = "write elsewhere") -> Iterator[Path]:
    """A path beside `path` to write to, which takes its place when the block ends well and is removed when not.

    Args:
        remedy: what a path that cannot be written to is told.
        elsewhere: what else a full disk is told.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    part = path.with_name(path.name + ".part")
    with _writing(path, remedy, elsewhere):
        try:
            yield part
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path, ours: str) -> Iterator[Path]:
    """A folder beside `path` to write to, which takes its place when the block ends well and is removed when not.

    Args:
        ours: pattern of the names that a folder of the same kind has; one that holds anything else is not replaced.

    Raises:
        InputError: the path cannot be written to, or holds something else.
        RunError: the disk is full or broken.
    """
    part, old = path.with_name(f".{path.name}.part"), path.with_name(f".{path.name}.old")
    with _writing(path):
        if old.exists() and not path.exists():  # another run was killed between the two names
            old.rename(path)
        there = [entry.name for entry in path.iterdir()] if path.exists() else []
        if foreign := [name for name in there if not re.fullmatch(ours, name)]:
            raise InputError(f"{path} holds {foreign[0]}, which is not of this export; name another folder with -o")
        for left in (part, old):
            shutil.rmtree(left, ignore_errors=True)
        part.mkdir()
        try:
            yield part
            if path.exists():
                path.rename(old)
            part.rename(path)
            shutil.rmtree(old, ignore_errors=True)
        finally:
            if old.exists() and not path.exists():
                old.rename(path)
            shutil.rmtree(part, ignore_errors=True)


@contextmanager
def _writing(path: Path, remedy: str = "", elsewhere: str = "write elsewhere") -> Iterator[None]:
    try:
        yield
    except OSError as error:  # PyAV's errors of the system are OSErrors too
        if error.errno in FULL:
            raise RunError(f"cannot write {path}: {error.strerror}; free some space or {elsewhere}") from error
        raise InputError(f"cannot write {path}: {error.strerror}{remedy}") from error
