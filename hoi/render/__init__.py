"""Pictures of Gaussians: cameras, the differentiable rasteriser, replay of a record, videos."""

from enum import StrEnum
from typing import Literal

from hoi.callable import called

Backend = Literal["taichi", "gsplat", "reference"]
"""What draws: `hoi.render.kernels`, gsplat's CUDA kernels, or the formulas themselves."""


class Ground(StrEnum):
    """What the person stands on, see `hoi.render.places`."""

    plain = "plain"
    grass = "grass"
    court = "court"
    gym = "gym"


called(__name__)
