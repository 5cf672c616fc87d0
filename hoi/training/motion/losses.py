"""What a denoiser is trained for: the features themselves, and the body and its steps that they stand for.

The rotations and root features alone move a person at run time, and a small error in a thigh's rotation is a large one
at the foot: joints and their velocities are therefore compared too, after forward kinematics (as MDM's geometric
losses, Tevet et al. 2022).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from hoi.body.kinematics import forward_kinematics, rotation_from_6d
from hoi.motion.features import turn_about_z

ROOT_FEATURES = 4
ROOT_WEIGHT = 5.0
"""Of each of the four root features against the 201 others: all of the person's way hangs on them."""
POSITION_SCALE = 0.15
"""An error of a joint [m] that counts as much as one of a standard deviation of a feature."""
VELOCITY_SCALE = 0.04
"""The same for a joint's velocity [m/frame]."""
FEET = (6, 7, 9, 10)
"""Ankles and toes among joints 1..23."""
CONTACT_HEIGHT, CONTACT_SPEED = 0.12, 0.02
"""A foot stands where its joint is lower [m] and slower [m/frame] than this in the real clip."""
CONTACT_WEIGHT = 4.0
"""Of the velocity of a foot that stands, against that of another joint."""
GEOMETRY_WEIGHT = 0.1
"""Of the joints and their velocities against the features."""


def joints_of(features: Tensor, rest_joints: Tensor) -> Tensor:
    """Joints 1..23 relative to the pelvis in the heading frame [m], (..., 23, 3), from the rotations of features."""
    rotations = rotation_from_6d(features[..., 4:136].unflatten(-1, (22, 6)))
    hands = torch.eye(3, dtype=features.dtype, device=features.device).expand(*rotations.shape[:-3], 2, 3, 3)
    origin = torch.zeros_like(features[..., :3])
    return forward_kinematics(torch.cat([rotations, hands], dim=-3), origin, rest_joints)[1][..., 1:, :]


def velocities_of(features: Tensor, joints: Tensor) -> Tensor:
    """Steps of the joints (..., T, 23, 3) over the ground in the heading frame [m/frame], (..., T-1, 23, 3)."""
    turn = features[..., :-1, 3]
    ahead = torch.einsum(
        "...ij,...kj->...ki", turn_about_z(torch.stack([turn.cos(), turn.sin()], -1)), joints[..., 1:, :, :]
    )
    root = torch.cat([features[..., :-1, 1:3], features[..., :1].diff(dim=-2)], dim=-1)
    return root[..., None, :] + ahead - joints[..., :-1, :, :]


@dataclass(frozen=True)
class MotionLoss:
    """Loss of a predicted x0."""

    mean: Tensor
    std: Tensor
    rest_joints: Tensor

    def __call__(self, predicted: Tensor, x0: Tensor, alphas_cumprod: Tensor) -> tuple[Tensor, Tensor]:
        """The loss, and the plain mean squared error of the features beside it.

        Where little of the motion is left in x_t there are many answers, and the best guess is their mean, which is no
        body: the geometric terms count by abar_t.

        Args:
            predicted, x0: normalised features, (B, T, 205).
            alphas_cumprod: abar_t of each row, (B,).
        """
        square = (predicted - x0).square()
        weights = torch.ones_like(self.mean)
        weights[:ROOT_FEATURES] = ROOT_WEIGHT
        plain = (square * weights).sum(-1).mean() / weights.sum()

        guess, real = predicted * self.std + self.mean, x0 * self.std + self.mean
        real_joints = real[..., 136:].unflatten(-1, (23, 3))
        joints = joints_of(guess, self.rest_joints)
        position = (joints - real_joints).square().sum(-1).mean((-1, -2)) / POSITION_SCALE**2

        real_velocity = velocities_of(real, real_joints)
        velocity = (velocities_of(guess, joints) - real_velocity).square().sum(-1)
        counts = torch.ones_like(velocity)
        feet = list(FEET)
        height = real[..., :-1, :1] + real_joints[..., :-1, feet, 2]
        stands = (height < CONTACT_HEIGHT) & (real_velocity[..., feet, :].norm(dim=-1) < CONTACT_SPEED)
        counts[..., feet] += (CONTACT_WEIGHT - 1) * stands
        velocity = (velocity * counts).mean((-1, -2)) / VELOCITY_SCALE**2

        geometry = (alphas_cumprod * (position + velocity)).mean()
        return plain + GEOMETRY_WEIGHT * geometry, square.mean()
