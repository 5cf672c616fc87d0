"""Linear blend skinning and what it does to orientations."""

import numpy as np
import pytest
import roma
import torch

from hoi.body.kinematics import forward_kinematics, local_rotations, rotation_from_6d, rotation_to_6d
from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES
from hoi.body.skinning import (
    BodyTensors,
    body_tensors,
    joint_paths,
    pose_gaussians,
    pose_means,
    pose_quaternions,
    posed_means,
    stand_motion,
)
from hoi.data import Motion


def random_body(seed: int, count: int = 12, influences: int = 4) -> BodyTensors:
    rng = np.random.default_rng(seed)
    weights = np.zeros((count, JOINT_COUNT))
    for row in weights:
        row[rng.choice(JOINT_COUNT, influences, replace=False)] = rng.dirichlet(np.ones(influences))
    quaternions = rng.normal(size=(count, 4))
    arrays = (
        rng.normal(size=(count, 3)),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        weights,
        rng.normal(size=(JOINT_COUNT, 3)),
    )
    return BodyTensors(*(torch.from_numpy(array) for array in arrays))


def random_pose(seed: int, frames: int, spread: float = 0.3) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    rotvec = torch.randn(frames, 3, dtype=torch.float64, generator=generator)
    return (
        torch.randn(frames, 3, dtype=torch.float64, generator=generator),
        rotation_to_6d(roma.rotvec_to_rotmat(rotvec)),
        spread * torch.randn(frames, 23, 3, dtype=torch.float64, generator=generator),
    )


def rest_rotations(body: BodyTensors) -> torch.Tensor:
    return roma.unitquat_to_rotmat(body.quaternions[:, [1, 2, 3, 0]])


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def test_against_a_plain_loop():
    body, pose = random_body(0), random_pose(1, frames=3)
    means, rotations = pose_gaussians(body, *pose)
    joint_rotations, joint_positions = forward_kinematics(local_rotations(*pose[1:]), pose[0], body.rest_joints)
    rest = rest_rotations(body).numpy()
    for frame in range(3):
        for i in range(len(body.means)):
            blended = np.zeros((3, 4))
            for k in range(JOINT_COUNT):
                global_transform = np.eye(4)
                global_transform[:3, :3] = joint_rotations[frame, k].numpy()
                global_transform[:3, 3] = joint_positions[frame, k].numpy()
                to_joint = np.eye(4)
                to_joint[:3, 3] = -body.rest_joints[k].numpy()
                blended += body.weights[i, k].item() * (global_transform @ to_joint)[:3]
            np.testing.assert_allclose(means[frame, i], blended @ np.append(body.means[i].numpy(), 1), atol=1e-12)
            expected = nearest_rotation(blended[:, :3]) @ rest[i]
            np.testing.assert_allclose(rotations[frame, i], expected, atol=2e-3)


def test_identity_pose_changes_nothing():
    body = random_body(2)
    identity = rotation_to_6d(torch.eye(3, dtype=torch.float64))[None]
    means, rotations = pose_gaussians(
        body, body.rest_joints[None, 0], identity, torch.zeros(1, 23, 3, dtype=torch.float64)
    )
    torch.testing.assert_close(means[0], body.means)
    torch.testing.assert_close(rotations[0], rest_rotations(body))


def test_moves_rigidly_with_the_root():
    body = random_body(3)
    translation, orientation, body_pose = random_pose(4, frames=2)
    turn = roma.rotvec_to_rotmat(torch.tensor([0.4, -1.1, 2.0], dtype=torch.float64))
    shift = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    means, rotations = pose_gaussians(body, translation, orientation, body_pose)
    moved, turned = pose_gaussians(
        body, translation @ turn.T + shift, rotation_to_6d(turn @ rotation_from_6d(orientation)), body_pose
    )
    torch.testing.assert_close(moved, means @ turn.T + shift)
    # Power iteration starts at a joint that turns along, so equivariance holds whether or not it has converged.
    torch.testing.assert_close(turned, turn @ rotations)


@pytest.mark.parametrize("spread", [0.3, 3.0])
def test_orientations_stay_rotations(spread):
    body = random_body(5, count=200)
    _, rotations = pose_gaussians(body, *random_pose(6, frames=5, spread=spread))
    identity = torch.eye(3, dtype=torch.float64).expand_as(rotations)
    torch.testing.assert_close(rotations @ rotations.mT, identity, atol=1e-10, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones_like(rotations[..., 0, 0]))


