"""3D Gaussian clouds: files, spherical harmonics, and what rigid motion and deformation do to them.

Formats, told apart by content and then by extension:

- `.ply` as INRIA's 3DGS and Trellis write it: raw parameters (log scales, opacity logits, wxyz quaternions of any
  length), `f_rest_*` channel-major. Properties are found by name, so their order, type and encoding do not matter.
- `.splat`: 32 bytes a Gaussian (position 3 f4, scale 3 f4, RGBA 4 u1, quaternion 4 u1), no view dependence.
- `.spz` versions 2 and 3: gzip; fixed-point positions, then alphas, colours, scales, rotations, harmonics.

Files keep their own axes and units. Harmonics follow the 3DGS basis: colour = 0.5 + sum_k Y_k(d) c_k, d from the camera
to the Gaussian.
"""

import gzip
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud, fields_of
from hoi.errors import InputError

T = TypeVar("T", bound=Any)

SH_C0 = 0.28209479177387814
"""Y_0, the constant spherical harmonic."""
MOST_STRETCH = 2.0
"""Most that a Gaussian is drawn longer than at rest [-]."""
MAX_DROPPED_FRACTION = 0.01
"""A file with more unusable Gaussians than this is taken as broken."""

_SPLAT = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])
_SPZ_HEADER = np.dtype(
    [("magic", "<u4"), ("version", "<u4"), ("count", "<u4"), ("degree", "u1"), ("bits", "u1"), ("pad", "u1", 2)]
)
_SPZ_MAGIC = 0x5053474E
_SPZ_MAX_COUNT = 10_000_000


# --- reading ---------------------------------------------------------------------------------------------------------


def read_gaussians(path: Path) -> GaussianCloud:
    """Read a cloud as it stands in the file: its axes, its units, its rows, usable or not (see `load_clean`).

    Args:
        path: a `.ply`, `.splat` or `.spz` file, or a 3DGS model directory, of which the last iteration is read.

    Raises:
        InputError: the file is missing, empty, cut short, of another kind, or holds no Gaussian.
    """
    path = _latest_iteration(Path(path))
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(4)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); give a .ply, .splat or .spz file"
        ) from None
    if size == 0:
        raise InputError(f"{path}: the file is empty")
    if head.startswith(b"ply"):
        cloud = _read_ply(path)
    elif path.suffix.lower() == ".splat":
        cloud = _read_splat(path, size)
    elif head.startswith(b"\x1f\x8b"):
        cloud = _read_spz(path)
    else:
        raise InputError(f"{path}: not a Gaussian cloud; allowed are 3DGS .ply, .splat and .spz (version 2 or 3)")
    if len(cloud) == 0:
        raise InputError(f"{path}: holds no Gaussian")
    return cloud


def load_clean(path: Path) -> tuple[GaussianCloud, list[str]]:
    """Read a cloud and drop its unusable Gaussians (not finite, negative scale, no rotation).

    Returns:
        The cloud, and one line for each thing that was done to it.

    Raises:
        InputError: as `read_gaussians`, or more than 1 % of the Gaussians are unusable.
    """
    cloud = read_gaussians(path)
    columns = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities[:, None], cloud.sh.reshape(len(cloud), -1))
    usable = np.logical_and.reduce([np.isfinite(column).all(1) for column in columns]) & (cloud.scales >= 0).all(1)
    dropped = int(np.count_nonzero(~usable))
    if dropped > MAX_DROPPED_FRACTION * len(cloud):
        raise InputError(
            f"{path}: {dropped} of {len(cloud)} Gaussians are not finite or have a negative scale; "
            f"at most {MAX_DROPPED_FRACTION:.0%} may be"
        )
    return (select(cloud, usable), [f"dropped {dropped} Gaussians that are not finite"]) if dropped else (cloud, [])


def _latest_iteration(path: Path) -> Path:
    """The point cloud of a 3DGS model directory; any other path as it is."""
    if not path.is_dir():
        return path
    found = {int(p.parent.name[10:]): p for p in path.glob("point_cloud/iteration_[0-9]*/point_cloud.ply")}
    if not found:
        raise InputError(f"{path}: a directory without point_cloud/iteration_<N>/point_cloud.ply; give that or a file")
    return found[max(found)]


def _cloud(
    means: Array, quaternions: Array, scales: Array, opacities: Array, sh: Array, surface: Array | None = None
) -> GaussianCloud:
    with np.errstate(all="ignore"):  # what becomes NaN here is found by `load_clean`
        quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        arrays = (np.ascontiguousarray(a, np.float32) for a in (means, quaternions, scales, opacities, sh))
        return GaussianCloud(*arrays, surface)


