"""Skeleton, rotations, forward kinematics, interpolation."""

import numpy as np
import pytest
import roma
import torch

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import (
    forward_kinematics,
    joint_positions,
    local_rotations,
    rotation_from_6d,
    rotation_to_6d,
)
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS, PARENTS
from hoi.data import Motion


def rodrigues(rotvec: np.ndarray) -> np.ndarray:
    """Textbook axis-angle to matrix, one vector, float64."""
    angle = np.linalg.norm(rotvec)
    if angle == 0:
        return np.eye(3)
    x, y, z = rotvec / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def random_pose(seed: int, frames: int, spread: float = 0.6) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    translation = torch.randn(frames, 3, dtype=torch.float64, generator=generator)
    orientation = rotation_to_6d(
        roma.rotvec_to_rotmat(torch.randn(frames, 3, dtype=torch.float64, generator=generator))
    )
    body_pose = spread * torch.randn(frames, 23, 3, dtype=torch.float64, generator=generator)
    return translation, orientation, body_pose


@pytest.fixture
def rest_joints() -> torch.Tensor:
    return torch.randn(JOINT_COUNT, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))


def test_skeleton_is_a_tree_with_mirrored_sides():
    assert len(PARENTS) == JOINT_COUNT == 24
    assert all(parent < joint for joint, parent in enumerate(PARENTS))
    for joint, name in enumerate(JOINT_NAMES):
        if name.startswith("left_"):
            mirrored = JOINT_NAMES.index("right_" + name.removeprefix("left_"))
            left_parent, right_parent = JOINT_NAMES[PARENTS[joint]], JOINT_NAMES[PARENTS[mirrored]]
            assert right_parent == left_parent.replace("left_", "right_")
    for limb, joints in LIMBS.items():
        assert all(0 < joint < JOINT_COUNT for joint in joints), limb


def test_6d_keeps_rotations_also_half_turns():
    axes = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [-0.48, 0.6, 0.64]], dtype=torch.float64)
    for angle in (0.0, 1e-8, 1.0, np.pi - 1e-9, np.pi, 3.5):
        rotation = torch.from_numpy(np.stack([rodrigues(angle * axis.numpy()) for axis in axes]))
        torch.testing.assert_close(rotation_from_6d(rotation_to_6d(rotation)), rotation, atol=1e-12, rtol=0)


def test_6d_uses_the_first_two_rows():
    rotation = roma.rotvec_to_rotmat(torch.tensor([0.3, -0.2, 0.9], dtype=torch.float64))
    torch.testing.assert_close(rotation_to_6d(rotation), torch.cat([rotation[0], rotation[1]]))


def test_any_6d_decodes_to_a_rotation():
    rows = torch.randn(50, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    rotation = rotation_from_6d(rows)
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3))
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(50, dtype=torch.float64))
    direction = rows[:, :3] / rows[:, :3].norm(dim=1, keepdim=True)
    torch.testing.assert_close(rotation[:, 0], direction)


def test_forward_kinematics_against_a_plain_loop(rest_joints):
    translation, orientation, body_pose = random_pose(3, frames=4)
    rotations, positions = forward_kinematics(local_rotations(orientation, body_pose), translation, rest_joints)
    rest = rest_joints.numpy()
    for frame in range(4):
        first, second = orientation[frame].reshape(2, 3).numpy()
        root = np.stack([first, second, np.cross(first, second)])
        expected_rotations, expected_positions = [root], [translation[frame].numpy()]
        for joint in range(1, JOINT_COUNT):
            parent = PARENTS[joint]
            offset = expected_rotations[parent] @ (rest[joint] - rest[parent])
            expected_positions.append(expected_positions[parent] + offset)
            expected_rotations.append(expected_rotations[parent] @ rodrigues(body_pose[frame, joint - 1].numpy()))
        np.testing.assert_allclose(rotations[frame], np.stack(expected_rotations), atol=1e-12)
        np.testing.assert_allclose(positions[frame], np.stack(expected_positions), atol=1e-12)


def test_identity_pose_is_the_rest_pose(rest_joints):
    identity = rotation_to_6d(torch.eye(3, dtype=torch.float64))[None]
    positions = joint_positions(rest_joints[None, 0], identity, torch.zeros(1, 23, 3, dtype=torch.float64), rest_joints)
    torch.testing.assert_close(positions[0], rest_joints)


def test_bones_keep_their_length(rest_joints):
    positions = joint_positions(*random_pose(4, frames=5, spread=2.0), rest_joints)
    parents = list(PARENTS[1:])
    length = (positions[:, 1:] - positions[:, parents]).norm(dim=-1)
    expected = (rest_joints[1:] - rest_joints[parents]).norm(dim=-1)
    torch.testing.assert_close(length, expected.expand_as(length))


