"""SMPL, SMPL-H and SMPL-X motions in .npz files, as AMASS, AIST++ and video estimators spell them."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import roma
import torch

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array
from hoi.errors import InputError
from hoi.importers.plausible import FASTEST, SLOWEST, is_possible, unit_of
from hoi.importers.retarget import hips_from_pelvis, leg_bones

JOINTS_IN_FILES = (22, JOINT_COUNT, 52, 55)
"""Without hands, SMPL, SMPL-H, SMPL-X."""
SMPL_LEG_BONES = 0.777
"""Thigh and shin of the neutral SMPL body [m]."""
SMPL_HIPS = np.array([0.0, -0.091, -0.006])
"""Middle of its hips from its pelvis joint, in the T-pose [m]."""
LEGS = (0.2, 2.0)
"""Thighs and shins of people, in metres."""
FRAME_RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "frame_rate", "framerate")
POSES = ("poses", "smpl_poses", "full_pose")
ROOTS, BODIES = ("root_orient", "global_orient"), ("pose_body", "body_pose")
PATHS = ("trans", "transl", "smpl_trans", "root_trans", "translation")
SCALING, REST = "smpl_scaling", "rest_joints"
DEGREES = 7.0
"""No turn is so long [rad]; half of a person's largest ones are longer where degrees are meant."""


def read_amass(path: Path, rest_joints: Array, fps: float | None = None) -> tuple[Array, Array, float, tuple[str, ...]]:
    """Read a motion for a body of other size: the path of its hips is scaled by the length of the legs.

    `trans` is the pelvis joint's path less a constant, where that joint rests in the SMPL body; whoever moves the start
    to the origin and the feet to the ground need not know it. Fingers have no place in 24 joints.

    Args:
        path: .npz of `poses` (or `smpl_poses`, or `root_orient` and `pose_body`, or `global_orient` and `body_pose`) as
            axis-angle [rad], rotation matrices or quaternions of 22, 24, 52 or 55 joints, `trans` (`transl`,
            `smpl_trans`) (F, 3) [m] and `mocap_framerate` (`fps`, ...); `rest_joints` (24, 3) [m] where the body is not
            SMPL's. A leading dimension of 1 is taken off.
        rest_joints: T-pose joints of our body [m], (24, 3).
        fps: frames a second, whatever the file says.

    Returns:
        Local rotations (F, 24, 3, 3), the path of our pelvis joint up to a constant [m], (F, 3), frames a second; in
        the file's axes. And what there is to say about them.

    Raises:
        InputError: it cannot be read, or lacks something.
    """
    data, notes = _load(path), []
    turns = _turns(path, data, notes)
    frames = len(turns)
    trans = next((data[name] for name in PATHS if name in data), None)
    if trans is None:
        notes.append("no trans in the file: the person stays in place")
        trans = np.zeros((frames, 3))
    trans = _without_batch(trans, 2)
    if trans.shape != (frames, 3):
        raise InputError(f"{path}: trans has shape {trans.shape}, must be ({frames}, 3) as poses has frames")
    if SCALING in data and data[SCALING].size == 1 and float(data[SCALING].reshape(-1)[0]) > 0:
        trans = trans / float(data[SCALING].reshape(-1)[0])
    if not (np.isfinite(turns).all() and np.isfinite(trans).all()):
        raise InputError(f"{path}: poses or trans hold numbers that are not finite")
    own = data.get(REST)
    if own is not None and own.shape != (JOINT_COUNT, 3):
        raise InputError(f"{path}: rest_joints has shape {own.shape}, must be ({JOINT_COUNT}, 3)")

    local = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    kept = JOINT_COUNT if turns.shape[1] in (JOINT_COUNT, 23) else 22
    kept = min(kept, turns.shape[1])
    local[:, :kept] = turns[:, :kept]
    rate = float(fps) if fps is not None else _rate(path, data, trans, local, notes)
    if own is None or LEGS[0] < leg_bones(own) < LEGS[1]:
        unit, size, why = unit_of(trans, local, rate, rest_joints)
        if not unit:
            raise InputError(f"{path}: {why}, which nobody can: its unit or frame rate is wrong")
        if why:
            notes.append(f"trans read as {unit}: {why}")
        trans = trans * size
    legs, hips = (SMPL_LEG_BONES, SMPL_HIPS) if own is None else (leg_bones(own), hips_from_pelvis(own))
    centre = (trans + local[:, 0] @ hips) * (leg_bones(rest_joints) / legs)
    return local, centre - local[:, 0] @ hips_from_pelvis(rest_joints), rate, tuple(notes)


def _load(path: Path) -> dict[str, Array]:
    """The arrays of the file that count, as numbers."""
    wanted = {*POSES, *ROOTS, *BODIES, *PATHS, *FRAME_RATES, SCALING, REST}
    data: dict[str, Any] = {}
    name = ""
    try:
        opened = np.load(path, allow_pickle=False)
        if not isinstance(opened, np.lib.npyio.NpzFile):
            raise InputError(f"{path} holds one array; an .npz of poses, trans and mocap_framerate is wanted")
        with opened as file:
            for name in [name for name in file.files if name in wanted]:
                data[name] = np.asarray(file[name], np.float64)
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        where = f": {name}" if name else ""
        raise InputError(f"{path}{where} cannot be read as numbers: {' '.join(str(error).split())}") from error
    return data


