"""3D Gaussian clouds: spherical harmonics, and what rigid motion and deformation do to them.

Harmonics follow the 3DGS basis: colour = 0.5 + sum_k Y_k(d) c_k, d from the camera to the Gaussian.
"""

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud, fields_of

T = TypeVar("T", bound=Any)

SH_C0 = 0.28209479177387814
"""Y_0, the constant spherical harmonic."""
MOST_STRETCH = 2.0
"""Most that a Gaussian is drawn longer than at rest [-]."""


def cloud_of(
    means: Array, quaternions: Array, scales: Array, opacities: Array, sh: Array, surface: Array | None = None
) -> GaussianCloud:
    """A cloud in float32, quaternions of unit length."""
    with np.errstate(all="ignore"):  # what becomes NaN here is found by `hoi.gaussians.load_clean`
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        arrays = (np.ascontiguousarray(a, np.float32) for a in (means, quaternions, scales, opacities, sh))
        return GaussianCloud(*arrays, surface=surface)


# --- colour ----------------------------------------------------------------------------------------------------------


def sh_basis(directions: Array, degree: int) -> Array:
    """Y_k(d) of the 3DGS basis: unit directions (..., 3) -> (..., (degree + 1)^2), degree 0 to 3."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([np.full_like(x, SH_C0), *higher_harmonics(x, y, z, degree)], -1)


def higher_harmonics(x: T, y: T, z: T, degree: int) -> list[T]:
    """Y_1.. of the 3DGS basis up to a degree, of the components of unit directions: arrays or tensors."""
    basis: list[Any] = []
    xx, yy, zz = x * x, y * y, z * z
    if degree > 0:
        basis += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        basis += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy)]
        basis += [-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy)]
    if degree > 2:
        basis += [-0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z]
        basis += [-0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * (xx + yy))]
        basis += [-0.4570457994644658 * x * (4 * zz - xx - yy), 1.445305721320277 * z * (xx - yy)]
        basis += [-0.5900435899266435 * x * (xx - 3 * yy)]
    return basis


def sh_degree(cloud: GaussianCloud) -> int:
    """Degree of the cloud's harmonics, 0 to 3."""
    return round(cloud.sh.shape[1] ** 0.5) - 1


def colours(cloud: GaussianCloud, directions: Array | None = None) -> Array:
    """RGB (N, 3), not below 0: of degree 0 alone, or as seen along unit directions (N, 3) from camera to Gaussian."""
    if directions is None:
        return np.maximum(0.5 + SH_C0 * cloud.sh[:, 0], 0.0)
    return np.maximum(0.5 + np.einsum("nk,nkc->nc", sh_basis(directions, sh_degree(cloud)), cloud.sh), 0.0)


def sh_from_colours(rgb: Array) -> Array:
    """RGB (N, 3) -> degree-0 coefficients (N, 1, 3)."""
    return ((np.asarray(rgb) - 0.5) / SH_C0)[:, None].astype(np.float32)


def rotate_sh(sh: Array, rotation: Array) -> Array:
    """Coefficients (N, K, 3) of a colour that turns with its Gaussian, under rotations (3, 3) or (N, 3, 3).

    A band is closed under rotation, so fitting Y(d) c' = Y(R^T d) c over a few directions d is exact.
    """
    rotated = np.array(sh)
    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0:
        return rotated
    directions = fibonacci_sphere(16)
    before, after = sh_basis(directions @ rotation, degree), sh_basis(directions, degree)
    for band in range(1, degree + 1):
        rows = slice(band**2, (band + 1) ** 2)
        rotated[:, rows] = np.linalg.pinv(after[:, rows]) @ before[..., rows] @ sh[:, rows]
    return rotated


