"""How a limb is turned about its own axis, which places of joints and rest poses do not show: its bends tell.

Knees and elbows are hinges: in the frame of a thigh whose T-pose points down the shin goes backwards, in that of an
upper arm to the side the forearm goes forwards.
"""

import numpy as np
import roma
import torch
from numpy.typing import NDArray

from hoi.data import Array

HINGES = {"hip": (0.0, 0.0, -1.0), "knee": (0.0, 0.0, 1.0), "shoulder": (0.0, 0.0, 1.0), "elbow": (0.0, 0.0, -1.0)}
"""Where the other bone of its knee or elbow goes when that bends, in the T-pose frame of a limb's bone."""
SURE = 0.85
"""Share of the bends that go the same way, above which they tell how a bone is turned."""
BENT = 0.03
"""Mean square of the sine of bends that tell it."""
BACKWARDS = np.radians(135)
"""A thigh that would have to be turned by more for its knee to bend as knees do has a knee that bends backwards."""


def unit(vectors: Array, otherwise: Array | float = 0.0) -> Array:
    """Of unit length; `otherwise` where there is none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-9), otherwise)


def bending(bone: Array, name: str, other: Array) -> NDArray[np.complex128]:
    """How far a hinge bends and which way: complex (F,), square of the sine of the bend and angle about `bone`.

    Args:
        bone: its T-pose direction, (3,).
        name: of `HINGES`.
        other: unit directions of the other bone in the frame of this one, (F, 3).
    """
    bend = np.array(HINGES[name])
    bend = unit(bend - (bend @ bone) * bone)
    along, across = other @ bend, other @ np.cross(bone, bend)
    return np.hypot(along, across) * (along + 1j * across)


def roll(bends: NDArray[np.complex128]) -> float | None:
    """The angle about the bone that makes bends (F,) of `bending` those of a person; None where they do not tell."""
    total = np.abs(bends).sum()
    if total < BENT * len(bends) or np.abs(bends.sum()) < SURE * total:
        return None
    return float(np.angle(bends.sum()))


def about(bone: Array, angles: Array | float) -> Array:
    """Turns about a bone by angles (...,): (..., 3, 3)."""
    return roma.rotvec_to_rotmat(torch.from_numpy(np.asarray(angles, np.float64)[..., None] * bone)).numpy()


def shortest_arcs(start: Array, ends: Array) -> Array:
    """The least rotations (..., 3, 3) that take one unit vector to others (..., 3); half a turn about any axis where
    they are opposite."""
    cosine, across = ends @ start, np.cross(start, ends)
    sine = np.linalg.norm(across, axis=-1)
    opposite = np.where(cosine < 0, np.pi, 0.0)[..., None] * unit(np.cross(start, np.eye(3)[np.abs(start).argmin()]))
    turn = np.where((sine > 1e-9)[..., None], unit(across) * np.arctan2(sine, cosine)[..., None], opposite)
    return roma.rotvec_to_rotmat(torch.from_numpy(turn)).numpy()


def untwist(local: Array, axis: Array) -> float:
    """The angle about `axis` after which rotations (F, 3, 3) have no twist about it on average (swing-twist)."""
    xyzw = roma.rotmat_to_unitquat(torch.from_numpy(np.ascontiguousarray(local))).numpy()
    half = np.stack([xyzw[:, 3], xyzw[:, :3] @ axis])  # cosine and sine of half the twist, shrunk by the swing's
    cosine, sine = (half[0] ** 2 - half[1] ** 2).sum(), (2 * half[0] * half[1]).sum()
    return float(-np.arctan2(sine, cosine))
