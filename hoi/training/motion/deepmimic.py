"""The DeepMimic clips that ship in the PyPI package `pybullet`, as motions of our skeleton.

A `humanoid3d_*.txt` is JSON whose "Frames" rows hold: duration; root position (3) and rotation (4); rotations of chest,
neck, right hip (4 each), right knee (1), right ankle, right shoulder (4 each), right elbow (1), then the left side
likewise. Quaternions wxyz relative to the parent; a hinge turns about z. There x is forward, y up, z right, and the
person rests with hanging arms.
"""

import json
import math
from importlib import metadata
from pathlib import Path

import numpy as np
import roma
import torch
from torch import Tensor

from hoi.body.kinematics import forward_kinematics
from hoi.data import Array
from hoi.errors import InputError
from hoi.motion.features import towards_plus_y
from hoi.training.motion.dataset import FPS, Clip, rest_joints_of

PACKAGE = "pybullet"
OFFSETS = np.array(
    [
        (0, 0, 0), (0.075, -0.09, 0), (-0.075, -0.09, 0), (0, 0.11, 0), (0, -0.38, 0), (0, -0.38, 0), (0, 0.13, 0),
        (0, -0.4, 0), (0, -0.4, 0), (0, 0.06, 0), (0, -0.055, 0.13), (0, -0.055, 0.13), (0, 0.21, -0.02),
        (0.06, 0.12, -0.02), (-0.06, 0.12, -0.02), (0, 0.08, 0.04), (0.11, 0.02, 0), (-0.11, 0.02, 0), (0.26, 0, 0),
        (-0.26, 0, 0), (0.25, 0, 0), (-0.25, 0, 0), (0.085, 0, 0), (-0.085, 0, 0),
    ]
)  # fmt: skip
"""Plain skeleton of 1.70 m: each joint's T-pose offset from its parent [m], (24, 3)."""
LEG = 0.38 + 0.40
DEEPMIMIC_LEG = 0.421546 + 0.40987
"""Thigh and shin of the two skeletons [m]."""

CLIPS: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    "kick": ("kick_side", "right", 11, ("a person does a side kick with the right leg", "a person kicks")),
    "punch": ("punch_swing", "right", 23, ("a person swings the right fist", "a person punches")),
    "spinkick": ("kick_spin", "right", 11, ("a person spins and kicks", "a person does a spinning kick")),
    "walk": ("walk", "", 0, ("a person walks",)),
    "run": ("run", "", 0, ("a person runs",)),
    "jump": ("jump", "", 0, ("a person jumps",)),
    "crawl": ("crawl", "", 0, ("a person crawls",)),
    "dance_a": ("dance", "", 0, ("a person dances",)),
    "dance_b": ("dance", "", 0, ("a person dances",)),
    "cartwheel": ("cartwheel", "", 0, ("a person does a cartwheel",)),
    "backflip": ("flip", "", 0, ("a person does a backflip",)),
    "roll": ("roll", "", 0, ("a person rolls on the floor",)),
    "spin": ("spin", "", 0, ("a person spins around",)),
    "getup_facedown": ("getup", "", 0, ("a person gets up from the floor",)),
    "getup_faceup": ("getup", "", 0, ("a person gets up from the floor",)),
}
"""File -> label, side, striking joint (0: none), captions."""

_SOURCE_TO_REST = torch.tensor([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]], dtype=torch.float64)
"""x forward, z right -> z forward, x left."""
_REST_TO_WORLD = torch.tensor([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]], dtype=torch.float64)
"""y up facing z -> z up facing +Y."""


def clip_folder() -> Path:
    """The folder of the clips inside the installed package.

    Raises:
        InputError: the package is not installed, or ships no clip.
    """
    try:
        files = metadata.distribution(PACKAGE).files or []
    except metadata.PackageNotFoundError:
        raise InputError(f"--pybullet: the package {PACKAGE} is not installed; pip install it") from None
    for file in files:
        if file.name == "humanoid3d_kick.txt":
            return Path(str(file.locate())).parent
    raise InputError(f"--pybullet: the package {PACKAGE} holds no humanoid3d_kick.txt")


def _rotations(frames: Tensor, column: int) -> Tensor:
    """Quaternion at a column -> rotation in the rest frame, (F, 3, 3)."""
    wxyz = frames[:, column : column + 4]
    rotation = roma.unitquat_to_rotmat(roma.quat_normalize(wxyz.roll(-1, dims=-1)))
    return _SOURCE_TO_REST @ rotation @ _SOURCE_TO_REST.T


def _hinge(frames: Tensor, column: int) -> Tensor:
    """Hinge angle at a column -> rotation in the rest frame, (F, 3, 3)."""
    angle = frames[:, column]
    zero = torch.zeros_like(angle)
    rotation = roma.rotvec_to_rotmat(torch.stack([zero, zero, angle], dim=-1))
    return _SOURCE_TO_REST @ rotation @ _SOURCE_TO_REST.T


