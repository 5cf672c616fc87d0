"""A user's own motion as the start of a run: .npz as AMASS has it, or BVH, on our body and in our world."""

from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import rotation_to_6d
from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Array, Body, Motion
from hoi.errors import InputError, about
from hoi.importers.amass import read_amass
from hoi.importers.bvh import read_bvh
from hoi.importers.retarget import map_joints, retarget
from hoi.motion.features import towards_plus_y

SUFFIXES = (".npz", ".bvh")
Y_TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def read_motion(
    path: Path, body: Body, frames: int, fps: float, start_time: float = 0.0, up: str = "auto"
) -> tuple[Motion, tuple[str, ...]]:
    """Read a motion file for a scene.

    The piece from `start_time` on is resampled to `fps`, cut to `frames` or its last pose held, and turned and moved so
    that it begins at the origin facing +Y. The lowest joint from `start_time` to the end of the recording lies where it
    does when the body stands on the ground.

    Args:
        path: .npz (see `hoi.importers.amass`) or .bvh (see `hoi.importers.retarget`).
        start_time: where in the recording the motion begins [s].
        up: the file's up axis, "y" or "z"; "auto" takes the one along which the pelvis' own up axis mostly lies.

    Returns:
        The motion, and what there is to say about it.

    Raises:
        InputError: the file is broken, its skeleton not a person's, or `start_time` outside the recording.
    """
    notes: tuple[str, ...] = ()
    if path.suffix.lower() == ".npz":
        local, translation, rate = read_amass(path, body.rest_joints)
    elif path.suffix.lower() == ".bvh":
        local, translation, rate, notes = _from_bvh(path, body)
    else:
        raise InputError(f"{path}: a motion is read from {' or '.join(SUFFIXES)}, not from {path.suffix!r}")
    length = (len(local) - 1) / rate
    if not 0 <= start_time <= length:
        raise InputError("start_time", f"{start_time:g}", f"in [0, {length:g}] s, which {path} lasts")
    axis = _up_axis(local[:, 0], path) if up == "auto" else up
    if axis == "y":
        local[:, 0], translation = Y_TO_Z_UP @ local[:, 0], translation @ Y_TO_Z_UP.T
    whole = _motion(local, translation, rate)
    ground = joint_paths(body, whole)[int(start_time * rate) :, :, 2].min() - sole_height(body)
    whole.translation[:, 2] -= ground

    wanted = start_time * rate + np.arange(frames) * (rate / fps)
    piece = interpolate_motion(whole, np.minimum(wanted, len(whole) - 1))
    held = int((wanted > len(whole) - 1 + 1e-6).sum())
    placed = _from_origin_facing_plus_y(piece, fps)
    seconds = f"{path.name}: {len(whole)} frames at {rate:g} Hz, {axis} up"
    used = f"from {start_time:g} s on" + (f", its last pose held for {held} of {frames} frames" if held else "")
    return placed, (f"{seconds}; {used}", *notes)


def _from_bvh(path: Path, body: Body) -> tuple[Array, Array, float, tuple[str, ...]]:
    recording = read_bvh(path)
    names, parents = [j.name for j in recording.joints], [j.parent for j in recording.joints]
    with about(path):
        local, translation = retarget(
            names, parents, recording.rest_positions(), *recording.poses(), np.asarray(body.rest_joints)
        )
    unused = [name for row, name in enumerate(names) if row not in map_joints(names, parents).values()]
    return local, translation, recording.fps, (f"joints not used: {', '.join(unused)}",) if unused else ()


def _up_axis(root: Array, path: Path) -> str:
    _, y, z = root[:, :, 1].mean(axis=0)
    if max(y, z) < 0.3 or abs(y - z) < 0.1:
        raise InputError(f"up: cannot tell the up axis of {path}; say up=y or z")
    return "y" if y > z else "z"


def _motion(local: Array, translation: Array, fps: float) -> Motion:
    rotations = torch.from_numpy(np.ascontiguousarray(local))
    return Motion(
        translation=np.array(translation, np.float64),
        orientation=rotation_to_6d(rotations[:, 0]).numpy(),
        body_pose=roma.rotmat_to_rotvec(rotations[:, 1:]).numpy(),
        fps=fps,
    )


def _from_origin_facing_plus_y(motion: Motion, fps: float) -> Motion:
    rows = torch.from_numpy(motion.orientation).unflatten(-1, (2, 3))
    root = torch.cat([rows, torch.linalg.cross(rows[:, 0], rows[:, 1])[:, None]], dim=1)
    turn = towards_plus_y(root[0])
    moved = motion.translation - motion.translation[0] * (1, 1, 0)
    return Motion(
        translation=(moved @ turn.numpy().T).astype(np.float32),
        orientation=rotation_to_6d(turn @ root).numpy().astype(np.float32),
        body_pose=motion.body_pose.astype(np.float32),
        fps=fps,
    )
