"""Motions between their frames: their velocity has no jumps, as that of a limb has none."""

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
    """The motion at fractional frames: cubic from frame to frame, of translation and of each local rotation.

    At a frame the velocity is the mean of the steps before and after it (Catmull and Rom 1974), at the ends that of the
    one step. A rotation's step is along the shorter arc, and between frames it goes by its logarithm: two frames alone
    are joined by a straight line and a slerp.

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
    before = np.minimum(np.floor(at).astype(np.intp), max(last - 1, 0))
    after = np.minimum(before + 1, last)
    share = torch.from_numpy(at - before).to(translation)[:, None]
    step = translation[1:] - translation[:-1]
    rates = _rates(step)
    moved = step[before] if last else translation.new_zeros(len(at), 3)
    root = _turned(roma.rotmat_to_unitquat(rotation_from_6d(orientation)), before, after, share)
    joints = _turned(roma.rotvec_to_unitquat(body_pose), before, after, share[..., None])
    return (
        translation[before] + _hermite(moved, rates[before], rates[after], share),
        rotation_to_6d(roma.unitquat_to_rotmat(root)),
        roma.unitquat_to_rotvec(joints),
    )


def _rates(steps: Tensor) -> Tensor:
    """Per frame, (T, ...), from what is passed from each frame to the next, (T - 1, ...)."""
    if not len(steps):
        return steps.new_zeros((1, *steps.shape[1:]))
    return torch.cat([steps[:1], 0.5 * (steps[1:] + steps[:-1]), steps[-1:]])


def _hermite(step: Tensor, begins: Tensor, ends: Tensor, share: Tensor) -> Tensor:
    """The cubic from 0 to `step` as `share` goes from 0 to 1, with rates `begins` and `ends`."""
    left = 1 - share
    return share**2 * (3 - 2 * share) * step + share * left * (left * begins - share * ends)


def _turned(quaternions: Tensor, before: np.ndarray, after: np.ndarray, share: Tensor) -> Tensor:
    """q_0 exp(r(s)), r the cubic from 0 to log(q_0^-1 q_1): roma's xyzw quaternions (T, ..., 4) -> (F, ..., 4)."""
    inverse = roma.quat_conjugation(quaternions[:-1])
    steps = roma.unitquat_to_rotvec(roma.quat_product(inverse, quaternions[1:]))
    rates = _rates(steps)  # in the turning frame, which a turn about itself leaves alone
    start = quaternions[before]
    if not len(steps):
        return start
    step = steps[before]
    turn = _hermite(step, rates[before], _to_logarithm(step, rates[after]), share)
    return roma.quat_product(start, roma.rotvec_to_unitquat(turn))


def _to_logarithm(turn: Tensor, rate: Tensor) -> Tensor:
    """How fast log(exp(turn) exp(rate t)) begins to change: J_r(turn)^-1 rate, both (..., 3)."""
    square = turn.square().sum(dim=-1, keepdim=True)
    small = square < 1e-4
    angle = torch.where(small, 1.0, square).sqrt()
    factor = torch.where(small, 1 / 12 + square / 720, 1 / angle**2 - 1 / (2 * angle * torch.tan(angle / 2)))
    across = torch.linalg.cross(turn, rate)
    return rate + 0.5 * across + factor * torch.linalg.cross(turn, across)
