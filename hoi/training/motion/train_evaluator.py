"""Train the judge of motions, `hoi.motion.evaluator`.

    python -m hoi.training.motion.train_evaluator --data DIR --out OUT

DIR holds the clips that priors are trained on; those held out are left alone. OUT then holds evaluator.safetensors.
Exit codes: 0 done; 2 bad input.
"""

import argparse
import sys
from pathlib import Path

from hoi.errors import InputError
from hoi.terminal.program import program


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m hoi.training.motion.train_evaluator",
        description="Train the judge of motions.",
        epilog="example: python -m hoi.training.motion.train_evaluator --data clips --out runs/evaluator",
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of .npz clip files and captions.json")
    parser.add_argument("--out", type=Path, required=True, help="folder for evaluator.safetensors")
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    from hoi.motion.evaluator import FILE_NAME, save_evaluator
    from hoi.training.motion.evaluator import train_evaluator
    from hoi.training.motion.training import read_split

    try:
        training, _ = read_split(options.data)
        save_evaluator(train_evaluator(training, options.steps, seed=options.seed), options.out / FILE_NAME)
    except (InputError, OSError) as error:
        print(f"train_evaluator: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    program(main)
