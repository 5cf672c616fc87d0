"""Rays against a dressed mesh (embree): what of the sky is open, and pictures of the mesh."""

from collections.abc import Callable, Sequence

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from hoi.data import Camera
from scripts.bake_people import Array
from scripts.dress_people.makehuman import Part, look_up

STEP = 3e-5
"""How far behind a hit a ray goes on [m]."""
SEE_THROUGH = ("hair", "brow", "lash", "eye")
Shader = Callable[[NDArray[np.intp], NDArray[np.intp], Array, Array], tuple[Array, Array]]
"""Part, face (of all), uv and normal of hits -> RGB and alpha."""


class Scene:
    """All parts, at their own vertices or others."""

    def __init__(self, parts: Sequence[Part], vertices: Sequence[Array] | None = None) -> None:
        self.parts = parts
        placed = [part.vertices for part in parts] if vertices is None else vertices
        starts = np.cumsum([0, *map(len, placed)])
        self.vertices = np.concatenate(placed).astype(np.float32)
        self.faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=False)]).astype(np.int32)
        self.part = np.concatenate([np.full(len(part.faces), index) for index, part in enumerate(parts)])
        self.uv = np.concatenate([part.uv for part in parts])
        self.normals = np.concatenate([smooth_normals(p, v) for p, v in zip(parts, placed, strict=True)])
        see_through = [part.kind in SEE_THROUGH or part.texture[..., 3].min() < 0.9 for part in parts]
        self.see_through = np.array(see_through)[self.part]
        self.embree = rtcore_scene.EmbreeScene()
        TriangleMesh(self.embree, self.vertices, self.faces)

    def hits(self, origins: Array, directions: Array) -> dict[str, NDArray]:
        """Face (-1: none), distance and barycentric u, v of each ray's first hit."""
        rays = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
        return self.embree.run(*rays, query="INTERSECT", output=1)

    def alpha(self, face: NDArray[np.intp], uv: Array) -> Array:
        alphas = np.ones(len(face), np.float32)
        for index, part in enumerate(self.parts):
            rows = (self.part[face] == index) & self.see_through[face]
            if rows.any():
                alphas[rows] = look_up(part.texture[..., 3:4], uv[rows])[:, 0]
        return alphas

    def transmittance(self, origins: Array, directions: Array, passes: int = 3) -> Array:
        """Share of the light from infinity that gets to the origins."""
        left, live = np.ones(len(origins), np.float32), np.arange(len(origins))
        origins = np.array(origins, np.float32)
        for _ in range(passes):
            hit = self.hits(origins[live], directions[live])
            some = hit["primID"] >= 0
            live, face, u, v, far = live[some], *(hit[key][some] for key in ("primID", "u", "v", "tfar"))
            if not len(live):
                break
            bary = np.stack([1 - u - v, u, v], 1)
            left[live] *= 1 - self.alpha(face, np.einsum("nc,ncd->nd", bary, self.uv[face]))
            on = (left[live] > 0.02) & self.see_through[face]
            live, far = live[on], far[on]
            origins[live] += directions[live] * (far[:, None] + STEP)
        return left

    def openness(self, points: Array, normals: Array, rays: int, rng: np.random.Generator, off: float = 1e-3) -> Array:
        """The mean direction of what is open of the cosine-weighted hemisphere, as long as the open share, (N, 3)."""
        found = np.zeros((len(points), 3))
        for start in range(0, len(points), 20000):
            rows = slice(start, start + 20000)
            directions = hemisphere(normals[rows], rays, rng)
            origins = np.repeat(points[rows] + normals[rows] * off, rays, 0)
            free = self.transmittance(origins, directions.reshape(-1, 3)).reshape(-1, rays)
            mean = (free[..., None] * directions).mean(1)
            length = np.linalg.norm(mean, axis=1, keepdims=True)
            found[rows] = mean / np.maximum(length, 1e-9) * free.mean(1)[:, None]
        return found

    def picture(self, camera: Camera, shade: Shader, samples: int = 2, passes: int = 6) -> tuple[Array, Array]:
        """RGB over black, and alpha, of samples x samples rays a pixel."""
        x, y = (
            (np.arange(size * samples) / samples + 0.5 / samples - centre) / focal
            for size, centre, focal in ((camera.width, camera.cx, camera.fx), (camera.height, camera.cy, camera.fy))
        )
        local = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], -1).reshape(-1, 3)
        directions = (local @ camera.world_to_camera[:3, :3]).astype(np.float32)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.tile(camera.position.astype(np.float32), (len(directions), 1))
        rgb, left = np.zeros_like(origins), np.ones(len(origins), np.float32)
        live = np.arange(len(origins))
        for _ in range(passes):
            hit = self.hits(origins[live], directions[live])
            some = hit["primID"] >= 0
            live, face, u, v, far = live[some], *(hit[key][some] for key in ("primID", "u", "v", "tfar"))
            if not len(live):
                break
            bary = np.stack([1 - u - v, u, v], 1)
            normals = np.einsum("nc,ncd->nd", bary, self.normals[self.faces[face]])
            normals *= np.where((normals * directions[live]).sum(1) > 0, -1, 1)[:, None]
            colour, alpha = shade(self.part[face], face, np.einsum("nc,ncd->nd", bary, self.uv[face]), normals)
            rgb[live] += (left[live] * alpha)[:, None] * colour
            left[live] *= 1 - alpha
            origins[live] += directions[live] * (far[:, None] + STEP)
            live = live[left[live] > 0.01]
        shape = (camera.height, samples, camera.width, samples)
        return rgb.reshape(*shape, 3).mean((1, 3)), 1 - left.reshape(shape).mean((1, 3))

    def unlit(self, part: NDArray[np.intp], face: NDArray[np.intp], uv: Array, normals: Array) -> tuple[Array, Array]:
        """The shader of what the textures say alone."""
        rgb = np.zeros((len(part), 3), np.float32)
        for index, each in enumerate(self.parts):
            rows = part == index
            if rows.any():
                rgb[rows] = albedo(each, uv[rows])
        return rgb, self.alpha(face, uv)


