"""From any human skeleton to the 24 SMPL joints: which joint is which by its name and place, and how its rest differs.

G_k = G_j C_k: the world rotation of SMPL joint k is that of the joint j it stands for, times a constant C_k that takes
SMPL's T-pose to the other skeleton's rest pose.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Array
from hoi.errors import InputError
from hoi.importers.roll import BACKWARDS, about, bending, roll, shortest_arcs, unit, untwist
from hoi.importers.shape import map_by_shape

ALIASES = {
    "hip": ("upleg", "upperleg", "thigh", "thighbend", "femur", "hip", "leg"),
    "knee": ("knee", "leg", "lowerleg", "lowleg", "shin", "calf", "tibia"),
    "ankle": ("ankle", "foot"),
    "foot": ("toebase", "toe", "toes", "ball", "foot"),
    "shoulder": ("arm", "upperarm", "uparm", "uarm", "humerus", "shldr", "shldrbend", "shoulder"),
    "elbow": ("elbow", "forearm", "forearmbend", "lowerarm", "lowarm", "farm", "radius"),
    "wrist": ("wrist", "hand"),
    "hand": ("hand",),
}
"""What skeletons call the joints of a limb, the clearest name first: of two that match, the earlier is taken, which
tells Mixamo's LeftShoulder, a collar, from Biovision's."""
NEEDED = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
SIDED = (
    r"(?P<side>left|right)[ _.-]?(?P<part>.+)", r"(?P<part>.+?)[ _.-]?(?P<side>left|right)",
    r"(?P<side>[lr])[ _.-](?P<part>.+)", r"(?P<part>.+)[ _.-](?P<side>[lr])",
    r"(?P<side>[lr])(?P<part>hipjoint|femur|tibia|foot|toes|clavicle|humerus|radius|wrist|hand|shldr|shin|thigh|forearm"
    r"|upleg|leg|arm|uarm|farm|collar|shoulder|elbow|knee|ankle|hip|toe|thighbend|shldrbend|forearmbend)",
)  # fmt: skip
"""How names tell left from right."""
LIMB_BONES = {"hip": "knee", "knee": "ankle", "shoulder": "elbow", "elbow": "wrist"}
"""Joints whose rest direction is taken over exactly; those of feet, collars and the trunk differ between skeletons
in where the joint lies, not in the pose."""
OTHER_BONES = {"collar": "shoulder", "ankle": "foot"}
STANDING = np.cos(np.radians(60))
"""A bone that is further than this from the T-pose's direction is not where a standing person has it."""
SPLIT = np.cos(np.radians(1))
"""A joint within a thigh or an upper arm that leads no further off the bone than this only twists it."""
TOES_BACKWARDS = -0.5
"""Cosine between where the toes point and where the person faces, of a skeleton in left-handed axes."""
ALIGNED = 0.9
"""Cosine above which the rest pose's body axes are taken to be the file's axes."""


def side_and_part(name: str) -> tuple[str, str]:
    """ "LeftUpLeg" -> ("left", "upleg"); "Spine1" -> ("", "spine")."""
    side, part = "", name
    for pattern in SIDED:
        if match := re.fullmatch(pattern, name, re.IGNORECASE):
            side, part = {"l": "left", "r": "right"}[match["side"][0].lower()], match["part"]
            break
    return side, re.sub(r"[^a-z0-9]", "", part.lower()).rstrip("0123456789")


