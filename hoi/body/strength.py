"""What muscles, and the ground under the feet, can give a person. No torch, no MuJoCo."""

import numpy as np

from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array

TORQUES = {
    "hip": 3.3, "knee": 3.2, "ankle": 2.0, "foot": 0.3, "spine1": 3.5, "spine2": 3.5, "spine3": 3.5, "neck": 0.6,
    "head": 0.6, "collar": 1.4, "shoulder": 1.2, "elbow": 1.0, "wrist": 0.25, "hand": 0.1,
}  # fmt: skip
"""The most that muscles give about a joint [N m per kg of body]: legs after Anderson, Madigan and Nussbaum (2007), arms
after Holzbaur et al. (2007), neck after Vasavada, Li and Delp (2001), rounded; trunk and collar bones as strong as the
hips and shoulders need."""
SOLE_FRICTION = 0.8
"""Coulomb coefficient of a shoe on a dry floor [-]."""
FEET = (7, 8, 10, 11)
"""Ankles and toe joints."""
LOW = 0.05
"""A joint of a foot on the ground is less than this above its height in standing [m]."""


def torque_limits(joints: list[int]) -> Array:
    """Of TORQUES, those of some joints of 1 to 23 [N m per kg of body], (J,)."""
    return np.array([next(TORQUES[key] for key in TORQUES if JOINT_NAMES[joint].endswith(key)) for joint in joints])
