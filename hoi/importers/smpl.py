"""People from the user's own SMPL file (Loper et al. 2015): a shape by betas, Gaussians on its skin, pose blend shapes.

Files are SMPL's own, neutral, male or female, as `.npz` or `.pkl` (`hoi.importers.unpickle`). SMPL-H and SMPL-X have
the same first 22 joints; their fingers move with the hand, jaw and eyes with the head. Rest frame as SMPL's, the pelvis
joint at the origin.

All of these models are licensed for non-commercial research, without redistribution: what is made of them here says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.body.avatar import LICENCE_MARK
from hoi.body.clothing import MAN_HEAD, MAN_HEIGHT, OUTFITS, Face
from hoi.body.people import MIN_GAUSSIANS, dress, sample_surface, vertex_normals
from hoi.body.skeleton import JOINT_NAMES, PARENTS, POSE_FEATURES
from hoi.data import Array, Body
from hoi.errors import InputError
from hoi.importers.unpickle import read_arrays

LICENCE = "SMPL body model licence: non-commercial research, no redistribution"
KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")
BODY_JOINTS = 22
"""The joints that SMPL, SMPL-H and SMPL-X share."""
ROW_SUM_TOLERANCE = 1e-2
HEIGHTS = (0.3, 4.0)
"""What a person may measure in the T-pose [m]: beyond, units or betas are wrong."""
EYE_APART, EYE_SIZE, MOUTH_BELOW, MOUTH_SIZE = 0.031, (0.014, 0.0065), 0.070, (0.022, 0.007)
"""Where eyes and mouth of a head of the man's size are painted [m]: SMPL's files do not say."""


@dataclass(frozen=True)
class Family:
    """How the joints of a body model become SMPL's 24."""

    name: str
    head: tuple[int, ...]
    """Joints that move with the head."""
    hands: tuple[range, range]
    """The finger joints of the left and of the right hand."""
    knuckle: int
    """Which of a hand's joints stands for the hand: the middle finger's first."""
    shapes: dict[int, int]
    """Directions in the file -> how many of them are of the shape, where it is not all; the rest is expression."""


FAMILIES = {
    24: Family("SMPL", (), (range(22, 23), range(23, 24)), 0, {}),
    52: Family("SMPL-H", (), (range(22, 37), range(37, 52)), 3, {}),
    55: Family("SMPL-X", (22, 23, 24), (range(25, 40), range(40, 55)), 3, {20: 10, 400: 300}),
}
"""Joints in the file -> what it is."""


@dataclass(frozen=True)
class SmplModel:
    """A body model with SMPL's 24 joints."""

    family: str
    template: Array
    """T-posed vertices at betas 0 [m], (V, 3)."""
    shape_directions: Array
    """[m], (V, 3, S)."""
    pose_directions: Array
    """See `hoi.data.Body`, (V, 3, 207)."""
    joint_regressor: Array
    """(24, V)."""
    weights: Array
    """w, (V, 24)."""
    faces: NDArray[np.intp]
    """(F, 3)."""

    def shaped(self, betas: Sequence[float]) -> tuple[Array, Array]:
        """Vertices (V, 3) and joints (24, 3) of a shape, T-posed [m], in the model's own frame.

        Raises:
            InputError: more betas than the file has, one that is not finite, or no person's height.
        """
        count = self.shape_directions.shape[2]
        if len(betas) > count:
            raise InputError(f"betas: {len(betas)} given; this {self.family} file has {count}")
        if not np.isfinite(betas).all():
            raise InputError(f"betas={list(betas)}: must be finite")
        vertices = self.template + self.shape_directions[:, :, : len(betas)] @ np.array(betas, np.float64)
        height = float(np.ptp(vertices[:, 1]))
        low, high = HEIGHTS
        if not low <= height <= high:
            raise InputError(
                f"betas={list(betas)}: the person would be {height:.3g} m tall; must be {low:g} to {high:g}"
            )
        return vertices, self.joint_regressor @ vertices


