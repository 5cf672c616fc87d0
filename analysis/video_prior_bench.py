"""What an iteration of Video-SDS with CogVideoX takes: `python -m analysis.video_prior_bench [--full] [--device cuda]`.

The same classes and the same path as a run, with random weights: seconds and memory do not depend on what they are. Not
measured but counted on shapes alone are the operations of the 5B at each length of the clip. Without --full the weights
are a few million, so that a CPU does it too. Rendering is not in it.
"""

from pathlib import Path

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command, sheets


@command.exit_code("analysis.video_prior_bench")
def main(argv: list[str] | None = None) -> None:
    parser = command.parser(
        "analysis.video_prior_bench",
        "What an iteration of Video-SDS with CogVideoX takes, of random weights: seconds and memory.",
        "--frames 13 --turns 1",
    )
    parser.add_argument("--full", action="store_true", help="measure the 5B's sizes (22 GB of memory and more)")
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--frames", type=int, nargs="+", help="lengths of the clip")
    parser.add_argument("--height", type=int, help="of the pictures (default: 480, 96 without --full)")
    parser.add_argument("--width", type=int, help="(default: 720, 144 without --full)")
    parser.add_argument("--turns", type=int, default=3, help="iterations of which the best counts")
    parser.add_argument("--offload", action="store_true", help="as stage.refine.offload")
    parser.add_argument("--no-count", action="store_true", help="leave the count for the 5B out")
    parser.add_argument("-o", "--out", type=Path, help="folder for the tables, .csv")
    arguments = parser.parse_args(argv)
    import torch

    from .video_prior_cost import FULL, LENGTHS, SCALED, RandomWeights, count, measure, with_share

    lengths = arguments.frames or LENGTHS
    height, width = (480, 720) if arguments.full else (96, 144)
    size = (arguments.height or height, arguments.width or width)
    files = RandomWeights(Path("random weights"), FULL if arguments.full else SCALED)
    if arguments.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: no CUDA device found; use --device cpu")
    measured = [
        measure(files, frames, size, arguments.device, arguments.turns, arguments.offload) for frames in lengths
    ]
    name = f"measured, {'5B' if arguments.full else 'scaled'}, {size[1]} x {size[0]}, {arguments.device}"
    tables = {name: with_share(measured, "s an iteration")}
    if not arguments.no_count:
        counted = [count(FULL, frames, (480, 720)) for frames in lengths]
        tables["counted on shapes, 5B, 720 x 480"] = with_share(counted, "PFLOP")
    for title, table in tables.items():
        print(title, sheets.plain(table, digits=3), sep="\n")
        if arguments.out:
            arguments.out.mkdir(parents=True, exist_ok=True)
            table.to_csv(arguments.out / f"video_prior_{title.split(',')[0].split()[0]}.csv", index=False)


if __name__ == "__main__":
    program(main)
