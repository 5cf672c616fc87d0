"""Takes a finished run to other programs, from its record alone.

    python -m hoi.export RUN.mcap                    # scene.glb, smpl.npz, motion.bvh, trajectories.csv, video.mp4
    python -m hoi.export RUN.mcap --spz --gif -o DIR

Exit codes: 0 done; 2 bad input; 3 the disk is full or broken; 130 interrupted.
"""

import argparse
import sys
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

from hoi.errors import InputError, RunError
from hoi.terminal.arguments import Parser
from hoi.terminal.program import program

CHOICES = {
    "glb": ("scene.glb", "glTF 2.0: skinned person and moving object, for Blender, three.js, game engines"),
    "ply": ("ply/", "all Gaussians in INRIA's layout, a file a frame"),
    "splat": ("splat/", "the same as .splat, 32 bytes a Gaussian"),
    "spz": ("spz/", "the same as .spz (version 3), the smallest"),
    "khr": ("khr/", "the same as .glb with KHR_gaussian_splatting, Y up"),
    "usd-splats": ("splats.usdc", "the Gaussians over time as USD's ParticleField3DGaussianSplat; needs usd-core"),
    "rerun-splats": ("splats.rrd", "the Gaussians over time as Rerun's GaussianSplats3D; needs rerun-sdk"),
    "collider": ("collider.glb", "the object's surface as one mesh, as it lies in frame 0"),
    "npz": ("smpl.npz", "the motion as SMPL parameters, with AMASS's names"),
    "bvh": ("motion.bvh", "the motion as BVH: metres, Y up"),
    "mp4": ("video.mp4", "the recorded video; drawn anew where the record has none"),
    "gif": ("video.gif", "the same, under 5 MB"),
    "csv": ("trajectories.csv", "object and joints, a line a frame"),
    "html": ("scene.html", "the scene in 3D, in one file that needs no server"),
    "usd": ("scene.usdc", "skinned person and moving object as USD; needs usd-core"),
}
WRITERS = {
    "glb": "hoi.export.glb:write_glb",
    "npz": "hoi.export.motions:write_smpl",
    "bvh": "hoi.export.motions:write_bvh",
    "mp4": "hoi.render.encode:write_mp4",
    "gif": "hoi.export.pictures:write_gif",
    "csv": "hoi.export.trajectories:write_csv",
    "html": "hoi.export.page:write_page",
    "usd": "hoi.export.usd:write_usd",
    "usd-splats": "hoi.export.splats:write_usd_splats",
    "rerun-splats": "hoi.export.splats:write_rerun_splats",
    "collider": "hoi.export.glb:write_collider",
}
"""What writes the run, or its video, to a path, imported when it is called; the other choices are clouds by frame."""
USUAL = ("glb", "npz", "bvh", "csv", "mp4")
"""What is written when nothing is named, as far as the run has it."""
OF_MOTION, OF_VIDEO = ("npz", "bvh"), ("mp4", "gif")
"""What a person is needed for, and what a video is enough for."""


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m hoi.export",
        description="Takes a finished run to Blender, game engines, splat viewers and spreadsheets.",
        epilog=f"example: python -m hoi.export runs/kick_soccer_ball/laptop/full/s0/run.mcap --glb --gif. "
        f"With nothing named: {', '.join('--' + name for name in USUAL)}.",
    )
    parser.add_argument("record", type=Path, metavar="RUN.mcap")
    parser.add_argument("-o", "--out", type=Path, metavar="DIR", help="default: the folder export beside the record")
    for name, (file, what) in CHOICES.items():
        parser.add_argument(f"--{name}", action="store_true", help=f"{file}: {what}")
    parser.add_argument(
        "--axes", choices=("z-up", "y-up", "y-down"), default="z-up", help="of .ply, .splat and .spz (default: z-up)"
    )
    return parser


def execute(options: argparse.Namespace) -> list[Path]:
    """Do what the command line says; what was written.

    Raises:
        InputError: what was given is wrong, or the run lacks what was asked for.
        RunError: the disk is full or broken.
    """
    from hoi import record
    from hoi.render.shown import scene_of

    source: Path = options.record
    run = record.read(source)
    named = [name for name in CHOICES if getattr(options, name.replace("-", "_"))]
    wanted = named or [name for name in USUAL if run.state.motion is not None or name not in OF_MOTION]
    if not set(wanted) <= set(OF_VIDEO):
        scene_of(run, source)
    if run.state.motion is None and (lacking := [name for name in wanted if name in OF_MOTION]):
        raise InputError(f"{source} has no motion of a person, which --{lacking[0]} needs")
    folder: Path = options.out or source.with_name("export")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}") from error
    shaped = run.state.motion is not None and run.scene is not None and run.scene.body.pose_directions is not None
    if shaped and {"glb", "usd"} & set(wanted):
        print("export: the person's pose blend shapes are left out of --glb and --usd", file=sys.stderr)
    video = cache(lambda: resolve_name("hoi.export.pictures:video_of")(run, source))
    written = []
    for name in wanted:
        path = folder / CHOICES[name][0]
        try:
            if name in WRITERS:
                resolve_name(WRITERS[name])(video() if name in OF_VIDEO else run, path)
            else:
                resolve_name("hoi.export.clouds:write_sequence")(run, path, name, options.axes)
        except InputError as error:
            told = any(str(file) in str(error) for file in (path, source))
            raise InputError(str(error) if told else f"{source}: {error}") from None
        written.append(path)
    return written


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m hoi.export`; the exit code."""
    options = _parser().parse_args(arguments)
    try:
        written = execute(options)
    except (InputError, RunError) as error:
        print(f"export: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    print(*written, sep="\n")
    return 0


if __name__ == "__main__":
    program(main)
