"""A user's own motion as the start of a run: SMPL's, BVH or joints alone, on our body and in our world."""

from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import rotation_to_6d
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Array, Body, Motion
from hoi.errors import InputError, about
from hoi.importers.amass import read_amass
from hoi.importers.bvh import read_bvh
from hoi.importers.joints import read_joints
from hoi.importers.plausible import doubts, rate_of
from hoi.importers.retarget import is_mirrored, is_standing, map_joints, named, read_names, retarget
from hoi.motion.features import towards_plus_y

SUFFIXES = (".npz", ".bvh", ".npy")
Y_TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
HALF_TURN = np.diag([1.0, -1, -1])
TO_Z_UP = {
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]) @ np.diag([-1.0, -1, 1]),
    "y": Y_TO_Z_UP,
    "-y": Y_TO_Z_UP @ HALF_TURN,
    "z": np.eye(3),
    "-z": HALF_TURN,
}
"""The file's up axis -> the turn of its axes to ours."""


def read_motion(
    path: Path,
    body: Body,
    frames: int,
    fps: float,
    start_time: float = 0.0,
    up: str = "auto",
    rate: float | None = None,
    names: Path | None = None,
) -> tuple[Motion, tuple[str, ...]]:
    """Read a motion file for a scene.

    The piece from `start_time` on is resampled to `fps`, cut to `frames` or its last pose held, and turned and moved so
    that it begins at the origin facing +Y. The lowest joint from `start_time` to the end of the recording lies where it
    does when the body stands on the ground.

    Args:
        path: .npz (see `hoi.importers.amass`), .bvh (`hoi.importers.retarget`) or .npy (`hoi.importers.joints`).
        start_time: where in the recording the motion begins [s].
        up: the file's up axis, "y", "-y", ...; "auto" takes the one along which the pelvis' own up axis mostly lies.
        rate: frames a second of the file, whatever it says itself; None takes what it says.
        names: what each joint of a .bvh stands for, see `hoi.importers.retarget.read_names`.

    Returns:
        The motion, and what there is to say about it.

    Raises:
        InputError: the file is broken, its skeleton not a person's, or `start_time` outside the recording.
    """
    notes: tuple[str, ...] = ()
    if path.suffix.lower() == ".npz":
        local, translation, rate, notes = read_amass(path, body.rest_joints, rate)
    elif path.suffix.lower() == ".bvh":
        local, translation, own, notes = _from_bvh(path, body, names)
        rate = own if rate is None else rate
    elif path.suffix.lower() == ".npy":
        local, translation, own, notes = read_joints(path, body.rest_joints)
        rate = own if rate is None else rate
    else:
        raise InputError(f"{path}: a motion is read from {' or '.join(SUFFIXES)}, not from {path.suffix!r}")
    length = (len(local) - 1) / rate
    if not 0 <= start_time <= length:
        raise InputError("start_time", f"{start_time:g}", f"in [0, {length:g}] s, which {path} lasts")
    axis = _up_axis(local[:, 0], path) if up == "auto" else up
    axis = axis.removeprefix("+")
    local[:, 0], translation = TO_Z_UP[axis] @ local[:, 0], translation @ TO_Z_UP[axis].T
    whole = _motion(local, translation, rate)
    joints = joint_paths(body, whole)
    ground = joints[int(start_time * rate) :, :, 2].min() - sole_height(body)
    whole.translation[:, 2] -= ground

    wanted = start_time * rate + np.arange(frames) * (rate / fps)
    piece = interpolate_motion(whole, np.minimum(wanted, len(whole) - 1))
    held = int((wanted > len(whole) - 1 + 1e-6).sum())
    placed = _from_origin_facing_plus_y(piece, fps)
    seconds = f"{path.name}: {len(whole)} frames at {rate:g} Hz, {axis} up"
    used = f"from {start_time:g} s on" + (f", its last pose held for {held} of {frames} frames" if held else "")
    return placed, (f"{seconds}; {used}", *notes, *doubts(joints, local, rate))


def _from_bvh(path: Path, body: Body, given: Path | None) -> tuple[Array, Array, float, tuple[str, ...]]:
    recording = read_bvh(path)
    names, parents = [j.name for j in recording.joints], [j.parent for j in recording.joints]
    rest, (rotations, positions), notes = recording.rest_positions(), recording.poses(), []
    said = None if given is None else read_names(given)
    with about(path):
        joints = map_joints(names, parents, rest, said)
        if is_standing(joints, rest, body.rest_joints):
            if is_mirrored(joints, rest):
                notes.append("its axes are left-handed: it is mirrored")
                mirror = np.diag([-1.0, 1, 1])
                rest, positions, rotations = rest @ mirror, positions @ mirror, mirror @ rotations @ mirror
        else:
            notes.append(
                "its rest pose is no standing person's: joints are where the file has them, but how bones are turned"
                " about their own axes is not in it; limbs are turned as they bend, all else as little as may be"
            )
        place = (rotations, positions, np.asarray(body.rest_joints), joints)
        local, translation, turned = retarget(names, parents, rest, *place)
    if said is None and not named(names):
        taken = ", ".join(f"{names[row]} as {JOINT_NAMES[joint]}" for joint, row in sorted(joints.items()))
        notes.append(f"joints told by the shape of the skeleton: {taken}")
    if unused := [name for row, name in enumerate(names) if row not in joints.values()]:
        notes.append(f"joints not used: {', '.join(unused)}")
    rate, said = rate_of(1 / recording.fps)
    return local, translation, rate, (*notes, *said, *turned)


def _up_axis(root: Array, path: Path) -> str:
    """The axis along which the pelvis' own up axis mostly lies, and which way."""
    mean = root[:, :, 1].mean(axis=0)
    second, first = np.argsort(np.abs(mean))[-2:]
    if abs(mean[first]) < 0.3 or abs(mean[first]) - abs(mean[second]) < 0.1:
        raise InputError(f"up: cannot tell the up axis of {path}; say up=y or z")
    return ("-" if mean[first] < 0 else "") + "xyz"[first]


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