def read_names(path: Path) -> dict[str, str]:
    """SMPL joint -> the file's, of a text of lines `left_knee = KnieL`; `#` begins a remark.

    Raises:
        InputError: it cannot be read, or a line is none of this kind.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"names: {path} cannot be read: {error}") from error
    said = {}
    for line in filter(None, (line.partition("#")[0].strip() for line in lines)):
        ours, _, theirs = (part.strip() for part in re.sub(r"\s*[=:]\s*", "=", line, count=1).partition("="))
        if ours not in JOINT_NAMES or not theirs:
            raise InputError(f"names: {path}: {line!r} must be JOINT = NAME with one of {', '.join(JOINT_NAMES)}")
        said[ours] = theirs
    return said


def map_joints(
    names: Sequence[str], parents: Sequence[int], rest: Array | None = None, given: Mapping[str, str] | None = None
) -> dict[int, int]:
    """SMPL joint -> joint that stands for it.

    Arms, legs and the head are found by name, or else by the shape of the skeleton at `rest`, (J, 3); the trunk by its
    place between them. `given` says of some by what name they go. Of a spine of more than three
    joints the first, the middle and the last count. Joints that SMPL has not, such as fingers, are left out.

    Raises:
        InputError: joints that no motion can do without are not found, or a limb's are not in a row.
    """
    found = _by_name(names)
    if given:
        unknown = [name for name in given.values() if name not in names]
        if unknown:
            raise InputError(f"names: the skeleton has no {', '.join(unknown)}; it has {', '.join(names)}")
        found |= {ours: names.index(theirs) for ours, theirs in given.items()}
    missing = [f"{side}_{part}" for part in NEEDED for side in ("left", "right") if f"{side}_{part}" not in found]
    if missing:
        told = f"no joint for {', '.join(missing)}"
        try:
            if rest is None or given:
                raise InputError("")
            found = map_by_shape(names, parents, rest)
        except InputError as error:
            why = f"; {error}" if str(error) else ""
            raise InputError(f"{told}{why}; the skeleton has {', '.join(names)}") from None

    def above(row: int) -> list[int]:
        """The joint and all it hangs on, from the root."""
        return [*above(parents[row]), row] if row >= 0 else []

    for side in ("left", "right"):
        for limb in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
            for first, second in pairwise(limb):
                if found[f"{side}_{first}"] not in above(found[f"{side}_{second}"])[:-1]:
                    said = " and ".join(names[found[f"{side}_{part}"]] for part in (first, second))
                    raise InputError(f"{said} were taken for {side}_{first} and {side}_{second}, but are not in a row")

    to_hips = [above(found[f"{side}_hip"]) for side in ("left", "right")]
    to_arms = [above(found[f"{side}_shoulder"])[:-1] for side in ("left", "right")]
    trunk = _common_start(to_arms)
    pelvis = _common_start([*to_hips, trunk])[-1:]
    spine = trunk[trunk.index(pelvis[0]) + 1 :] if pelvis else []
    if not spine:
        raise InputError(f"no joint for spine1 between the legs and the arms; the skeleton has {', '.join(names)}")
    found["pelvis"] = pelvis[0]
    if len(spine) > 1:
        found["spine1"] = spine[0]
    if len(spine) > 2:
        found["spine2"] = spine[len(spine) // 2]
    found["spine3"] = spine[-1]
    for side, path in zip(("left", "right"), to_arms, strict=True):
        if len(path) > len(trunk):
            found[f"{side}_collar"] = path[len(trunk)]
    if "head" not in found:  # what hangs above the arms, whatever it is called
        arms = {*to_arms[0], *to_arms[1], *found.values()}
        neck = [row for row, parent in enumerate(parents) if parent == spine[-1] and row not in arms]
        neck = [row for row in neck if not side_and_part(names[row])[0]]
        above_neck = [row for row, parent in enumerate(parents) if [parent] == neck]
        if above_neck:
            found["head"] = above_neck[0]
    if "head" in found:
        to_head = above(found["head"])
        if spine[-1] in to_head[:-2]:
            found["neck"] = to_head[to_head.index(spine[-1]) + 1]
    return {JOINT_NAMES.index(name): row for name, row in found.items()}


def named(names: Sequence[str]) -> bool:
    """Whether the names alone tell which joint is which."""
    found = _by_name(names)
    return all(f"{side}_{part}" in found for part in NEEDED for side in ("left", "right"))


def _by_name(names: Sequence[str]) -> dict[str, int]:
    """SMPL joint name -> joint, of the limbs and the head, as far as names tell."""
    plain = [name.rpartition(":")[2] for name in names]
    prefix, suffix = _common_start(plain), _common_start([name[::-1] for name in plain])[::-1]  # "Bip01", "_JNT"
    suffix = suffix if re.fullmatch(r"[_. -].+", suffix) else ""
    parts = [side_and_part(name.removeprefix(prefix).removesuffix(suffix).strip(" _.-")) for name in plain]
    numbered = [re.search(r"\d", name.removeprefix(prefix)) is not None for name in plain]
    found: dict[str, int] = {}

    def rows(side: str, alias: str) -> list[int]:
        """Those without a number first."""
        return sorted((row for row, part in enumerate(parts) if part == (side, alias)), key=lambda row: numbered[row])

    for side in ("left", "right"):
        for part, aliases in ALIASES.items():
            matches = [rows(side, alias)[0] for alias in aliases if rows(side, alias)]
            row = next((row for row in matches if row not in found.values()), None)
            if row is not None:
                found[f"{side}_{part}"] = row
    if heads := rows("", "head"):
        found["head"] = heads[0]
    return found


def _common_start(rows: Sequence[Any]) -> Any:
    """What all of some strings or lists begin with."""
    same = [len(set(column)) == 1 for column in zip(*rows, strict=False)]
    return rows[0][: [*same, False].index(False)]


def retarget(
    names: Sequence[str],
    parents: Sequence[int],
    rest_positions: Array,
    rotations: Array,
    positions: Array,
    rest_joints: Array,
    joints: dict[int, int] | None = None,
) -> tuple[Array, Array, tuple[str, ...]]:
    """The motion of another skeleton on ours, in the other's axes.

    Its path is scaled by the length of the legs, whatever its unit. Where its rest pose is no standing person's (some
    skeletons lay every bone along one axis), how a limb is turned about its own axis is told by how its knee or elbow
    bends (`hoi.importers.roll`); where that does not tell it is taken to be unturned on average.

    Args:
        names: of J joints.
        parents: of the joints, -1 for the root.
        rest_positions: joints where all rotations are the identity, (J, 3).
        rotations: world rotations of the joints, (F, J, 3, 3).
        positions: of the joints, in the unit of `rest_positions`, (F, J, 3).
        rest_joints: T-pose joints of our body [m], (24, 3).
        joints: of `map_joints`; None finds them.

    Returns:
        Local rotations (F, 24, 3, 3), the path of our pelvis joint [m], (F, 3), and what was done about such turns.

    Raises:
        InputError: as `map_joints`, or the skeleton has no extent.
    """
    joints = map_joints(names, parents, rest_positions) if joints is None else joints
    ours = np.asarray(rest_joints, np.float64)
    theirs = {joint: rest_positions[row] for joint, row in joints.items()}
    lengths = [_leg_length(theirs), _leg_length(dict(enumerate(ours)))]
    if not lengths[0] > 0:
        raise InputError("the legs of the skeleton have no length")
    body = _body_axes(theirs)

    def directions(joint: int, child: int) -> tuple[Array, Array]:
        """Of the bone in the T-pose and in the other's rest pose, both in SMPL's rest frame."""
        return unit(ours[child] - ours[joint]), unit(body.T @ (theirs[child] - theirs[joint]))

    def whole_turn(joint: int, child: int) -> Array:
        """World rotations of a bone, of the last of its joints where one bends and others twist."""
        last = parents[joints[child]]
        turn = rotations[:, last]
        rest_bone = unit(theirs[child] - theirs[joint])
        bone = unit(positions[:, joints[child]] - positions[:, joints[joint]])
        along = ((turn @ rest_bone) * bone).sum(-1).min() > SPLIT
        return turn if along else rotations[:, joints[joint]]

    bones = {
        JOINT_NAMES.index(f"{side}_{part}"): JOINT_NAMES.index(f"{side}_{end}")
        for part, end in (LIMB_BONES | OTHER_BONES).items()
        for side in ("left", "right")
    }
    legs = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee")]
    standing = all(np.dot(*directions(joint, bones[joint])) > STANDING for joint in legs)

    world = np.empty((len(rotations), JOINT_COUNT, 3, 3))
    local = np.empty_like(world)
    corrections: dict[int, Array] = {}
    notes: list[str] = []
    unknown: list[str] = []
    backwards: list[int] = []
    told = False
    for joint, parent in enumerate(PARENTS):
        name = JOINT_NAMES[joint].partition("_")[2]
        toes = name == "foot" and not standing  # where their rest lies is not known
        if joint not in joints or toes:
            local[:, joint] = np.eye(3)
            world[:, joint] = world[:, parent]
            continue
        turn = rotations[:, joints[joint]]
        if name in ("hip", "shoulder") and bones[joint] in joints:
            turn = whole_turn(joint, bones[joint])
        correction = corrections.get(parent, body) if name in ("wrist", "hand", "foot") else body
        child = bones.get(joint, -1)
        if child in joints:
            tpose, rest = directions(joint, child)
            odd = not standing and tpose @ rest < STANDING
            if odd or name in LIMB_BONES:
                correction = body @ shortest_arcs(tpose, rest)
            elif name == "ankle":  # at rest the foot stands on the ground, or is spread with the leg
                leans = (body, corrections[parent])
                correction = min(leans, key=lambda axes: abs((axes.T @ body @ rest - tpose)[0]))
            raised = name in ("shoulder", "elbow") and tpose @ rest < STANDING and rest[1] > -STANDING
            bends = None
            if name in LIMB_BONES:
                other = child if name in ("hip", "shoulder") else parent
                bone = unit(positions[:, joints[bones[other]]] - positions[:, joints[other]])
                bends = roll(bending(tpose, name, (bone[:, None] @ turn @ correction)[:, 0]))
            if odd or raised:
                told = told or (raised and bends is not None)
                if bends is None:
                    unknown.append(JOINT_NAMES[joint])
                    bends = untwist(world[:, parent].mT @ turn @ correction, tpose) if odd else 0.0
                correction = correction @ about(tpose, bends)
            elif name == "hip" and bends is not None and abs(bends) > BACKWARDS:
                backwards.append(joint)
        corrections[joint] = correction
        world[:, joint] = turn @ correction
        local[:, joint] = world[:, joint] if parent < 0 else world[:, parent].mT @ world[:, joint]

    if len(backwards) == 2:
        notes.append("both knees bend backwards: the file may be mirrored, or its legs taken for each other's")
    if told:
        notes.append("its arms are raised at rest: how they are turned about themselves is told by how the elbows bend")
    if unknown:
        notes.append(f"turned about themselves as little as may be, where bends do not tell: {', '.join(unknown)}")
    hips = [JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("right_hip")]
    centre = positions[:, [joints[hip] for hip in hips]].mean(axis=1) * (lengths[1] / lengths[0])
    return local, centre - world[:, 0] @ hips_from_pelvis(ours), tuple(notes)


def is_standing(joints: dict[int, int], rest_positions: Array, rest_joints: Array) -> bool:
    """Whether the legs at rest are where a standing person has them."""
    theirs = {joint: rest_positions[row] for joint, row in joints.items()}
    body = _body_axes(theirs)
    for name, child in (("hip", "knee"), ("knee", "ankle")):
        for side in ("left", "right"):
            first, second = (JOINT_NAMES.index(f"{side}_{part}") for part in (name, child))
            bone = unit(np.asarray(rest_joints[second] - rest_joints[first], np.float64))
            if bone @ unit(body.T @ (theirs[second] - theirs[first])) <= STANDING:
                return False
    return True


def is_mirrored(joints: dict[int, int], rest_positions: Array) -> bool:
    """Whether the toes point backwards at rest, by where left and right are: the file's axes are left-handed."""
    theirs = {joint: rest_positions[row] for joint, row in joints.items()}
    body = _body_axes(theirs)
    toes = [
        theirs[JOINT_NAMES.index(f"{side}_foot")] - theirs[JOINT_NAMES.index(f"{side}_ankle")]
        for side in ("left", "right")
        if {JOINT_NAMES.index(f"{side}_foot"), JOINT_NAMES.index(f"{side}_ankle")} <= theirs.keys()
    ]
    if not toes or not np.any(toes):
        return False
    return bool(unit(np.sum(toes, axis=0)) @ body[:, 2] < TOES_BACKWARDS)


