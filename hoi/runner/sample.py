"""Draw a motion from a sentence.

    python -m hoi.runner.sample "a person kicks" -o kick.npz
    python -m hoi.runner.sample "a person kicks" -o kick.mcap --person woman

The .npz holds, as AMASS does, `poses` (T, 72) axis-angle of the 24 SMPL joints [rad], `trans` (T, 3) [m] and
`mocap_framerate`, besides `joints` (T, 24, 3) and `rest_joints` (24, 3) of the prior's own skeleton [m], `prompt` and
`seed`; Z up, starting at the origin facing +Y. `trans` is the world position of the pelvis *joint*: an SMPL layer whose
pelvis rests at J0 wants trans - J0.

The .mcap is a record with a person and no object, which `analysis.strip`, `hoi.render.video` and `hoi.record.read`
take. Exit codes: 0 done; 2 bad input.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.data import Body, Motion, Plan, Plane, Run, Scene, State, Step
from hoi.errors import InputError, RunError

if TYPE_CHECKING:
    from hoi.motion.prior import MotionPrior

SUFFIXES = (".npz", ".mcap")
MOST_FRAMES = 4000
"""The denoiser has places for some thousand tokens."""
VIEWING_POINTS = 6000


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.runner.sample",
        description="Draw a motion from a sentence: an .npz as in AMASS, or a record with a person and no object.",
        epilog='example: python -m hoi.runner.sample "a person kicks" -o kick.mcap --person woman',
    )
    parser.add_argument("prompt")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".npz as in AMASS, or .mcap to look at")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--guidance", type=float, default=2.5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--prior", type=Path, help="a trained folder or an STMC checkpoint; default: the one shipped")
    parser.add_argument(
        "--clip", type=Path, help="for STMC, a Hugging Face folder of CLIP ViT-B/32; default: its clip/"
    )
    parser.add_argument("--person", default="man", help="who moves in the .mcap: one of the people in the package")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    return parser


def sample(options: argparse.Namespace) -> None:
    """Draw and write.

    Raises:
        InputError: an option is out of range, the prior cannot be loaded, or the file not written.
        RunError: the disk is full.
    """
    import torch

    from hoi import record
    from hoi.body.people import load_person
    from hoi.body.skinning import posed_means
    from hoi.gaussians import colours
    from hoi.motion.features import decode
    from hoi.motion.prior import load_prior

    started = time.perf_counter()
    if options.out.suffix not in SUFFIXES:
        raise InputError(f"--out {options.out}: must end in {' or '.join(SUFFIXES)}")
    if not 3 <= options.frames <= MOST_FRAMES:
        raise InputError(f"--frames {options.frames}: must be at least 3, and at most {MOST_FRAMES}")
    if options.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: no CUDA device found")
    body = load_person(options.person) if options.out.suffix == ".mcap" else None
    prior = load_prior(options.prior, options.device, options.clip)
    generator = torch.Generator().manual_seed(options.seed)
    features = prior.sample(options.prompt, options.frames, options.guidance, generator).cpu()
    if not features.isfinite().all():
        raise InputError(f"--guidance {options.guidance:g}: the motion is not finite; a smaller one gives one that is")
    motion = Motion(*(part.numpy() for part in decode(features)), fps=prior.fps)
    if body is None:
        _write_npz(options, prior, motion)
    else:
        moved = prior.on_body(motion, body)
        run = run_of(moved, body, options.prompt, options.seed, prior, options.guidance, time.perf_counter() - started)
        chosen = np.linspace(0, len(body.cloud) - 1, VIEWING_POINTS).astype(int)
        points = posed_means(body, moved, subset=chosen), colours(body.cloud)[chosen]
        record.write(run, options.out, *points, plan_text=f"motion  {run.plan.steps[0].reason}\n")


def run_of(
    motion: Motion, body: Body, prompt: str, seed: int, prior: MotionPrior, guidance: float, seconds: float
) -> Run:
    """A record's content: a person on the ground, and no object."""
    ground = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    frames, gravity = len(motion), np.array([0.0, 0.0, -9.81])
    said = f"{prior.source}: {prior.timesteps} steps of ancestral sampling, guidance {guidance:g}"
    facts = {"seed": str(seed), "scene": "sample", "experiment": "sample", "ablation": "full", "config_hash": ""}
    result = {"status": "done", "outcome": "a motion without an object", "variant": "sample", "seconds": repr(seconds)}
    return Run(
        config_yaml="",
        provenance=facts,
        result=result,
        plan=Plan("sample", (Step("motion", "sample", said),), (), ()),
        reports=(),
        history=(),
        scene=Scene("sample", body, None, prompt, frames, motion.fps, gravity, (ground,)),
        state=State(motion=motion),
    )


def _write_npz(options: argparse.Namespace, prior: MotionPrior, motion: Motion) -> None:
    import roma
    import torch

    from hoi.body.kinematics import forward_kinematics, local_rotations

    parts = (torch.from_numpy(part) for part in (motion.orientation, motion.body_pose))
    local, rest_joints = local_rotations(*parts), prior.rest_joints.cpu()
    _, joints = forward_kinematics(local, torch.from_numpy(motion.translation), rest_joints)
    try:
        with options.out.open("wb") as file:
            np.savez(
                file,
                poses=roma.rotmat_to_rotvec(local).flatten(1).numpy(),
                trans=motion.translation,
                mocap_framerate=np.array(motion.fps),
                joints=joints.numpy(),
                rest_joints=rest_joints.numpy(),
                prompt=np.array(options.prompt),
                seed=np.array(options.seed),
            )
    except OSError as error:
        raise InputError(f"--out {options.out}: {error}") from error


def main() -> int:
    try:
        sample(parser().parse_args())
    except (InputError, RunError) as error:
        print(f"sample: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
