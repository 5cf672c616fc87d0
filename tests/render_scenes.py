"""Small scenes of Gaussians for the tests of the rasterisers, in float64."""

import json
from dataclasses import replace

import numpy as np
import roma
import torch
from torch import Tensor
from torch.nn.functional import normalize

from hoi.data import Camera
from hoi.render.cameras import look_at
from hoi.render.splats import Picture, Splats, covariances

INPUTS = ("means", "covariances", "opacities", "sh", "turns")


def camera(width: int = 72, height: int = 48) -> Camera:
    """Looks at the origin from 3 m away, along no axis; unequal focal lengths, centre out of the middle."""
    seen = look_at((2.0, -2.0, 1.0), (0.0, 0.0, 0.0), width=width, height=height)
    return replace(seen, fx=1.1 * seen.fx, cx=seen.cx - 0.7, cy=seen.cy + 0.4)


def cameras_in(text: str) -> list[Camera]:
    """What `hoi.render.cameras.to_json` has written."""
    found = []
    for row in json.loads(text)["cameras"]:
        (fx, _, cx), (_, fy, cy), _ = row["K"]
        pose = np.array(row["world_to_camera"])
        found.append(Camera(row["width"], row["height"], fx, fy, cx, cy, pose, row["near"]))
    return found


def straight(width: int = 32, height: int = 24, focal: float = 40.0) -> Camera:
    """The camera's axes are the world's."""
    return Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))


def random_splats(
    seed: int, count: int = 300, degree: int = 0, *, spread: float = 0.4, size: float = 0.06, turned: bool = False
) -> Splats:
    """A cloud around the origin, of axes up to `size` [m] and of colours that are hardly ever cut at 0."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    higher = normal(count, (degree + 1) ** 2 - 1, 3) * 0.05
    return Splats(
        means=normal(count, 3) * spread,
        covariances=covariances(normal(count, 4), size * (0.1 + 0.9 * uniform(count, 3))),
        opacities=0.05 + 0.9 * uniform(count),
        sh=torch.cat([(uniform(count, 1, 3) - 0.5) * 2.5, higher], dim=1),
        turns=roma.unitquat_to_rotmat(normalize(normal(count, 4), dim=-1)) if turned else None,
    )


def balls(means: list, sizes: list | float, opacities: list | float, colours: list | None = None) -> Splats:
    """Round Gaussians at `means` [m], of standard deviations `sizes` [m]; grey when no colours are given."""
    count = len(means)
    one = torch.ones(count, dtype=torch.float64)
    scales = (one * torch.as_tensor(sizes, dtype=torch.float64))[:, None].expand(count, 3)
    rgb = torch.full((count, 3), 0.5) if colours is None else torch.tensor(colours, dtype=torch.float64)
    return Splats(
        means=torch.tensor(means, dtype=torch.float64).reshape(count, 3),
        covariances=torch.diag_embed(scales**2),
        opacities=one * torch.as_tensor(opacities, dtype=torch.float64),
        sh=(rgb.double()[:, None] - 0.5) / 0.28209479177387814,
    )


def to(splats: Splats, dtype: torch.dtype) -> Splats:
    """The same numbers, free of any graph, in another type."""
    turns = splats.turns
    return Splats(
        splats.means.detach().to(dtype),
        splats.covariances.detach().to(dtype),
        splats.opacities.detach().to(dtype),
        splats.sh.detach().to(dtype),
        None if turns is None else turns.detach().to(dtype),
    )


def leaves(splats: Splats) -> dict[str, Tensor]:
    """The inputs there are, made to collect gradients."""
    parts = {name: getattr(splats, name) for name in INPUTS}
    return {name: part.requires_grad_() for name, part in parts.items() if part is not None}


def weighed(picture: Picture, seed: int = 0) -> Tensor:
    """A number that depends on all of a picture: its colour, alpha and depth under random weights."""
    generator = torch.Generator().manual_seed(seed)
    planes = [picture.colour, picture.alpha[..., None]]
    if picture.depth is not None:
        planes.append(picture.depth[..., None])
    stacked = torch.cat(planes, dim=-1)
    return (stacked * torch.randn(stacked.shape, generator=generator, dtype=torch.float64).to(stacked)).sum()
