"""Rotations, forward kinematics and linear blend skinning on the SMPL skeleton, differentiable (torch)."""

import roma
import torch
from torch import Tensor

from hoi.body.skeleton import PARENTS


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
    rotations = [local[..., 0, :, :]]
    positions = [translation]
    for joint, parent in enumerate(PARENTS[1:], start=1):
        offset = rest_joints[joint] - rest_joints[parent]
        positions.append(positions[parent] + (rotations[parent] @ offset[:, None])[..., 0])
        rotations.append(rotations[parent] @ local[..., joint, :, :])
    return torch.stack(rotations, dim=-3), torch.stack(positions, dim=-2)


def joint_positions(translation: Tensor, orientation: Tensor, body_pose: Tensor, rest_joints: Tensor) -> Tensor:
    """World joint positions p_j [m], (..., 24, 3), of a motion given by its parameters (see `hoi.data.Motion`)."""
    return forward_kinematics(local_rotations(orientation, body_pose), translation, rest_joints)[1]
