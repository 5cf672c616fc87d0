"""Small clouds, a ground, and a fist on its way, for tests of all rooms."""

import numpy as np
import torch
from numpy.typing import ArrayLike

from hoi.data import Body, GaussianCloud, Motion, Plane
from hoi.gaussians import fibonacci_sphere, sh_from_colours
from hoi.render.splats import Splats

HAND = 22


def ground(friction: float = 0.5) -> Plane:
    return Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=friction)


def cloud_of(
    means: np.ndarray, scale: float, rgb: ArrayLike = 0.5, opacity: float = 0.9, dtype: type = np.float32
) -> GaussianCloud:
    """Round Gaussians of one size, unturned, grey unless told otherwise."""
    count = len(means)
    return GaussianCloud(
        means=means.astype(dtype),
        quaternions=np.tile(np.array([1, 0, 0, 0], dtype), (count, 1)),
        scales=np.full((count, 3), scale, dtype),
        opacities=np.full(count, opacity, dtype),
        sh=sh_from_colours(np.clip(np.broadcast_to(rgb, (count, 3)), 0, 1)),
    )


def splats_of(means: np.ndarray, scale: float, sh: torch.Tensor | None = None, opacity: float = 0.9) -> Splats:
    """The same for the rasteriser."""
    count = len(means)
    sigma = scale**2 * torch.eye(3).expand(count, 3, 3)
    colours = torch.zeros(count, 1, 3) if sh is None else sh
    return Splats(torch.as_tensor(means, dtype=torch.float32), sigma, torch.full((count,), opacity), colours)


def fist(count: int = 300, radius: float = 0.05) -> Body:
    """A body whose only skin is a ball around the left hand; all joints sit at the origin of the rest frame."""
    weights = np.zeros((count, 24))
    weights[:, HAND] = 1
    cloud = cloud_of(radius * fibonacci_sphere(count), 0.005, opacity=1, dtype=np.float64)
    return Body("fist", cloud, weights, np.zeros((24, 3)))


def carried(start: ArrayLike, velocity: ArrayLike, frames: int, fps: float) -> Motion:
    """A body carried along a line [m, m/s], unturned."""
    path = np.asarray(start, float) + np.arange(frames)[:, None] / fps * np.asarray(velocity, float)
    return Motion(path, np.tile([1.0, 0, 0, 0, 1, 0], (frames, 1)), np.zeros((frames, 23, 3)), fps)
