"""The object of a record as a mesh that moves rigidly and, where that is not all, changes its shape."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, ObjectTrajectory, SceneObject
from hoi.export.person import FAINT
from hoi.export.surface import Faces, blend_weights, reconstruct
from hoi.gaussians import colours, limited

RIGID = 1e-4
"""What moves no vertex farther than this from where the rigid motion has it is no deformation [m]."""
TORN = 4.0
"""An edge in a hundred longer than this times its length: the surface no longer holds, and points are shown."""
FINEST = 1 / 100
"""Least edge of a cell of the surface, in extents of the object: each frame in which it changes shape is stored."""
MOST_POINTS = 20_000


@dataclass(frozen=True)
class MovingMesh:
    """x(t) = R(t) (vertices + offsets(t)) + r(t), in the world: z up."""

    vertices: Array
    """About the centre of mass in frame 0 [m], (V, 3)."""
    faces: Faces
    """(F, 3); none where no surface holds, and the vertices are points."""
    colours: Array
    """As they are shown, in [0, 1], (V, 3)."""
    translation: Array
    """r, the centre of mass [m], (T, 3)."""
    rotation: Array
    """R, (T, 3, 3)."""
    offsets: dict[int, Array]
    """By frame, where there are any beyond `RIGID`: [m], (V, 3)."""


def moving_mesh(thing: SceneObject, trajectory: ObjectTrajectory) -> MovingMesh:
    """The surface through the object's Gaussians at rest, carried along by those nearest to it."""
    count = len(thing.cloud)
    rest = trajectory.positions[0].astype(np.float64)
    seen = np.flatnonzero(thing.cloud.opacities >= FAINT)
    seen = seen if len(seen) else np.arange(count)
    vertices, faces = reconstruct(rest[seen], rest[count:], FINEST)
    if len(faces) and not _holds(places := _carried(vertices, rest[seen], seen, trajectory), faces):
        faces = faces[:0]
    if len(faces) == 0:
        seen = seen[:: -(-len(seen) // MOST_POINTS)]
        vertices, places = rest[seen], trajectory.positions[:, seen].astype(np.float64)
    rows, blend = blend_weights(rest[seen], vertices)
    rgb = np.einsum("vk,vkc->vc", blend, np.clip(colours(thing.cloud)[seen], 0, 1)[rows])
    rotation = rigid_rotations(trajectory.positions[:, :count])
    local = np.einsum("tji,tvj->tvi", rotation, places - trajectory.com[:, None])
    offsets = {
        frame: local[frame] - local[0]
        for frame in range(1, len(local))
        if np.linalg.norm(local[frame] - local[0], axis=1).max() > RIGID
    }
    return MovingMesh(local[0], faces, rgb, trajectory.com.astype(np.float64), rotation, offsets)


def still_surface(thing: SceneObject, trajectory: ObjectTrajectory) -> tuple[Array, Faces]:
    """The closed surface through the object's visible Gaussians in frame 0 [m]: vertices (V, 3), faces (F, 3)."""
    count, rest = len(thing.cloud), trajectory.positions[0].astype(np.float64)
    seen = np.flatnonzero(thing.cloud.opacities >= FAINT)
    return reconstruct(rest[seen if len(seen) else slice(count)], rest[count:], FINEST)


def rigid_rotations(positions: Array) -> Array:
    """R(t) that takes the points (T, N, 3) of frame 0 nearest to those of frame t, about their means, (T, 3, 3)."""
    about = positions.astype(np.float64) - positions.mean(axis=1, keepdims=True, dtype=np.float64)
    left, sizes, right = np.linalg.svd(np.einsum("tni,nj->tij", about, about[0]))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    rotation = left @ right
    rotation[sizes[:, 1] < 1e-9 * max(1e-30, float(sizes.max()))] = np.eye(3)  # on a line: nothing tells how it turned
    return rotation


def quaternions_xyzw(rotation: Array) -> Array:
    """Rotations over time (T, ..., 3, 3) -> (T, ..., 4), neighbours in time on the same side of the sphere."""
    quaternions = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:-2], 4)
    turns = np.sign((quaternions[1:] * quaternions[:-1]).sum(-1, keepdims=True))
    quaternions[1:] *= np.cumprod(np.where(turns == 0, 1, turns), axis=0)
    return quaternions


def _carried(vertices: Array, rest: Array, seen: NDArray[np.intp], trajectory: ObjectTrajectory) -> Array:
    """Vertices (T, V, 3) [m]: the mean of where each Gaussian near them, with its F, takes them."""
    rows, weights = blend_weights(rest, vertices)
    arms = vertices[:, None] - rest[rows]
    gradient = trajectory.deformation_gradient
    rigid = rigid_rotations(trajectory.positions[:, seen]) if gradient is None else None
    places = np.empty((len(trajectory.positions), len(vertices), 3))
    for frame, positions in enumerate(trajectory.positions):
        if rigid is None:
            assert gradient is not None
            turned = np.einsum("vkij,vkj->vki", limited(gradient[frame][seen])[rows].astype(np.float64), arms)
        else:
            turned = arms @ rigid[frame].T
        places[frame] = np.einsum("vk,vkd->vd", weights, positions[seen].astype(np.float64)[rows] + turned)
    return places


def _holds(places: Array, faces: Faces) -> bool:
    """Whether the edges of the mesh stay what they are in all frames (T, V, 3)."""
    first, second = (places[:, faces[:, corner]] for corner in (0, 1))
    lengths = np.linalg.norm(first - second, axis=-1)
    return bool(np.quantile(lengths.max(axis=0) / np.maximum(lengths[0], 1e-9), 0.99) < TORN)
