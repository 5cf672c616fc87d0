"""Motions between their frames."""

import numpy as np
import roma
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from hoi.body.kinematics import rotation_from_6d, rotation_to_6d
from hoi.data import Motion

SLACK = 1e-6
"""How far outside the first and last frame rounding may put a frame."""


def interpolate_motion(motion: Motion, frames: ArrayLike) -> Motion:
    """The motion at fractional frames: translation linearly, each local rotation by slerp along the shorter arc.

    Args:
        frames: (F,), in [0, T - 1] and in any order.

    Returns:
        Motion of F frames; its `fps` is still that of `motion`, not the rate of `frames`.

    Raises:
        ValueError: a frame lies outside the motion.
    """
    last = len(motion) - 1
    at = np.atleast_1d(np.asarray(frames, dtype=np.float64))
    if len(at) and not (at.min() >= -SLACK and at.max() <= last + SLACK):
        raise ValueError(f"frames from {at.min():g} to {at.max():g}: must lie in [0, {last}]")
    values = (motion.translation, motion.orientation, motion.body_pose)
    translation, orientation, body_pose = (torch.as_tensor(value, dtype=torch.float64) for value in values)
    parts = interpolate_pose(translation, orientation, body_pose, at)
    dtype = np.asarray(motion.translation).dtype
    return Motion(*(part.numpy().astype(dtype) for part in parts), fps=motion.fps)


def interpolate_pose(
    translation: Tensor, orientation: Tensor, body_pose: Tensor, at: np.ndarray
) -> tuple[Tensor, Tensor, Tensor]:
    """What `interpolate_motion` does, of a motion's parameters (see `hoi.data.Motion`) and differentiable in them.

    Args:
        at: frames (F,), those outside the motion are taken as its first or last.
    """
    last = len(translation) - 1
    at = at.clip(0, last)
    before = np.floor(at).astype(np.intp)
    after = np.minimum(before + 1, last)
    share = torch.from_numpy(at - before).to(translation)
    root = _slerp(roma.rotmat_to_unitquat(rotation_from_6d(orientation)), before, after, share)
    joints = _slerp(roma.rotvec_to_unitquat(body_pose), before, after, share[:, None])
    return (
        torch.lerp(translation[before], translation[after], share[:, None]),
        rotation_to_6d(roma.unitquat_to_rotmat(root)),
        roma.unitquat_to_rotvec(joints),
    )


def _slerp(quaternions: Tensor, before: np.ndarray, after: np.ndarray, share: Tensor) -> Tensor:
    """q_0 exp(s log(q_0^-1 q_1)) with roma's xyzw quaternions (T, ..., 4) -> (F, ..., 4)."""
    start = quaternions[before]
    turn = roma.unitquat_to_rotvec(roma.quat_product(roma.quat_conjugation(start), quaternions[after]))
    return roma.quat_product(start, roma.rotvec_to_unitquat(share[..., None] * turn))
