"""The person's motion for other programs: SMPL parameters with AMASS's names, and BVH."""

import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Array, Run
from hoi.errors import InputError
from hoi.export.axes import Y_UP
from hoi.export.person import local_turns
from hoi.files import whole_file

BETAS = 10
_ORDER = "ZXY"
_DECIMALS = 8
_TIP = 0.35
"""Length of what hangs on a last joint, as a share of the bone before it; only to be drawn."""


def write_smpl(run: Run, path: Path) -> None:
    """Write an .npz as AMASS has it, of 24 SMPL joints: z up, the pelvis joint at trans + rest_joints[0].

    `rest_joints` are the body's own, as it is not SMPL's; `betas` are zero and mean nothing for it.

    Raises:
        InputError: the run has no motion, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    rest, local, translation, fps = _motion(run)
    vectors = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(len(local), JOINT_COUNT * 3)
    with whole_file(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            poses=vectors,
            root_orient=vectors[:, :3],
            pose_body=vectors[:, 3:66],
            trans=translation - rest[0],
            mocap_framerate=fps,
            gender="neutral",
            betas=np.zeros(BETAS),
            rest_joints=rest,
            joint_names=np.array(JOINT_NAMES),
        )


def write_bvh(run: Run, path: Path) -> None:
    """Write a BVH in metres, Y up, with the T-pose as its rest pose.

    Raises:
        InputError: the run has no motion, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    rest, local, translation, fps = _motion(run)
    local[:, 0] = Y_UP @ local[:, 0]
    with warnings.catch_warnings():  # at a gimbal's lock either choice of angles is the rotation
        warnings.simplefilter("ignore", UserWarning)
        angles = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_euler(_ORDER, degrees=True)
    angles = np.unwrap(angles.reshape(len(local), JOINT_COUNT, 3), axis=0, period=360)
    lines, order = ["HIERARCHY"], []

    def joint_lines(joint: int, depth: int) -> None:
        order.append(joint)
        indent, parent = "\t" * depth, PARENTS[joint]
        bone = np.zeros(3) if parent < 0 else rest[joint] - rest[parent]
        turns = " ".join(f"{axis}rotation" for axis in _ORDER)
        channels = f"6 Xposition Yposition Zposition {turns}" if parent < 0 else f"3 {turns}"
        lines.append(f"{indent}{'ROOT' if parent < 0 else 'JOINT'} {JOINT_NAMES[joint]}")
        lines.extend([f"{indent}{{", f"{indent}\tOFFSET {_numbers(bone)}", f"{indent}\tCHANNELS {channels}"])
        children = [child for child in range(JOINT_COUNT) if PARENTS[child] == joint]
        for child in children:
            joint_lines(child, depth + 1)
        if not children:
            lines.extend([f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET {_numbers(_TIP * bone)}"])
            lines.append(f"{indent}\t}}")
        lines.append(f"{indent}}}")

    joint_lines(0, 0)
    lines += ["MOTION", f"Frames: {len(local)}", f"Frame Time: {1 / fps:.10f}"]
    rows = np.concatenate([translation @ Y_UP.T, angles[:, order].reshape(len(local), -1)], axis=1)
    lines += [_numbers(row) for row in rows]
    with whole_file(path) as part:
        part.write_text("\n".join(lines) + "\n")


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.{_DECIMALS}f}" for value in values)


def _motion(run: Run) -> tuple[Array, Array, Array, float]:
    """T-pose joints (24, 3), local rotations (T, 24, 3, 3), path of the pelvis joint (T, 3), frames a second."""
    motion = run.state.motion
    if motion is None or run.scene is None:
        raise InputError("the run has no motion")
    rest, path = (array.astype(np.float64) for array in (run.scene.body.rest_joints, motion.translation))
    return rest, local_turns(motion), path, motion.fps