def fibonacci_sphere(count: int) -> Array:
    """`count` unit vectors spread evenly over the sphere, (count, 3)."""
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    angle = index * np.pi * (3 - 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


# --- geometry --------------------------------------------------------------------------------------------------------


def select(cloud: GaussianCloud, rows: NDArray[Any]) -> GaussianCloud:
    """The Gaussians of a mask or of indices."""
    return replace(cloud, **{name: array[rows] for name, array in fields_of(cloud).items() if array is not None})


def rotation_matrices(cloud: GaussianCloud) -> Array:
    """R of each Gaussian, (N, 3, 3)."""
    return Rotation.from_quat(cloud.quaternions, scalar_first=True).as_matrix()


def areas(cloud: GaussianCloud) -> Array:
    """What each Gaussian shows of a surface, in float64: opacity times the ellipse of its two long axes, (N,) [m^2]."""
    sizes = np.sort(cloud.scales.astype(np.float64), axis=1)
    return cloud.opacities * np.pi * sizes[:, 1] * sizes[:, 2]


def covariances(cloud: GaussianCloud) -> Array:
    """Sigma = R diag(scales^2) R^T [m^2], (N, 3, 3)."""
    root = rotation_matrices(cloud) * cloud.scales[:, None, :]
    return root @ root.transpose(0, 2, 1)


def with_surface(cloud: GaussianCloud, neighbours: int = 24) -> GaussianCloud:
    """A captured cloud with a surface: normals along the Gaussians' flattest axes, away from the middle of what is
    around them, or where they lie evenly from the middle of all; nothing closes the sky."""
    from scipy.spatial import KDTree

    axes, rows = rotation_matrices(cloud), np.arange(len(cloud))
    normals = axes[rows, :, cloud.scales.argmin(1)]
    means = cloud.means.astype(np.float64)
    near = KDTree(means).query(means, min(neighbours, len(cloud)))[1].reshape(len(cloud), -1)
    middle = means[near].mean(1)
    bulge = ((means - middle) * normals).sum(1)
    bulge += 0.02 * ((means - means.mean(0)) * normals).sum(1)
    normals *= np.where(bulge < 0, -1.0, 1.0)[:, None]
    return replace(cloud, surface=np.stack([normals, normals], 1).astype(np.float16))


def transform(
    cloud: GaussianCloud, rotation: ArrayLike, scale: float = 1.0, translation: ArrayLike = (0, 0, 0)
) -> GaussianCloud:
    """x' = scale R x + t for the whole cloud: rotation (3, 3), translation [m] (3,). Colours turn along."""
    rotation = np.asarray(rotation, np.float64)
    turned = Rotation.from_matrix(rotation) * Rotation.from_quat(cloud.quaternions, scalar_first=True)
    means = scale * cloud.means.astype(np.float64) @ rotation.T + np.asarray(translation)
    surface = None if cloud.surface is None else (cloud.surface @ rotation.T).astype(cloud.surface.dtype)
    return cloud_of(
        means, turned.as_quat(scalar_first=True), scale * cloud.scales, cloud.opacities, rotate_sh(cloud.sh, rotation),
        surface,
    )  # fmt: skip


def limited(deformation_gradient: Array) -> Array:
    """F (N, 3, 3) with its singular values at most `MOST_STRETCH`.

    As long as a body holds together, its Gaussians meet when each is as much longer as they are farther apart. What is
    stretched beyond that has torn, or has flowed past its neighbours: its F says how far they have gone, not how large
    it is, and would draw needles metres long.
    """
    torn = np.flatnonzero((deformation_gradient**2).sum((-2, -1)) > MOST_STRETCH**2)
    if len(torn) == 0:
        return deformation_gradient
    left, sizes, right = np.linalg.svd(deformation_gradient[torn])
    bounded = deformation_gradient.copy()
    bounded[torn] = (left * np.minimum(sizes, MOST_STRETCH)[:, None, :]) @ right
    return bounded


def deform(cloud: GaussianCloud, means: Array, deformation_gradient: Array) -> GaussianCloud:
    """The cloud with its Gaussians at `means` [m] (N, 3) and stretched by F (N, 3, 3): covariances F Sigma F^T
    (PhysGaussian's kinematics, used by the paper), F as `limited` has it.
    """
    return stretch(cloud, means, limited(deformation_gradient))


def stretch(cloud: GaussianCloud, means: Array, deformation_gradient: Array) -> GaussianCloud:
    """As `deform`, by all of F. Colours and surface turn with the rotation of F's polar decomposition."""
    axes, scales, _ = np.linalg.svd(deformation_gradient @ (rotation_matrices(cloud) * cloud.scales[:, None, :]))
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]  # an axis may point either way; a rotation may not mirror
    sh, surface = cloud.sh, cloud.surface
    if sh_degree(cloud) > 0 or surface is not None:
        left, _, right = np.linalg.svd(deformation_gradient)
        left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
        sh = rotate_sh(sh, left @ right)
        surface = surface if surface is None else (surface @ (left @ right).mT).astype(surface.dtype)
    turns = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return cloud_of(means, turns, scales, cloud.opacities, sh, surface)
