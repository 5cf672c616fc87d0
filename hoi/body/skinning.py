"""Linear blend skinning of a body's Gaussians, differentiable (torch), and what NumPy callers need of it.

mu'_i = (sum_k w_ik A_k) mu_i with A_k = G_k [I, -J_k] (paper, Human Representation). A blend of rotations is not a
rotation, so covariances turn by the rotation nearest to sum_k w_ik R_k, and quaternions stay unit. A body with pose
blend shapes (Loper et al. 2015, SMPL) has mu_i + B_i (R - I) in the place of mu_i; they move centres alone.
"""

from dataclasses import dataclass

import numpy as np
import roma
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import forward_kinematics, joint_positions, local_rotations, rotation_to_6d
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES
from hoi.data import Array, Body, Motion

POLAR_ITERATIONS = 6
"""Each shrinks the error of the blended rotation by tan^2(angle / 4) or better for two joints `angle` apart: 0.17 at 90
degrees."""


@dataclass(frozen=True)
class BodyTensors:
    """A body, or some of its Gaussians, ready to be posed."""

    means: Tensor
    """T-pose centres [m], (N, 3)."""
    quaternions: Tensor
    """T-pose orientations wxyz, (N, 4)."""
    weights: Tensor
    """w_ik, (N, 24)."""
    rest_joints: Tensor
    """[m], (24, 3)."""
    pose_directions: Tensor | None = None
    """B_i, (N, 3, 207), see `hoi.data.Body`."""


