"""What people call the place where a person is touched.

The skin goes with the joint that turns it: what is above the kneecap with the hip. Who strikes with it strikes with the
knee.
"""

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, LIMBS
from hoi.data import Array, Contact, ContactSearch

NEAR, FAR = 0.2, 0.7
"""Skin up to the first share of a bone belongs to the joint at its start, from the second on to the one at its end."""
_ALONG = {
    "hip": ("hip", "thigh", "knee"),
    "knee": ("knee", "shin", "ankle"),
    "shoulder": ("shoulder", "upper_arm", "elbow"),
    "elbow": ("elbow", "forearm", "wrist"),
    "wrist": ("wrist", "hand", "hand"),
}
"""Of the joints with a bone: what is at its start, along it, and at its end."""
_NEXT = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist", "wrist": "hand"}
"""The joint at the end of that bone."""
_WHOLE = {
    "ankle": "foot",
    "collar": "shoulder",
    "pelvis": "hips",
    "spine1": "belly",
    "spine2": "chest",
    "spine3": "chest",
}
"""Other joints whose skin people give another name."""


def part_at(joint: int, point: Array, joints: Array) -> str:
    """The name of a joint's skin at a point: "right_knee", "left_hand", "chest".

    Args:
        joint: whose skin it is. point: on the skin [m], (3,). joints: of the person then [m], (24, 3).
    """
    side, _, name = JOINT_NAMES[joint].rpartition("_")
    if name in _ALONG:
        bone = joints[JOINT_NAMES.index(f"{side}_{_NEXT[name]}")] - joints[joint]
        share = (point - joints[joint]) @ bone / max(float(bone @ bone), 1e-12)
        start, along, end = _ALONG[name]
        name = start if share < NEAR else along if share < FAR else end
    else:
        name = _WHOLE.get(name, name)
    return f"{side}_{name}" if side else name


_OWN = {"knee": ("knee",)}
"""Of limbs whose joints move skin that people call something else: what they call the limb's own."""


TOGETHER = 1.0
"""So soon after the push the object is still where it was freely, for the limbs that push together [frames]."""


def is_with(limb: str, joint: int, part: str) -> bool:
    """Whether what touched is of that limb (`hoi.body.skeleton.LIMBS`): a hip or a shin is no knee.

    Whatever touches is of a limb that is none of them ("any").

    Args:
        joint: whose skin it is. part: as people call it; empty where only the joint is known, which then has to do.
    """
    if joint not in LIMBS.get(limb, range(JOINT_COUNT)):
        return False
    side, _, name = limb.rpartition("_")
    own = _OWN.get(name.removesuffix("s"))
    sides = (side,) if side else ("left", "right")
    return own is None or not part or part in {f"{each}_{skin}" for each in sides for skin in own}


def struck_with(contact: Contact) -> str:
    """What touched the object, as people call it; the joint where the record is of a time before parts had names."""
    return contact.part or (JOINT_NAMES[contact.joint] if contact.joint >= 0 else "body")


def struck_together(search: ContactSearch) -> str:
    """What pushed the object first, as people call it, and what pushed with it: "left_hand and right_hand"."""
    first, push = next((place, each) for place, each in enumerate(search.contacts) if each is search.push)
    together = [each for each in search.contacts[first:] if each.frame <= push.frame + TOGETHER]
    return " and ".join(dict.fromkeys(struck_with(contact) for contact in together))
