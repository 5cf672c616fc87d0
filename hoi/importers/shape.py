"""Which joint is which by the tree and its rest pose, where names do not tell: two legs, two arms, a trunk, a head.

Legs and arms are pairs of branches with bones of the same lengths; legs hang on the pelvis, arms on the trunk above it.
Left and right are told by the names' sides in some languages, or else by where the toes point.
"""

import re
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hoi.data import Array
from hoi.errors import InputError

ALIKE = 0.1
"""Bones of two sides differ by less than this [of their length]."""
LONG = 0.6
"""Bones of an upper arm or thigh are at least so long [of the longest of their limb]."""
PART, IN_LINE = 0.3, np.cos(np.radians(12))
"""A bone at least so long [of the next], and in line with it, is the upper part of a thigh."""
BENT = np.cos(np.radians(35))
"""A foot turns away from the shin by more than this."""
SIDES = {
    "left": r"left|links?|gauche|izquierd[ao]|izq|sinistr[ao]|esquerd[ao]|lew[ya]|左|왼쪽|лев\w*|(?<![a-z])l(?![a-z])",
    "right": r"right|rechts?|droite?|derech[ao]|destr[ao]|direit[ao]|praw[ya]|右|오른쪽|прав\w*|(?<![a-z])r(?![a-z])",
}
"""How languages call them."""


def map_by_shape(names: Sequence[str], parents: Sequence[int], rest: Array) -> dict[str, int]:
    """SMPL joint name -> joint, of arms, legs and head; the trunk follows from them.

    Args:
        rest: joints at rest, in any unit and axes, (J, 3).

    Raises:
        InputError: the tree has no two legs and two arms, or which is left cannot be told.
    """
    children = [[row for row, parent in enumerate(parents) if parent == above] for above in range(len(parents))]

    def main_line(row: int) -> list[int]:
        """From a joint down its longest branch."""
        lines = [main_line(child) for child in children[row]]
        return [row, *max(lines, key=lambda line: length([row, *line]), default=[])]

    def length(line: Sequence[int]) -> float:
        return float(np.linalg.norm(np.diff(rest[list(line)], axis=0), axis=1).sum())

    def alike(first: list[int], second: list[int]) -> bool:
        lengths = [np.linalg.norm(np.diff(rest[line], axis=0), axis=1) for line in (first, second)]
        if len(lengths[0]) != len(lengths[1]) or len(lengths[0]) < 2:
            return False
        return bool(np.abs(lengths[0] - lengths[1]).max() < ALIKE * max(length(first), length(second)))

    def below(row: int) -> set[int]:
        return {row, *(joint for child in children[row] for joint in below(child))}

    pairs = [
        (above, first, second)
        for above in range(len(parents))
        for first, second in combinations([main_line(child) for child in children[above]], 2)
        if alike(first, second)
    ]
    found = []
    for hips, *legs in pairs:
        for chest, *arms in pairs:
            own = below(legs[0][0]) | below(legs[1][0])
            if chest != hips and chest in below(hips) - own and len(legs[0]) >= 3 and len(arms[0]) >= 3:
                found.append((length(legs[0]) + length(arms[0]), legs, arms, chest))
    if not found:
        raise InputError("its tree has no two legs and, above them, two arms whose bones are alike")
    _, legs, arms, chest = max(found, key=lambda each: each[0])
    limbs = [_leg(line, rest) for line in legs], [_arm(line, rest, children) for line in arms]
    up = rest[arms[0][0]] + rest[arms[1][0]] - rest[legs[0][0]] - rest[legs[1][0]]
    toes = [rest[leg["foot"]] - rest[leg["ankle"]] for leg in limbs[0] if "foot" in leg]
    forward = np.sum(toes, axis=0) if toes else np.zeros(3)
    joints: dict[str, int] = {}
    for pair in limbs:
        first = _first_is_left(pair, names, rest, up, forward)
        for side, limb in zip(("left", "right") if first else ("right", "left"), pair, strict=True):
            joints |= {f"{side}_{part}": row for part, row in limb.items()}
    others = [child for child in children[chest] if child not in (arms[0][0], arms[1][0])]
    if others:
        line = main_line(max(others, key=lambda child: float((rest[child] - rest[chest]) @ up)))
        joints["head"] = line[min(1, len(line) - 1)]
    return joints


