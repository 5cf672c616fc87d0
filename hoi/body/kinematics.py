"""Rotations, forward kinematics and linear blend skinning on the SMPL skeleton, differentiable (torch)."""

from itertools import pairwise

import roma
import torch
from torch import Tensor

from hoi.body.skeleton import PARENTS


def _levels() -> tuple[list[tuple[Tensor, Tensor]], Tensor, Tensor]:
    """The skeleton by depth, so that a level is one product of matrices instead of one a joint.

    Returns:
        a level below the root each: its joints, and the places of their parents in the level above; the place of each
        joint in the levels laid end to end (24,); and which bones, each named by its lower joint 1..23, lead to a joint
        (24, 23), 0 or 1.
    """
    ancestry = torch.eye(len(PARENTS))
    for joint, parent in enumerate(PARENTS[1:], start=1):
        ancestry[joint] += ancestry[parent]
    depth = ancestry.sum(dim=1)
    levels = [(depth == d).nonzero()[:, 0] for d in range(1, int(depth.max()) + 1)]
    parents = torch.tensor(PARENTS)
    below = [(now, torch.searchsorted(above, parents[now])) for above, now in pairwise(levels)]
    return below, torch.cat(levels).argsort(), ancestry[:, 1:]


_LEVELS, _RANK, _ANCESTRY = _levels()


def rotation_from_6d(rows: Tensor) -> Tensor:
    """(..., 6) first two rows of a rotation, not necessarily orthonormal -> (..., 3, 3), by Gram-Schmidt on them."""
    return roma.special_gramschmidt(rows.unflatten(-1, (2, 3)).transpose(-1, -2)).transpose(-1, -2)


def rotation_to_6d(rotation: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 6): the first two rows, row-major."""
    return rotation[..., :2, :].flatten(-2)


def local_rotations(orientation: Tensor, body_pose: Tensor) -> Tensor:
    """orientation (..., 6), body_pose (..., 23, 3) axis-angle -> local rotation matrices (..., 24, 3, 3)."""
    root = rotation_from_6d(orientation)
    return torch.cat([root[..., None, :, :], roma.rotvec_to_rotmat(body_pose)], dim=-3)


def forward_kinematics(local: Tensor, translation: Tensor, rest_joints: Tensor) -> tuple[Tensor, Tensor]:
    """Global joint rotations and positions.

    Args:
        local: local rotations (..., 24, 3, 3); the root's maps the rest frame to the world.
        translation: world position of the pelvis joint [m], (..., 3).
        rest_joints: T-pose joints [m], (24, 3).

    Returns:
        rotations (..., 24, 3, 3) and positions (..., 24, 3) [m] in the world.
    """
    rotations = [local[..., :1, :, :]]
    for joints, parents in _LEVELS:
        above = rotations[-1].index_select(-3, parents.to(local.device))
        rotations.append(above @ local.index_select(-3, joints.to(local.device)))
    turned = torch.cat(rotations, dim=-3).index_select(-3, _RANK.to(local.device))
    parents = torch.tensor(PARENTS[1:], device=local.device)
    offsets = rest_joints[1:] - rest_joints[parents]
    bones = (turned.index_select(-3, parents) @ offsets[:, :, None])[..., 0]
    return turned, translation[..., None, :] + _ANCESTRY.to(bones) @ bones


def joint_positions(translation: Tensor, orientation: Tensor, body_pose: Tensor, rest_joints: Tensor) -> Tensor:
    """World joint positions p_j [m], (..., 24, 3), of a motion given by its parameters (see `hoi.data.Motion`)."""
    return forward_kinematics(local_rotations(orientation, body_pose), translation, rest_joints)[1]


def leg_length(rest_joints: Tensor) -> Tensor:
    """Height of the pelvis above the lowest joint in the T-pose [m]."""
    return rest_joints[0, 1] - rest_joints[:, 1].min()
