"""How Foxglove and Rerun show a record.

`foxglove` writes a layout, which Foxglove takes under Layouts, Import from file, and which suits every record.
`rerun` opens one record in Rerun's viewer, or writes what that shows to a file .rrd, which `rerun FILE.rrd` opens.
Exit codes: 0 done; 2 bad input; 3 the disk is full or broken; 130 interrupted.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.arguments import Parser
from hoi.terminal.program import program

EXAMPLES = """examples:
  python -m hoi.view.layouts foxglove -o hoi.foxglove.json
  python -m hoi.view.layouts rerun runs/kick_soccer_ball/laptop/full/s0/run.mcap
  python -m hoi.view.layouts rerun RUN.mcap -o run.rrd
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `python -m hoi.view.layouts`; the exit code."""
    parser = Parser(
        prog="python -m hoi.view.layouts",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    viewers = parser.add_subparsers(dest="viewer", required=True, metavar="{foxglove,rerun}")
    foxglove = viewers.add_parser("foxglove", help="a layout file")
    foxglove.add_argument("-o", "--out", type=Path, default=Path("hoi.foxglove.json"), help="default: %(default)s")
    rerun = viewers.add_parser("rerun", help="a record in Rerun, or as .rrd; needs hoi[rerun]")
    rerun.add_argument("record", type=Path, metavar="RUN.mcap")
    rerun.add_argument("-o", "--out", type=Path, metavar="FILE.rrd", help="write it there and open no viewer")
    options = parser.parse_args(arguments)
    try:
        if options.viewer == "foxglove":
            from hoi.view.layouts.foxglove import write

            write(options.out)
        else:
            from hoi.view.layouts.rerun import open_viewer, save

            if options.out is None:
                open_viewer(options.record)
                return 0
            save(options.record, options.out)
    except (InputError, RunError) as error:
        print(f"layouts: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    print(options.out)
    return 0


if __name__ == "__main__":
    program(main)
