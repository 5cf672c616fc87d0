"""The whole scene as Gaussians, a file a frame: INRIA's `.ply`, `.splat`, `.spz`, and glTF with KHR_gaussian_splatting.

Rows are those of the record in every frame, the person's first, so that a Gaussian keeps its number. What `.ply` and
`.splat` hold is said in `hoi.gaussians`, which also reads all of them back.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.body.skinning import body_tensors, pose_means, pose_quaternions
from hoi.data import Body, GaussianCloud, Motion, ObjectTrajectory, Run, SceneObject, fields_of
from hoi.export.axes import AXES
from hoi.files import whole_folder
from hoi.gaussians.khr import write_khr
from hoi.objects.carrying import carried_by
from hoi.render.shown import scene_of

FRAME = "frame_{:04d}"


KINDS: dict[str, Callable[[GaussianCloud, Path], None]] = {
    "ply": gaussians.write_ply,
    "splat": gaussians.write_splat,
    "spz": gaussians.write_spz,
    "khr": write_khr,
}
"""What a sequence may be of."""
EXTENSIONS = {"khr": "glb"}
"""Of the files of a kind, where it is not their name."""


def write_sequence(run: Run, folder: Path, kind: str, axes: str = "z-up") -> None:
    """Write `folder`/frame_0000.KIND and so on; an older sequence there is replaced as a whole.

    Args:
        kind: of `KINDS`.
        axes: of `hoi.export.axes.AXES`.

    Raises:
        InputError: as `clouds`, or the folder cannot be written to or holds something else.
        RunError: the disk is full or broken.
    """
    extension = EXTENSIONS.get(kind, kind)
    axes = "y-up" if kind == "khr" else axes  # glTF's way, always
    with whole_folder(folder, rf"frame_\d+\.{extension}") as part:
        for frame, cloud in enumerate(clouds(run)):
            turned = cloud if axes == "z-up" else gaussians.transform(cloud, AXES[axes])
            KINDS[kind](turned, part / f"{FRAME.format(frame)}.{extension}")


def clouds(run: Run) -> Iterator[GaussianCloud]:
    """Person and object, whichever the run has, in the world, frame by frame.

    Raises:
        InputError: as `hoi.render.shown.scene_of`.
    """
    for clouds_now in zip(*moving_parts(run).values(), strict=True):
        yield join(clouds_now)


def moving_parts(run: Run) -> dict[str, Iterator[GaussianCloud]]:
    """ "person" and "object", whichever the run has, each frame by frame in the world.

    Raises:
        InputError: as `hoi.render.shown.scene_of`.
    """
    scene, motion, trajectory = scene_of(run), run.state.motion, run.state.trajectory
    parts: dict[str, Iterator[GaussianCloud]] = {}
    if motion is not None:
        parts["person"] = _person(scene.body, motion)
    if trajectory is not None:
        parts["object"] = _thing(scene.thing, trajectory)
    return parts


def join(parts: tuple[GaussianCloud, ...]) -> GaussianCloud:
    """All Gaussians as one cloud; harmonics that a part lacks are zero."""
    bands = max(part.sh.shape[1] for part in parts)
    sh = [np.pad(part.sh, ((0, 0), (0, bands - part.sh.shape[1]), (0, 0))) for part in parts]
    padded = [replace(part, sh=harmonics) for part, harmonics in zip(parts, sh, strict=True)]
    return GaussianCloud(*map(np.concatenate, zip(*(fields_of(part).values() for part in padded), strict=True)))


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
    count, cloud, carried = len(thing.cloud), thing.drawn or thing.cloud, carried_by(thing)
    for frame, positions in enumerate(trajectory.positions[:, :count]):
        gradient = None
        if trajectory.deformation_gradient is not None:
            gradient = trajectory.deformation_gradient[frame, :count].astype(np.float64)
        if carried is not None:
            positions, gradient = carried.moved(positions, gradient)
        yield replace(cloud, means=positions) if gradient is None else gaussians.deform(cloud, positions, gradient)
