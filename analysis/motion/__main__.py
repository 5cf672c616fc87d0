"""How good a motion prior is: `python -m analysis.motion --data DIR [--prior DIR ...] [-o FOLDER]`.

Samples of each prior are held against real clips that it has not seen, against other clips of the same kinds, and
against retrieval: the training clip whose caption is nearest. Writes motion.csv (held-out sentences), strikes.csv (each
strike's limb, speed and skating) and motion.md with both tables. Exit codes: 0 done; 2 bad arguments.

    R@k        share of motions closer to their own sentence than to all but k - 1 of 31 others, each of another kind
    FID        Fréchet distance to the held-out clips' embeddings; "worst": the largest among the labels
    diversity  mean distance of two motions' embeddings
    skating    mean horizontal speed of a toe below 5 cm
    ground     mean distance of the lowest joint from the ground
    jerk       against the held-out clips'
    mismatch   of the predicted joint positions with those of the predicted rotations, which alone are used
    bones      largest relative error of a bone's length, after decoding
"""

from pathlib import Path

from hoi.terminal.program import program

from .. import command


@command.exit_code("analysis.motion")
def main() -> None:
    parser = command.parser(
        "analysis.motion",
        "How good a motion prior is: its motions and real clips, measured alike.",
        "--data clips -o runs/motion",
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of .npz clip files and captions.json")
    parser.add_argument("--prior", type=Path, action="append", help="beside the one shipped; may be given again")
    parser.add_argument("--evaluator", type=Path, help="evaluator.safetensors; default: the one shipped")
    parser.add_argument("--guidance", type=float, nargs="+", default=[2.5])
    parser.add_argument("--rescale", type=float, default=0.0, help="of the guidance, 0 to 1")
    parser.add_argument("--steps", type=int, default=20, help="of sampling")
    parser.add_argument("--sampler", choices=("ancestral", "ddim"), default="ancestral")
    parser.add_argument("--each", type=int, default=8, help="motions a held-out kind")
    parser.add_argument("--strikes", type=int, default=10, help="motions a strike")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/motion"), help="folder for the tables")
    options = parser.parse_args()
    import torch

    from .compare import study
    from .report import write

    torch.set_num_threads(options.threads)
    print(*write(options.out, *study(options), options), sep="\n")


if __name__ == "__main__":
    program(main)
