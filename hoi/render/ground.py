"""What stands behind the Gaussians: a ground, a sky, and soft shadows.

The sky is a large light straight overhead. Its shadow therefore lies exactly below what casts it, and it is the softer
and the fainter the higher that is: this is what lets heights be read off a picture. The key light of `hoi.render.light`
adds a sharper one. The plain ground is light, with a metre grid; the others are those of `hoi.render.places`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hoi.data import Array, Camera
from hoi.render import Ground
from hoi.render.cameras import project
from hoi.render.light import Light
from hoi.render.places import PLACES, pattern_at
from hoi.render.splats import Splats

FLOOR, LINE, HORIZON, ZENITH = 0.909, 0.842, 0.961, 0.99
"""Greys as they are shown: the floor fades into the horizon, the horizon into the sky above. A hint of a colour would
become a cast in a video, whose chroma is rounded to 8 bits."""
LINE_WIDTH = 0.016
"""Of the lines of the grid, which lie at whole metres [m]."""
FADE = (math.radians(0.3), math.radians(7.0))
"""How far below the horizon the floor begins to show and shows fully."""
DARKNESS = 0.52
"""Share of its light that a covered floor loses."""
SOFTNESS = 0.13
"""Standard deviation of the shadow's edge a metre of height [-]: the light's angular size."""
SKY_DARKNESS = 0.40
"""The same of the sky's light beside a key light."""
KEY_SOFTNESS = 0.045
EDGES = (0.012, 0.03, 0.065, 0.14, 0.3)
"""Standard deviations of the edges that are mixed to any softness between [m]."""
_SKY_EDGES, _KEY_EDGES = (0.02, 0.08, 0.3), (0.018, 0.08)
"""The same of two lights, which hide each other's steps."""
COARSE = 2
"""Pixels from one place where shadows are looked up to the next: they are softer than that."""
_FINE = 2.5  # cells of a shadow's map in a standard deviation
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
_GRAZING = 1e-4  # rays that are more level than this do not reach the floor
_CELLS = 1_000_000  # in one map at most, where a part is spread out very far
_FAR, _WIDE = 500.0, 0.3  # what is further away casts nothing, and no footprint is taken for wider [m]
_CASTERS = 6000
"""From twice as many Gaussians on only every second, third, ... casts a shadow, for itself and those left out."""


@dataclass(frozen=True)
class Beam:
    """A light on the floor."""

    towards: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit direction to it."""
    softness: float = SOFTNESS
    darkness: float = DARKNESS
    edges: tuple[float, ...] = EDGES


def beams(light: Light | None) -> tuple[Beam, ...]:
    """The lights that shadows are cast by: the sky and, in a light, its key light; what that gives the floor is shown
    by the root of what is left."""
    if light is None:
        return (Beam(),)
    key = light.key * light.direction[2]
    rest = light.horizon + (light.zenith - light.horizon) * 2 / 3
    return (
        Beam(darkness=SKY_DARKNESS, edges=_SKY_EDGES),
        Beam(light.direction, KEY_SOFTNESS, 1 - (rest / (rest + key)) ** (1 / 2.2), _KEY_EDGES),
    )


@dataclass(frozen=True)
class Shadow:
    """How much of the light some Gaussians take from the floor around them."""

    cover: Tensor
    """0 to 1, rows along y and columns along x, (ny, nx)."""
    low: tuple[float, float]
    """Where the outer corner of the first cell lies, x and y [m]."""
    cell: float
    """[m]"""
    darkness: float = DARKNESS
    """Share of its light that the floor loses where it is covered."""

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

    def __init__(
        self,
        camera: Camera,
        *,
        floor: bool = True,
        ground: Ground = Ground.plain,
        device: torch.device | str = "cpu",
    ) -> None:
        """Without a `floor` at z = 0 there is sky all around, and nothing that a shadow could fall on."""
        rays = _rays(camera, device)
        colour = _sky(rays, ground)
        if floor:
            lit, share, places = _floor(camera, rays, ground)
            colour = _mix(colour, lit, share[..., None])
            blocks = functional.avg_pool2d(places[None], COARSE, ceil_mode=True)[0]
            self._places = blocks.permute(1, 2, 0).contiguous()
            self._share = share
        self.colour = colour
        """Without shadows, (height, width, 3)."""
        self._camera, self._floor = camera, floor

    def __call__(self, shadows: Sequence[Shadow]) -> Tensor:
        """The background with these shadows, (height, width, 3) in [0, 1]."""
        colour = self.colour.clone()
        if not self._floor:
            return colour
        height, width = self._share.shape
        for darkness in dict.fromkeys(shadow.darkness for shadow in shadows):
            layers = [(shadow, self._window(shadow)) for shadow in shadows if shadow.darkness == darkness]
            rows, columns = (
                slice(min(side.start for side in sides), max(side.stop for side in sides))
                for sides in zip(*(window for _, window in layers), strict=True)
            )
            cover = torch.zeros_like(self._places[..., 0])
            for shadow, window in layers:
                cover[window] += shadow.look_up(self._places[window])
            cover = cover[rows, columns]
            if not cover.numel():
                continue
            # Several layers of one body above each other are hardly darker than one.
            loss = torch.expm1(-1.8 * cover)[None, None]
            loss = functional.interpolate(loss, scale_factor=COARSE, mode="bilinear", align_corners=False)[0, 0]
            top, left = rows.start * COARSE, columns.start * COARSE
            loss = darkness * loss[: height - top, : width - left]
            around = (slice(top, top + loss.shape[0]), slice(left, left + loss.shape[1]))
            colour[around] *= 1 + (self._share[around] * loss)[..., None]
        return colour

    def _window(self, shadow: Shadow) -> tuple[slice, slice]:
        """The part of `_places` in which the shadow's map lies."""
        pixels, depth = project(self._camera, shadow.corners())
        size = self._places.shape[1::-1]
        if (depth <= self._camera.near).any():
            return slice(0, size[1]), slice(0, size[0])
        (left, top), (right, bottom) = np.clip(
            np.floor([pixels.min(0) / COARSE, pixels.max(0) / COARSE + 1]), 0, size
        ).astype(int)
        return slice(top, bottom), slice(left, right)


