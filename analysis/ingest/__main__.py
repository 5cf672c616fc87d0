"""`python -m analysis.ingest`: the command line."""

import argparse
import sys
from pathlib import Path

from hoi.errors import InputError, RunError
from hoi.terminal.arguments import Parser
from hoi.terminal.program import program

from . import meshes


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog=f"python -m {__package__}",
        description="One output of another system, a video or meshes or both, becomes a record to compare with.",
        epilog="example: %(prog)s --scene kick_soccer_ball --system Other --video other.mp4",
    )
    add = parser.add_argument
    add("--scene", required=True, help="of conf/scene: its object's material, gravity, prompts and expected limb")
    add("--system", required=True, help="the system's name, as the table shall show it")
    add("--video", type=Path, metavar="FILE.mp4", help="what the system shows: for the learned metrics")
    add("--person", type=Path, metavar="FILE", help=f"the person: {meshes.FORMATS}")
    add("--object", type=Path, metavar="FILE", help="the object, likewise")
    add("--person-node", metavar="NAME", help="the node of a GLB that the person hangs on")
    add("--object-node", metavar="NAME", help="the node of a GLB that the object hangs on")
    add("--fps", type=float, help="frames a second; default: what the file says, of a GLB the scene's")
    add("--scale", type=float, default=1.0, help="metres in a unit of the meshes (default: 1)")
    add("--up", choices=("y", "z"), default="y", help="the meshes' up axis (default: y)")
    add("--ground", type=float, help="height of the ground [m]; default: the lowest vertex of the first frame")
    add("--prompt", help="what the system was asked for, in the place of the scene's prompts")
    add("--no-contact", dest="contact", action="store_false", help="do not look for contact")
    add("--distance", type=float, help="that counts as contact [m]; default: the scene's")
    add("--seconds", type=float, help="that the system took, for the table")
    add("--seed", type=int, default=0, help="of the system's run, to tell several apart")
    add("-o", "--out", type=Path, metavar="RUN.mcap", help="default: runs/SCENE/baseline/SYSTEM/sSEED/run.mcap")
    add("--overwrite", action="store_true", help="replace the record that is there")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The exit code: 0 done, 2 bad input, 3 the disk is full or broken."""
    options = _parser().parse_args(arguments)
    from .run import ingest

    try:
        path = ingest(options)
    except (InputError, RunError) as error:
        print(f"ingest: {' '.join(str(error).split())}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    except OSError as error:
        print(f"ingest: {error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    print(f"recorded {path}")
    return 0


if __name__ == "__main__":
    program(main)
