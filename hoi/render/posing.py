"""A person in one pose after another, for pictures that need no gradients: the skinning of `hoi.body.skinning` as a
kernel, Gaussian by Gaussian, with the joints that move each alone."""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportOptionalCall=false
# pyright: reportOperatorIssue=false

import numpy as np
import roma
import torch
from torch import Tensor

from hoi import gaussians
from hoi.body.kinematics import forward_kinematics, local_rotations
from hoi.body.skinning import POLAR_ITERATIONS
from hoi.compute import CPU_TASK, ti
from hoi.data import Body, Motion
from hoi.render.kernels import array, start_kernels
from hoi.render.splats import Splats, from_cloud


class Poser:
    """A body without pose blend shapes, and its motion."""

    def __init__(self, body: Body, motion: Motion, device: torch.device | str) -> None:
        self._still = from_cloud(body.cloud, device)
        axes = gaussians.rotation_matrices(body.cloud) * body.cloud.scales[:, None, :]
        count = max(1, int((body.skinning_weights > 0).sum(1).max(initial=0)))
        joints = np.argsort(-body.skinning_weights, axis=1, kind="stable")[:, :count]

        def there(values: np.ndarray) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        self._axes, self._weights = there(axes), there(np.take_along_axis(body.skinning_weights, joints, 1))
        self._joints = torch.tensor(joints.astype(np.int32), device=device)
        rest_joints = there(body.rest_joints)
        local = local_rotations(there(motion.orientation), there(motion.body_pose))
        rotations, positions = forward_kinematics(local, there(motion.translation), rest_joints)
        offsets = positions - (rotations @ rest_joints[:, :, None])[..., 0]
        self._transforms = torch.cat([rotations, offsets[..., None]], -1)
        self._quaternions = roma.rotmat_to_unitquat(rotations)

    def at(self, frame: int) -> Splats:
        """As `hoi.render.replay.posed`, to rounding."""
        still = self._still
        own = still.surface
        means, sigma, turns = (torch.empty_like(each) for each in (still.means, still.covariances, still.covariances))
        surface = None if own is None else torch.empty_like(own)
        if len(still):
            start_kernels(means)
            pose(
                self._weights.shape[1], own is not None, self._joints, self._weights,
                self._transforms[frame].flatten(0, 1), self._quaternions[frame], still.means, self._axes,
                means if own is None else own, means, turns, sigma, means if surface is None else surface,
            )  # fmt: skip
        return Splats(means, sigma, still.opacities, still.sh, turns if still.sh.shape[1] > 1 else None, surface)


@ti.kernel
def pose(
    count: ti.template(), surfaced: ti.template(), joints: array, weights: array, transforms: array, quaternions: array,
    rest: array, axes: array, own: array, means: array, turns: array, sigma: array, surface: array
):  # fmt: skip
    """Means, blended rotations, covariances and surfaces of Gaussians that `count` joints move.

    The rotation nearest to sum_k w_k R_k is the leading eigenvector of B = sum_k w_k q_k q_k^T, found by powers of B
    from the joint of most weight on.
    """
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(rest.shape[0]):
        rx, ry, rz = rest[i, 0], rest[i, 1], rest[i, 2]
        mx, my, mz = 0.0, 0.0, 0.0
        xx, xy, xz, xw, yy, yz, yw, zz, zw, ww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            w, joint = weights[i, k], joints[i, k]
            if w > 0.0:
                at = joint * 3
                mx += w * (transforms[at, 0] * rx + transforms[at, 1] * ry + transforms[at, 2] * rz + transforms[at, 3])
                at += 1
                my += w * (transforms[at, 0] * rx + transforms[at, 1] * ry + transforms[at, 2] * rz + transforms[at, 3])
                at += 1
                mz += w * (transforms[at, 0] * rx + transforms[at, 1] * ry + transforms[at, 2] * rz + transforms[at, 3])
                x, y, z = quaternions[joint, 0], quaternions[joint, 1], quaternions[joint, 2]
                s = quaternions[joint, 3]
                xx, xy, xz, xw = xx + w * x * x, xy + w * x * y, xz + w * x * z, xw + w * x * s
                yy, yz, yw = yy + w * y * y, yz + w * y * z, yw + w * y * s
                zz, zw, ww = zz + w * z * z, zw + w * z * s, ww + w * s * s
        means[i, 0], means[i, 1], means[i, 2] = mx, my, mz
        first = joints[i, 0]
        x, y, z, s = quaternions[first, 0], quaternions[first, 1], quaternions[first, 2], quaternions[first, 3]
        if weights[i, 0] < 0.9999:
            for _ in range(POLAR_ITERATIONS):
                x, y, z, s = (
                    xx * x + xy * y + xz * z + xw * s, xy * x + yy * y + yz * z + yw * s,
                    xz * x + yz * y + zz * z + zw * s, xw * x + yw * y + zw * z + ww * s,
                )  # fmt: skip
        double = 2.0 / (x * x + y * y + z * z + s * s)
        t00, t01, t02 = 1.0 - double * (y * y + z * z), double * (x * y - z * s), double * (x * z + y * s)
        t10, t11, t12 = double * (x * y + z * s), 1.0 - double * (x * x + z * z), double * (y * z - x * s)
        t20, t21, t22 = double * (x * z - y * s), double * (y * z + x * s), 1.0 - double * (x * x + y * y)
        turns[i, 0, 0], turns[i, 0, 1], turns[i, 0, 2] = t00, t01, t02
        turns[i, 1, 0], turns[i, 1, 1], turns[i, 1, 2] = t10, t11, t12
        turns[i, 2, 0], turns[i, 2, 1], turns[i, 2, 2] = t20, t21, t22
        s00, s01, s02, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for axis in ti.static(range(3)):
            u, v, w = axes[i, 0, axis], axes[i, 1, axis], axes[i, 2, axis]
            a, b, c = t00 * u + t01 * v + t02 * w, t10 * u + t11 * v + t12 * w, t20 * u + t21 * v + t22 * w
            s00, s01, s02 = s00 + a * a, s01 + a * b, s02 + a * c
            s11, s12, s22 = s11 + b * b, s12 + b * c, s22 + c * c
        sigma[i, 0, 0], sigma[i, 0, 1], sigma[i, 0, 2] = s00, s01, s02
        sigma[i, 1, 0], sigma[i, 1, 1], sigma[i, 1, 2] = s01, s11, s12
        sigma[i, 2, 0], sigma[i, 2, 1], sigma[i, 2, 2] = s02, s12, s22
        if ti.static(surfaced):
            for k in ti.static(range(2)):
                u, v, w = own[i, k, 0], own[i, k, 1], own[i, k, 2]
                surface[i, k, 0] = t00 * u + t01 * v + t02 * w
                surface[i, k, 1] = t10 * u + t11 * v + t12 * w
                surface[i, k, 2] = t20 * u + t21 * v + t22 * w
