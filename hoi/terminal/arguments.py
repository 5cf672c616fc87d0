"""Command lines that say what is wrong with them in one line."""

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from hoi.errors import InputError


class Parser(argparse.ArgumentParser):
    """As argparse's, of a `prog` "python -m PACKAGE.COMMAND"; what it refuses ends with "COMMAND: why" and code 2."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.split()[2].rpartition(".")[2]
        self.exit(2, f"{command}: {message}; --help tells what is allowed\n")


def refusing(command: Callable[[], object]) -> int:
    """Does what a command does; its exit code: 0, or 2 after the line of an `InputError`."""
    try:
        command()
    except InputError as error:
        print(f"hoi: {error}", file=sys.stderr)
        return 2
    return 0
