"""Motions that are places of joints alone: HumanML3D's 263 features a frame, or the 22 joints themselves, in .npy.

    0        half the turn of the heading to the next frame, about y [rad]
    1:3      xz velocity of the pelvis to the next frame, in that frame's heading [m/frame]
    3        height of the pelvis [m]
    4:67     places of joints 1..21, the pelvis above the origin, in the heading frame [m]
    67:263   rotations, velocities and foot contacts, which are not used: the rotations are no SMPL rotations

(Guo et al. 2022, motion_process.py.) Y up, 20 frames a second. A person of heading 0 faces +z.
"""

from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Array
from hoi.errors import InputError
from hoi.importers.retarget import hips_from_pelvis, leg_bones
from hoi.importers.roll import about, bending, shortest_arcs, unit

FEATURES, JOINTS = 263, 22
KIT_FEATURES = (251, 21)
FPS = 20.0
UNSTEADY = 0.25
"""Bones whose length varies by more than this (standard deviation over mean) are none."""
STRAIGHT = 0.01
"""Sine squared of a bend below which it hardly tells how a limb is turned about its own axis."""


def read_joints(path: Path, rest_joints: Array) -> tuple[Array, Array, float, tuple[str, ...]]:
    """Read a motion for a body of other size: the path of its hips is scaled by the length of the legs.

    Args:
        path: .npy of (F, 263) features or (F, 22, 3) places [m]; a leading dimension of 1 is taken off.
        rest_joints: T-pose joints of our body [m], (24, 3).

    Returns:
        As `hoi.importers.amass.read_amass`.

    Raises:
        InputError: it cannot be read, or is neither.
    """
    values = _load(path)
    kind = "HumanML3D's features" if values.ndim == 2 else "joints"
    places = places_of(values) if values.ndim == 2 else values
    bones = np.linalg.norm(places[:, [4, 5, 7, 8]] - places[:, [1, 2, 4, 5]], axis=-1)
    if not (bones.mean(axis=0) > 0).all() or (bones.std(axis=0) > UNSTEADY * bones.mean(axis=0)).any():
        raise InputError(f"{path}: its legs change their length; features that were normalised must be x Std + Mean")
    local = rotations_of(places, rest_joints)
    centre = places[:, [1, 2]].mean(axis=1) * (leg_bones(rest_joints) / (bones.mean() * 2))
    note = f"{kind}: rotations by inverse kinematics, limbs turned about themselves as knees and elbows bend"
    return local, centre - local[:, 0] @ hips_from_pelvis(rest_joints), FPS, (note,)


def _load(path: Path) -> Array:
    """(F, 263) or (F, 22, 3), finite."""
    try:
        given = np.load(path, allow_pickle=False)
        if not isinstance(given, np.ndarray):
            raise InputError(f"{path} is an .npz; call it so")
        values = np.asarray(given, np.float64)
    except (OSError, ValueError, TypeError, EOFError) as error:
        if "allow_pickle" in str(error) and _is_npy(path):
            raise InputError(f"{path} holds Python objects, which are not unpickled; save the array alone") from None
        raise InputError(f"{path} cannot be read as numbers: {' '.join(str(error).split())}") from error
    shape = values.shape
    if len(shape) > 2 and shape[0] == 1 and shape[1:] != (JOINTS, 3):
        values = values[0]
    if values.shape[1:] not in ((FEATURES,), (JOINTS, 3)) or not len(values):
        kit = values.shape[-1:] == KIT_FEATURES[:1] or values.shape[1:] == (KIT_FEATURES[1], 3)
        why = "; that is KIT-ML's skeleton of 21 joints, which is not read" if kit else ""
        raise InputError(f"{path} has shape {shape}, must be (frames, {FEATURES}) or (frames, {JOINTS}, 3){why}")
    if not np.isfinite(values).all():
        raise InputError(f"{path} holds numbers that are not finite")
    return values


def _is_npy(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"\x93NUMPY"


def places_of(features: Array) -> Array:
    """Joints of HumanML3D's features (F, 263): (F, 22, 3) [m], y up, the first frame above the origin facing +z."""
    heading = -2 * np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    cosine, sine, zero, one = np.cos(heading), np.sin(heading), np.zeros_like(heading), np.ones_like(heading)
    turn = np.stack([cosine, zero, sine, zero, one, zero, -sine, zero, cosine], axis=-1).reshape(-1, 3, 3)
    step = np.zeros((len(features), 3))
    step[1:, [0, 2]] = features[:-1, 1:3]
    pelvis = np.cumsum((turn @ step[..., None])[..., 0], axis=0)
    pelvis[:, 1] = features[:, 3]
    others = features[:, 4:67].reshape(-1, JOINTS - 1, 3) @ turn.swapaxes(-1, -2)
    others[..., [0, 2]] += pelvis[:, None, [0, 2]]
    return np.concatenate([pelvis[:, None], others], axis=1)


def rotations_of(places: Array, rest_joints: Array) -> Array:
    """Local rotations (F, 24, 3, 3) of our skeleton whose bones point as those between places (F, 22, 3) do.

    Pelvis and chest fit all bones that leave them. How a thigh or an upper arm is turned about itself is told by the
    knee's or elbow's bend, the less the straighter the limb; hands and head are turned as what they hang on.
    """
    rest = np.asarray(rest_joints, np.float64)
    world = np.tile(np.eye(3), (len(places), JOINT_COUNT, 1, 1))
    local = world.copy()
    for joint, parent in enumerate(PARENTS):
        above = world[:, parent] if parent >= 0 else np.broadcast_to(np.eye(3), (len(places), 3, 3))
        children = [child for child in range(JOINTS) if PARENTS[child] == joint]
        if joint < JOINTS and children:
            ours = unit(rest[children] - rest[joint])
            theirs = unit(places[:, children] - places[:, [joint]], ours) @ above  # in the parent's frame
            if len(children) > 1:
                local[:, joint] = _fit(ours, theirs)
            else:
                local[:, joint] = shortest_arcs(ours[0], theirs[:, 0])
        world[:, joint] = above @ local[:, joint]
        if (part := JOINT_NAMES[joint].partition("_")[2]) in ("hip", "shoulder"):
            (child,) = children
            after = PARENTS.index(child)
            lower = (unit(places[:, [after]] - places[:, [child]]) @ world[:, joint])[:, 0]
            turn = about(ours[0], np.angle(bending(ours[0], part, lower) + STRAIGHT))
            local[:, joint], world[:, joint] = local[:, joint] @ turn, world[:, joint] @ turn
    return local


def _fit(ours: Array, theirs: Array) -> Array:
    """The rotations (F, 3, 3) that best take directions (C, 3) to (F, C, 3), in least squares."""
    product = torch.from_numpy(np.einsum("fci,cj->fij", theirs, ours))
    turns = roma.special_procrustes(product)
    assert isinstance(turns, torch.Tensor)
    return turns.numpy()
