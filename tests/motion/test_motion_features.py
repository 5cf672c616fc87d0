import math

import pytest
import roma
import torch

from hoi.body.kinematics import joint_positions, rotation_to_6d
from hoi.motion.features import FACING_PLUS_Y, FEATURE_COUNT, decode, encode, heading_of, turn_about_z

FRAMES = 12
STANDING = torch.tensor([math.pi / 2, 0, 0], dtype=torch.float64)
"""Rotation vector of a pelvis that stands upright facing -Y."""


def rest_joints(seed: int = 3) -> torch.Tensor:
    return 0.3 * torch.randn(24, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def random_motion(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Two motions that tumble mildly while turning more than a full circle."""
    generator = torch.Generator().manual_seed(seed)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(2, FRAMES, *shape, generator=generator, dtype=torch.float64)

    turn = torch.linspace(0, 7, FRAMES, dtype=torch.float64)
    root = turn_about_z(torch.stack([turn.cos(), turn.sin()], -1)) @ roma.rotvec_to_rotmat(STANDING + 0.3 * noise(3))
    body_pose = 0.4 * noise(23, 3)
    body_pose[..., 21:, :] = 0  # the features have no slot for the hands
    return 0.05 * noise(3).cumsum(1), rotation_to_6d(root), body_pose


def heading_angle(orientation: torch.Tensor) -> float:
    """Of the first frame."""
    cosine, sine = heading_of(orientation.unflatten(-1, (2, 3)))[0]
    return math.atan2(sine, cosine)


def standing(frames: int = 5) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    orientation = rotation_to_6d(roma.rotvec_to_rotmat(STANDING)).expand(frames, 6).clone()
    return (
        torch.zeros(frames, 3, dtype=torch.float64),
        orientation,
        torch.zeros(frames, 23, 3, dtype=torch.float64),
    )


def test_round_trip_is_exact_in_double():
    translation, orientation, body_pose = random_motion()
    features = encode(translation, orientation, body_pose, rest_joints(), ground=0.0)
    assert features.shape == (2, FRAMES, FEATURE_COUNT)
    for one in range(2):
        start = tuple(translation[one, 0, :2].tolist())
        r, omega, theta = decode(features[one], start, heading_angle(orientation[one]))
        torch.testing.assert_close(r, translation[one], atol=1e-9, rtol=0)
        torch.testing.assert_close(omega, orientation[one], atol=1e-9, rtol=0)
        torch.testing.assert_close(theta, body_pose[one], atol=1e-9, rtol=0)


def test_features_ignore_where_on_the_ground_and_which_way():
    translation, orientation, body_pose = random_motion()
    features = encode(translation, orientation, body_pose, rest_joints())
    turn = turn_about_z(torch.tensor([math.cos(2.1), math.sin(2.1)], dtype=torch.float64))
    moved = (turn @ translation[..., None])[..., 0] + torch.tensor([3.0, -4.0, 0.7])
    root = turn @ torch.cat([orientation.unflatten(-1, (2, 3)), torch.zeros_like(translation)[..., None, :]], dim=-2)
    root[..., 2, :] = torch.linalg.cross(root[..., 0, :], root[..., 1, :])
    full = roma.special_gramschmidt(orientation.unflatten(-1, (2, 3)).transpose(-1, -2)).transpose(-1, -2)
    again = encode(moved, rotation_to_6d(turn @ full), body_pose, rest_joints())
    torch.testing.assert_close(again, features, atol=1e-10, rtol=0)


def test_height_counts_from_the_lowest_joint_or_from_a_given_ground():
    translation, orientation, body_pose = random_motion()
    joints = joint_positions(translation, orientation, body_pose, rest_joints())
    lowest = encode(translation, orientation, body_pose, rest_joints())[..., 0]
    torch.testing.assert_close(lowest, translation[..., 2] - joints[..., 2].amin(dim=(-1, -2))[:, None])
    given = encode(translation, orientation, body_pose, rest_joints(), ground=0.25)[..., 0]
    torch.testing.assert_close(given, translation[..., 2] - 0.25)


def test_positions_and_velocity_are_in_the_heading_frame():
    """Walking straight ahead while facing +Y: in the frame of heading pi, ahead is -y and the left is +x."""
    translation, orientation, body_pose = standing()
    half_turn = torch.tensor([-1.0, 0.0], dtype=torch.float64)
    full = turn_about_z(half_turn) @ roma.rotvec_to_rotmat(STANDING)
    orientation = rotation_to_6d(full).expand_as(orientation)
    translation[:, 1] = 0.04 * torch.arange(5)
    rest = torch.zeros(24, 3, dtype=torch.float64)
    rest[1] = torch.tensor([0.1, -0.2, 0.03])  # left hip: to the left, below, a bit ahead
    features = encode(translation, orientation, body_pose, rest)
    torch.testing.assert_close(features[:, 1:3], torch.tensor([[0.0, -0.04]]).double().expand(5, 2))
    torch.testing.assert_close(features[:, 136:139], torch.tensor([[0.1, -0.03, -0.2]]).double().expand(5, 3))
    assert heading_angle(orientation) == pytest.approx(FACING_PLUS_Y)


def test_last_velocity_repeats_the_last_acceleration():
    translation, orientation, body_pose = standing(4)
    translation[:, 0] = torch.tensor([0.0, 1.0, 3.0, 6.0])  # velocities 1, 2, 3, then 4
    turn = torch.tensor([0.0, 0.1, 0.3, 0.6], dtype=torch.float64)
    orientation = rotation_to_6d(turn_about_z(torch.stack([turn.cos(), turn.sin()], -1)) @ _upright())
    features = encode(translation, orientation, body_pose, rest_joints())
    torch.testing.assert_close(features[:, 3], torch.tensor([0.1, 0.2, 0.3, 0.4]).double())
    torch.testing.assert_close(features[:, 1:3].norm(dim=-1), torch.tensor([1.0, 2.0, 3.0, 4.0]).double())


def _upright() -> torch.Tensor:
    return roma.rotvec_to_rotmat(STANDING)


def test_gradients_are_finite_at_zero_pose_and_right_elsewhere():
    translation, orientation, body_pose = (value.requires_grad_() for value in standing())
    encode(translation, orientation, body_pose, rest_joints()).square().sum().backward()
    for value in (translation, orientation, body_pose):
        assert value.grad is not None and value.grad.isfinite().all()

    features = encode(*standing(), rest_joints()).detach().requires_grad_()
    torch.cat([value.flatten() for value in decode(features)]).square().sum().backward()
    assert features.grad is not None and features.grad.isfinite().all()

    translation, orientation, body_pose = (value[0, :3].clone().requires_grad_() for value in random_motion(1))
    arguments = (translation, orientation, body_pose)
    assert torch.autograd.gradcheck(lambda r, o, p: encode(r, o, p, rest_joints())[..., ::11], arguments, atol=1e-5)
    features = encode(translation, orientation, body_pose, rest_joints()).detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda f: decode(f)[1][::2], (features,), atol=1e-5)


def test_no_heading_lying_on_the_side_stays_finite():
    left_up = torch.tensor([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]], dtype=torch.float64)  # the left points straight up
    translation, orientation, body_pose = standing()
    orientation = rotation_to_6d(left_up).expand_as(orientation).clone().requires_grad_()
    features = encode(translation, orientation, body_pose, rest_joints())
    features.sum().backward()
    assert features.isfinite().all() and orientation.grad is not None and orientation.grad.isfinite().all()


def test_decode_drops_the_pelvis_own_turn_and_orthonormalises():
    translation, orientation, body_pose = random_motion()
    features = encode(translation[0], orientation[0], body_pose[0], rest_joints())
    expected = decode(features)
    spoilt = features.clone()
    turn = turn_about_z(torch.tensor([math.cos(0.4), math.sin(0.4)], dtype=torch.float64))
    root = roma.special_gramschmidt(features[:, 4:10].unflatten(-1, (2, 3)).transpose(-1, -2)).transpose(-1, -2)
    spoilt[:, 4:10] = 1.7 * rotation_to_6d(turn @ root)
    spoilt[:, 136:] = 9.0  # positions are redundant
    for got, wanted in zip(decode(spoilt), expected, strict=True):
        torch.testing.assert_close(got, wanted)
