"""The 205 features a frame of the motion prior ("smplrifke", STMC), from and to a motion; differentiable both ways.

    0        height of the pelvis joint above the ground [m]
    1:3      xy velocity of the pelvis, in the heading frame of its own frame [m/frame]
    3        angular velocity of the heading about z [rad/frame]
    4:136    first two rows of the rotation of joints 0..21, relative to the parent; the pelvis' without heading
    136:205  positions of joints 1..23 relative to the pelvis, in the heading frame [m]

Heading: with the pelvis rotation R = Rz(c) Ry(b) Rx(a), from the rest frame (y up, facing +z) to the world (z up), the
heading is c: the angle of the body's left in the ground plane, counted from +x. A standing person of heading 0
faces -Y, of heading pi +Y. Features know neither the start's xy nor its heading; `decode` is given both.
R has no heading where the body's left points straight up or down (b = +-pi/2, lying on the side).
"""

import math

import roma
import torch
from torch import Tensor

from hoi.body.kinematics import forward_kinematics, local_rotations, rotation_from_6d, rotation_to_6d

FEATURE_COUNT = 205
FACING_PLUS_Y = math.pi
"""The heading at which people start here."""

_HEIGHT, _VELOCITY, _TURN, _ROTATIONS, _POSITIONS = (
    slice(0, 1), slice(1, 3), slice(3, 4), slice(4, 136), slice(136, 205),
)  # fmt: skip

PARTS = {
    "left_arm": (13, 16, 18, 20, 22),
    "right_arm": (14, 17, 19, 21, 23),
    "legs": (0, 1, 2, 4, 5, 7, 8, 10, 11),
    "head": (12, 15),
    "spine": (3, 6, 9),
}
"""The joints of the body parts that STMC puts motions together from; the root goes with the legs."""


def columns_of(part: str) -> list[int]:
    """The features of a body part: each feature is one part's."""
    joints = PARTS[part]
    rotations = [_ROTATIONS.start + 6 * joint + k for joint in joints if joint < 22 for k in range(6)]
    positions = [_POSITIONS.start + 3 * (joint - 1) + k for joint in joints if joint > 0 for k in range(3)]
    return [*(range(_ROTATIONS.start) if part == "legs" else ()), *rotations, *positions]


def heading_of(rotation: Tensor) -> Tensor:
    """Unit vector (cos c, sin c) of the heading, (..., 2), of pelvis rotations (..., 3, 3); (1, 0) where undefined."""
    left = rotation[..., :2, 0]
    square = left.square().sum(-1, keepdim=True)
    defined = square > 1e-12
    safe = torch.where(defined, square, torch.ones_like(square))
    return torch.where(defined, left * safe.rsqrt(), torch.tensor([1.0, 0.0], dtype=left.dtype, device=left.device))


def turn_about_z(direction: Tensor) -> Tensor:
    """Rz of (cos c, sin c): (..., 2) -> (..., 3, 3)."""
    cosine, sine = direction.unbind(-1)
    zero, one = torch.zeros_like(cosine), torch.ones_like(cosine)
    rows = [cosine, -sine, zero, sine, cosine, zero, zero, zero, one]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def towards_plus_y(rotation: Tensor) -> Tensor:
    """The turn about z, (3, 3), after which a person with the pelvis rotation (3, 3) faces +Y."""
    forward = torch.tensor([math.cos(FACING_PLUS_Y), math.sin(FACING_PLUS_Y)], dtype=rotation.dtype)
    return turn_about_z(forward) @ turn_about_z(heading_of(rotation)).mT


def _repeat_last_acceleration(velocity: Tensor) -> Tensor:
    """(..., T-1, n) -> (..., T, n): the velocity after the last frame, which nobody has seen."""
    return torch.cat([velocity, 2 * velocity[..., -1:, :] - velocity[..., -2:-1, :]], dim=-2)


def encode(
    translation: Tensor, orientation: Tensor, body_pose: Tensor, rest_joints: Tensor, ground: float | None = None
) -> Tensor:
    """Features of a motion X = (r, omega, theta).

    Args:
        translation: r, world position of the pelvis joint [m], (..., T, 3), T >= 3.
        orientation: omega, first two rows of the pelvis rotation, (..., T, 6).
        body_pose: theta, axis-angle of joints 1..23 [rad], (..., T, 23, 3). The hands' (22, 23) does not count.
        rest_joints: T-pose joints of the *prior's* skeleton [m], (24, 3).
        ground: height z from which the pelvis is measured [m]. None: the lowest joint of the sequence, as STMC has it;
            its gradient then also passes through that joint, and lifting the whole motion changes nothing.

    Returns:
        (..., T, 205), unnormalised.
    """
    local = local_rotations(orientation, body_pose)
    _, joints = forward_kinematics(local, translation, rest_joints)
    root = local[..., 0, :, :]
    heading = heading_of(root)
    to_heading = turn_about_z(heading).transpose(-1, -2)

    if ground is None:
        height = translation[..., 2:] - joints[..., 2].amin(dim=(-1, -2), keepdim=True)
    else:
        height = translation[..., 2:] - ground
    velocity = _repeat_last_acceleration(translation.diff(dim=-2))
    velocity = (to_heading @ velocity[..., None])[..., :2, 0]
    before, after = heading[..., :-1, :], heading[..., 1:, :]
    sine = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    turn = _repeat_last_acceleration(torch.atan2(sine, (before * after).sum(-1))[..., None])
    rotations = torch.cat([(to_heading @ root)[..., None, :, :], local[..., 1:22, :, :]], dim=-3)
    positions = torch.einsum("...ij,...kj->...ki", to_heading, joints[..., 1:, :] - joints[..., :1, :])
    return torch.cat([height, velocity, turn, rotation_to_6d(rotations).flatten(-2), positions.flatten(-2)], dim=-1)


def decode(
    features: Tensor, start_xy: tuple[float, float] = (0.0, 0.0), start_heading: float = FACING_PLUS_Y
) -> tuple[Tensor, Tensor, Tensor]:
    """The motion of features (..., T, 205), from the root features and the rotations; the positions are not used.

    The rotations need not be orthonormal. The pelvis' own turn about z is dropped for the integrated heading, as STMC
    does, and the last frame's velocities are not used. Hands get no rotation.

    Returns:
        translation (..., T, 3) with z measured from the ground, orientation (..., T, 6), body_pose (..., T, 23, 3).
    """
    turn = features[..., _TURN]
    start = torch.full_like(turn[..., :1, :], start_heading)
    angle = torch.cat([start, start_heading + turn[..., :-1, :].cumsum(-2)], dim=-2)
    heading = turn_about_z(torch.cat([angle.cos(), angle.sin()], dim=-1))

    velocity = (heading[..., :2, :2] @ features[..., _VELOCITY, None])[..., 0]
    origin = torch.tensor(start_xy, dtype=features.dtype, device=features.device).expand_as(velocity[..., :1, :])
    xy = torch.cat([origin, origin + velocity[..., :-1, :].cumsum(-2)], dim=-2)

    rotations = rotation_from_6d(features[..., _ROTATIONS].unflatten(-1, (22, 6)))
    root = rotations[..., 0, :, :]
    root = heading @ turn_about_z(heading_of(root)).transpose(-1, -2) @ root
    pose = roma.rotmat_to_rotvec(rotations[..., 1:, :, :])
    pose = torch.cat([pose, torch.zeros_like(pose[..., :2, :])], dim=-2)
    return torch.cat([xy, features[..., _HEIGHT]], dim=-1), rotation_to_6d(root), pose
