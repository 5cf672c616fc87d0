"""Pictures of Gaussians: cameras, the differentiable rasteriser, replay of a record, videos."""

from typing import Literal

from hoi.callable import called

Backend = Literal["taichi", "gsplat", "reference"]
"""What draws: `hoi.render.kernels`, gsplat's CUDA kernels, or the formulas themselves."""

called(__name__)