def _read_ply(path: Path) -> GaussianCloud:
    from plyfile import PlyData, PlyParseError

    try:
        ply = PlyData.read(str(path))
    except (PlyParseError, ValueError, EOFError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: broken PLY, cut short or not well formed ({reason})") from None
    if "vertex" not in ply:
        raise InputError(f"{path}: a PLY without a vertex element, not a 3DGS file")
    vertex = ply["vertex"]
    present = {p.name for p in vertex.properties}
    rest = sorted((n for n in present if re.fullmatch(r"f_rest_\d+", n)), key=lambda n: int(n[7:]))
    groups = ["x y z", "rot_0 rot_1 rot_2 rot_3", "scale_0 scale_1 scale_2", "opacity", "f_dc_0 f_dc_1 f_dc_2"]
    missing = [name for group in groups for name in group.split() if name not in present]
    if missing:
        raise InputError(f"{path}: not a 3DGS PLY, it has no {', '.join(missing)} (an ordinary mesh or point cloud?)")
    if len(rest) not in (0, 9, 24, 45):
        raise InputError(f"{path}: {len(rest)} f_rest properties; a 3DGS PLY has 0, 9, 24 or 45 (degree 0 to 3)")
    try:
        means, quaternions, log_scales, logits, dc = (
            np.stack([np.asarray(vertex[name], np.float64) for name in group.split()], 1) for group in groups
        )
        columns = [np.asarray(vertex[name], np.float64) for name in rest]
    except (ValueError, TypeError):
        raise InputError(f"{path}: not a 3DGS PLY, a property of its vertices is a list") from None
    view = np.stack(columns, 1).reshape(vertex.count, 3, -1).transpose(0, 2, 1) if rest else dc[:, None][:, :0]
    with np.errstate(over="ignore"):
        opacities, scales = 1 / (1 + np.exp(-logits[:, 0])), np.exp(log_scales)
    return _cloud(means, quaternions, scales, opacities, np.concatenate([dc[:, None], view], 1))


def _read_splat(path: Path, size: int) -> GaussianCloud:
    if size % _SPLAT.itemsize:
        raise InputError(f"{path}: {size} bytes is not a multiple of {_SPLAT.itemsize}; cut short or not a .splat file")
    rows = np.fromfile(path, _SPLAT)
    rgba = rows["rgba"] / 255.0
    quaternions = (rows["quaternion"] - 128.0) / 128.0
    return _cloud(rows["mean"], quaternions, rows["scale"], rgba[:, 3], ((rgba[:, :3] - 0.5) / SH_C0)[:, None])


def _read_spz(path: Path) -> GaussianCloud:
    try:
        with gzip.open(path) as file:
            header = np.frombuffer(file.read(_SPZ_HEADER.itemsize).ljust(_SPZ_HEADER.itemsize, b"\0"), _SPZ_HEADER)[0]
            magic, version, count, degree, bits = (
                int(header[name]) for name in ("magic", "version", "count", "degree", "bits")
            )
            if magic != _SPZ_MAGIC or version not in (2, 3) or degree > 3 or count > _SPZ_MAX_COUNT:
                raise InputError(
                    f"{path}: no readable SPZ (magic {magic:#x}, version {version}, degree {degree}, {count} points); "
                    f"allowed are version 2 and 3, degree 0 to 3, at most {_SPZ_MAX_COUNT} points"
                )
            # bytes a Gaussian: position, alpha, colour, log scale, rotation, higher harmonics
            widths = (9, 1, 3, 3, 3 if version == 2 else 4, 3 * ((degree + 1) ** 2 - 1))
            payload = file.read(count * sum(widths))
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: broken SPZ, cut short or not gzip ({error})") from None
    if len(payload) < count * sum(widths):
        raise InputError(f"{path}: cut short, {len(payload)} of {count * sum(widths)} bytes for {count} Gaussians")
    blocks = np.split(np.frombuffer(payload, np.uint8), count * np.cumsum(widths)[:-1])
    fixed, alphas, colours, log_scales, rotations, view = (b.reshape(count, -1).astype(np.int32) for b in blocks)
    fixed = fixed.reshape(count, 3, 3) @ np.array([1, 1 << 8, 1 << 16], np.int32)
    means = (fixed - ((fixed >> 23) << 24)) / float(1 << bits)  # 24-bit two's complement
    dc = (colours / 255.0 - 0.5) / 0.15
    sh = np.concatenate([dc[:, None], (view.reshape(count, -1, 3) - 128.0) / 128.0], 1)
    quaternions = _spz_first_three(rotations) if version == 2 else _spz_smallest_three(rotations)
    return _cloud(means, quaternions, np.exp(log_scales / 16.0 - 10.0), alphas[:, 0] / 255.0, sh)


def _spz_first_three(rotations: NDArray[Any]) -> Array:
    """Version 2: x, y, z as bytes; w >= 0 follows from unit length."""
    xyz = rotations / 127.5 - 1.0
    return np.column_stack([np.sqrt(np.maximum(0.0, 1.0 - (xyz**2).sum(1))), xyz])


def _spz_smallest_three(rotations: NDArray[Any]) -> Array:
    """Version 3: 2 bits tell the largest of x, y, z, w; the others have a sign and 9 bits each, the last one lowest."""
    packed = rotations.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16, 1 << 24], np.uint32)
    largest = packed >> 30
    xyzw = np.zeros((len(packed), 4))
    for component in (3, 2, 1, 0):
        stored = largest != component
        magnitude = (packed & 511) / 511.0 * np.sqrt(0.5)
        xyzw[stored, component] = np.where(packed & 512, -magnitude, magnitude)[stored]
        packed = np.where(stored, packed >> 10, packed)
    xyzw[np.arange(len(packed)), largest] = np.sqrt(np.maximum(0.0, 1.0 - (xyzw**2).sum(1)))
    return xyzw[:, [3, 0, 1, 2]]


