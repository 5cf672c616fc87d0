"""`python -m analysis.baseline`: the command line."""

import argparse
import os
import sys
from pathlib import Path

from hoi.terminal.interrupt import interruptible
from hoi.terminal.program import program


def main() -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}",
        description="Kinematic replay: the nearest motion-capture clip, the object carried on by what touches it.",
        epilog="All other arguments are those of python -m hoi.run: scene=NAME seed=N render=video out=DIR --multirun. "
        "Example: %(prog)s scene=kick_soccer_ball seed=1",
    )
    parser.add_argument("--clips", type=Path, help="folder of .npz (AMASS) and .bvh files; default: those of pybullet")
    options, overrides = parser.parse_known_args()
    from .run import OUT, compose_and_execute

    for default in (f"out={OUT}", "render=none"):
        if not any(override.partition("=")[0] == default.partition("=")[0] for override in overrides):
            overrides.append(default)
    sys.argv[1:] = overrides
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")  # errors come to us instead of being printed with a traceback
    with interruptible():
        sys.exit(compose_and_execute(options.clips))


if __name__ == "__main__":
    program(main)