def body_tensors(
    body: Body,
    subset: NDArray[np.integer] | None = None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> BodyTensors:
    """The Gaussians of `body` with indices `subset` (default all) as tensors.

    They are copies: matrix products of what lies otherwise in memory differ in the last digit, and so would runs.
    """
    rows = slice(None) if subset is None else subset
    arrays = [body.cloud.means[rows], body.cloud.quaternions[rows], body.skinning_weights[rows], body.rest_joints]
    if body.pose_directions is not None:
        arrays.append(body.pose_directions[rows])
    return BodyTensors(*(torch.tensor(array, dtype=dtype, device=device) for array in arrays))


def pose_means(body: BodyTensors, translation: Tensor, orientation: Tensor, body_pose: Tensor) -> Tensor:
    """World centres [m], (T, N, 3), of a motion's parameters (T, 3), (T, 6), (T, 23, 3); see `hoi.data.Motion`."""
    return _blend_means(body, *_joint_frames(body, translation, orientation, body_pose), body_pose)


def pose_gaussians(
    body: BodyTensors, translation: Tensor, orientation: Tensor, body_pose: Tensor
) -> tuple[Tensor, Tensor]:
    """World centres [m] and orientations of a motion's parameters (T, 3), (T, 6), (T, 23, 3); see `hoi.data.Motion`.

    Returns:
        means (T, N, 3) and rotations (T, N, 3, 3), such that the covariance is R diag(scales^2) R^T.
    """
    rotations, positions = _joint_frames(body, translation, orientation, body_pose)
    quaternions = _blend_quaternions(body, rotations)
    return _blend_means(body, rotations, positions, body_pose), roma.unitquat_to_rotmat(quaternions)


def pose_quaternions(body: BodyTensors, orientation: Tensor, body_pose: Tensor) -> Tensor:
    """World orientations wxyz, unit, (T, N, 4), of a motion's orientation (T, 6) and body pose (T, 23, 3)."""
    nowhere = orientation.new_zeros((*orientation.shape[:-1], 3))
    return _blend_quaternions(body, _joint_frames(body, nowhere, orientation, body_pose)[0])[..., [3, 0, 1, 2]]


def posed_means(
    body: Body, motion: Motion, frames: ArrayLike | None = None, subset: NDArray[np.integer] | None = None
) -> Array:
    """World centres of a body's Gaussians.

    Args:
        frames: (F,), may be fractional (see `interpolate_motion`); default each frame of the motion.
        subset: indices (n,) of the Gaussians wanted; default all.

    Returns:
        (F, n, 3) [m], float32.
    """
    with torch.no_grad():
        return pose_means(body_tensors(body, subset), *_motion_tensors(motion, frames)).numpy()


def joint_paths(body: Body, motion: Motion, frames: ArrayLike | None = None) -> Array:
    """World joint positions [m], (F, 24, 3), at each frame of the motion or at `frames` as in `posed_means`."""
    with torch.no_grad():
        return joint_positions(
            *_motion_tensors(motion, frames), torch.as_tensor(body.rest_joints, dtype=torch.float32)
        ).numpy()


def joint_frames(body: Body, motion: Motion, frames: ArrayLike | None = None) -> tuple[Array, Array]:
    """World rotations (F, 24, 3, 3) and positions (F, 24, 3) [m] of the joints, at frames as in `posed_means`."""
    rest_joints = torch.as_tensor(body.rest_joints, dtype=torch.float64)
    with torch.no_grad():
        translation, orientation, body_pose = (part.double() for part in _motion_tensors(motion, frames))
        rotations, positions = forward_kinematics(local_rotations(orientation, body_pose), translation, rest_joints)
    return rotations.numpy(), positions.numpy()


def stand_motion(body: Body, frames: int, fps: float) -> Motion:
    """Standing still at the origin, facing +Y, arms hanging, soles on the ground z = 0."""
    pose = np.zeros((JOINT_COUNT, 3), dtype=np.float32)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # Rotations of the T-pose about its z axis lower the arms, about its y axis bend the elbows forward.
        pose[JOINT_NAMES.index(f"{side}_collar")] = (0, 0, -sign * 0.08)
        pose[JOINT_NAMES.index(f"{side}_shoulder")] = (0, 0, -sign * 1.2)
        pose[JOINT_NAMES.index(f"{side}_elbow")] = (0, -sign * 0.25, 0)
    # The rest frame's x (left) to -X, y (up) to Z, z (forward) to Y: Rz(pi) Rx(pi / 2).
    facing = torch.tensor([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    still = Motion(
        translation=np.zeros((frames, 3), dtype=np.float32),
        orientation=np.tile(rotation_to_6d(facing).numpy(), (frames, 1)),
        body_pose=np.tile(pose[1:], (frames, 1, 1)),
        fps=fps,
    )
    still.translation[:, 2] = -posed_means(body, still, frames=[0])[0, :, 2].min()
    return still


def sole_height(body: Body) -> float:
    """Height of the lowest joint when the body's soles stand on the ground [m]."""
    return float(joint_paths(body, stand_motion(body, 1, 1.0))[0, :, 2].min())


def _motion_tensors(motion: Motion, frames: ArrayLike | None) -> tuple[Tensor, Tensor, Tensor]:
    if frames is not None:
        motion = interpolate_motion(motion, frames)
    translation, orientation, body_pose = (
        torch.as_tensor(array, dtype=torch.float32)
        for array in (motion.translation, motion.orientation, motion.body_pose)
    )
    return translation, orientation, body_pose


def _joint_frames(
    body: BodyTensors, translation: Tensor, orientation: Tensor, body_pose: Tensor
) -> tuple[Tensor, Tensor]:
    return forward_kinematics(local_rotations(orientation, body_pose), translation, body.rest_joints)


def _blend_means(body: BodyTensors, rotations: Tensor, positions: Tensor, body_pose: Tensor) -> Tensor:
    """(T, 24, 3, 3), (T, 24, 3), (T, 23, 3) -> (T, N, 3).

    sum_k w_ik (R_k mu_i + t_k) is linear in (R_k, t_k) with coefficients w_ik (mu_i, 1), so that all frames are one
    matrix product.
    """
    offsets = positions - (rotations @ body.rest_joints[:, :, None])[..., 0]
    transforms = torch.cat([rotations.mT, offsets[..., None, :]], dim=-2)  # (T, 24, 4, 3)
    coefficients = body.weights[:, :, None] * torch.nn.functional.pad(body.means, (0, 1), value=1.0)[:, None, :]
    blended = transforms.flatten(1, 2).mT.flatten(0, 1) @ coefficients.flatten(1).T  # (T * 3, N)
    means = blended.unflatten(0, (-1, 3)).mT
    return means if body.pose_directions is None else means + _pose_corrections(body, rotations, body_pose)


def _pose_corrections(body: BodyTensors, rotations: Tensor, body_pose: Tensor) -> Tensor:
    """(sum_k w_ik R_k) B_i (R - I), (T, N, 3), of (T, 24, 3, 3) and (T, 23, 3)."""
    assert body.pose_directions is not None
    feature = (roma.rotvec_to_rotmat(body_pose) - torch.eye(3).to(body_pose)).flatten(-3)  # (T, 207)
    corrections = (feature @ body.pose_directions.flatten(0, 1).T).unflatten(-1, (-1, 3))
    turns = (body.weights @ rotations.flatten(-2)).unflatten(-1, (3, 3))
    return (turns @ corrections[..., None])[..., 0]


def _blend_quaternions(body: BodyTensors, rotations: Tensor) -> Tensor:
    """(T, 24, 3, 3) -> orientations of the Gaussians as roma's xyzw quaternions (T, N, 4).

    The rotation nearest to sum_k w_k R_k (Frobenius) is the leading eigenvector of sum_k w_k q_k q_k^T, whatever the
    signs of q_k. Power iteration finds it. Started at the strongest joint, it shrinks each time by that joint's weight
    at worst, so that normalising once at the end is enough.
    """
    joints = roma.rotmat_to_unitquat(rotations)
    outer = joints[..., :, None] * joints[..., None, :]
    blended = (body.weights @ outer.flatten(-2)).unflatten(-1, (4, 4))
    quaternion = joints[:, body.weights.argmax(dim=1)]
    for _ in range(POLAR_ITERATIONS):
        quaternion = (blended @ quaternion[..., None])[..., 0]
    turned = roma.quat_product(quaternion, body.quaternions[:, [1, 2, 3, 0]].expand_as(quaternion))
    return torch.nn.functional.normalize(turned, dim=-1)
