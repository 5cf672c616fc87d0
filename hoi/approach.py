"""Where the person starts and which way they face (paper, In-Scene Variations).

The motion prior knows neither: its motions are the same wherever they begin. So the object's place decides, exactly
and before any optimisation, what attraction would otherwise have to tear out of the motion.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import roma
import torch

from hoi.body.kinematics import rotation_from_6d, rotation_to_6d
from hoi.data import Array, Motion


def turned(motion: Motion, angle: float) -> Motion:
    """The motion about the world's Z axis by `angle`."""
    about_z = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, angle], dtype=torch.float64))
    root = rotation_from_6d(torch.as_tensor(motion.orientation, dtype=torch.float64))
    return replace(
        motion,
        translation=(motion.translation @ about_z.T.numpy()).astype(motion.translation.dtype),
        orientation=rotation_to_6d(about_z @ root).numpy().astype(motion.orientation.dtype),
    )


def shifted(motion: Motion, offset: Array) -> Motion:
    """The motion moved by `offset` [m], (3,)."""
    return replace(motion, translation=motion.translation + np.asarray(offset, dtype=motion.translation.dtype))


def placed(
    motion: Motion, joint_at_meeting: Callable[[Motion], Array], goal_of: Callable[[Motion], Array], com: Array
) -> Motion:
    """The motion turned and moved along the ground such that its strike ends where it should.

    It is turned about the origin until the strike ends in the direction of the object, then moved along the ground.
    The start so lies near the straight line through the origin and the object.

    Args:
        joint_at_meeting: p_j* of a motion when the strike meets the object [m], (3,).
        goal_of: where that joint should then be [m], (3,); it depends on the way the strike comes.
        com: the object's centre of mass then [m], (3,).
    """
    struck = joint_at_meeting(motion)
    if np.linalg.norm(com[:2]) > 1e-6 and np.linalg.norm(struck[:2]) > 1e-6:
        motion = turned(motion, float(np.arctan2(com[1], com[0]) - np.arctan2(struck[1], struck[0])))
    offset = goal_of(motion) - joint_at_meeting(motion)
    return shifted(motion, offset * [1.0, 1.0, 0.0])
