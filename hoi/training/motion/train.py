"""Train a motion prior.

    python -m hoi.training.motion.train --data DIR --out OUT       from a folder of clip files (`.dataset`)
    python -m hoi.training.motion.train --pybullet --out OUT       from the 15 clips in the PyPI package pybullet

OUT then holds prior.safetensors and prior.json, which `load_prior(OUT)` reads, beside training.json, curve.png,
log.jsonl and checkpoint.pt, from which `--resume` goes on.
"""

import argparse
import shlex
import sys
from pathlib import Path

from hoi.errors import InputError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.training.motion.train",
        description="Train a motion prior, on clips of your own or on those in the package pybullet.",
        epilog="example: python -m hoi.training.motion.train --pybullet --out runs/prior --minutes 60",
    )
    parser.add_argument("--data", type=Path, help="folder of .npz clip files and captions.json")
    parser.add_argument("--pybullet", action="store_true", help="use the clips in the PyPI package pybullet")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoint, log and the finished prior")
    parser.add_argument("--resume", action="store_true", help="continue from OUT/checkpoint.pt")
    parser.add_argument("--steps", type=int, default=15000)
    parser.add_argument("--minutes", type=float, default=0.0, help="end after so long, the schedule fitted to it")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--lr", type=float, default=4e-4)
    parser.add_argument("--warmup", type=int, default=300, help="steps")
    parser.add_argument("--ema", type=float, default=0.998, help="decay of the moving average, per step")
    parser.add_argument("--drop-text", type=float, default=0.1, help="share of windows with an empty caption")
    parser.add_argument("--text-noise", type=float, default=0.2, help="noise on the normalised sentence embedding")
    parser.add_argument("--timesteps", type=int, default=100)
    parser.add_argument("--latent-dim", type=int, default=256)
    parser.add_argument("--layers", type=int, default=6)
    parser.add_argument("--ff-size", type=int, default=1024)
    parser.add_argument("--heads", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--hardware", default="", help="in plain words, for training.json; default: the thread count")
    parser.add_argument("--save-minutes", type=float, default=4.0)
    return parser


def main() -> int:
    options = parser().parse_args()
    command = "python -m hoi.training.motion.train " + shlex.join(sys.argv[1:])
    from hoi.training.motion.training import train

    try:
        train(options, command)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
