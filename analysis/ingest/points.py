"""From moving triangles to what a record holds: points of a skin, and an object of particles."""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from hoi.data import Array, GaussianCloud, Material, SceneObject
from hoi.errors import InputError
from hoi.gaussians import sh_from_colours
from hoi.objects.filling import fill_cloud, fill_mesh

from .meshes import MeshSequence

SKIN_POINTS, SURFACE_POINTS = 6000, 12_000
GREY = 0.7
FILLING_ACROSS = 20
"""Particles across the object's inside."""
OPACITY = 0.9
NEIGHBOURS = 8
"""Points of the surface that an inner particle follows."""
Y_TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def in_our_world(mesh: MeshSequence, scale: float, up: str) -> MeshSequence:
    """Metres, Z up."""
    vertices = mesh.vertices * scale
    return replace(mesh, vertices=vertices @ Y_TO_Z_UP.T if up == "y" else vertices)


def tracked_points(mesh: MeshSequence, count: int, seed: int) -> tuple[Array, Array]:
    """Points that stay where they are on a mesh's triangles, spread evenly over its area in the first frame.

    Returns:
        points (T, count, 3) and their colours in [0, 1], (count, 3).

    Raises:
        InputError: the mesh has no area.
    """
    random = np.random.default_rng(seed)
    areas = triangle_areas(mesh)
    face = np.searchsorted(np.cumsum(areas), (np.arange(count) + random.random(count)) / count * areas.sum())
    face = np.minimum(face, len(areas) - 1)
    root, along = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=-1)
    corners = mesh.faces[face]
    points = np.einsum("tnci,nc->tni", mesh.vertices[:, corners], weights)
    if mesh.colours is None:
        return points, np.full((count, 3), GREY)
    return points, np.clip(np.einsum("nci,nc->ni", mesh.colours[corners], weights), 0.0, 1.0)


def triangle_areas(mesh: MeshSequence) -> Array:
    """In the first frame [m^2], (F,).

    Raises:
        InputError: they are all 0.
    """
    a, b, c = np.moveaxis(mesh.vertices[0, mesh.faces], 1, 0)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    if not areas.sum() > 0:
        raise InputError("the triangles of a mesh have no area")
    return areas


def object_of(mesh: MeshSequence, name: str, material: Material, seed: int) -> tuple[SceneObject, Array]:
    """The object at t = 0, and its particles over time (T, P, 3) [m].

    Its mass is density times volume: that of a closed mesh, else what `hoi.objects.filling.fill_cloud` takes for solid.
    The inside follows the surface: the affine map that fits the whole surface best, and what that leaves over near by.
    """
    import trimesh

    surface, rgb = tracked_points(mesh, SURFACE_POINTS, seed)
    size = float(np.ptp(surface[0], axis=0).max())
    spacing = size / FILLING_ACROSS
    apart = float(np.median(np.asarray(KDTree(surface[0]).query(surface[0], 2)[0])[:, 1]))
    cloud = GaussianCloud(
        means=surface[0].astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (len(rgb), 1)),
        scales=np.full((len(rgb), 3), apart, np.float32),
        opacities=np.full(len(rgb), OPACITY, np.float32),
        sh=sh_from_colours(rgb),
    )
    closed: Any = trimesh.Trimesh(mesh.vertices[0], mesh.faces, process=True)
    if closed.is_volume:
        filling, how = fill_mesh(surface[0], closed.vertices, closed.faces, spacing), "a closed mesh"
    else:
        filling, how = fill_cloud(cloud, spacing), "no closed mesh: its volume is an estimate"
    inside = _followed(surface, filling.interior)
    positions = np.concatenate([surface, inside], axis=1)
    thing = SceneObject(
        name=name,
        cloud=cloud,
        particles=positions[0].astype(np.float32),
        volumes=filling.volumes.astype(np.float32),
        material=material,
        velocity=np.zeros(3),
        angular_velocity=np.zeros(3),
        size=size,
        notes=(f"{how}, {filling.volumes.sum():.3g} m^3",),
    )
    return thing, positions.astype(np.float32)


def _followed(surface: Array, interior: Array) -> Array:
    """(T, N, 3) and (M, 3) -> (T, M, 3)."""
    start = np.column_stack([surface[0], np.ones(len(surface[0]))])
    inner = np.column_stack([interior, np.ones(len(interior))])
    distance, rows = (np.asarray(found) for found in KDTree(surface[0]).query(interior, NEIGHBOURS))
    weights = 1 / np.maximum(distance, 1e-9) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    inverse = np.linalg.pinv(start)
    moved = np.empty((len(surface), len(interior), 3))
    for frame, points in enumerate(surface):
        affine = inverse @ points
        left = points - start @ affine
        moved[frame] = inner @ affine + np.einsum("mk,mki->mi", weights, left[rows])
    return moved