def test_gradient_of_forward_kinematics(rest_joints):
    inputs = tuple(tensor.requires_grad_() for tensor in random_pose(5, frames=1))
    assert torch.autograd.gradcheck(lambda r, omega, theta: joint_positions(r, omega, theta, rest_joints), inputs)


def test_gradient_is_finite_at_the_zero_pose(rest_joints):
    _, orientation, _ = random_pose(6, frames=1)
    body_pose = torch.zeros(1, 23, 3, dtype=torch.float64, requires_grad=True)
    joint_positions(
        torch.zeros(1, 3, dtype=torch.float64), orientation, body_pose, rest_joints
    ).square().sum().backward()
    assert body_pose.grad is not None
    assert torch.isfinite(body_pose.grad).all() and body_pose.grad.abs().max() > 0


def example_motion(frames: int = 5) -> Motion:
    translation, orientation, body_pose = (tensor.numpy() for tensor in random_pose(7, frames))
    return Motion(translation, orientation, body_pose, fps=20.0)


def test_interpolation_returns_whole_frames():
    motion = example_motion()
    same = interpolate_motion(motion, np.arange(5))
    np.testing.assert_allclose(same.translation, motion.translation, atol=1e-12)
    np.testing.assert_allclose(same.orientation, motion.orientation, atol=1e-12)
    turned, expected = (roma.rotvec_to_rotmat(torch.from_numpy(m.body_pose)) for m in (same, motion))
    torch.testing.assert_close(turned, expected, atol=1e-12, rtol=0)


def test_interpolation_turns_at_a_constant_rate():
    pose = np.zeros((2, 23, 3))
    pose[0, 4], pose[1, 4] = (0, 0, 0.5), (0, 0, 2.5)
    root = np.stack([rodrigues(np.array([0, angle, 0]))[:2].ravel() for angle in (0.0, 1.6)])
    motion = Motion(np.array([[0.0, 0, 1], [2.0, 0, 1]]), root, pose, fps=20.0)
    between = interpolate_motion(motion, [0.0, 0.25, 0.5, 1.0])
    np.testing.assert_allclose(between.body_pose[:, 4, 2], [0.5, 1.0, 1.5, 2.5], atol=1e-12)
    np.testing.assert_allclose(between.translation[:, 0], [0, 0.5, 1, 2], atol=1e-12)
    np.testing.assert_allclose(between.orientation[1], rodrigues(np.array([0, 0.4, 0]))[:2].ravel(), atol=1e-12)


def test_interpolation_takes_the_shorter_arc():
    pose = np.zeros((2, 23, 3))
    pose[0, 0], pose[1, 0] = (3.0, 0, 0), (-3.0, 0, 0)
    motion = Motion(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0, 1, 0], (2, 1)), pose, fps=20.0)
    halfway = interpolate_motion(motion, [0.5]).body_pose[0, 0]
    assert np.linalg.norm(halfway) == pytest.approx(np.pi)


@pytest.mark.parametrize("frame", [-0.1, 4.1, np.nan])
def test_interpolation_refuses_frames_outside(frame):
    with pytest.raises(ValueError, match=r"must lie in \[0, 4\]"):
        interpolate_motion(example_motion(), [frame])


def test_interpolated_velocities_have_no_jumps_and_are_exact_where_a_limb_gains_speed_evenly():
    seconds = np.arange(6) / 20.0
    pose = np.zeros((6, 23, 3))
    pose[:, 4, 2] = 0.3 + 2.0 * seconds + 0.5 * 40.0 * seconds**2
    root = np.stack([rodrigues(np.array([0, 30.0 * s**2, 0]))[:2].ravel() for s in seconds])
    motion = Motion(np.outer(seconds**2, [1.0, 0, 2]), root, pose, fps=20.0)
    at = np.array([1.3, 2.0, 2.5, 3.9])
    between = interpolate_motion(motion, at)
    np.testing.assert_allclose(
        between.body_pose[:, 4, 2], 0.3 + 2.0 * at / 20 + 0.5 * 40.0 * (at / 20) ** 2, atol=1e-12
    )
    np.testing.assert_allclose(between.translation, np.outer((at / 20) ** 2, [1.0, 0, 2]), atol=1e-12)
    expected = np.stack([rodrigues(np.array([0, 30.0 * (a / 20) ** 2, 0]))[:2].ravel() for a in at])
    np.testing.assert_allclose(between.orientation, expected, atol=1e-12)


@pytest.mark.parametrize("frame", [1, 2, 3])
def test_a_turn_in_space_is_smooth_at_its_frames(frame):
    motion, small = example_motion(), 1e-6
    sides = interpolate_motion(motion, [frame - small, frame, frame + small])
    turns = roma.rotvec_to_rotmat(torch.from_numpy(sides.body_pose))
    before, after = (roma.rotmat_to_rotvec(turns[i].mT @ turns[i + 1]) / small for i in (0, 1))
    torch.testing.assert_close(before, after, atol=1e-3, rtol=0)
