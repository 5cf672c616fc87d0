"""Objects that are meshes: .glb, .gltf, .obj, .ply and .stl, as image-to-3D models give them.

The surface is sampled evenly and covered with flat Gaussians in the colours of textures, materials or vertices; what is
watertight is filled as the built-in objects are, the rest like a capture.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import sh_from_colours
from hoi.gaussians.found import brief
from hoi.objects.thinning import even

WAYS = {
    ".glb": ("+y", "glTF's way: y points up"),
    ".gltf": ("+y", "glTF's way: y points up"),
    ".obj": ("+y", "the way of most programs that write OBJ: y points up"),
    ".ply": ("+z", "the way of most programs that write meshes as PLY: z points up"),
    ".stl": ("+z", "the way of printers: z points up"),
}
"""Extension -> up axis, and what says so."""
SPACING = 0.003
"""Wanted distance between neighbouring Gaussians [m]."""
FEWEST = 1000
OPACITY = 0.95
WIDTH, FLATNESS = 0.95, 0.1
"""Standard deviation along the surface, in spacings, and thickness in widths."""
OVERSAMPLED = 8
MOST_FACES = 5_000_000
_GREY = 0.7


@dataclass(frozen=True)
class Mesh:
    """A mesh in the file's axes and units."""

    parts: tuple[Any, ...]
    """`trimesh.Trimesh` each, in one frame."""
    vertices: Array
    """All of them, one where textures had split them, (V, 3)."""
    faces: NDArray[np.integer]
    """(F, 3), outward where it is watertight."""
    watertight: bool
    linear: bool
    """Whether colours of vertices and materials are of linear light, as in glTF."""


def read_mesh(path: Path) -> Mesh:
    """Read a mesh, all its parts.

    Raises:
        InputError: broken, without faces, or with too many.
    """
    import trimesh

    try:
        scene = trimesh.load_scene(str(path), process=False, skip_materials=False)
        parts = [part for part in scene.dump(concatenate=False) if isinstance(part, trimesh.Trimesh)]
    except Exception as error:  # the readers of many formats end in as many ways on broken files
        raise InputError(f"{path}: broken mesh ({type(error).__name__}: {brief(error)})") from None
    parts = [part for part in parts if len(part.faces)]
    count = sum(len(part.faces) for part in parts)
    if not 0 < count <= MOST_FACES:
        raise InputError(f"{path}: a mesh of {count} triangles; allowed are 1 to {MOST_FACES}")
    shifts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    faces = np.concatenate([np.asarray(part.faces) + shift for part, shift in zip(parts, shifts, strict=False)])
    if not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).any():
        raise InputError(f"{path}: a mesh whose vertices are not finite or all in one place")
    whole = trimesh.Trimesh(vertices, faces, process=False)
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    whole.update_faces(whole.nondegenerate_faces())
    closed = bool(whole.is_watertight)
    if closed:
        whole.fix_normals(multibody=True)
    return Mesh(
        tuple(parts),
        np.asarray(whole.vertices, np.float64),
        np.asarray(whole.faces),
        closed,
        path.suffix.lower() in (".glb", ".gltf"),
    )


def cover(mesh: Mesh, scale: float, most: int, seed: int = 0) -> GaussianCloud:
    """Flat Gaussians all over a mesh, in its own units.

    Args:
        scale: metres a unit of the file: how many there are depends on it.
        most: more than this there are not.
    """
    area = [float(part.area) for part in mesh.parts]
    count = int(np.clip(sum(area) * scale**2 / SPACING**2, min(FEWEST, most), most))
    rng = np.random.default_rng(seed)
    places, normals, rgba = [], [], []
    for part, share in zip(mesh.parts, area, strict=True):
        drawn = max(1, int(OVERSAMPLED * count * share / sum(area)))
        faces = rng.choice(len(part.faces), drawn, p=part.area_faces / part.area_faces.sum())
        u, v = rng.uniform(size=(2, drawn))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        corners = np.column_stack([1 - u - v, u, v])
        places.append(np.einsum("nk,nkd->nd", corners, np.asarray(part.triangles)[faces]))
        normals.append(np.asarray(part.face_normals)[faces])
        rgba.append(_colours(part, faces, corners, mesh.linear))
    points = np.concatenate(places)
    rows = even(points, count, seed)
    points, normal, colour = points[rows], np.concatenate(normals)[rows], np.concatenate(rgba)[rows]
    width = WIDTH * np.sqrt(sum(area) / len(points))
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0, 0]], [[0.0, 1, 0]])
    first = np.cross(helper, normal)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    frames = np.stack([first, np.cross(normal, first), normal], 2)
    kept = (colour[:, 3] >= 0.05) & (np.abs(np.linalg.norm(normal, axis=1) - 1) < 0.01)
    return GaussianCloud(
        means=points[kept].astype(np.float32),
        quaternions=Rotation.from_matrix(frames[kept]).as_quat(scalar_first=True).astype(np.float32),
        scales=np.tile(np.array([width, width, FLATNESS * width], np.float32), (int(kept.sum()), 1)),
        opacities=(OPACITY * colour[kept, 3]).astype(np.float32),
        sh=sh_from_colours(colour[kept, :3]),
    )


