"""Draw a motion from a sentence: python -m hoi.motion.sample "a person kicks" -o out.npz

The file holds, as AMASS does, `poses` (T, 72) axis-angle of the 24 SMPL joints [rad], `trans` (T, 3) [m] and
`mocap_framerate`, besides `joints` (T, 24, 3) [m], `prompt` and `seed`; Z up, starting at the origin facing +Y. `trans`
is the world position of the pelvis *joint*: an SMPL layer whose pelvis rests at J0 wants trans - J0.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.kinematics import forward_kinematics, local_rotations
from hoi.errors import InputError
from hoi.motion.features import decode
from hoi.motion.prior import load_prior


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m hoi.motion.sample", description="Draw a motion from a sentence.")
    parser.add_argument("prompt")
    parser.add_argument("-o", "--out", type=Path, required=True, help=".npz file")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--guidance", type=float, default=2.5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--prior", type=Path, help="a trained folder or an STMC checkpoint; default: the one shipped")
    parser.add_argument("--device", default="cpu")
    return parser


def sample(options: argparse.Namespace) -> None:
    """Draw and write.

    Raises:
        InputError: the prior cannot be loaded, the file not written, or the number of frames is below 3.
    """
    if options.frames < 3:
        raise InputError(f"--frames {options.frames}: must be at least 3")
    prior = load_prior(options.prior, options.device)
    generator = torch.Generator().manual_seed(options.seed)
    features = prior.sample(options.prompt, options.frames, options.guidance, generator).cpu()
    translation, orientation, body_pose = decode(features)
    local = local_rotations(orientation, body_pose)
    _, joints = forward_kinematics(local, translation, prior.rest_joints.cpu())
    try:
        with options.out.open("wb") as file:
            np.savez(
                file,
                poses=roma.rotmat_to_rotvec(local).flatten(1).numpy(),
                trans=translation.numpy(),
                mocap_framerate=np.array(prior.fps),
                joints=joints.numpy(),
                prompt=np.array(options.prompt),
                seed=np.array(options.seed),
            )
    except OSError as error:
        raise InputError(f"--out {options.out}: {error}") from error


def main() -> int:
    try:
        sample(parser().parse_args())
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
