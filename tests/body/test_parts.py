"""What people call the skin that touches."""

import numpy as np
import pytest

from hoi.body.parts import is_with, part_at, struck_with
from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Contact

BODY = load_person("man", 4000, 0)


def part(joint: str, x: float, y: float, z: float) -> str:
    """Of skin of the joint so far from it in the T-pose [m]."""
    row = JOINT_NAMES.index(joint)
    return part_at(row, BODY.rest_joints[row] + [x, y, z], BODY.rest_joints)


@pytest.mark.parametrize(
    ("joint", "away", "name"),
    [
        ("right_hip", (0, -0.36, 0.06), "right_knee"),  # the skin above the kneecap
        ("right_hip", (0, -0.2, 0.08), "right_thigh"),
        ("left_hip", (0, 0.02, 0.08), "left_hip"),
        ("left_knee", (0, 0.02, 0.05), "left_knee"),
        ("left_knee", (0, -0.2, 0.05), "left_shin"),
        ("right_ankle", (0, -0.05, 0.1), "right_foot"),
        ("right_foot", (0, 0, 0.05), "right_foot"),
        ("left_elbow", (0.0, 0, -0.04), "left_elbow"),
        ("left_elbow", (0.12, 0, -0.04), "left_forearm"),
        ("left_shoulder", (0.25, 0, 0), "left_elbow"),
        ("right_wrist", (-0.05, 0, 0), "right_hand"),
        ("right_hand", (-0.05, 0, 0), "right_hand"),
        ("spine3", (0, 0, 0.1), "chest"),
        ("head", (0, 0.1, 0.1), "head"),
        ("pelvis", (0, 0, -0.1), "hips"),
    ],
)
def test_part_is_what_people_name(joint, away, name):
    assert part(joint, *away) == name


def test_every_joint_has_a_name():
    names = {part_at(row, BODY.rest_joints[row], BODY.rest_joints) for row in range(24)}
    assert not {name for name in names if "spine" in name or "collar" in name or "ankle" in name}


def test_old_records_fall_back_on_the_joint():
    zero = np.zeros(3)
    contact = Contact(1.0, JOINT_NAMES.index("right_hip"), 0.1, zero, zero, zero, zero, 1.0, zero, zero, 0.0)
    assert struck_with(contact) == "right_hip"


@pytest.mark.parametrize(
    ("limb", "joint", "part", "counts"),
    [
        ("right_knee", "right_hip", "right_knee", True),
        ("right_knee", "right_knee", "right_knee", True),
        ("right_knee", "right_hip", "right_hip", False),
        ("right_knee", "right_hip", "right_thigh", False),
        ("right_knee", "right_knee", "right_shin", False),
        ("left_knee", "right_knee", "right_knee", False),
        ("right_knee", "right_hip", "", True),  # a record from before parts had names
        ("right_foot", "right_ankle", "right_foot", True),
        ("right_foot", "right_knee", "right_shin", False),
        ("hands", "left_wrist", "left_hand", True),
        ("right_arm", "right_elbow", "right_forearm", True),
        ("head", "neck", "neck", True),
        ("any", "spine3", "chest", True),
        ("knees", "left_hip", "left_knee", True),
        ("knees", "left_hip", "left_thigh", False),
    ],
)
def test_a_hip_is_no_knee(limb, joint, part, counts):
    assert is_with(limb, JOINT_NAMES.index(joint), part) is counts
