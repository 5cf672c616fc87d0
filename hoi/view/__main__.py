"""Finished runs in the browser, from their records alone.

    python -m hoi.view RUN.mcap [RUN2.mcap ...] [--port 8080] [--open]

Several runs are seen side by side in one clock. Exit codes: 0 ended with Ctrl-C; 2 bad input.
"""

import argparse
import importlib.util
import sys
import threading
import webbrowser
from pathlib import Path

from hoi.errors import InputError
from hoi.terminal.arguments import Parser
from hoi.terminal.interrupt import interruptible
from hoi.terminal.program import program


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text}: allowed is 0 to 65535, 0 takes any that is free")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m hoi.view",
        description="Finished runs as a moving 3D scene in the browser; several are seen side by side.",
        epilog="example: python -m hoi.view runs/kick_soccer_ball/laptop/full/s0/run.mcap --open",
    )
    add = parser.add_argument
    add("records", type=Path, nargs="+", metavar="RUN.mcap")
    add("--port", type=_port, default=8080, help="where to listen; 0 takes any that is free (default: %(default)s)")
    add("--host", default="127.0.0.1", help="0.0.0.0 lets other machines look, too (default: %(default)s)")
    add("--open", action="store_true", help="open the browser")
    add("--paused", action="store_true", help="do not play at once")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m hoi.view`; the exit code."""
    options = _parser().parse_args(arguments)
    try:
        if importlib.util.find_spec("viser") is None:
            raise InputError("needs hoi[view]: pip install 'hoi[view]'")
        with interruptible():
            from hoi.view.viewer import Viewer

            viewer = Viewer(options.records, options.host, options.port, playing=not options.paused)
    except InputError as error:
        print(f"view: {error}", file=sys.stderr)
        return 2
    try:
        host = "localhost" if options.host in ("127.0.0.1", "0.0.0.0", "::") else options.host
        url = f"http://[{host}]:{viewer.port}" if ":" in host else f"http://{host}:{viewer.port}"
        print(f"{url}  (Ctrl-C ends it)", flush=True)
        if options.open:
            webbrowser.open(url)
        threading.Event().wait()
    except KeyboardInterrupt:
        viewer.stop()
    return 0


if __name__ == "__main__":
    program(main)
