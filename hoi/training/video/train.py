"""Train the embedded video prior.

    python -m hoi.training.video.train --out OUT --minutes 60

First makes the training clips, which stay in OUT and are made once. OUT then holds video_prior.safetensors, which
`load_embedded(OUT)` reads, beside training.json, curve.png, log.jsonl and checkpoint.pt, from which `--resume` goes on.
"""

import argparse
import shlex
import sys
from pathlib import Path

from hoi.errors import InputError


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.training.video.train",
        description="Train the video prior that stage 3 distils from: first the clips, then the network.",
        epilog="example: python -m hoi.training.video.train --out runs/video_prior --minutes 60",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for clips, checkpoint, log and finished prior")
    parser.add_argument("--resume", action="store_true", help="continue from OUT/checkpoint.pt")
    parser.add_argument("--clips", type=int, default=3584, help="views of contacts to train on, each in four clips")
    parser.add_argument("--held-out", type=float, default=0.04, help="share of the views that are only tested on")
    parser.add_argument("--test-clips", type=int, default=32)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--minutes", type=float, default=0.0, help="end after so long, the schedule fitted to it")
    parser.add_argument("--batch", type=int, default=15)
    parser.add_argument("--lr", type=float, default=8e-4)
    parser.add_argument("--warmup", type=int, default=200, help="steps")
    parser.add_argument("--ema", type=float, default=0.998, help="decay of the moving average, per step")
    parser.add_argument("--drop-text", type=float, default=0.1, help="share of clips with an empty caption")
    parser.add_argument("--text-noise", type=float, default=0.15, help="noise on the normalised sentence embedding")
    parser.add_argument("--time-power", type=float, default=1.5, help="t = 1000 u^p of a uniform u")
    parser.add_argument("--channels", type=int, nargs=2, default=[64, 128])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--hardware", default="", help="in plain words, for training.json; default: the thread count")
    parser.add_argument("--save-minutes", type=float, default=4.0)
    return parser


def main() -> int:
    options = parser().parse_args()
    command = "python -m hoi.training.video.train " + shlex.join(sys.argv[1:])
    from hoi.training.video.training import train

    try:
        train(options, command)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; clips that are whole are kept, --resume goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