def _colours(part: Any, faces: NDArray[Any], corners: Array, linear: bool) -> Array:
    """RGBA as shown, of points on faces by their barycentric coordinates, (N, 4)."""
    visual, count = part.visual, len(faces)
    at = np.asarray(part.faces)[faces]
    if visual.kind == "texture" and getattr(visual, "material", None) is not None:
        material = visual.material
        factor = getattr(material, "baseColorFactor", None)
        image = getattr(material, "baseColorTexture", None) if hasattr(material, "baseColorTexture") else material.image
        tint = np.ones(4) if factor is None else _shares(factor)
        if image is not None and visual.uv is not None and len(visual.uv) == len(part.vertices):
            uv = np.einsum("nk,nkd->nd", corners, np.asarray(visual.uv)[at])
            shown = _texels(image, uv)
            if factor is not None and not np.allclose(tint, 1):
                shown = np.column_stack([_displayed(_lit(shown[:, :3]) * tint[:3]), shown[:, 3] * tint[3]])
            return _opaque(shown, material)
        if factor is None:
            tint = _shares(getattr(material, "diffuse", np.full(4, _GREY * 255)))
            return np.tile(tint, (count, 1))
        return _opaque(np.tile(np.r_[_displayed(tint[:3]) if linear else tint[:3], tint[3]], (count, 1)), material)
    if visual.kind == "vertex":
        mixed = np.einsum("nk,nkd->nd", corners, _shares(visual.vertex_colors)[at])
        return np.column_stack([_displayed(mixed[:, :3]), mixed[:, 3]]) if linear else mixed
    if visual.kind == "face":
        return _shares(visual.face_colors)[faces]
    return np.tile([_GREY, _GREY, _GREY, 1.0], (count, 1))


def _opaque(rgba: Array, material: Any) -> Array:
    """Alpha counts only where glTF says so."""
    mode = getattr(material, "alphaMode", None)
    if mode == "MASK":
        cut = getattr(material, "alphaCutoff", None)
        rgba[:, 3] = rgba[:, 3] >= (0.5 if cut is None else cut)
    elif mode != "BLEND":
        rgba[:, 3] = 1
    return rgba


def _texels(image: Any, uv: Array) -> Array:
    """RGBA of a picture at uv, v upwards, between the four pixels around, (N, 4). It repeats beyond its edges."""
    pixels = np.asarray(image.convert("RGBA"), np.float64) / 255
    height, width = pixels.shape[:2]
    uv = np.nan_to_num(uv)
    uv = np.where((uv < 0) | (uv > 1), uv - np.floor(uv), uv)
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = (x - left)[:, None], (y - top)[:, None]

    def at(dx: int, dy: int) -> Array:
        return pixels[np.clip(top + dy, 0, height - 1), np.clip(left + dx, 0, width - 1)]

    upper, lower = at(0, 0) * (1 - across) + at(1, 0) * across, at(0, 1) * (1 - across) + at(1, 1) * across
    return upper * (1 - down) + lower * down


def _shares(colours: Any) -> Array:
    """Colours in bytes or shares of 1 as shares of 1, with an alpha."""
    values = np.asarray(colours)
    values = values / 255.0 if values.dtype.kind in "ui" else np.asarray(values, np.float64)
    return np.concatenate([values, np.ones((*values.shape[:-1], 1))], -1) if values.shape[-1] == 3 else values


def _displayed(linear: Array) -> Array:
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def _lit(shown: Array) -> Array:
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
