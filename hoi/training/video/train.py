"""Train the embedded video prior.

    python -m hoi.training.video.train --out OUT --minutes 60

First makes the training clips, which stay in OUT and are made once. OUT then holds video_prior.safetensors, which
`load_embedded(OUT)` reads, beside training.json, curve.png, log.jsonl and checkpoint.pt, from which `--resume` goes on.
"""

import argparse

from hoi.terminal.program import program
from hoi.training.arguments import add_folder, add_machine, add_schedule, run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.training.video.train",
        description="Train the video prior that stage 3 distils from: first the clips, then the network.",
        epilog="example: python -m hoi.training.video.train --out runs/video_prior --minutes 60",
    )
    add_folder(parser, "clips, checkpoint, log and finished prior")
    parser.add_argument("--clips", type=int, default=3584, help="views of contacts to train on, each in four clips")
    parser.add_argument("--held-out", type=float, default=0.04, help="share of the views that are only tested on")
    parser.add_argument("--test-clips", type=int, default=32)
    add_schedule(parser, steps=100_000, batch=15, lr=8e-4, warmup=200, text_noise=0.15, sees="clips")
    parser.add_argument("--time-power", type=float, default=1.5, help="t = 1000 u^p of a uniform u")
    parser.add_argument("--channels", type=int, nargs=2, default=[64, 128])
    add_machine(parser)
    return parser


def main() -> int:
    return run(parser(), "hoi.training.video.training", kept="clips that are whole are kept, ")


if __name__ == "__main__":
    program(main)
