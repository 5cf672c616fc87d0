"""A scene that answers while it is being set up, in the browser.

    python -m hoi.live [scene=NAME ...] [--port 8080] [--open]      (the same: hoi view --live ...)

Sentence, object, material, seed and the attraction's weight are controls, the object is moved by its handle. What is
seen can be recorded as a run. Exit codes: 0 ended with Ctrl-C; 2 bad input; 3 the first run failed.
"""

import importlib.util
import sys
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.arguments import Parser
from hoi.terminal.interrupt import interruptible
from hoi.terminal.program import program
from hoi.view.serving import add_server_options, serve


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m hoi.live`; the exit code."""
    parser = Parser(
        prog="python -m hoi.live",
        description="A scene in the browser that is made anew whenever its controls change.",
        epilog='example: python -m hoi.live scene=kick_soccer_ball "stage.coordinate.iterations=120" --open',
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="as of python -m hoi.run")
    parser.add_argument("-o", "--folder", type=Path, default=Path("runs/live"), help="of records (%(default)s)")
    add_server_options(parser)
    options = parser.parse_args(arguments)
    try:
        if importlib.util.find_spec("viser") is None:
            raise InputError("needs hoi[view]: pip install 'hoi[view]'")
        with interruptible():
            from hoi.live.studio import Studio
            from hoi.terminal.progress import bar

            overrides = ["experiment=live", *options.overrides]
            studio = Studio(overrides, options.folder, options.host, options.port, bar)
    except InputError as error:
        print(*(f"live: {line}" for line in str(error).splitlines()), sep="\n", file=sys.stderr)
        return 2
    except RunError as error:
        print(f"live: {error}", file=sys.stderr)
        return 3
    return serve(studio.viewer.port, options, studio.stop)


if __name__ == "__main__":
    program(main)
