"""A person of one's own: `python -m hoi.importers.convert --smpl FILE [--betas ...] [--hugs CHECKPOINT] -o FOLDER`.

Without --hugs the SMPL body itself, with Gaussians on its skin; with it the person HUGS has learned. The folder goes
into a run as `human=avatar human.path=FOLDER`. See docs/people.md.
"""

import argparse
import math
import shlex
from pathlib import Path

import numpy as np

from hoi.body.clothing import OUTFITS
from hoi.data import Body
from hoi.errors import InputError
from hoi.importers.unpickle import read_arrays
from hoi.terminal.arguments import refusing
from hoi.terminal.overrides import as_override
from hoi.terminal.program import program


def read_betas(text: str) -> list[float]:
    """Shape parameters written out, as "0.5,-1" or "[0.5, -1]", or the first row of `betas` in an .npz or .pkl.

    Raises:
        InputError: neither numbers nor such a file.
    """
    if text.endswith((".npz", ".pkl")):
        betas = read_arrays(Path(text), ["betas"]).get("betas")
        if betas is None or betas.size == 0 or betas.ndim > 2:
            raise InputError(f"--betas: {text}: betas: {'missing' if betas is None else f'shape {betas.shape}'}")
        return [float(beta) for beta in np.atleast_2d(betas)[0]]
    try:
        betas = [float(word) for word in text.strip("[] ").split(",")]
    except ValueError:
        raise InputError(f"--betas must be numbers with commas between, or an .npz with betas, got {text!r}") from None
    if not all(map(math.isfinite, betas)):
        raise InputError(f"--betas must be finite, got {text!r}")
    return betas


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.importers.convert",
        description="Turn your own SMPL body or HUGS person into an avatar.",
        epilog="example: python -m hoi.importers.convert --smpl SMPL_MALE.pkl --betas=0.5,-1 --outfit man -o me",
    )
    parser.add_argument("--smpl", type=Path, required=True, help="SMPL, SMPL-H or SMPL-X model file, .npz or .pkl")
    parser.add_argument("--betas", help="shape: --betas=-0.5,1,... or a file with betas; default: the mean")
    parser.add_argument("--hugs", type=Path, metavar="CHECKPOINT", help="human_*.pth; needs --betas")
    parser.add_argument("--gaussians", type=int, help="on the skin of an SMPL body; default: 26000")
    parser.add_argument("--outfit", choices=sorted(OUTFITS), help="clothes of an SMPL body; default: man")
    parser.add_argument("--no-pose-correctives", action="store_true", help="leave out SMPL's pose blend shapes")
    parser.add_argument("--seed", type=int, default=0, help="of the sampling")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FOLDER", help="the avatar's folder")
    return parser


def person_of(options: argparse.Namespace) -> Body:
    """Read what the options name.

    Raises:
        InputError: a file or an option that cannot be used.
    """
    from hoi.importers.smpl import load_smpl

    if options.seed < 0:
        raise InputError(f"--seed must be 0 or more, got {options.seed}")
    betas = [] if options.betas is None else read_betas(options.betas)
    if options.hugs is None:
        correctives = not options.no_pose_correctives
        gaussians = 26000 if options.gaussians is None else options.gaussians
        return load_smpl(options.smpl, betas, gaussians, options.seed, options.outfit or "man", correctives)
    if options.betas is None:
        raise InputError(
            "--hugs needs --betas: the file that the person was trained with "
            "(4d_humans/smpl_optimized_aligned_scale.npz), or 0 for the mean shape"
        )
    for name in ("gaussians", "outfit"):
        if getattr(options, name) is not None:
            raise InputError(f"--{name} is for SMPL bodies; HUGS brings its own")
    from hoi.importers.hugs import load_hugs

    return load_hugs(options.hugs, options.smpl, betas)


def run(options: argparse.Namespace) -> None:
    """Read, write, report.

    Raises:
        InputError: as `person_of`, or the folder cannot be written.
    """
    from hoi.body.avatar import LICENCE_MARK, save_avatar

    body = person_of(options)
    try:
        save_avatar(body, options.out)
    except OSError as error:
        raise InputError(f"-o: cannot write {options.out}: {error.strerror}") from None
    height = float(np.ptp(body.cloud.means[:, 1]))
    correctives = "without" if body.pose_directions is None else "with"
    print(f"{len(body.cloud)} Gaussians, {height:.2f} m tall, {correctives} pose blend shapes")
    print(body.source.replace(LICENCE_MARK, "\nlicence: "))
    print(f"python -m hoi.run human=avatar {shlex.quote(as_override('human.path', options.out))}")


def main() -> int:
    return refusing(lambda: run(parser().parse_args()))


if __name__ == "__main__":
    program(main)