def load_smpl(
    path: Path,
    betas: Sequence[float] = (),
    gaussians: int = 26000,
    seed: int = 0,
    outfit: str = "man",
    pose_correctives: bool = True,
) -> Body:
    """A person of the shape `betas` (those left out are 0), in the clothes of one of the people in the package.

    Args:
        path: SMPL, SMPL-H or SMPL-X, `.npz` or `.pkl`.
        gaussians: how many to cover the skin with.
        seed: of the sampling.
        outfit: a key of `hoi.body.clothing.OUTFITS`.
        pose_correctives: whether to keep the pose blend shapes.

    Raises:
        InputError: the file is broken or of another kind, unknown outfit, too few Gaussians, impossible betas.
    """
    if outfit not in OUTFITS:
        raise InputError(f"person={outfit!r}: no such outfit; choose one of {', '.join(OUTFITS)}")
    if gaussians < MIN_GAUSSIANS:
        raise InputError(f"gaussians={gaussians}: must be at least {MIN_GAUSSIANS}")
    model = read_smpl(path)
    vertices, joints = model.shaped(betas)
    vertices, joints = vertices - joints[0], joints - joints[0]

    rng = np.random.default_rng(seed)
    regions = regions_of(model, vertices)
    landmarks = guess_face(path, vertices, model.weights)
    face, barycentric = sample_surface(vertices, model.faces, regions, gaussians, rng)
    corners = model.faces[face]

    def at_samples(values: Array) -> Array:
        return sum(barycentric[:, [corner]] * values[corners[:, corner]] for corner in range(3))  # pyright: ignore

    points = at_samples(vertices)
    normals = at_samples(vertex_normals(vertices, model.faces))
    cloud = dress(points, normals, draw_face(points, regions[face], landmarks), joints, landmarks, OUTFITS[outfit], rng)
    weights = at_samples(model.weights)
    directions = None
    if pose_correctives:
        flat = model.pose_directions.reshape(len(vertices), -1).astype(np.float32)
        directions = at_samples(flat).astype(np.float16).reshape(gaussians, 3, POSE_FEATURES)
    return Body(
        path.stem,
        cloud,
        (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        joints.astype(np.float32),
        f"{model.family}, {path.name}, betas {[round(float(beta), 4) for beta in betas]}{LICENCE_MARK}{LICENCE}",
        directions,
    )


# --- reading ---------------------------------------------------------------------------------------------------------


def read_smpl(path: Path) -> SmplModel:
    """Read and check a model file.

    Raises:
        InputError: the file cannot be read, lacks a key, or its arrays contradict each other; names file and key.
    """
    path = Path(path)
    arrays = read_arrays(path, KEYS)
    missing = [key for key in KEYS if key not in arrays]
    if missing:
        raise InputError(f"{path}: {', '.join(missing)}: missing; not an SMPL model file")
    for key, array in arrays.items():
        if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
            raise InputError(f"{path}: {key}: {array.dtype}; must be finite numbers")

    vertices, joints = len(arrays["v_template"]), arrays["weights"].shape[-1]
    if joints not in FAMILIES:
        known = ", ".join(f"{count} ({family.name})" for count, family in FAMILIES.items())
        raise InputError(f"{path}: weights: {joints} joints; must be {known}")
    family = FAMILIES[joints]
    shapes = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, -1),
        "posedirs": (vertices, 3, 9 * (joints - 1)),
        "J_regressor": (joints, vertices),
        "weights": (vertices, joints),
        "kintree_table": (2, joints),
        "f": (-1, 3),
    }
    for key, shape in shapes.items():
        given = arrays[key].shape
        if len(given) != len(shape) or any(want not in (-1, have) for want, have in zip(shape, given, strict=True)):
            raise InputError(f"{path}: {key}: shape {given}; must be {str(shape).replace('-1', 'any')}")
    faces, weights = arrays["f"].astype(np.intp), arrays["weights"].astype(np.float64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= vertices:
        raise InputError(f"{path}: f: must be triangles of the {vertices} vertices")
    if weights.min() < -1e-6 or np.abs(weights.sum(axis=1) - 1).max() > ROW_SUM_TOLERANCE:
        raise InputError(f"{path}: weights: must not be negative, and each row must sum to 1")
    _check_tree(path, arrays["kintree_table"][0], family)

    shape_directions = arrays["shapedirs"].astype(np.float64)
    return SmplModel(
        family=family.name,
        template=arrays["v_template"].astype(np.float64),
        shape_directions=shape_directions[:, :, : family.shapes.get(shape_directions.shape[2])],
        pose_directions=_pose_directions(arrays["posedirs"]),
        joint_regressor=arrays["J_regressor"][_kept_joints(family)].astype(np.float64),
        weights=_collapsed(weights, family),
        faces=faces,
    )


def _check_tree(path: Path, parents: NDArray[Any], family: Family) -> None:
    """Files keep the root's parent as -1 or as the largest unsigned integer, so that it is not looked at."""
    kept = _kept_joints(family)
    expected = [kept[parent] for parent in PARENTS[1:]]
    if parents[kept[1:]].tolist() != expected:
        raise InputError(f"{path}: kintree_table: parents {parents[kept[1:]].tolist()}; {family.name}'s are {expected}")


def _kept_joints(family: Family) -> list[int]:
    return [*range(BODY_JOINTS), *(hand[family.knuckle] for hand in family.hands)]


def _collapsed(weights: Array, family: Family) -> Array:
    """(V, K) -> (V, 24)."""
    collapsed = weights[:, _kept_joints(family)].clip(0)
    collapsed[:, JOINT_NAMES.index("head")] += weights[:, list(family.head)].sum(axis=1)
    for joint, hand in enumerate(family.hands, start=BODY_JOINTS):
        collapsed[:, joint] = weights[:, list(hand)].sum(axis=1)
    return collapsed / collapsed.sum(axis=1, keepdims=True)


def _pose_directions(directions: NDArray[Any]) -> Array:
    """(V, 3, 9 (K - 1)) -> (V, 3, 207). What bends with fingers, jaw and eyes, which stay as they are, is left out."""
    kept = np.zeros((len(directions), 3, POSE_FEATURES), np.float32)
    shared = POSE_FEATURES if directions.shape[2] == POSE_FEATURES else 9 * (BODY_JOINTS - 1)
    kept[:, :, :shared] = directions[:, :, :shared]
    return kept


# --- what to paint ---------------------------------------------------------------------------------------------------


def regions_of(model: SmplModel, vertices: Array) -> NDArray[np.str_]:
    """ "head", "face" (its front), "hand" or "body" of each triangle, by the joint that moves it most; (F,)."""
    dominant = model.weights[model.faces].sum(axis=1).argmax(axis=1)
    head = JOINT_NAMES.index("head")
    hands = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("wrist", "hand")]
    regions = np.full(len(model.faces), "body")
    regions[np.isin(dominant, hands)] = "hand"
    regions[dominant == head] = "head"
    depth = vertices[model.faces].mean(axis=1)[:, 2]
    if (dominant == head).any():
        middle = np.mean([depth[dominant == head].min(), depth[dominant == head].max()])
        regions[(dominant == head) & (depth > middle)] = "face"
    return regions