@torch.no_grad()
def cast(splats: Splats, beam: Beam = Beam()) -> tuple[Shadow, ...]:
    """The shadows of the Gaussians on the floor z = 0, to be added up: one a softness, none where nothing is above it.

    In a light from aside each falls along it, as if the Gaussian stood straight above that place. A Gaussian's
    optical thickness falls on its footprint, the horizontal block of its covariance. Of all that is about equally
    high the share of the light that is gone is 1 - exp(-thickness), blurred by the height.
    """
    step = max(1, len(splats) // _CASTERS)
    means, sigma, opacities = (t[::step].float() for t in (splats.means, splats.covariances, splats.opacities))
    xx, xy, yy, xz, yz, zz = (sigma[:, row, column] for row, column in _ENTRIES)
    x, y, height = means.unbind(1)
    if beam.towards[2] < 1:  # slid along the light onto the floor
        a, b = (-along / beam.towards[2] for along in beam.towards[:2])
        x, y = x + a * height, y + b * height
        xx, xy, yy = xx + a * (2 * xz + a * zz), xy + a * yz + b * (xz + a * zz), yy + b * (2 * yz + b * zz)
    area = 2 * math.pi * step * (xx * yy - xy * xy).clamp_min(0).sqrt()
    table = torch.stack([x, y, height, opacities * area, step * (xx + yy) / 2])
    near = (x.abs() < _FAR) & (y.abs() < _FAR)
    rows = torch.nonzero((height > 0) & (opacities > 0.02) & near & table.sum(0).isfinite())[:, 0]
    if len(rows) == 0:
        return ()
    table = table if len(rows) == table.shape[1] else table[:, rows]
    edges = table.new_tensor(beam.edges)
    softness = (beam.softness / beam.towards[2] * table[2]).clamp(beam.edges[0], beam.edges[-1])
    lower = torch.bucketize(softness, edges[1:-1])  # softness lies between edges `lower` and `lower + 1`
    share = torch.log(softness / edges[lower]) / torch.log(edges[lower + 1] / edges[lower])
    shadows = []
    for index, edge in enumerate(beam.edges):
        rows = torch.nonzero((lower == index) | (lower == index - 1))[:, 0]
        if len(rows):
            x, y, _, mass, spread = table[:, rows]
            part = torch.where(lower[rows] == index, 1 - share[rows], share[rows])
            shadows.append(_shadow(torch.stack([x, y], 1), mass, spread, part, edge, beam.darkness))
    return tuple(shadows)


def _shadow(places: Tensor, mass: Tensor, spread: Tensor, share: Tensor, edge: float, darkness: float) -> Shadow:
    """One shadow of Gaussians at `places` with their thickness summed over the floor, `mass` [m^2].

    Args:
        spread: variance of the footprints [m^2].
        share: how much of each Gaussian belongs to this shadow and not to the next softer or sharper one.
        edge: standard deviation of its edge [m].
    """
    foot = math.sqrt(float(spread.clamp(0, _WIDE**2).mean()))
    total = math.hypot(foot, edge)
    low, high = (places.amin(0) - 3 * total).tolist(), (places.amax(0) + 3 * total).tolist()
    width, height = high[0] - low[0], high[1] - low[1]
    cell = max(total / _FINE, math.sqrt(width * height / _CELLS))
    nx, ny = math.ceil(width / cell), math.ceil(height / cell)
    column, row = ((places - places.new_tensor(low)) / cell).long().unbind(1)
    index = row * nx + column
    image = torch.stack([torch.bincount(index, weights, nx * ny) for weights in (mass, mass * share)])
    whole, part = _blur(image.reshape(2, ny, nx).float() / cell**2, foot / cell)
    cover = -torch.expm1(-whole) * part / whole.clamp_min(1e-12)
    return Shadow(_blur(cover[None], edge / cell)[0].clamp(0, 1), (low[0], low[1]), cell, darkness)


def _blur(images: Tensor, sigma: float) -> Tensor:
    """Gaussian of `sigma` cells, of images (n, height, width)."""
    radius = math.ceil(3 * sigma)
    offsets = torch.arange(-radius, radius + 1, device=images.device)
    kernel = torch.softmax(-0.5 * (offsets / max(sigma, 1e-3)) ** 2, 0)
    rows = functional.conv2d(images[:, None], kernel[None, None, None, :], padding=(0, radius))
    return functional.conv2d(rows, kernel[None, None, :, None], padding=(radius, 0))[:, 0]


def _rays(camera: Camera, device: torch.device | str) -> Tensor:
    """Unit directions through the middles of the pixels in the world, (3, height, width): channels first, for speed."""
    x = (torch.arange(camera.width, device=device) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height, device=device) + 0.5 - camera.cy) / camera.fy
    right, down, forward = torch.as_tensor(camera.world_to_camera[:3, :3], dtype=torch.float32, device=device)
    rays = right[:, None, None] * x + down[:, None, None] * y[:, None] + forward[:, None, None]
    return rays / torch.sqrt(1 + x**2 + y[:, None] ** 2)