def albedo(part: Part, uv: Array) -> Array:
    """RGB as shown: the texture, darkened in its creases."""
    rgb = look_up(part.texture[..., :3], uv)
    if part.occlusion_map is not None:
        rgb = to_shown(to_linear(rgb) * (0.35 + 0.65 * look_up(part.occlusion_map[..., :1], uv)))
    return rgb


def to_linear(shown: Array) -> Array:
    return np.where(shown <= 0.04045, shown / 12.92, ((np.clip(shown, 0, None) + 0.055) / 1.055) ** 2.4)


def to_shown(linear: Array) -> Array:
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.clip(linear, 1e-9, None) ** (1 / 2.4) - 0.055)


def smooth_normals(part: Part, vertices: Array) -> Array:
    """Unit normals (V, 3), area-weighted."""
    corners = vertices[part.faces]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, part.faces[:, corner], of_faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def hemisphere(normals: Array, count: int, rng: np.random.Generator) -> Array:
    """Cosine-weighted directions about normals (N, 3), evenly spread, each turned by chance, (N, count, 3)."""
    index = np.arange(count)
    height = (index + 0.5) / count
    turn = 2 * np.pi * (index * 0.6180339887498949 + rng.random((len(normals), 1)))
    radius = np.sqrt(height)
    x, y, z = radius * np.cos(turn), radius * np.sin(turn), np.broadcast_to(np.sqrt(1 - height), turn.shape)
    aside = np.cross(normals, np.where(np.abs(normals[:, :1]) > 0.9, [[0, 1, 0]], [[1, 0, 0]]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True) + 1e-12
    other = np.cross(normals, aside)
    return x[..., None] * aside[:, None] + y[..., None] * other[:, None] + z[..., None] * normals[:, None]
