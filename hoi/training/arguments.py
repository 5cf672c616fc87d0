"""What the command lines of the trainings share."""

import argparse
import shlex
import sys
from importlib import import_module
from pathlib import Path

from hoi.errors import InputError, RunError


def add_folder(parser: argparse.ArgumentParser, holds: str) -> None:
    """Where a training is, and whether it goes on."""
    parser.add_argument("--out", type=Path, required=True, help=f"folder for {holds}")
    parser.add_argument("--resume", action="store_true", help="continue from OUT/checkpoint.pt")


def add_schedule(
    parser: argparse.ArgumentParser, *, steps: int, batch: int, lr: float, warmup: int, text_noise: float, sees: str
) -> None:
    """How long, how fast, and how sure of the text; `sees` is what has a caption."""
    parser.add_argument("--steps", type=int, default=steps)
    parser.add_argument("--minutes", type=float, default=0.0, help="end after so long, the schedule fitted to it")
    parser.add_argument("--batch", type=int, default=batch)
    parser.add_argument("--lr", type=float, default=lr)
    parser.add_argument("--warmup", type=int, default=warmup, help="steps")
    parser.add_argument("--ema", type=float, default=0.998, help="decay of the moving average, per step")
    parser.add_argument("--drop-text", type=float, default=0.1, help=f"share of {sees} with an empty caption")
    parser.add_argument(
        "--text-noise", type=float, default=text_noise, help="noise on the normalised sentence embedding"
    )


def add_machine(parser: argparse.ArgumentParser) -> None:
    """Seed, threads, and how often to save."""
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--hardware", default="", help="in plain words, for training.json; default: the thread count")
    parser.add_argument("--save-minutes", type=float, default=4.0)


def run(parser: argparse.ArgumentParser, training: str, kept: str = "") -> int:
    """Parse the command line and call `train(options, command)` of the module `training`, imported only then.

    Args:
        kept: what an interrupt leaves besides the last checkpoint.

    Returns:
        The exit code: 0 done; 2 bad input; 3 it cannot be written; 130 interrupted.
    """
    options = parser.parse_args()
    try:
        import_module(training).train(options, f"{parser.prog} {shlex.join(sys.argv[1:])}")
    except (InputError, RunError) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    except KeyboardInterrupt:
        print(f"interrupted; {kept}--resume goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0
