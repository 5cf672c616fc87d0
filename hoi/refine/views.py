"""Where stage 3 and the training of its prior look from: a ring of cameras around what matters, and what is behind it.

The prior judges what it has learned to see, so that its training clips are seen through this module too.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hoi.data import Array
from hoi.errors import InputError
from hoi.render.cameras import CIRCLE_ELEVATION, FOV_Y, Camera, look_at
from hoi.render.ground import Backdrop

STEEP = 0.1
"""Sine of the angle from the vertical below which a normal has no sides of its own."""


@dataclass(frozen=True)
class Framing:
    """What a picture shows: a ball, touching the picture's shorter sides in the plane through its centre."""

    centre: Array
    """In the world [m], (3,)."""
    radius: float
    """[m]."""


def viewpoint(
    framing: Framing,
    azimuth: float,
    elevation: float = CIRCLE_ELEVATION,
    *,
    width: int,
    height: int,
    distance: float | None = None,
) -> Camera:
    """The camera that looks at the framing's centre from one direction.

    Args:
        azimuth: of the camera seen from the centre [rad]: 0 at +X, counter-clockwise seen from above.
        elevation: above the horizon of the centre [rad].
        distance: from the centre [m], at which the picture opens as far as the framing takes; default: where it opens
            by `hoi.render.cameras.FOV_Y` along its shorter side.

    Raises:
        InputError: a radius, distance or elevation that is not allowed, or as `hoi.render.cameras.look_at`.
    """
    if not abs(elevation) < math.pi / 2:
        raise InputError(f"camera elevation {elevation:g} rad: between -pi/2 and pi/2 is allowed")
    level = math.cos(elevation)
    away = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    return _looking(framing, away, width, height, distance)


def _looking(framing: Framing, away: Array, width: int, height: int, distance: float | None) -> Camera:
    """From the unit direction `away` of the framing's centre, (3,); see `viewpoint`."""
    if not (math.isfinite(framing.radius) and framing.radius > 0):
        raise InputError(f"framing radius {framing.radius:g} m: a positive number is allowed")
    if distance is None:
        distance = framing.radius / math.tan(FOV_Y / 2)
    if not (math.isfinite(distance) and distance > 0):
        raise InputError(f"camera distance {distance:g} m: a positive number is allowed")
    fov_y = 2 * math.atan(framing.radius / distance * height / min(width, height))
    return look_at(framing.centre + distance * away, framing.centre, width=width, height=height, fov_y=fov_y)


def ring(
    framing: Framing,
    count: int = 100,
    elevation: float = CIRCLE_ELEVATION,
    *,
    width: int,
    height: int,
    distance: float | None = None,
) -> list[Camera]:
    """`count` viewpoints evenly spaced on a circle at one elevation (paper, Video-SDS Details).

    The first stands in front of a person who starts (+Y); the others follow counter-clockwise seen from above.

    Raises:
        InputError: `count` below 1, or as `viewpoint`.
    """
    if count < 1:
        raise InputError(f"ring of {count} cameras: at least 1 viewpoint is allowed")
    turns = math.pi / 2 + 2 * math.pi / count * np.arange(count)
    return [viewpoint(framing, float(t), elevation, width=width, height=height, distance=distance) for t in turns]


def edge_on(
    framing: Framing,
    normal: Array,
    count: int,
    elevation: float = CIRCLE_ELEVATION,
    *,
    width: int,
    height: int,
    distance: float | None = None,
) -> list[Camera]:
    """`count` viewpoints that look along the surface at the contact, half of them from either side.

    Seen so, a limb that only touches covers nothing of a flat object, from wherever else it may. The directions turn
    about the normal (3,), from level to twice the elevation.

    Raises:
        InputError: `count` below 1, or as `viewpoint`.
    """
    if count < 1:
        raise InputError(f"{count} cameras: at least 1 viewpoint is allowed")
    if not abs(elevation) < math.pi / 2:
        raise InputError(f"camera elevation {elevation:g} rad: between -pi/2 and pi/2 is allowed")
    normal = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    level = np.cross(normal, (0.0, 0.0, 1.0))
    if np.linalg.norm(level) < STEEP:  # of a floor, every level direction is along it
        level = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    level /= np.linalg.norm(level)
    rising = np.cross(level, normal)
    rising *= 1.0 if rising[2] >= 0 else -1.0
    half = math.ceil(count / 2)
    angles = 2 * elevation * (np.arange(count) % half + 0.5) / half
    sides = np.where(np.arange(count) < half, 1.0, -1.0)
    aways = np.cos(angles)[:, None] * sides[:, None] * level + np.sin(angles)[:, None] * rising
    return [_looking(framing, away, width, height, distance) for away in aways]


def background(camera: Camera, *, floor: bool = True, device: torch.device | str = "cpu") -> Tensor:
    """What the camera sees behind the Gaussians: floor and sky without shadows, (height, width, 3) in [0, 1]."""
    return Backdrop(camera, floor=floor, device=device)(())
