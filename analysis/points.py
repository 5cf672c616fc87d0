"""Pictures of coloured points, in NumPy alone: closed surfaces, soft light, shadows on the ground.

For looking at a record where nothing else is installed; `hoi.render` draws the Gaussians themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import KDTree

from hoi.data import Array

VIEWS = {"side": (1.0, 0.0, 0.12), "front": (0.0, 1.0, 0.15), "three_quarter": (0.88, 0.47, 0.30)}
"""Where the camera stands, seen from the scene. The person starts facing +Y."""

DISTANCE = 4.5
"""Of the camera, in radii of what it looks at."""
MARGIN = 0.07
SKY, GROUND = np.array([0.985, 0.987, 0.99]), np.array([0.915, 0.917, 0.915])
_LIGHT = np.array([0.35, 0.15, 0.92])
"""Towards the light; shadows fall the other way."""
_CELL = 0.02  # of the shadow map [m]


@dataclass(frozen=True)
class Camera:
    """A pinhole: x_camera = axes (x - eye), pixel = focal x_camera / depth + centre."""

    eye: Array
    axes: Array
    """Rows point right, down and forward."""
    focal: float
    """[pixel]"""
    centre: Array
    """Where the axis of view meets the picture, (x, y) [pixel]."""
    width: int
    height: int

    def project(self, points: Array) -> tuple[Array, Array]:
        """World points (N, 3) -> pixels (N, 2) and depths [m] (N,)."""
        local = (points - self.eye) @ self.axes.T
        return local[:, :2] / local[:, 2:] * self.focal + self.centre, local[:, 2]


def frame_points(points: Array, view: str, height: int, aspects: tuple[float, float] = (0.55, 1.25)) -> Camera:
    """The camera of `VIEWS[view]` whose picture, `height` pixels high, the points (N, 3) fill but for a margin.

    Args:
        aspects: the least and the largest width / height.
    """
    back = np.array(VIEWS[view]) / np.linalg.norm(VIEWS[view])
    right = np.cross((0, 0, 1), back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, -np.cross(back, right), -back])
    middle = (points.min(0) + points.max(0)) / 2
    eye = middle + DISTANCE * np.linalg.norm(points - middle, axis=1).max() * back
    local = (points - eye) @ axes.T
    plane = local[:, :2] / local[:, 2:]
    low, high = plane.min(0), plane.max(0)
    span = np.maximum(high - low, 1e-6) * (1 + 2 * MARGIN)
    aspect = float(np.clip(span[0] / span[1], *aspects))
    focal = height / max(span[1], span[0] / aspect)
    width = round(height * aspect)
    return Camera(eye, axes, focal, np.array([width, height]) / 2 - focal * (low + high) / 2, width, height)


def spacing(points: Array) -> Array:
    """How far apart the points lie around each of them [m], (N,): the distance to the fifth neighbour."""
    neighbours = min(6, len(points))
    distances = KDTree(points).query(points, neighbours)[0]
    far = np.reshape(distances, (len(points), -1))[:, -1]
    return np.clip(far, 1e-3, 2.5 * np.median(far) + 1e-3)


def draw(camera: Camera, points: Array, colours: Array, radii: Array, supersample: int = 2) -> Array:
    """The points (N, 3) as discs of `radii` [m] (N,) on the ground, an image (height, width, 3) in [0, 1]."""
    fine = Camera(
        camera.eye,
        camera.axes,
        camera.focal * supersample,
        camera.centre * supersample,
        camera.width * supersample,
        camera.height * supersample,
    )
    image = _ground(fine, points)
    depth, rgb = _splat(fine, points, colours, radii)
    hit = np.isfinite(depth)
    if hit.any():
        image[hit] = _shade(fine, depth, rgb, hit, float(np.median(radii)))
    image = image.reshape(camera.height, supersample, camera.width, supersample, 3).mean((1, 3))
    return np.clip(image, 0, 1)


def _splat(camera: Camera, points: Array, colours: Array, radii: Array) -> tuple[Array, Array]:
    """Depth (H, W), infinite where nothing is, and colours (H, W, 3): every disc bulges towards the camera."""
    pixels, depths = camera.project(points)
    size = radii * camera.focal / depths
    largest_first = np.argsort(-size)
    pixels, depths, size, radii, colours = (a[largest_first] for a in (pixels, depths, size, radii, colours))
    corner = np.floor(pixels).astype(int)
    reach = int(np.ceil(size.max(initial=0)))
    where, nearness, owner = [], [], []
    for dx, dy in np.ndindex(2 * reach + 1, 2 * reach + 1):
        dx, dy = dx - reach, dy - reach
        count = int(np.searchsorted(-size, 1 - np.hypot(dx, dy)))  # those large enough to reach so far
        x, y = corner[:count, 0] + dx, corner[:count, 1] + dy
        square = ((x + 0.5 - pixels[:count, 0]) ** 2 + (y + 0.5 - pixels[:count, 1]) ** 2) / size[:count] ** 2
        inside = (square < 1) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        rows = np.flatnonzero(inside)
        where.append(y[rows] * camera.width + x[rows])
        nearness.append(depths[rows] - radii[rows] * np.sqrt(1 - square[rows]))
        owner.append(rows)
    flat, near, who = np.concatenate(where), np.concatenate(nearness), np.concatenate(owner)
    order = np.argsort(-near, kind="stable")  # the nearest is written last
    depth = np.full(camera.width * camera.height, np.inf)
    rgb = np.zeros((camera.width * camera.height, 3))
    depth[flat[order]] = near[order]
    rgb[flat[order]] = colours[who[order]]
    shape = (camera.height, camera.width)
    return depth.reshape(shape), rgb.reshape(*shape, 3)


def _shade(camera: Camera, depth: Array, rgb: Array, hit: NDArray[np.bool_], radius: float) -> Array:
    """Light from above by the slope of the smoothed depth, and darker creases; (hits, 3)."""
    pixel = float(np.median(depth[hit])) / camera.focal
    width = 0.8 * radius / pixel
    filled = np.where(hit, depth, 0.0)

    def smooth(values: Array, sigma: float) -> Array:
        weight = gaussian_filter(hit.astype(float), sigma, truncate=2.5)
        return gaussian_filter(values, sigma, truncate=2.5) / np.maximum(weight, 1e-6)

    level = smooth(filled, width)
    down, right = (np.gradient(level, pixel, axis=axis)[hit] for axis in range(2))
    # Where depth grows to the right, the surface turns to the right.
    normal = np.stack([right, down, -np.ones_like(right)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    facing = normal @ (camera.axes @ _LIGHT / np.linalg.norm(_LIGHT))
    crease = np.clip((level - smooth(filled, 6 * width))[hit] / 0.08, -0.5, 1.0)
    strength = 0.74 + 0.34 * facing - 0.16 * crease
    even = np.stack([smooth(channel, 0.4 * width)[hit] for channel in np.moveaxis(rgb, -1, 0)], -1)
    return even * strength[:, None]


def _ground(camera: Camera, points: Array) -> Array:
    """The plane z = 0 with a metre grid and the points' shadow, under a plain sky."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([columns - camera.centre[0], rows - camera.centre[1], np.full_like(rows, camera.focal)], -1)
    rays = rays @ camera.axes
    below = rays[..., 2] < -1e-6
    distance = np.where(below, -camera.eye[2] / np.where(below, rays[..., 2], -1), np.inf)
    place = camera.eye[:2] + np.where(below, distance, 0)[..., None] * rays[..., :2]
    metres = distance * np.linalg.norm(rays, axis=-1)
    pixel = metres / camera.focal  # what a pixel spans at that distance
    line = np.zeros(below.shape)
    for axis in range(2):
        offset = np.abs(place[..., axis] - np.round(place[..., axis] * 2) / 2)
        line = np.maximum(line, np.clip(1.4 - offset / np.maximum(pixel, 1e-9), 0, 1))
    middle = np.linalg.norm(camera.eye - points.mean(0))
    near = np.clip(1.0 - (metres - middle) / (1.2 * middle + 3.0), 0, 1)  # fades into the sky
    near = np.where(below, near * near * (3 - 2 * near), 0)
    dark = _shadow(points, place)
    floor = GROUND * (1 - 0.055 * line[..., None]) * (1 - 0.55 * dark[..., None])
    return SKY + (floor - SKY) * near[..., None]


def _shadow(points: Array, place: Array) -> Array:
    """Darkness in [0, 1] at ground places (..., 2); softer the higher what casts it."""
    fallen = points[:, :2] - points[:, 2:] * _LIGHT[:2] / _LIGHT[2]
    low = fallen.min(0) - 1.0
    cells = np.ceil((fallen.max(0) + 1.0 - low) / _CELL).astype(int) + 1
    lit = np.ones(cells)
    for bottom, top, blur in ((-np.inf, 0.2, 0.025), (0.2, 0.7, 0.06), (0.7, np.inf, 0.14)):
        rows = (points[:, 2] >= bottom) & (points[:, 2] < top)
        index = ((fallen[rows] - low) / _CELL).astype(int)
        count = np.zeros(cells)
        np.add.at(count, tuple(index.T), 1.0)
        covered = gaussian_filter(np.minimum(gaussian_filter(count, 1.5), 0.5) / 0.5, blur / _CELL)
        lit *= 1 - np.clip(covered, 0, 1)
    return 1 - map_coordinates(lit, np.moveaxis((place - low) / _CELL, -1, 0), order=1, mode="constant", cval=1.0)
