"""Command lines that say what is wrong with them in one line."""

import argparse
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """As argparse's, of a `prog` "python -m PACKAGE.COMMAND"; what it refuses ends with "COMMAND: why" and code 2."""

    def error(self, message: str) -> NoReturn:
        command = self.prog.split()[2].rpartition(".")[2]
        self.exit(2, f"{command}: {message}; --help tells what is allowed\n")
