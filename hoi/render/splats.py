"""What the rasteriser takes and gives: Gaussians as tensors, whose harmonics turn with them, and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass

import roma
import torch
from torch import Tensor

from hoi.data import GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import SH_C0, higher_harmonics


@dataclass(frozen=True)
class Splats:
    """Gaussians in the world frame. Any of the tensors may carry gradients."""

    means: Tensor
    """[m], (N, 3)."""
    covariances: Tensor
    """Sigma [m^2], symmetric, (N, 3, 3)."""
    opacities: Tensor
    """In [0, 1], (N,)."""
    sh: Tensor
    """Harmonics in the Gaussians' own frames, (N, K, 3), K in {1, 4, 9, 16}; see `hoi.gaussians`."""
    turns: Tensor | None = None
    """Rotations that took the Gaussians from those frames to the world, (N, 3, 3); None: they have not turned."""
    surface: Tensor | None = None
    """Normal and openness in the world, (N, 2, 3), see `hoi.data.GaussianCloud`: colours are albedo, until
    `hoi.render.light` lights them; None: they are as they are seen."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class Picture:
    """One view of some Gaussians over a background."""

    colour: Tensor
    """RGB as the Gaussians have it, not clipped, (height, width, 3)."""
    alpha: Tensor
    """1 minus the share of the background that is left, (height, width)."""
    depth: Tensor | None = None
    """sum_i w_i z_i, camera z accumulated with the weights of the colours [m], (height, width); divided by alpha it is
    the expected depth."""


def from_cloud(cloud: GaussianCloud, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> Splats:
    """The cloud as it stands."""
    means, quaternions, scales, opacities, sh = (
        torch.as_tensor(array, dtype=dtype, device=device)
        for array in (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.sh)
    )
    surface = None if cloud.surface is None else torch.as_tensor(cloud.surface, dtype=dtype, device=device)
    return Splats(means, covariances(quaternions, scales), opacities, sh, surface=surface)


def covariances(quaternions: Tensor, scales: Tensor) -> Tensor:
    """Sigma = R diag(scales^2) R^T, (N, 3, 3), of quaternions wxyz (N, 4), of any length, and scales (N, 3)."""
    xyzw = torch.nn.functional.normalize(quaternions, dim=-1).roll(-1, -1)
    root = roma.unitquat_to_rotmat(xyzw) * scales[..., None, :]
    return root @ root.mT


def join(parts: Sequence[Splats]) -> Splats:
    """All Gaussians of the parts as one; harmonics that a part lacks are zero. Surfaces are left out: light comes
    first."""
    if len(parts) == 1:
        return parts[0]
    bands = max(part.sh.shape[1] for part in parts)
    turns = None
    if any(part.turns is not None for part in parts):
        still = torch.eye(3, dtype=parts[0].means.dtype, device=parts[0].means.device)
        turns = torch.cat([still.expand(len(p), 3, 3) if p.turns is None else p.turns for p in parts])
    padded = [torch.nn.functional.pad(part.sh, (0, 0, 0, bands - part.sh.shape[1])) for part in parts]
    return Splats(
        means=torch.cat([part.means for part in parts]),
        covariances=torch.cat([part.covariances for part in parts]),
        opacities=torch.cat([part.opacities for part in parts]),
        sh=torch.cat(padded),
        turns=turns,
    )


def check(splats: Splats) -> None:
    """Refuses what cannot be drawn.

    Raises:
        InputError: a tensor has a wrong shape or holds a number that is not finite.
    """
    count, allowed = len(splats), {"means": [(3,)], "covariances": [(3, 3)], "opacities": [()], "turns": [(3, 3)]}
    allowed |= {"sh": [((degree + 1) ** 2, 3) for degree in range(4)], "surface": [(2, 3)]}
    for name, shapes in allowed.items():
        tensor = getattr(splats, name)
        if tensor is None:
            continue
        if tensor.shape not in [(count, *shape) for shape in shapes]:
            raise InputError(f"splats.{name}: shape {tuple(tensor.shape)}; must be {(count, *shapes[-1])}")
        if not bool(tensor.detach().sum().isfinite()):  # cheaper than to look at each, which may overflow
            broken = int((~tensor.isfinite()).reshape(count, -1).any(1).sum())
            if broken:
                raise InputError(f"splats.{name}: {broken} of {count} Gaussians are not finite; drop them first")


def sh_degree(splats: Splats) -> int:
    """Degree of the harmonics, 0 to 3."""
    return round(splats.sh.shape[1] ** 0.5) - 1


def shade(splats: Splats, eye: Tensor, degree: int | None = None) -> Tensor:
    """Colours (N, 3), not below 0, as seen from `eye` [m] (3,), with harmonics up to `degree` (default: all).

    Harmonics turn with their Gaussians: the direction is taken back into the frame in which they were fitted, which is
    the same as rotating the coefficients and much cheaper.

    Raises:
        InputError: a negative degree.
    """
    if degree is not None and degree < 0:
        raise InputError(f"sh_degree {degree}: 0 to 3 are allowed")
    degree = sh_degree(splats) if degree is None else min(degree, sh_degree(splats))
    colours = 0.5 + SH_C0 * splats.sh[:, 0]
    if degree > 0:
        directions = torch.nn.functional.normalize(splats.means - eye, dim=-1)
        if splats.turns is not None:
            directions = (directions[:, None, :] @ splats.turns)[:, 0]
        x, y, z = directions.unbind(-1)
        basis = torch.stack(higher_harmonics(x, y, z, degree), -1)
        colours = colours + (basis[:, None, :] @ splats.sh[:, 1 : (degree + 1) ** 2])[:, 0]
    return colours.clamp_min(0.0)
