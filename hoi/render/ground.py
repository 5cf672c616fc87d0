"""What stands behind the Gaussians: a light floor with a metre grid, a plain sky, and soft shadows.

The light is a large one straight overhead. A shadow therefore lies exactly below what casts it, and it is the softer
and the fainter the higher that is: this is what lets heights be read off a picture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hoi.data import Array
from hoi.render.cameras import Camera, project
from hoi.render.splats import Splats

FLOOR, HORIZON, ZENITH = (0.905, 0.908, 0.912), (0.962, 0.964, 0.968), (0.992, 0.993, 0.995)
"""Colours as they are shown; the floor fades into the horizon, the horizon into the sky above."""
LINE = (0.83, 0.838, 0.848)
LINE_WIDTH = 0.016
"""Of the lines of the grid, which lie at whole metres [m]."""
FADE = (math.radians(0.3), math.radians(7.0))
"""How far below the horizon the floor begins to show and shows fully."""
DARKNESS = 0.52
"""Share of its light that a covered floor loses."""
SOFTNESS = 0.13
"""Standard deviation of the shadow's edge a metre of height [-]: the light's angular size."""
_EDGES = (0.012, 0.03, 0.065, 0.14, 0.3)
"""Standard deviations of the edges that are mixed to any softness between [m]."""
_FINE = 2.5  # cells of a shadow's map in a standard deviation
_CELLS = 1_000_000  # in one map at most, where a part is spread out very far


@dataclass(frozen=True)
class Shadow:
    """How much of the light some Gaussians take from the floor around them."""

    cover: Tensor
    """0 to 1, rows along y and columns along x, (ny, nx)."""
    low: tuple[float, float]
    """Where the outer corner of the first cell lies, x and y [m]."""
    cell: float
    """[m]"""

    def corners(self) -> Array:
        """Of the map, on the floor [m], (4, 3)."""
        (x, y), (ny, nx) = self.low, self.cover.shape
        far_x, far_y = x + nx * self.cell, y + ny * self.cell
        return np.array([[x, y, 0], [far_x, y, 0], [far_x, far_y, 0], [x, far_y, 0]])

    def look_up(self, places: Tensor) -> Tensor:
        """Cover at places (height, width, 2) of the floor [m], (height, width); 0 outside the map."""
        size = places.new_tensor(self.cover.shape[::-1]) * self.cell
        grid = (places - places.new_tensor(self.low)) * (2 / size) - 1
        return functional.grid_sample(self.cover[None, None], grid[None], align_corners=False)[0, 0]


class Backdrop:
    """The background of one camera; what does not move is worked out once."""

    def __init__(self, camera: Camera, *, floor: bool = True, device: torch.device | str = "cpu") -> None:
        """Without a `floor` at z = 0 there is sky all around, and nothing that a shadow could fall on."""
        bare, places, share = _bare(camera) if floor else (_sky(_rays(camera)), None, None)
        self.bare = torch.as_tensor(bare, dtype=torch.float32, device=device)
        """Without shadows, (height, width, 3)."""
        self._camera, self._floor = camera, floor
        if floor:
            self._places = torch.as_tensor(places, dtype=torch.float32, device=device)
            share = torch.as_tensor(share, dtype=torch.float32, device=device)
            self._loss = DARKNESS * share[..., None] * self.bare  # what the darkest shadow takes away

    def __call__(self, shadows: Sequence[Shadow]) -> Tensor:
        """The background with these shadows, (height, width, 3) in [0, 1]."""
        if not self._floor:
            return self.bare
        cover = self.bare.new_zeros(self.bare.shape[:2])
        for shadow in shadows:
            window = self._window(shadow)
            cover[window] += shadow.look_up(self._places[window])
        # Several layers of one body above each other are hardly darker than one.
        return self.bare - self._loss * -torch.expm1(-1.8 * cover)[..., None]

    def _window(self, shadow: Shadow) -> tuple[slice, slice]:
        """The part of the picture in which the shadow's map lies."""
        pixels, depth = project(self._camera, shadow.corners())
        if (depth <= self._camera.near).any():
            return slice(None), slice(None)
        size = (self._camera.width, self._camera.height)
        (left, top), (right, bottom) = np.clip(np.floor([pixels.min(0), pixels.max(0) + 1]), 0, size).astype(int)
        return slice(top, bottom), slice(left, right)


def cast(splats: Splats) -> tuple[Shadow, ...]:
    """The shadows of the Gaussians on the floor z = 0, to be added up: one a softness, none where nothing is above it.

    A Gaussian's optical thickness falls on its footprint, the horizontal block of its covariance. Of all that is about
    equally high the share of the light that is gone is 1 - exp(-thickness), blurred by the height.
    """
    means, covariances, opacities = (t.detach().float() for t in (splats.means, splats.covariances, splats.opacities))
    rows = (means[:, 2] > 0) & (opacities > 0.02) & means.isfinite().all(1) & covariances.isfinite().all((1, 2))
    means, covariances, opacities = means[rows], covariances[rows, :2, :2], opacities[rows]
    if len(means) == 0:
        return ()
    area = 2 * math.pi * torch.linalg.det(covariances).clamp_min(0).sqrt()
    spread = covariances.diagonal(dim1=1, dim2=2).mean(1)
    edges = torch.tensor(_EDGES, device=means.device)
    softness = (SOFTNESS * means[:, 2]).clamp(_EDGES[0], _EDGES[-1])
    above = torch.searchsorted(edges[1:-1].contiguous(), softness)  # softness lies between edges `above` and the next
    share = torch.log(softness / edges[above]) / torch.log(edges[above + 1] / edges[above])
    shadows = []
    for index, sigma in enumerate(_EDGES):
        here = torch.where(above == index, 1 - share, torch.where(above == index - 1, share, 0.0))
        rows = here > 1e-3
        if rows.any():
            shadows.append(_shadow(means[rows, :2], opacities[rows] * area[rows], spread[rows], here[rows], sigma))
    return tuple(shadows)


