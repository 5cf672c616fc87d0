"""The 24-joint SMPL skeleton: names, order, parents and the limbs people speak of."""

JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
JOINT_COUNT = len(JOINT_NAMES)
POSE_FEATURES = 9 * (JOINT_COUNT - 1)
"""Entries of R_j - I of joints 1..23, which pose blend shapes are linear in."""

CHAINS = {
    "left leg": (1, 4, 7, 10),
    "right leg": (2, 5, 8, 11),
    "left arm": (16, 18, 20, 22),
    "right arm": (17, 19, 21, 23),
    "head": (12, 15),
    "trunk": (0, 3, 6, 9, 13, 14),
}
"""The joints that push together, from the body outwards: each joint is in one chain."""


def chain_of(joint: int) -> str:
    """The name of the chain that a joint is in."""
    return next(chain for chain, joints in CHAINS.items() if joint in joints)


_OF_CHAIN = {
    "foot": ("leg", (2, 3)),
    "knee": ("leg", (1, 0)),  # the skin above the kneecap goes with the thigh
    "leg": ("leg", (1, 2, 3)),
    "hand": ("arm", (2, 3)),
    "arm": ("arm", (1, 2, 3)),
}
LIMBS = {
    f"{side}_{limb}": tuple(CHAINS[f"{side} {chain}"][place] for place in places)
    for limb, (chain, places) in _OF_CHAIN.items()
    for side in ("left", "right")
}
LIMBS |= {
    "feet": tuple(sorted(LIMBS["left_foot"] + LIMBS["right_foot"])),
    "knees": tuple(sorted(LIMBS["left_knee"] + LIMBS["right_knee"])),
    "hands": tuple(sorted(LIMBS["left_hand"] + LIMBS["right_hand"])),
    "head": CHAINS["head"],
}
"""A limb's name -> the joints whose Gaussians belong to it."""