def _sky(rays: Tensor, ground: Ground) -> Tensor:
    """Lighter or bluer upwards, (height, width, 3)."""
    low, high = (
        ((HORIZON,) * 3, (ZENITH,) * 3) if ground is Ground.plain else (PLACES[ground].horizon, PLACES[ground].zenith)
    )
    return _between(low, high, _smooth_step(rays[2], 0.0, 0.5))


def _floor(camera: Camera, rays: Tensor, ground: Ground) -> tuple[Tensor, Tensor, Tensor]:
    """Its colour (height, width, 3), its share of each pixel, (height, width), and where the pixels lie on it [m],
    (2, height, width)."""
    eye = torch.as_tensor(camera.position, dtype=torch.float32, device=rays.device)
    towards = -rays[2] * (1.0 if eye[2] >= 0 else -1.0)
    distance = abs(eye[2]) / towards.clamp_min(_GRAZING)
    places = eye[:2, None, None] + distance * rays[:2]
    share = _smooth_step(towards, math.sin(FADE[0]), math.sin(FADE[1]))
    spans = _spans(camera, rays, distance)
    if ground is Ground.plain:
        return _between((FLOOR,) * 3, (LINE,) * 3, _lines(places, spans, 1.0, LINE_WIDTH)), share, places
    place = PLACES[ground]
    tone = pattern_at(ground, places, torch.sqrt(spans[0] * spans[1]))
    colour = _between(place.dark, place.light, tone).clamp(0, 1)
    drawn = _lines(places, spans, place.line_every, place.line_width)[..., None]
    return _mix(colour, places.new_tensor(place.line), drawn), share, places


def _spans(camera: Camera, rays: Tensor, distance: Tensor) -> list[Tensor]:
    """How wide a pixel's footprint on the floor is along x and along y [m], (height, width) each."""
    axes = torch.as_tensor(camera.world_to_camera[:3, :3], dtype=torch.float32, device=rays.device)
    # From a pixel to the next, at depth 1, the ray moves by a step that leaves the floor; sliding back onto it along
    # the ray takes step_z / ray_z of the ray.
    depth = distance * (axes[2, :, None, None] * rays).sum(0)
    upright = rays[2].abs().clamp_min(_GRAZING) * rays[2].sign()
    spans = []
    for axis in range(2):
        right, down = (
            (axes[row, axis] - axes[row, 2] * rays[axis] / upright) / focal
            for row, focal in ((0, camera.fx), (1, camera.fy))
        )
        spans.append((depth * torch.hypot(right, down)).clamp_min(1e-6))
    return spans


def _lines(places: Tensor, spans: Sequence[Tensor], every: float, width: float) -> Tensor:
    """How much of each pixel the lines of a grid cover, exact for a footprint's box: far ones become an even tone by
    themselves."""
    clear = torch.ones_like(spans[0])
    for place, span in zip(places, spans, strict=True):
        length = _line_length(place + span / 2, every, width) - _line_length(place - span / 2, every, width)
        clear *= 1 - (length / span).clamp(0, 1)
    return 1 - clear


def _line_length(x: Tensor, every: float, width: float) -> Tensor:
    """How much of the stretch from 0 to x lies on lines at multiples of `every`."""
    whole = torch.floor(x / every + 0.5)
    return whole * width + (x - whole * every).clamp(-width / 2, width / 2)


def _between(low: Sequence[float], high: Sequence[float], share: Tensor) -> Tensor:
    """Colours (height, width, 3)."""
    first, last = share.new_tensor(low), share.new_tensor(high)
    return first + (last - first) * share[..., None]


def _mix(a: float | Tensor, b: float | Tensor, share: Tensor) -> Tensor:
    return a + (b - a) * share


def _smooth_step(x: Tensor, low: float, high: float) -> Tensor:
    t = ((x - low) / (high - low)).clamp(0, 1)
    return t * t * (3 - 2 * t)