def test_blended_orientation_is_the_nearest_rotation_up_to_a_right_angle():
    """Two joints 90 degrees apart: tan(phi) = w sin(a) / (1 - w + w cos(a)) from the first one."""
    for share in (0.1, 0.3, 0.45):
        body = random_body(7, count=1)
        weights = torch.zeros(1, JOINT_COUNT, dtype=torch.float64)
        weights[0, [16, 18]] = torch.tensor([1 - share, share], dtype=torch.float64)
        upright = torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64)
        body = BodyTensors(body.means, upright, weights, body.rest_joints)
        pose = torch.zeros(1, 23, 3, dtype=torch.float64)
        pose[0, 18 - 1, 2] = np.pi / 2
        identity = rotation_to_6d(torch.eye(3, dtype=torch.float64))[None]
        w, _, _, z = pose_quaternions(body, identity, pose)[0, 0].tolist()
        assert 2 * np.arctan2(z, w) == pytest.approx(np.arctan2(share, 1 - share), abs=1e-4)


def test_quaternions_and_matrices_agree():
    body, pose = random_body(8), random_pose(9, frames=2)
    quaternions = pose_quaternions(body, *pose[1:])
    torch.testing.assert_close(roma.unitquat_to_rotmat(quaternions[..., [1, 2, 3, 0]]), pose_gaussians(body, *pose)[1])


def test_gradient():
    body = random_body(10, count=3)
    inputs = tuple(tensor.requires_grad_() for tensor in random_pose(11, frames=1))
    assert torch.autograd.gradcheck(lambda *pose: pose_gaussians(body, *pose), inputs)


def test_gradient_is_finite_standing_still():
    body = load_person("man", 500)
    motion = stand_motion(body, 2, 20.0)
    inputs = [
        torch.from_numpy(array).requires_grad_() for array in (motion.translation, motion.orientation, motion.body_pose)
    ]
    means, rotations = pose_gaussians(body_tensors(body), *inputs)
    (means.square().sum() + rotations[..., 0].sum()).backward()
    assert all(tensor.grad is not None and torch.isfinite(tensor.grad).all() for tensor in inputs)


def test_float32_is_close_to_float64():
    body = load_person("woman", 1000)
    pose = random_pose(12, frames=3)
    exact = pose_means(body_tensors(body, dtype=torch.float64), *pose)
    single = pose_means(body_tensors(body), *(tensor.float() for tensor in pose))
    torch.testing.assert_close(single.double(), exact, atol=1e-5, rtol=0)


def kicking() -> Motion:
    translation, orientation, body_pose = random_pose(13, frames=4)
    return Motion(translation.numpy(), orientation.numpy(), body_pose.numpy(), fps=20.0)


def test_subset_and_fractional_frames():
    body, motion = load_person("child", 800), kicking()
    everything = posed_means(body, motion)
    assert everything.shape == (4, 800, 3)
    subset = np.array([5, 700, 41])
    np.testing.assert_allclose(posed_means(body, motion, subset=subset), everything[:, subset], atol=1e-6)
    np.testing.assert_allclose(posed_means(body, motion, frames=[2, 0]), everything[[2, 0]], atol=1e-5)
    step = np.linalg.norm(everything[2] - everything[1], axis=-1).max()
    near = posed_means(body, motion, frames=[1.01])[0]
    assert 0 < np.linalg.norm(near - everything[1], axis=-1).max() < 0.05 * step


def test_joint_paths_start_at_the_pelvis():
    body, motion = load_person("child", 800), kicking()
    paths = joint_paths(body, motion)
    assert paths.shape == (4, JOINT_COUNT, 3)
    np.testing.assert_allclose(paths[:, 0], motion.translation, atol=1e-6)
    x0, x1, x2, x3 = motion.translation
    between = 0.5 * (x1 + x2) + ((x2 - x0) - (x3 - x1)) / 16  # the cubic with those rates at its ends
    np.testing.assert_allclose(joint_paths(body, motion, [1.5])[0, 0], between, atol=1e-6)


@pytest.mark.parametrize("name", ["man", "child"])
def test_stands_at_the_origin_facing_plus_y(name):
    body = load_person(name, 4000)
    motion = stand_motion(body, 3, 20.0)
    means, joints = posed_means(body, motion), joint_paths(body, motion)[0]
    at = {joint: joints[index] for index, joint in enumerate(JOINT_NAMES)}
    assert len(motion) == 3 and np.ptp(means, axis=0).max() < 1e-6
    assert abs(means[0, :, 2].min()) < 1e-5
    np.testing.assert_allclose(at["pelvis"][:2], 0, atol=1e-6)
    assert at["left_hip"][0] < 0 < at["right_hip"][0]
    assert at["left_foot"][1] > at["left_ankle"][1] + 0.05
    assert at["head"][2] > at["pelvis"][2] > at["left_knee"][2] > at["left_ankle"][2] > 0
    for side in ("left", "right"):
        assert at[f"{side}_wrist"][2] < at[f"{side}_elbow"][2] < at[f"{side}_shoulder"][2]
        assert at[f"{side}_wrist"][1] > at[f"{side}_elbow"][1]
        sole = means[0, body.skinning_weights.argmax(axis=1) == JOINT_NAMES.index(f"{side}_ankle"), 2].min()
        assert sole < 0.02
