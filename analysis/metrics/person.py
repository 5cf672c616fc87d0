"""How the person moves: feet that slide, jerks, joints bent farther than people bend them."""

import numpy as np

from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array

from ..records import Record
from .metric import NAN

TOES = (10, 11)
DOWN = 0.03
"""A toe joint that is no higher than this over its height in standing is on the ground [m]."""

LIMITS = {
    "hip": 135.0, "knee": 155.0, "ankle": 75.0, "foot": 75.0, "spine1": 50.0, "spine2": 50.0, "spine3": 50.0,
    "neck": 70.0, "head": 70.0, "collar": 60.0, "shoulder": 180.0, "elbow": 160.0, "wrist": 100.0, "hand": 100.0,
}  # fmt: skip
"""Largest turn of a joint from the T-pose, about whatever axis [degrees]: the range of motion of healthy adults (AAOS,
Kapandji), with 10 to 20 degrees for what the T-pose and the skeleton's cuts add."""
HYPEREXTENSION = 15.0
"""Knees bend forwards by no more than this [degrees]."""


def foot_skating(record: Record) -> float:
    """Mean horizontal speed of the toes that are on the ground in two frames in a row."""
    run, joints = record.run, record.joints
    if joints is None or run.scene is None or run.state.motion is None or len(joints) < 2:
        return NAN
    body = run.scene.body
    sole = float(body.cloud.means[:, 1].min()) if len(body.cloud) else float(body.rest_joints[:, 1].min())
    standing = body.rest_joints[list(TOES), 1] - sole
    return skating(joints[:, list(TOES)], standing + DOWN, run.state.motion.fps)


def skating(toes: Array, heights: Array, fps: float) -> float:
    """Mean horizontal speed [m/s] of toes (T, 2, 3) [m] that stay below their heights (2,) [m]; NaN where none does."""
    slide = fps * np.linalg.norm(np.diff(toes[..., :2], axis=0), axis=-1)
    down = np.maximum(toes[1:, :, 2], toes[:-1, :, 2]) < heights
    return float(slide[down].mean()) if down.any() else NAN


def jerk(record: Record) -> float:
    """Mean size of the third derivative of the joints' positions, over joints and frames."""
    joints, motion = record.joints, record.run.state.motion
    if joints is None or motion is None or len(joints) < 4:
        return NAN
    return float(motion.fps**3 * np.linalg.norm(np.diff(joints, n=3, axis=0), axis=-1).mean())


def joint_limits(record: Record) -> float:
    """Share of the joints' poses, over joints 1 to 23 and all frames, that are beyond the range of motion of healthy
    adults: turned farther than the joint can, or a knee bent forwards."""
    motion = record.run.state.motion
    return NAN if motion is None else float(beyond_limits(motion.body_pose).mean())


def beyond_limits(body_pose: Array) -> Array:
    """Which poses (T, 23, 3), axis-angle [rad], are beyond the limits, (T, 23)."""
    pose = np.asarray(body_pose, np.float64)
    turn = np.linalg.norm(pose, axis=-1)
    shortest = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)  # an axis-angle of 350 degrees is a turn of 10
    limits = np.radians([LIMITS[name.partition("_")[2] or name] for name in JOINT_NAMES[1:]])
    beyond = shortest > limits
    knees = [JOINT_NAMES.index(f"{side}_knee") - 1 for side in ("left", "right")]
    beyond[:, knees] |= (pose[:, knees, 0] < -np.radians(HYPEREXTENSION)) & (turn[:, knees] < np.pi)
    return beyond
