"""Videos, filmstrips and cameras of finished runs, from their records alone.

    python -m hoi.render.video RUN.mcap [RUN2.mcap ...] [--view side] [-o out.mp4] [--png strip.png] [--size 720x480]

One record gives a video; several give theirs side by side in one clock. Exit codes: 0 done; 2 bad input; 3 the disk is
full or broken; 130 interrupted.
"""

import argparse
import math
import os
import re
import sys
from pathlib import Path
from typing import get_args

from hoi.errors import InputError, RunError
from hoi.render import Backend, Ground
from hoi.render.cameras import ACTION, HEIGHT, VIEWS, WIDTH, to_json
from hoi.terminal.arguments import Parser
from hoi.terminal.program import program

CHOICES = (ACTION, *VIEWS, "turntable", "all")


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text}: allowed is WIDTHxHEIGHT, like {WIDTH}x{HEIGHT}")
    return int(found[1]), int(found[2])


def _frames(text: str) -> slice:
    found = re.fullmatch(r"(-?\d*):(-?\d*)", text)
    if not found or "-" in found.groups():
        raise argparse.ArgumentTypeError(f"{text}: allowed is FIRST:END, like 10:30, either may be left out")
    return slice(*(int(part) if part else None for part in found.groups()))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m hoi.render.video",
        description="Videos, filmstrips and cameras of finished runs; several runs are seen side by side.",
        epilog="Without -o, --png and --cameras the video is written beside the first record, as VIEW.mp4. "
        "Example: python -m hoi.render.video runs/kick_soccer_ball/laptop/full/s0/run.mcap --view side -o side.mp4",
    )
    add = parser.add_argument
    add("records", type=Path, nargs="+", metavar="RUN.mcap")
    add("--view", default=ACTION, metavar="VIEW", help=f"{', '.join(CHOICES)} (default: %(default)s)")
    add("-o", "--out", type=Path, metavar="OUT.mp4", help="the video")
    add("--png", type=Path, metavar="STRIP.png", help="a filmstrip")
    add("--cameras", type=Path, metavar="OUT.json", help="the cameras of the (first) picture, one a frame")
    add("--size", type=_size, default=(WIDTH, HEIGHT), metavar="WxH", help=f"of a picture (default: {WIDTH}x{HEIGHT})")
    add("--frames", type=_frames, metavar="A:B", help="only these, as Python slices; --frames=-10: are the last ten")
    add("--speed", type=float, default=1.0, help="1 is real time, 0.25 slow motion (default: 1)")
    add("--fps", type=float, help="pictures a second, with moments between the frames (default: each frame once)")
    add(
        "--slow", type=float, default=1.0, metavar="4", help="slow motion around the contact, so many times (at 60 fps)"
    )
    add("--no-light", action="store_true", help="albedo alone, as people and objects of the package are coloured")
    add("--no-shadows", action="store_true", help="person and object keep no key light from each other and the ground")
    add("--relight", action="store_true", help="light on captured Gaussians too, as a gain that keeps their mean")
    add("--ground", choices=list(Ground), help="what the ground looks like (default: the scene's)")
    add("--freeze", type=int, metavar="FRAME", help="turntable around this moment")
    add("--sh-degree", type=int, choices=range(4), metavar="0..3", help="of the colours (default: all there is)")
    add("--backend", choices=get_args(Backend), default="taichi", help="what draws (default: taichi)")
    add("--device", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    return parser


def _check(options: argparse.Namespace) -> None:
    """What can be seen to be wrong before anything is read."""
    if options.view not in CHOICES:
        raise InputError(f"--view {options.view}: allowed are {', '.join(CHOICES)}")
    width, height = options.size
    if width % 2 or height % 2 or not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise InputError(f"--size {width}x{height}: even numbers from 16 to 8192 are allowed")
    if not (math.isfinite(options.speed) and options.speed > 0):
        raise InputError(f"--speed {options.speed:g}: more than 0 is allowed")
    if not 1 <= options.slow <= 100:
        raise InputError(f"--slow {options.slow:g}: 1 to 100 is allowed")
    if options.freeze is not None and (options.view != "turntable" or options.frames is not None):
        raise InputError("--freeze goes with --view turntable, without --frames")
    for name, kind in {"out": ".mp4", "png": ".png", "cameras": ".json"}.items():
        path = getattr(options, name)
        if path is not None and path.suffix.lower() != kind:
            raise InputError(f"{'-o' if name == 'out' else '--' + name} {path}: a {kind} file is allowed")
        if path is not None and not os.access(path.absolute().parent, os.W_OK):
            raise InputError(f"cannot write {path}: {path.parent} is no folder that can be written to")


def execute(options: argparse.Namespace) -> list[Path]:
    """Do what the command line says; the files written.

    Raises:
        InputError: what was given is wrong.
        RunError: the disk is full or broken.
    """
    _check(options)
    import torch

    from hoi.files import whole_file
    from hoi.render import panels as side_by_side
    from hoi.render.light import DAY
    from hoi.render.look import Look
    from hoi.terminal.progress import bar

    if options.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: no CUDA device found; cpu is allowed")
    runs, replays = zip(
        *(side_by_side.load(path, options.device, relight=options.relight) for path in options.records), strict=True
    )
    clock = side_by_side.make_clock(
        replays, options.frames or slice(None), options.speed, options.freeze, options.fps, options.slow
    )
    labels = side_by_side.labels_of(runs, options.records)
    panels = side_by_side.make_panels(replays, labels, options.view, options.size, clock)
    video = options.out
    if not (options.out or options.png or options.cameras):
        video = options.records[0].with_name(f"{options.view}.mp4")
    look = Look(
        light=None if options.no_light else DAY,
        shadows=not options.no_shadows,
        ground=options.ground and Ground(options.ground),
    )
    how = side_by_side.Drawing(options.sh_degree, options.backend, options.device, look)
    if video:
        with bar("video", len(clock.times)) as advance:
            side_by_side.make_video(panels, clock, video, how, advance)
    if options.png:
        side_by_side.make_strip(panels, clock, options.png, how)
    if options.cameras:
        with whole_file(options.cameras) as part:
            part.write_text(to_json(panels[0].cameras))
    return [path for path in (video, options.png, options.cameras) if path]


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m hoi.render.video`; the exit code."""
    options = _parser().parse_args(arguments)
    try:
        written = execute(options)
    except (InputError, RunError) as error:
        print(f"video: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    print(*written, sep="\n")
    return 0


if __name__ == "__main__":
    program(main)