def _turns(path: Path, data: dict[str, Array], notes: list[str]) -> Array:
    """Local rotations (F, J, 3, 3), the pelvis' first."""
    name = next((name for name in POSES if name in data), None)
    root, body = (next((name for name in names if name in data), None) for names in (ROOTS, BODIES))
    if name is not None:
        turns = _as_matrices(path, name, data[name], JOINTS_IN_FILES, notes)
    elif root is not None and body is not None:
        parts = [_as_matrices(path, root, data[root], (1,), notes)]
        parts.append(_as_matrices(path, body, data[body], (21, 23), notes))
        if len(parts[0]) != len(parts[1]):
            raise InputError(f"{path}: {root} has {len(parts[0])} frames, {body} has {len(parts[1])}")
        turns = np.concatenate(parts, axis=1)
    else:
        rates = [] if set(FRAME_RATES) & set(data) else [FRAME_RATES[0]]
        missing = ["poses", *([] if set(PATHS) & set(data) else ["trans"]), *rates]
        raise InputError(f"{path} lacks {', '.join(missing)}")
    return turns


def _as_matrices(path: Path, name: str, given: Array, counts: tuple[int, ...], notes: list[str]) -> Array:
    """Axis-angle (F, 3 J) or (F, J, 3), matrices (F, J, 3, 3) or (F, J, 9), quaternions (F, J, 4) -> (F, J, 3, 3)."""
    flat = given.reshape(given.shape[0], -1) if given.ndim and len(given) else given
    values = given[0] if given.ndim > 2 and len(given) == 1 and given.shape[1] != counts[-1] else given
    for array in (given, values):
        flat = array.reshape(len(array), -1) if array.ndim >= 2 and len(array) else np.zeros((0, 0))
        for size in (3, 9, 4):
            shaped = array.ndim <= 2 or array.shape[-1] in ((size, size * flat.shape[1]) if size != 9 else (3, 9))
            if size == 3 and array.ndim == 4:
                shaped = False
            if flat.shape[1] and flat.shape[1] % size == 0 and flat.shape[1] // size in counts and shaped:
                vectors = torch.from_numpy(np.ascontiguousarray(flat.reshape(len(flat), -1, size)))
                return _matrices(name, vectors, notes)
    allowed = ", ".join(map(str, counts))
    raise InputError(f"{path}: {name} has shape {given.shape}, must be (frames, 3 x joints) of {allowed} joints")


def _matrices(name: str, given: torch.Tensor, notes: list[str]) -> Array:
    """(F, J, 3), (F, J, 4) or (F, J, 9) -> (F, J, 3, 3)."""
    if given.shape[-1] == 9:
        return roma.special_gramschmidt(given.unflatten(-1, (3, 3))).numpy()
    if given.shape[-1] == 4:
        first, last = (float(given[..., place].abs().mean()) for place in (0, 3))
        notes.append(f"{name}: quaternions, read as {'wxyz' if first >= last else 'xyzw'}")
        xyzw = torch.cat([given[..., 1:], given[..., :1]], dim=-1) if first >= last else given
        return roma.unitquat_to_rotmat(xyzw / xyzw.norm(dim=-1, keepdim=True)).numpy()
    largest = given.norm(dim=-1).amax(dim=0)
    if given.shape[1] > 1 and float(largest[: min(len(largest), 22)].median()) > DEGREES:
        notes.append(f"{name}: turns of up to {float(largest.max()):.0f}, read as degrees")
        given = given.deg2rad()
    return roma.rotvec_to_rotmat(given).numpy()


def _without_batch(values: Array, dimensions: int) -> Array:
    return values[0] if values.ndim == dimensions + 1 and len(values) == 1 else values


def _rate(path: Path, data: dict[str, Array], trans: Array, local: Array, notes: list[str]) -> float:
    """Frames a second, from the file; of several that differ the one at which somebody can move like that."""
    given = {name: data[name] for name in FRAME_RATES if name in data}
    if not given:
        raise InputError(f"{path} lacks {FRAME_RATES[0]}; say how many frames it has a second, such as fps=60")
    rates = {}
    for name, value in given.items():
        if value.size != 1 or not 0 < float(value.reshape(-1)[0]) < np.inf:
            raise InputError(f"{path}: {name} is {value.tolist()}, must be greater than 0 [1/s]")
        rates[name] = float(value.reshape(-1)[0])
    possible = {name: rate for name, rate in rates.items() if is_possible(trans, local, rate)}
    if max(rates.values()) > 1.01 * min(rates.values()) and len(possible) == 1:
        others = ", ".join(f"{name} of {rate:g}" for name, rate in rates.items() if name not in possible)
        notes.append(f"{next(iter(possible))} is its rate: at {others} nobody could move like that")
        rates = possible
    elif max(rates.values()) > 1.01 * min(rates.values()):
        said = " but ".join(f"{name} is {rate:g}" for name, rate in rates.items())
        raise InputError(f"{path}: {said}; say which is true, such as fps={max(rates.values()):g}")
    name, rate = next(iter(rates.items()))
    if rate < SLOWEST and SLOWEST <= 1 / rate <= FASTEST:
        notes.append(f"{name} of {rate:g} read as the time of a frame: {1 / rate:g} Hz")
        rate = 1 / rate
    return rate
