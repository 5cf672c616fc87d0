"""SMPL, SMPL-H and SMPL-X motions in .npz files as AMASS has them."""

import zipfile
from pathlib import Path

import numpy as np
import roma
import torch

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array
from hoi.errors import InputError
from hoi.importers.retarget import hips_from_pelvis, leg_bones

JOINTS_IN_FILES = (22, JOINT_COUNT, 52, 55)
"""Without hands, SMPL, SMPL-H, SMPL-X."""
SMPL_LEG_BONES = 0.777
"""Thigh and shin of the neutral SMPL body [m]."""
SMPL_HIPS = np.array([0.0, -0.091, -0.006])
"""Middle of its hips from its pelvis joint, in the T-pose [m]."""
FRAME_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")


def read_amass(path: Path, rest_joints: Array) -> tuple[Array, Array, float]:
    """Read a motion for a body of other size: the path of its hips is scaled by the length of the legs.

    `trans` is the pelvis joint's path less a constant, where that joint rests in the SMPL body; whoever moves the start
    to the origin and the feet to the ground need not know it. Fingers have no place in 24 joints.

    Args:
        path: .npz of `poses` (F, 3 J) or (F, J, 3) [rad] with J = 22, 24, 52 or 55 (or `root_orient` and `pose_body`),
            `trans` (F, 3) [m] and `mocap_framerate`; `rest_joints` (24, 3) [m] where the body is not SMPL's.
        rest_joints: T-pose joints of our body [m], (24, 3).

    Returns:
        Local rotations (F, 24, 3, 3), the path of our pelvis joint up to a constant [m], (F, 3), frames a second; in
        the file's axes.

    Raises:
        InputError: it cannot be read, or lacks something.
    """
    try:
        opened = np.load(path, allow_pickle=False)
        if not isinstance(opened, np.lib.npyio.NpzFile):
            raise InputError(f"{path} holds one array; an .npz of poses, trans and mocap_framerate is wanted")
        with opened as file:
            wanted = {"poses", "root_orient", "pose_body", "trans", "rest_joints", *FRAME_RATES}
            data = {name: np.asarray(file[name], np.float64) for name in file.files if name in wanted}
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} cannot be read as numbers: {' '.join(str(error).split())}") from error
    if "poses" not in data and {"root_orient", "pose_body"} <= set(data):
        data["poses"] = np.concatenate([data[name].reshape(-1, 3 * n) for name, n in _PARTS], axis=1)
    rate = next((name for name in FRAME_RATES if name in data), None)
    missing = [name for name in ("poses", "trans") if name not in data] + ([] if rate else [FRAME_RATES[0]])
    if missing or rate is None:
        raise InputError(f"{path} lacks {', '.join(missing)}")
    poses, trans, fps = data["poses"], data["trans"], data[rate]
    if poses.ndim not in (2, 3) or len(poses) < 1 or poses[0].size not in [3 * count for count in JOINTS_IN_FILES]:
        allowed = ", ".join(map(str, JOINTS_IN_FILES))
        raise InputError(f"{path}: poses has shape {poses.shape}, must be (frames, 3 x joints) of {allowed} joints")
    if trans.shape != (len(poses), 3):
        raise InputError(f"{path}: trans has shape {trans.shape}, must be ({len(poses)}, 3) as poses has frames")
    if fps.size != 1 or not 0 < float(fps.reshape(-1)[0]) < np.inf:
        raise InputError(f"{path}: {rate} is {fps.tolist()}, must be greater than 0 [1/s]")
    if not (np.isfinite(poses).all() and np.isfinite(trans).all()):
        raise InputError(f"{path}: poses or trans hold numbers that are not finite")
    own = data.get("rest_joints")
    if own is not None and own.shape != (JOINT_COUNT, 3):
        raise InputError(f"{path}: rest_joints has shape {own.shape}, must be ({JOINT_COUNT}, 3)")

    vectors = np.zeros((len(poses), JOINT_COUNT, 3))
    given = poses.reshape(len(poses), -1, 3)
    kept = JOINT_COUNT if given.shape[1] == JOINT_COUNT else 22
    vectors[:, :kept] = given[:, :kept]
    local = roma.rotvec_to_rotmat(torch.from_numpy(vectors)).numpy()
    legs, hips = (SMPL_LEG_BONES, SMPL_HIPS) if own is None else (leg_bones(own), hips_from_pelvis(own))
    centre = (trans + local[:, 0] @ hips) * (leg_bones(rest_joints) / legs)
    return local, centre - local[:, 0] @ hips_from_pelvis(rest_joints), float(fps.reshape(-1)[0])


_PARTS = (("root_orient", 1), ("pose_body", 21))