def guess_face(path: Path, vertices: Array, weights: Array) -> Face:
    """Landmarks by human proportions: the eyes as far below the crown as the man's, scaled by the person's height.

    Raises:
        InputError: no vertex belongs to the head.
    """
    head = vertices[weights.argmax(axis=1) == JOINT_NAMES.index("head")]
    if len(head) == 0:
        raise InputError(f"{path}: weights: no vertex moves with the head")
    scale = np.ptp(vertices[:, 1]) / MAN_HEIGHT
    crown = head[:, 1].max()
    eye = np.array([EYE_APART * scale, crown - MAN_HEAD * scale])
    nearest = np.argsort(np.linalg.norm(np.abs(head[:, :2]) - eye, axis=1))[:20]
    above = head[head[:, 1] >= eye[1]]
    return Face(np.append(eye, head[nearest, 2].max()), float(crown), float(above[:, 2].min()))


def draw_face(points: Array, regions: NDArray[np.str_], face: Face) -> NDArray[np.str_]:
    """`regions` of surface points (N, 3) with "eye" and "lips" where they are to be painted on the face's front."""
    aside = np.abs(np.abs(points[:, 0]) - face.left_eye[0]) / face.scale
    above = (points[:, 1] - face.left_eye[1]) / face.scale
    front = (regions == "face") & (points[:, 2] > face.left_eye[2] - 0.04 * face.scale)
    regions = regions.copy()
    regions[front & (np.hypot(aside / EYE_SIZE[0], above / EYE_SIZE[1]) < 1)] = "eye"
    across = np.abs(points[:, 0]) / face.scale
    regions[front & (np.hypot(across / MOUTH_SIZE[0], (above + MOUTH_BELOW) / MOUTH_SIZE[1]) < 1)] = "lips"
    return regions