# --- writing ---------------------------------------------------------------------------------------------------------


def write_ply(cloud: GaussianCloud, path: Path) -> None:
    """Write INRIA's binary layout, of the cloud's own degree; every 3DGS viewer reads it."""
    from plyfile import PlyData, PlyElement

    count, coefficients = cloud.sh.shape[:2]
    opacities = np.clip(cloud.opacities.astype(np.float64), 1e-6, 1 - 1e-6)
    columns = {
        "x y z": cloud.means,
        "nx ny nz": np.zeros((count, 3)),
        "f_dc_0 f_dc_1 f_dc_2": cloud.sh[:, 0],
        " ".join(f"f_rest_{i}" for i in range(3 * (coefficients - 1))): cloud.sh[:, 1:].transpose(0, 2, 1),
        "opacity": np.log(opacities / (1 - opacities)),
        "scale_0 scale_1 scale_2": np.log(np.maximum(cloud.scales, 1e-9)),
        "rot_0 rot_1 rot_2 rot_3": cloud.quaternions,
    }
    names = [name for group in columns for name in group.split()]
    table = np.concatenate([values.reshape(count, -1) for values in columns.values()], 1).astype("<f4")
    vertices = np.ascontiguousarray(table).view([(name, "<f4") for name in names])[:, 0]
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(path))


def write_splat(cloud: GaussianCloud, path: Path) -> None:
    """Write 32 bytes a Gaussian; colours lose their view dependence and are rounded to bytes, as are rotations."""
    rows = np.zeros(len(cloud), _SPLAT)
    rows["mean"], rows["scale"] = cloud.means, cloud.scales
    rgba = np.column_stack([colours(cloud), cloud.opacities])
    rows["rgba"] = np.clip(np.rint(rgba * 255), 0, 255)
    rows["quaternion"] = np.clip(np.rint(cloud.quaternions * 128 + 128), 0, 255)
    rows.tofile(path)


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
    return GaussianCloud(*(array if array is None else array[rows] for array in fields_of(cloud).values()))


def rotation_matrices(cloud: GaussianCloud) -> Array:
    """R of each Gaussian, (N, 3, 3)."""
    return Rotation.from_quat(cloud.quaternions, scalar_first=True).as_matrix()


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
    return _cloud(
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

    Colours and surface turn with the rotation of F's polar decomposition.
    """
    deformation_gradient = limited(deformation_gradient)
    axes, scales, _ = np.linalg.svd(deformation_gradient @ (rotation_matrices(cloud) * cloud.scales[:, None, :]))
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]  # an axis may point either way; a rotation may not mirror
    sh, surface = cloud.sh, cloud.surface
    if sh_degree(cloud) > 0 or surface is not None:
        left, _, right = np.linalg.svd(deformation_gradient)
        left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
        sh = rotate_sh(sh, left @ right)
        surface = surface if surface is None else (surface @ (left @ right).mT).astype(surface.dtype)
    turns = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return _cloud(means, turns, scales, cloud.opacities, sh, surface)