def _part(rotation: Tensor, fraction: float) -> Tensor:
    """A fraction of a rotation."""
    return roma.rotvec_to_rotmat(fraction * roma.rotmat_to_rotvec(rotation))


def _local_rotations(frames: Tensor) -> Tensor:
    """Local rotations of our 24 joints from the T-pose, (F, 24, 3, 3).

    The chest's bend is spread over three spine joints, the neck's over two. Arms: the source rests with them hanging,
    which a fixed quarter turn of the whole arm chain takes back to the T-pose.
    """
    local = torch.eye(3, dtype=frames.dtype).repeat(len(frames), 24, 1, 1)
    local[:, 0] = _REST_TO_WORLD @ _rotations(frames, 4)
    chest, neck = _rotations(frames, 8), _rotations(frames, 12)
    local[:, 3] = local[:, 6] = _part(chest, 0.25)
    local[:, 9] = _part(chest, 0.5)
    local[:, 12] = local[:, 15] = _part(neck, 0.5)
    for column, (hip, knee, ankle, shoulder, elbow), sign in (
        (16, (2, 5, 8, 17, 19), 1.0),
        (30, (1, 4, 7, 16, 18), -1.0),
    ):
        local[:, hip], local[:, knee] = _rotations(frames, column), _hinge(frames, column + 4)
        local[:, ankle] = _rotations(frames, column + 5)
        hang = roma.rotvec_to_rotmat(torch.tensor([0, 0, sign * math.pi / 2], dtype=frames.dtype))
        local[:, shoulder] = _rotations(frames, column + 9) @ hang
        local[:, elbow] = hang.T @ _hinge(frames, column + 13) @ hang
    return local


def _resample(local: Tensor, position: Tensor, duration: float) -> tuple[Tensor, Tensor]:
    """From one sample every `duration` seconds to FPS, along the shortest rotations."""
    last = len(local) - 1
    at = torch.arange(0, last * duration + 1e-9, 1 / FPS, dtype=torch.float64) / duration
    before = at.floor().long().clamp(max=max(last - 1, 0))
    after, part = (before + 1).clamp(max=last), at - before
    turn = roma.rotmat_to_rotvec(local[before].transpose(-1, -2) @ local[after])
    rotation = local[before] @ roma.rotvec_to_rotmat(part[:, None, None] * turn)
    return rotation, torch.lerp(position[before], position[after], part[:, None])


def read_motion(path: Path) -> tuple[Array, Array]:
    """One file as rotation vectors (T, 24, 3) and pelvis positions (T, 3) at 20 FPS: Z up, starting at the origin of
    the ground, facing +Y, the lowest joint on the ground.

    Raises:
        InputError: the file cannot be read, or is no DeepMimic humanoid motion.
    """
    try:
        frames = torch.tensor(json.loads(path.read_text())["Frames"], dtype=torch.float64)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as a DeepMimic motion: {error!r}") from error
    if frames.ndim != 2 or frames.shape[1] != 44 or len(frames) < 3:
        raise InputError(f"{path}: a DeepMimic humanoid motion has rows of 44 numbers, this has {tuple(frames.shape)}")
    if frames[-1, 0] <= 0:  # the last row often only closes the file
        frames = frames[:-1]
    rest_joints = rest_joints_of(OFFSETS).double()
    local = _local_rotations(frames)
    hips = (_REST_TO_WORLD @ _SOURCE_TO_REST @ frames[:, 1:4, None])[..., 0] * (LEG / DEEPMIMIC_LEG)
    middle_of_hips = (rest_joints[1] + rest_joints[2]) / 2
    position = hips - (local[:, 0] @ middle_of_hips[:, None])[..., 0]
    local, position = _resample(local, position, float(frames[:, 0].median()))

    turn = towards_plus_y(local[0, 0])
    local[:, 0] = turn @ local[:, 0]
    position = (turn @ (position - position[0] * torch.tensor([1.0, 1, 0]))[..., None])[..., 0]
    _, joints = forward_kinematics(local, position, rest_joints)
    position[:, 2] -= joints[..., 2].min()
    return roma.rotmat_to_rotvec(local).numpy(), position.numpy()


def read_clips(folder: Path) -> list[Clip]:
    """Every known clip of a folder; a strike is where its joint is fastest."""
    clips = []
    for name, (label, side, joint, captions) in CLIPS.items():
        path = folder / f"humanoid3d_{name}.txt"
        if not path.is_file():
            continue
        poses, translation = read_motion(path)
        local = roma.rotvec_to_rotmat(torch.from_numpy(poses))
        _, joints = forward_kinematics(local, torch.from_numpy(translation), rest_joints_of(OFFSETS).double())
        peak = int(joints[:, joint].diff(dim=0).norm(dim=-1).argmax())
        clips.append(
            Clip(
                path.stem, label, side, captions, (peak,) if joint else (), False,
                poses.astype(np.float32), translation.astype(np.float32),
            )
        )  # fmt: skip
    return clips
