"""The person of a record as a skinned mesh, in the T-pose.

A record holds Gaussians. Those of the people in the package were laid on a mesh, which is taken again; any other person
gets the closed surface through their Gaussians. Colours and hair come from the Gaussians in both.
"""

from dataclasses import dataclass
from importlib import resources

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hoi.body.kinematics import local_rotations
from hoi.body.people import vertex_normals
from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array, Body, Motion
from hoi.export.surface import Faces, blend_weights, reconstruct
from hoi.gaussians import colours

INFLUENCES = 4
"""Joints a vertex follows: what every engine takes."""
SAME_SKELETON = 1e-5
"""Joints nearer than this are those of a person in the package [m]."""
ON_MESH = 0.06
"""99% of the Gaussians are nearer than this to a vertex of the mesh they were laid on, hair and all [m]."""
HAIR = 0.004
"""Gaussians farther than this above the skin have been lifted, and lift the mesh [m]."""
FINEST = 1 / 160
"""Least edge of a cell of a surface that has to be found, in extents of the body."""
FAINT = 0.05
"""Opacity below which a Gaussian is no part of the surface."""


@dataclass(frozen=True)
class SkinnedMesh:
    """In the body's rest frame: y up, facing +z."""

    vertices: Array
    """[m], (V, 3)."""
    faces: Faces
    """(F, 3); none where no surface was found, and the vertices are points."""
    colours: Array
    """As they are shown, in [0, 1], (V, 3)."""
    joints: NDArray[np.uint8]
    """That each vertex follows, (V, 4)."""
    weights: Array
    """How much, rows sum to 1, (V, 4)."""
    rest_joints: Array
    """[m], (24, 3)."""


def skinned_mesh(body: Body) -> SkinnedMesh:
    """The mesh that shows `body`; skinning alone poses it, so that pose blend shapes are left out."""
    seen = body.cloud.opacities >= FAINT
    seen = seen if seen.any() else ~seen
    points, rgb = body.cloud.means[seen].astype(np.float64), np.clip(colours(body.cloud)[seen], 0, 1)
    found = _package_mesh(body, points)
    if found is None:
        vertices, faces = reconstruct(points, points[:0], FINEST)
        if len(faces) == 0:
            vertices = points
        rows, blend = blend_weights(points, vertices)
        dense = np.einsum("vk,vkj->vj", blend, body.skinning_weights[seen][rows].astype(np.float64))
    else:
        vertices, faces, dense = found
        rows, blend = blend_weights(points, vertices)
    joints, weights = strongest(dense)
    mixed = np.einsum("vk,vkc->vc", blend, rgb[rows])
    return SkinnedMesh(vertices, faces, mixed, joints, weights, body.rest_joints.astype(np.float64))


def local_turns(motion: Motion) -> Array:
    """Rotations of the joints, each in its parent's frame, the root's in the world, (T, 24, 3, 3), float64."""
    parameters = (torch.from_numpy(np.asarray(a, np.float64)) for a in (motion.orientation, motion.body_pose))
    return local_rotations(*parameters).numpy()


def strongest(weights: Array) -> tuple[NDArray[np.uint8], Array]:
    """The `INFLUENCES` greatest of weights (V, 24) and their joints, (V, 4) each; weights of nothing name joint 0."""
    order = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, order, axis=1)
    kept = kept / kept.sum(axis=1, keepdims=True)
    return np.where(kept > 0, order, 0).astype(np.uint8), kept


def _package_mesh(body: Body, points: Array) -> tuple[Array, Faces, Array] | None:
    """Vertices, faces and weights (V, 24) of the mesh the body was made from, if it is one of the package's."""
    with resources.files("hoi.body").joinpath("people.npz").open("rb") as file:
        data = np.load(file, allow_pickle=False)
        same = [n for n in data["names"] if np.abs(data[f"{n}.rest_joints"] - body.rest_joints).max() < SAME_SKELETON]
        if not same:
            return None
        vertices, faces = data[f"{same[0]}.vertices"].astype(np.float64), data["faces"].astype(np.int64)
        dense = np.zeros((len(vertices), JOINT_COUNT))
        np.put_along_axis(dense, data["influences"].astype(np.intp), data["weights"].astype(np.float64), axis=1)
    if np.quantile(KDTree(vertices).query(points)[0], 0.99) > ON_MESH:
        return None
    return _lifted(vertices, faces, points), faces, dense


def _lifted(vertices: Array, faces: Faces, points: Array) -> Array:
    """The vertices raised along their normals to where hair is."""
    normals = vertex_normals(vertices, faces)
    rows, weights = blend_weights(points, vertices)
    heights = ((points[rows] - vertices[:, None]) * normals[:, None]).sum(-1)
    raised = np.einsum("vk,vk->v", weights, np.where(heights > HAIR, heights, 0.0))
    return vertices + raised[:, None] * normals