def _shadow(places: Tensor, mass: Tensor, spread: Tensor, share: Tensor, edge: float) -> Shadow:
    """One shadow of Gaussians at `places` with their thickness summed over the floor, `mass` [m^2].

    Args:
        spread: variance of the footprints [m^2].
        share: how much of each Gaussian belongs to this shadow and not to the next softer or sharper one.
        edge: standard deviation of its edge [m].
    """
    foot = math.sqrt(float(spread.mean()))
    total = math.hypot(foot, edge)
    low, high = (places.amin(0) - 3 * total).tolist(), (places.amax(0) + 3 * total).tolist()
    width, height = high[0] - low[0], high[1] - low[1]
    cell = max(total / _FINE, math.sqrt(width * height / _CELLS))
    nx, ny = math.ceil(width / cell), math.ceil(height / cell)
    column, row = ((places - places.new_tensor(low)) / cell).long().unbind(1)
    index = row * nx + column
    whole, part = (
        _blur(torch.bincount(index, weights, nx * ny).reshape(ny, nx).float() / cell**2, foot / cell)
        for weights in (mass, mass * share)
    )
    cover = -torch.expm1(-whole) * part / whole.clamp_min(1e-12)
    return Shadow(_blur(cover, edge / cell).clamp(0, 1), (low[0], low[1]), cell)


def _blur(image: Tensor, sigma: float) -> Tensor:
    """Gaussian of `sigma` cells."""
    radius = math.ceil(3 * sigma)
    offsets = torch.arange(-radius, radius + 1, device=image.device)
    kernel = torch.softmax(-0.5 * (offsets / max(sigma, 1e-3)) ** 2, 0)
    rows = functional.conv2d(image[None, None], kernel[None, None, None, :], padding=(0, radius))
    return functional.conv2d(rows, kernel[None, None, :, None], padding=(radius, 0))[0, 0]


def _rays(camera: Camera) -> Array:
    """Directions through the middles of the pixels in the world, with a depth of 1, (height, width, 3)."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(rows)], -1)
    return local @ camera.world_to_camera[:3, :3]


def _sky(rays: Array) -> Array:
    """Lighter upwards."""
    elevation = rays[..., 2] / np.linalg.norm(rays, axis=-1)
    return _mix(HORIZON, ZENITH, _smooth_step(elevation, 0.0, 0.5))


def _bare(camera: Camera) -> tuple[Array, Array, Array]:
    """Sky and floor (height, width, 3), where the pixels lie on the floor [m] (height, width, 2), the floor's share."""
    rays = _rays(camera)
    eye = camera.position
    down = -np.sign(eye[2] or 1.0) * rays[..., 2] / np.linalg.norm(rays, axis=-1)  # towards the floor
    share = _smooth_step(np.arcsin(np.clip(down, -1, 1)), *FADE)
    depth = np.where(down > 1e-4, -eye[2] / np.where(down > 1e-4, rays[..., 2], 1.0), 0.0)
    places = np.where(down[..., None] > 1e-4, eye[:2] + depth[..., None] * rays[..., :2], 1e6)
    floor = _mix(FLOOR, LINE, _grid(camera, rays, depth, places))
    return _mix(_sky(rays), floor, share), places, share


def _grid(camera: Camera, rays: Array, depth: Array, places: Array) -> Array:
    """How much of each pixel lines cover, exact for its footprint's box: far lines become an even tone by themselves."""
    # A step to the next pixel moves the place on the floor by depth (a - b r_xy / r_z), with the step (a, b) of the ray.
    right, below = camera.world_to_camera[0, :3] / camera.fx, camera.world_to_camera[1, :3] / camera.fy
    height = np.where(np.abs(rays[..., 2]) > 1e-9, rays[..., 2], 1e-9)
    clear = np.ones(depth.shape)
    for axis in range(2):
        steps = (step[axis] - step[2] * rays[..., axis] / height for step in (right, below))
        span = np.maximum(depth * np.sqrt(sum(step**2 for step in steps)), 1e-9)
        ends = (_line_length(places[..., axis] + sign * span / 2) for sign in (1, -1))
        clear *= 1 - np.clip((next(ends) - next(ends)) / span, 0, 1)
    return 1 - clear


def _line_length(x: Array) -> Array:
    """How much of the stretch from 0 to x lies on lines at whole metres."""
    whole = np.floor(x + 0.5)
    return whole * LINE_WIDTH + np.clip(x - whole, -LINE_WIDTH / 2, LINE_WIDTH / 2)


def _mix(a: Array | Sequence[float], b: Array | Sequence[float], share: Array) -> Array:
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * share[..., None]


def _smooth_step(x: Array, low: float, high: float) -> Array:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
