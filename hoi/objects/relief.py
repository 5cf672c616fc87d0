"""Heights on the built-in objects [m]: seams, gaps, pores. They bend the normals that light sees and darken what lies
deep; particles, and with them the physics, stay where they are."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.data import Array

Relief = Callable[[Array, Array], Array]
"""Surface points [m] (N, 3) of the shape at its own size and outward normals (N, 3) -> heights (N,)."""

TILT = Rotation.from_euler("xyz", [0.75, 0.35, 0.2]).as_matrix()
"""Balls lie as they fell."""
STEEPEST = 0.8
"""Slopes end here [-]: what is steeper is finer than a Gaussian."""
DEEP = 0.004
"""So far below its surroundings [m], half of the sky is closed."""


def surface_of(relief: Relief | None, points: Array, frames: Array, footprints: Array, scale: float) -> Array:
    """Normals and openness (N, 2, 3), see `hoi.data.GaussianCloud`, at points [m] with frames (tangent, tangent,
    normal).

    Args:
        scale: of the object over its own size.
    """
    normals = frames[:, :, 2]
    if relief is None:
        return np.stack([normals, normals], 1)
    tilted, around = normals.copy(), []
    for axis in range(2):
        step = 0.6 * footprints[:, axis, None] * frames[:, :, axis]
        above, below = (scale * relief((points + sign * step) / scale, normals) for sign in (1, -1))
        slope = np.clip((above - below) / (1.2 * footprints[:, axis]), -STEEPEST, STEEPEST)
        tilted -= slope[:, None] * frames[:, :, axis]
        around += [scale * relief((points + sign * 3 * step) / scale, normals) for sign in (1, -1)]
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    depth = np.mean(around, axis=0) - scale * relief(points / scale, normals)
    share = 1 / (1 + np.clip(depth, 0, None) / DEEP)
    return np.stack([tilted, share[:, None] * tilted], 1)


def groove(distance: Array, width: float, depth: float) -> Array:
    """A rounded valley along where `distance` [any unit] is 0, of half `width`, `depth` [m] deep."""
    return -depth * np.exp(-0.5 * (distance / (0.6 * width)) ** 2)


def noise(points: Array, grain: float) -> Array:
    """Smooth noise in [-1, 1] with lumps of `grain` [m], the same for the same points (N, 3)."""
    place = points / grain
    cell, inside = np.floor(place), place - np.floor(place)
    smooth = inside * inside * (3 - 2 * inside)
    total = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        mix = np.prod(np.where(corner, smooth, 1 - smooth), axis=1)
        value = np.sin((cell + corner) @ np.array([127.1, 311.7, 74.7])) * 43758.5453
        total += mix * (2 * (value - np.floor(value)) - 1)
    return total


def rough(grain: float, height: float) -> Relief:
    """Lumps of two sizes: clay, snow."""
    return lambda points, normals: height * (noise(points, grain) + 0.5 * noise(points + 7.3, grain / 2.3))


def pores(grain: float, depth: float) -> Relief:
    """Holes in an even surface: foam."""
    return lambda points, normals: -depth * np.clip(noise(points, grain) - 0.25, 0, None) / 0.75


def soccer(points: Array, normals: Array) -> Array:
    """Cushioned panels between seams, and a fine grain."""
    import trimesh

    icosahedron = trimesh.creation.icosahedron()
    pentagons, hexagons = np.asarray(icosahedron.vertices), np.asarray(icosahedron.triangles_center)
    # A direction lies in the face whose plane it meets first, as in the pattern.
    faces = [
        n / np.linalg.norm(n, axis=1, keepdims=True) / far for n, far in ((pentagons, 2.32744), (hexagons, 2.26728))
    ]
    directions = points / np.linalg.norm(points, axis=1, keepdims=True) @ TILT
    best = np.partition(directions @ np.concatenate(faces).T, -2, axis=1)
    return groove(best[:, -1] - best[:, -2], 0.012, 0.0025) + 0.0001 * noise(points, 0.006)


def basketball(points: Array, normals: Array) -> Array:
    """Channels along the seams, and pebbles."""
    _, y, z = (points / np.linalg.norm(points, axis=1, keepdims=True) @ TILT).T
    seam = np.minimum.reduce([np.abs(y), np.abs(z), np.abs(np.abs(y) - 0.52 - 0.34 * z**2)])
    return groove(seam, 0.03, 0.002) + 0.0006 * noise(points, 0.007)


def sand_bag(points: Array, normals: Array) -> Array:
    """Seams between leather panels, bulges between its bands, and wrinkles."""
    angle = np.arctan2(points[:, 1], points[:, 0])
    seam = np.abs((angle / (np.pi / 2)) % 1 - 0.5)
    return groove(0.5 - seam, 0.012, 0.002) + 0.0022 * noise(points * [1, 1, 0.4], 0.05) + 0.0004 * noise(points, 0.01)


def cardboard(points: Array, normals: Array) -> Array:
    """Flutes that show through, dents, and the flaps' gap."""
    lying = np.abs(normals[:, 2]) > 0.5
    along = np.where(lying, points[:, 1], points[:, 0] + points[:, 1])
    flutes = 0.00025 * np.sin(2 * np.pi * along / 0.05)
    gap = np.where(lying, groove(points[:, 0], 0.004, 0.003), 0.0)
    return flutes + 0.0025 * noise(points, 0.13) + gap


def cabinet(extent: tuple[float, float, float]) -> Relief:
    """Gaps around the drawers, their handles, and brushed steel."""

    def relief(points: Array, normals: Array) -> Array:
        width, _, height = extent
        x, z = points[:, 0], points[:, 2]
        brushed = 0.00008 * noise(points * [0.06, 0.06, 1.0], 0.006)
        step = (height - 0.06) / 4
        level = (z + height / 2 - 0.03) / step
        within = (level - np.floor(level) - 0.5) * step
        front = (normals[:, 1] < -0.5) & (np.abs(x) < width / 2 - 0.02) & (level > 0) & (level < 4)
        edge = np.minimum(step / 2 - np.abs(within), width / 2 - 0.028 - np.abs(x))
        handle = np.maximum(np.abs(x) - 0.075, np.abs(within - 0.005) - 0.013)
        pulled = 0.006 * np.clip(-handle / 0.008, 0, 1)
        return brushed + np.where(front, groove(edge, 0.010, 0.005) + pulled, 0.0)

    return relief


def jelly(points: Array, normals: Array) -> Array:
    """Slow waves."""
    return 0.003 * noise(points, 0.12)
