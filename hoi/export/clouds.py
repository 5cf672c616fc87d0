"""The whole scene as Gaussians, a file a frame: INRIA's `.ply`, `.splat` and `.spz`.

Rows are those of the record in every frame, the person's first, so that a Gaussian keeps its number. What `.ply` and
`.splat` hold is said in `hoi.gaussians`, which also reads all three back.
"""

import gzip
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.body.skinning import body_tensors, pose_means, pose_quaternions
from hoi.data import Array, Body, GaussianCloud, Motion, ObjectTrajectory, Run, SceneObject, fields_of
from hoi.export.axes import AXES
from hoi.files import whole_file, whole_folder
from hoi.render.light import lit_cloud
from hoi.render.shown import scene_of

FRAME = "frame_{:04d}"
SPZ_MAGIC, SPZ_VERSION = 0x5053474E, 3
SPZ_FRACTION = 16
"""Bits after the point of a position: steps of 0.015 mm up to 128 m; fewer where the scene is larger."""


def write_spz(cloud: GaussianCloud, path: Path) -> None:
    """Write SPZ version 3: gzip of positions, alphas, colours, log scales, rotations, higher harmonics.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    degree, count = gaussians.sh_degree(cloud), len(cloud)
    reach = float(np.abs(cloud.means).max(initial=1e-9))
    bits = int(np.clip(np.floor(np.log2((2**23 - 1) / reach)), 0, SPZ_FRACTION))
    fixed = np.rint(cloud.means.astype(np.float64) * 2**bits).astype("<i4")
    parts = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(count, 3, 4)[:, :, :3],
        _bytes(cloud.opacities * 255),
        _bytes((cloud.sh[:, 0] * 0.15 + 0.5) * 255),
        _bytes((np.log(np.maximum(cloud.scales, 1e-9)) + 10) * 16),
        _smallest_three(cloud.quaternions),
        _bytes(cloud.sh[:, 1:] * 128 + 128),
    ]
    header = struct.pack("<IIIBBBB", SPZ_MAGIC, SPZ_VERSION, count, degree, bits, 0, 0)
    with whole_file(path) as part:
        part.write_bytes(gzip.compress(header + b"".join(p.tobytes() for p in parts), compresslevel=6, mtime=0))


def _bytes(values: Array) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _smallest_three(quaternions: Array) -> np.ndarray:
    """wxyz (N, 4) -> 4 bytes each: 2 bits for the largest of x, y, z, w, then sign and 9 bits of the others."""
    xyzw = quaternions[:, [1, 2, 3, 0]].astype(np.float64)
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(np.take_along_axis(xyzw, largest[:, None], 1) < 0, -1, 1)
    packed = largest.astype(np.uint32)
    for component in range(4):
        magnitude = np.minimum(np.rint(np.abs(xyzw[:, component]) * np.sqrt(2) * 511), 511).astype(np.uint32)
        coded = (packed << 10) | ((xyzw[:, component] < 0).astype(np.uint32) << 9) | magnitude
        packed = np.where(largest == component, packed, coded)
    return packed.astype("<u4").view(np.uint8)


KINDS: dict[str, Callable[[GaussianCloud, Path], None]] = {
    "ply": gaussians.write_ply,
    "splat": gaussians.write_splat,
    "spz": write_spz,
}
"""What a sequence may be of, by extension."""


def write_sequence(run: Run, folder: Path, kind: str, axes: str = "z-up") -> None:
    """Write `folder`/frame_0000.KIND and so on; an older sequence there is replaced as a whole.

    Args:
        kind: of `KINDS`.
        axes: of `hoi.export.axes.AXES`.

    Raises:
        InputError: as `clouds`, or the folder cannot be written to or holds something else.
        RunError: the disk is full or broken.
    """
    with whole_folder(folder, rf"frame_\d+\.{kind}") as part:
        for frame, cloud in enumerate(clouds(run)):
            turned = cloud if axes == "z-up" else gaussians.transform(cloud, AXES[axes])
            KINDS[kind](turned, part / f"{FRAME.format(frame)}.{kind}")


def clouds(run: Run) -> Iterator[GaussianCloud]:
    """Person and object, whichever the run has, in the world, frame by frame, in the light of a film without shadows.

    Raises:
        InputError: as `hoi.render.shown.scene_of`.
    """
    scene, motion, trajectory = scene_of(run), run.state.motion, run.state.trajectory
    parts = []
    if motion is not None:
        parts.append(_person(scene.body, motion))
    if trajectory is not None:
        parts.append(_thing(scene.thing, trajectory))
    for clouds_now in zip(*parts, strict=True):
        yield join([lit_cloud(cloud) for cloud in clouds_now])


def join(parts: Sequence[GaussianCloud]) -> GaussianCloud:
    """All Gaussians as one cloud; harmonics that a part lacks are zero."""
    bands = max(part.sh.shape[1] for part in parts)
    sh = [np.pad(part.sh, ((0, 0), (0, bands - part.sh.shape[1]), (0, 0))) for part in parts]
    padded = [replace(part, sh=harmonics) for part, harmonics in zip(parts, sh, strict=True)]
    columns = (fields_of(replace(part, surface=None)).values() for part in padded)
    return GaussianCloud(*(np.concatenate(column) for column in zip(*columns, strict=True) if column[0] is not None))


def _person(body: Body, motion: Motion) -> Iterator[GaussianCloud]:
    tensors, still = body_tensors(body), gaussians.rotation_matrices(body.cloud)
    arrays = (motion.translation, motion.orientation, motion.body_pose)
    parameters = [torch.from_numpy(np.asarray(array, np.float32)) for array in arrays]
    for frame in range(len(motion)):
        pose = [parameter[frame : frame + 1] for parameter in parameters]
        with torch.no_grad():
            means, quaternions = pose_means(tensors, *pose)[0].numpy(), pose_quaternions(tensors, *pose[1:])[0].numpy()
        sh = body.cloud.sh
        if sh.shape[1] > 1:
            turned = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
            sh = gaussians.rotate_sh(sh, turned @ still.transpose(0, 2, 1))
        yield replace(body.cloud, means=means, quaternions=quaternions, sh=sh)


def _thing(thing: SceneObject, trajectory: ObjectTrajectory) -> Iterator[GaussianCloud]:
    count, cloud = len(thing.cloud), thing.cloud
    for frame, positions in enumerate(trajectory.positions):
        if trajectory.deformation_gradient is None:
            yield replace(cloud, means=positions[:count])
        else:
            gradient = trajectory.deformation_gradient[frame, :count].astype(np.float64)
            yield gaussians.deform(cloud, positions[:count], gradient)
