"""The person of a record, posed: forward kinematics and linear blend skinning in NumPy, so that no torch is needed.

The same formulas as `hoi.body.kinematics` and `hoi.body.skinning`, which optimise with them; here they only measure.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body.skeleton import JOINT_COUNT, PARENTS
from hoi.data import Array, Body, Motion


def rotation_from_6d(rows: Array) -> Array:
    """(..., 6), the first two rows of a rotation, not necessarily orthonormal -> (..., 3, 3), by Gram-Schmidt."""
    first, second = np.asarray(rows[..., :3], np.float64), np.asarray(rows[..., 3:], np.float64)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    second = second - (first * second).sum(-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-2)


def local_rotations(motion: Motion) -> Array:
    """Rotations of the joints relative to their parents, (T, 24, 3, 3); the pelvis' is from rest frame to world."""
    frames = len(motion)
    pose = Rotation.from_rotvec(np.asarray(motion.body_pose, np.float64).reshape(-1, 3)).as_matrix()
    root = rotation_from_6d(motion.orientation)
    return np.concatenate([root[:, None], pose.reshape(frames, JOINT_COUNT - 1, 3, 3)], axis=1)


def forward_kinematics(local: Array, translation: Array, rest_joints: Array) -> tuple[Array, Array]:
    """World rotations (T, 24, 3, 3) and positions (T, 24, 3) [m] of the joints.

    Args:
        local: (T, 24, 3, 3). translation: of the pelvis joint [m], (T, 3). rest_joints: T-pose joints [m], (24, 3).
    """
    rotations, positions = [local[:, 0]], [np.asarray(translation, np.float64)]
    for joint, parent in enumerate(PARENTS[1:], start=1):
        positions.append(positions[parent] + rotations[parent] @ (rest_joints[joint] - rest_joints[parent]))
        rotations.append(rotations[parent] @ local[:, joint])
    return np.stack(rotations, axis=1), np.stack(positions, axis=1)


def joint_frames(body: Body, motion: Motion) -> tuple[Array, Array]:
    """World rotations (T, 24, 3, 3) and positions (T, 24, 3) [m] of the body's joints at each frame."""
    return forward_kinematics(local_rotations(motion), motion.translation, np.asarray(body.rest_joints, np.float64))


def posed_means(body: Body, motion: Motion) -> Array:
    """World centres of the body's Gaussians at each frame [m], (T, N, 3), float32.

    sum_k w_ik (R_k mu_i + t_k) is linear in (R_k, t_k), so that all frames are one matrix product.
    """
    rotations, positions = joint_frames(body, motion)
    offsets = positions - np.einsum("tkij,kj->tki", rotations, body.rest_joints)
    transforms = np.concatenate([rotations, offsets[..., None]], axis=-1)  # (T, 24, 3, 4)
    means = np.concatenate([body.cloud.means, np.ones((len(body.cloud), 1))], axis=1)
    coefficients = (body.skinning_weights[:, :, None] * means[:, None, :]).reshape(len(means), -1).astype(np.float32)
    flat = transforms.transpose(1, 3, 0, 2).reshape(coefficients.shape[1], -1).astype(np.float32)
    posed = (coefficients @ flat).reshape(len(means), len(motion), 3).transpose(1, 0, 2)
    if body.pose_directions is None:
        return np.ascontiguousarray(posed)
    feature = (local_rotations(motion)[:, 1:] - np.eye(3)).reshape(len(motion), -1)
    corrections = np.einsum("nif,tf->tni", body.pose_directions, feature)
    turns = np.einsum("nk,tkij->tnij", body.skinning_weights, rotations)
    return (posed + np.einsum("tnij,tnj->tni", turns, corrections)).astype(np.float32)
