"""Train a motion prior.

    python -m hoi.training.motion.train --data DIR --out OUT       from a folder of clip files (`.dataset`)
    python -m hoi.training.motion.train --pybullet --out OUT       from the 15 clips in the PyPI package pybullet

OUT then holds prior.safetensors and prior.json, which `load_prior(OUT)` reads, beside training.json, curve.png,
log.jsonl and checkpoint.pt, from which `--resume` goes on.
"""

import argparse
from pathlib import Path

from hoi.terminal.program import program
from hoi.training.arguments import add_folder, add_machine, add_schedule, run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.training.motion.train",
        description="Train a motion prior, on clips of your own or on those in the package pybullet.",
        epilog="example: python -m hoi.training.motion.train --pybullet --out runs/prior --minutes 60",
    )
    parser.add_argument("--data", type=Path, help="folder of .npz clip files and captions.json")
    parser.add_argument("--pybullet", action="store_true", help="use the clips in the PyPI package pybullet")
    add_folder(parser, "checkpoint, log and the finished prior")
    add_schedule(parser, steps=15000, batch=32, lr=4e-4, warmup=300, text_noise=0.2, sees="windows")
    parser.add_argument("--timesteps", type=int, default=100)
    parser.add_argument("--latent-dim", type=int, default=256)
    parser.add_argument("--layers", type=int, default=6)
    parser.add_argument("--ff-size", type=int, default=1024)
    parser.add_argument("--heads", type=int, default=4)
    add_machine(parser)
    return parser


def main() -> int:
    return run(parser(), "hoi.training.motion.training")


if __name__ == "__main__":
    program(main)
