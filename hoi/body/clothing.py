"""Colours for the people in the package: skin, hair, face and clothes by where a point lies on the T-pose.

Colours are display RGB in [0, 1], as in captured splats. Lengths are given for a head or body of the man's size and
scale with the person.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array

RGB = tuple[float, float, float]

LIGHT, TAN, BROWN, PALE = (0.87, 0.68, 0.57), (0.76, 0.56, 0.43), (0.48, 0.32, 0.24), (0.90, 0.75, 0.67)
EYE_WHITE: RGB = (0.93, 0.92, 0.90)
MAN_HEIGHT = 1.745
MAN_HEAD = 0.105
"""Eyes to crown of the man [m]."""


@dataclass(frozen=True)
class Outfit:
    """What a person wears."""

    skin: RGB
    hair: RGB
    shirt: RGB
    trousers: RGB
    shoes: RGB
    iris: RGB = (0.25, 0.17, 0.11)
    sole: RGB = (0.88, 0.87, 0.84)
    socks: RGB = (0.90, 0.90, 0.90)
    sleeve: float = 0.55
    """How far the sleeves go from shoulder (0) to elbow (1) to wrist (2)."""
    trouser_leg: float = 2.0
    """How far the trousers go from hip (0) to knee (1) to ankle (2)."""
    hair_thickness: float = 0.010
    """[m]"""
    nape: float = 0.085
    """How far below the eyes the hair ends at the back [m]."""


OUTFITS = {
    "man": Outfit(LIGHT, (0.22, 0.14, 0.09), (0.16, 0.36, 0.62), (0.20, 0.22, 0.28), (0.55, 0.30, 0.16)),
    "woman": Outfit(
        TAN, (0.12, 0.08, 0.06), (0.75, 0.22, 0.26), (0.17, 0.25, 0.42), (0.85, 0.83, 0.80),
        sleeve=0.4, hair_thickness=0.016, nape=0.13,
    ),
    "child": Outfit(
        PALE, (0.62, 0.42, 0.20), (0.95, 0.75, 0.18), (0.25, 0.45, 0.32), (0.80, 0.20, 0.18),
        iris=(0.22, 0.38, 0.55), trouser_leg=0.8, hair_thickness=0.012,
    ),
    "athlete": Outfit(
        BROWN, (0.06, 0.05, 0.05), (0.86, 0.28, 0.10), (0.10, 0.10, 0.13), (0.92, 0.92, 0.92),
        sole=(0.86, 0.28, 0.10), sleeve=0.3, trouser_leg=0.65, hair_thickness=0.004, nape=0.07,
    ),
    "heavy": Outfit(
        LIGHT, (0.40, 0.24, 0.13), (0.27, 0.47, 0.36), (0.36, 0.31, 0.26), (0.15, 0.13, 0.12),
        sole=(0.30, 0.28, 0.26), sleeve=0.8, hair_thickness=0.008,
    ),
    "senior": Outfit(
        PALE, (0.80, 0.79, 0.77), (0.55, 0.45, 0.62), (0.45, 0.43, 0.42), (0.30, 0.20, 0.16),
        iris=(0.35, 0.42, 0.45), sole=(0.35, 0.27, 0.22), sleeve=1.9, hair_thickness=0.014, nape=0.10,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Face:
    """Landmarks that hair and features are placed by, in the rest frame."""

    left_eye: Array
    """Centre of the left eye's visible front [m], shape (3,); the right eye mirrors it."""
    crown: float
    """Highest point of the head [m]."""
    back: float
    """z of the rearmost point of the head above the eyes [m]."""

    @property
    def scale(self) -> float:
        """Size of this head over the man's."""
        return float(self.crown - self.left_eye[1]) / MAN_HEAD


def find_face(vertices: Array, faces: NDArray[np.integer], regions: NDArray[np.str_]) -> Face:
    """Measures the face of a T-posed mesh: vertices (V, 3), faces (F, 3) and the region of each face (F,)."""
    eyes = vertices[np.unique(faces[regions == "eye"])]
    head = vertices[np.unique(faces[regions == "head"])]
    left = eyes[eyes[:, 0] > 0]
    centre = np.array([left[:, 0].mean(), left[:, 1].mean(), left[:, 2].max()])
    return Face(centre, float(head[:, 1].max()), float(head[head[:, 1] > centre[1], 2].min()))


def hair(points: Array, regions: NDArray[np.str_], face: Face, outfit: Outfit) -> NDArray[np.bool_]:
    """Which points (N, 3) carry hair: above a line from the forehead past the ears down to the nape."""
    depth = (points[:, 2] - face.back) / (face.left_eye[2] - face.back)
    height = (points[:, 1] - face.left_eye[1]) / face.scale
    lowest = np.interp(depth, [0.30, 0.42, 0.52, 0.62, 0.78, 1.0], [-outfit.nape, -0.03, -0.015, 0.025, 0.055, 0.068])
    return np.isin(regions, ("head", "face")) & (height > lowest)


def paint(points: Array, regions: NDArray[np.str_], rest_joints: Array, face: Face, outfit: Outfit) -> Array:
    """Albedo as shown, RGB (N, 3), of surface points (N, 3) of a T-posed person."""
    joints: dict[str, Array] = dict(zip(JOINT_NAMES, rest_joints, strict=True))
    scale = float(face.crown - points[:, 1].min()) / MAN_HEIGHT
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    colours = np.empty_like(points)
    colours[:] = outfit.skin

    body = regions == "body"
    arm = np.interp(x, [joints[f"left_{part}"][0] for part in ("shoulder", "elbow", "wrist")], [0, 1, 2])
    leg = np.interp(-y, [-joints[f"left_{part}"][1] for part in ("hip", "knee", "ankle")], [0, 1, 2])
    neckline = joints["neck"] + np.array([0.0, 0.01, 0.02]) * scale
    collar = np.linalg.norm((points - neckline) / [1.0, 1.2, 1.0], axis=1) < 0.085 * scale
    waist = joints["spine1"][1] - 0.02 * scale
    ankle = joints["left_ankle"][1]
    shoe_top = ankle + 0.015 * scale
    torso = body & (y > waist)
    colours[torso & (arm <= outfit.sleeve) & ~collar] = outfit.shirt
    colours[body & (y <= waist) & (leg <= outfit.trouser_leg)] = outfit.trousers
    colours[body & (leg > outfit.trouser_leg) & (y < shoe_top + 0.05 * scale)] = outfit.socks
    colours[body & (y < shoe_top)] = outfit.shoes
    colours[body & (y < points[:, 1].min() + 0.010 * scale)] = outfit.sole

    aside = np.abs(x - face.left_eye[0]) / face.scale
    above = (y - face.left_eye[1]) / face.scale
    brow = (np.abs(above - 0.021) < 0.0035) & (aside < 0.017) & (z > face.left_eye[2] - 0.035 * face.scale)
    eye = regions == "eye"
    colours[regions == "lips"] = np.multiply(outfit.skin, (0.80, 0.58, 0.58))
    colours[(regions == "face") & brow] = np.multiply(0.7, outfit.hair) + np.multiply(0.3, outfit.skin)
    colours[eye | (regions == "eyelids")] = np.multiply(outfit.skin, (0.62, 0.55, 0.52))
    colours[eye & (aside < 0.012) & (np.abs(above) < 0.0045)] = EYE_WHITE
    colours[eye & (np.hypot(aside, above) < 0.0065)] = outfit.iris
    colours[hair(points, regions, face, outfit)] = outfit.hair
    return colours
