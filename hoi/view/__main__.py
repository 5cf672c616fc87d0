"""Finished runs in the browser, from their records alone.

    python -m hoi.view RUN.mcap [RUN2.mcap ...] [--port 8080] [--open]
    hoi view --live [scene=NAME ...]        (a scene that is being set up: python -m hoi.live)

Several runs are seen side by side in one clock. Exit codes: 0 ended with Ctrl-C; 2 bad input.
"""

import argparse
import importlib.util
import sys
from pathlib import Path

from hoi.errors import InputError
from hoi.terminal.arguments import Parser
from hoi.terminal.interrupt import interruptible
from hoi.terminal.program import program
from hoi.view.serving import add_server_options, serve


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m hoi.view",
        description="Finished runs as a moving 3D scene in the browser; several are seen side by side.",
        epilog="example: python -m hoi.view runs/kick_soccer_ball/laptop/full/s0/run.mcap --open",
    )
    add = parser.add_argument
    add("records", type=Path, nargs="+", metavar="RUN.mcap")
    add_server_options(parser)
    add("--paused", action="store_true", help="do not play at once")
    add("--live", action=_Live, nargs=0, help="of `hoi view` alone: a scene that is being set up, python -m hoi.live")
    return parser


class _Live(argparse.Action):
    """Another program's."""

    def __call__(self, parser: argparse.ArgumentParser, *args: object) -> None:
        parser.error("--live is another program: hoi view --live scene=NAME, or python -m hoi.live scene=NAME")


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m hoi.view`; the exit code."""
    options = _parser().parse_args(arguments)
    try:
        if importlib.util.find_spec("viser") is None:
            raise InputError("needs hoi[view]: pip install 'hoi[view]'")
        with interruptible():
            from hoi.view.viewer import of_records

            viewer = of_records(options.records, options.host, options.port, playing=not options.paused)
    except InputError as error:
        print(f"view: {error}", file=sys.stderr)
        return 2
    return serve(viewer.port, options, viewer.stop)


if __name__ == "__main__":
    program(main)