def _straight(first: Array, second: Array) -> bool:
    return bool(first @ second > IN_LINE * np.linalg.norm(first) * np.linalg.norm(second))


def _leg(line: list[int], rest: Array) -> dict[str, int]:
    """Hip, knee, ankle and, where there is one, foot."""
    bones = np.diff(rest[line], axis=0)
    lengths = np.linalg.norm(bones, axis=1)
    hip = int(np.argmax(lengths >= LONG * lengths.max()))
    while hip and lengths[hip - 1] > PART * lengths[hip] and _straight(bones[hip - 1], bones[hip]):
        hip -= 1  # of a thigh that is split
    knee = hip + 1
    ankle = knee + 1
    if ankle >= len(line):
        raise InputError("a leg has no ankle")
    for at in range(knee + 1, len(bones)):
        if lengths[at] > 0 and bones[at] @ bones[at - 1] < BENT * lengths[at] * lengths[at - 1]:
            ankle = at
            break
    between = range(hip + 1, ankle)
    reach = [abs(lengths[hip:at].sum() - lengths[at:ankle].sum()) for at in between]
    knee = between[int(np.argmin(reach))]
    leg = {"hip": line[hip], "knee": line[knee], "ankle": line[ankle]}
    return leg | ({"foot": line[ankle + 1]} if ankle + 1 < len(line) else {})


def _arm(line: list[int], rest: Array, children: Sequence[Sequence[int]]) -> dict[str, int]:
    """Shoulder, elbow and wrist, and where there is one the hand.

    Where fingers tell the wrist, bones may be split: upper arm and forearm are as long as each other.
    """
    lengths = np.linalg.norm(np.diff(rest[line], axis=0), axis=1)
    shoulder = int(np.argmax(lengths >= LONG * lengths.max()))
    elbow, wrist = shoulder + 1, shoulder + 2
    fingers = max(range(2, len(line)), key=lambda at: (len(children[line[at]]), at))
    if len(children[line[fingers]]) > 1:
        wrist = fingers
        shoulder, elbow = min(
            combinations(range(wrist), 2),
            key=lambda pair: abs(np.log(lengths[pair[0] : pair[1]].sum() / lengths[pair[1] : wrist].sum())),
        )
    if wrist >= len(line):
        raise InputError("an arm has no wrist")
    arm = {"shoulder": line[shoulder], "elbow": line[elbow], "wrist": line[wrist]}
    return arm | ({"hand": line[wrist + 1]} if wrist + 1 < len(line) else {})


def _first_is_left(
    pair: Sequence[dict[str, int]], names: Sequence[str], rest: Array, up: Array, forward: Array
) -> bool:
    """Whether the first limb of a pair is the left one.

    Raises:
        InputError: neither names nor toes tell.
    """
    said = [{side_in(names[row]) for row in limb.values()} - {""} for limb in pair]
    if len(said[0]) == len(said[1]) == 1 and said[0] != said[1]:
        return said[0] == {"left"}
    left = np.cross(up, forward - (forward @ up) * up / (up @ up))
    across = rest[next(iter(pair[0].values()))] - rest[next(iter(pair[1].values()))]
    if abs(float(across @ left)) < 0.3 * float(np.linalg.norm(across) * np.linalg.norm(left)) or not left.any():
        raise InputError("which side is left cannot be told: neither names nor toes say so")
    return float(across @ left) > 0


def side_in(name: str) -> str:
    """ "left", "right" or nothing, by the words of some languages."""
    spread = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[LR])(?=[A-Z][a-z])", "_", name).lower().replace("_", " ")
    found = [side for side, words in SIDES.items() if re.search(words, spread)]
    return found[0] if len(found) == 1 else ""