def hips_from_pelvis(rest_joints: Array) -> Array:
    """Middle of our hips from the pelvis joint in the T-pose [m], (3,)."""
    joints = np.asarray(rest_joints, np.float64)
    return (joints[JOINT_NAMES.index("left_hip")] + joints[JOINT_NAMES.index("right_hip")]) / 2 - joints[0]


def leg_bones(rest_joints: Array) -> float:
    """Thigh and shin of our skeleton [m], both sides' mean."""
    return _leg_length(dict(enumerate(np.asarray(rest_joints, np.float64))))


def _leg_length(places: dict[int, Array]) -> float:
    names = (("left_hip", "left_knee", "left_ankle"), ("right_hip", "right_knee", "right_ankle"))
    rows = [[places[JOINT_NAMES.index(name)] for name in leg] for leg in names]
    return float(np.linalg.norm(np.diff(rows, axis=1), axis=-1).sum(axis=1).mean())


def _body_axes(rest: dict[int, Array]) -> Array:
    """Left, up and forward of the rest pose as columns: from SMPL's rest frame to the other skeleton's."""

    def middle(part: str) -> Array:
        return (rest[JOINT_NAMES.index(f"left_{part}")] + rest[JOINT_NAMES.index(f"right_{part}")]) / 2

    left = unit(rest[JOINT_NAMES.index("left_hip")] - rest[JOINT_NAMES.index("right_hip")])
    up = middle("shoulder") - middle("hip")
    up = unit(up - (up @ left) * left)
    axes = np.stack([left, up, np.cross(left, up)], axis=1)
    if not np.isfinite(axes).all():
        raise InputError("the hips of the skeleton are in one place, or its shoulders are between them")
    return np.rint(axes) if (np.abs(axes).max(axis=0) > ALIGNED).all() else axes
