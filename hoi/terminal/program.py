"""A command from its start to its exit code, whatever becomes of the console around it."""

import io
import os
import sys
from collections.abc import Callable
from typing import Any, NoReturn

from hoi.terminal.interrupt import interruptible


class Console(io.TextIOWrapper):
    """A standard stream that outlives its reader, and can say whatever a command has to say.

    Where nobody reads any more (`| head`), what is written goes nowhere; what its encoding has not is escaped.
    """

    lost: OSError | None = None
    """Why what was written has not arrived, where it should have."""

    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        if not isinstance(error, BrokenPipeError):
            self.lost = error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def lasting_console() -> None:
    """Makes stdout and stderr a `Console` each; one that was closed is as one that nobody reads."""
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))
        elif isinstance(stream, io.TextIOWrapper) and stream is getattr(sys, f"__{name}__"):
            stream.flush()
            encoding, lines = stream.encoding, stream.line_buffering
            console = Console(
                stream.detach(), encoding, "backslashreplace", line_buffering=lines, write_through=not lines
            )
            setattr(sys, name, console)
            setattr(sys, f"__{name}__", console)  # or libraries take it for a notebook's


def arrived(code: int | None = 0) -> int:
    """An exit code, or 3 and a line where stdout could not be written to."""
    sys.stdout.flush()
    if (lost := getattr(sys.stdout, "lost", None)) is None:
        return code or 0
    print(f"hoi: stdout cannot be written to: {lost.strerror}", file=sys.stderr)
    return code or 3


def program(main: Callable[[], int | None]) -> NoReturn:
    """Ends the process with what `main` returns; with 130 after Ctrl-C, with 3 where stdout could not be written to."""
    lasting_console()
    with interruptible():
        try:
            code = main()
        except SystemExit as ended:
            if not isinstance(ended.code, int | None):
                raise
            code = ended.code
        code = arrived(code)
    sys.exit(code)
