"""The picture of some Gaussians straight from the formulas: every pixel times every Gaussian, in float64.

Slow, and there to judge the fast rasterisers by. Gradients are autograd's own. Conventions are gsplat 1.5's: EWA
splatting (Zwicker et al. 2001) with the thresholds of 3DGS (Kerbl et al. 2023). All cut-offs (near plane, `MIN_ALPHA`,
`MIN_TRANSMITTANCE`) and the order in depth are steps, through which no gradient flows.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from hoi.data import Camera
from hoi.render.splats import Picture, Splats, shade

BLUR, PIXEL = 0.3, 0.1
"""Added to the diagonal of each projected covariance [px^2], the second if antialiased: no Gaussian falls between
pixels."""
LEAST_SHARE = 2.5e-5
"""Of the determinant before the blur in that after it that `antialiased` takes into account."""
MAX_ALPHA = 0.999
MIN_ALPHA = 1 / 255
"""A Gaussian weaker than this at a pixel is skipped there."""
MIN_TRANSMITTANCE = 1e-4
"""A pixel is done before the Gaussian that would take its transmittance to this or lower."""
JACOBIAN_MARGIN = 0.3
"""x / z and y / z in the Jacobian end this share of half the picture beyond its edges."""

_PAIRS = 2**18
"""Pixels times Gaussians at once, so that memory does not grow with the picture."""


def rasterise_reference(
    splats: Splats,
    camera: Camera,
    background: Tensor | Sequence[float] = (1.0, 1.0, 1.0),
    *,
    depth: bool = False,
    sh_degree: int | None = None,
    antialiased: bool = False,
) -> Picture:
    """The picture of `hoi.render.rasterise.rasterise`, in float64 on the splats' device.

    A Gaussian whose projected covariance is not positive definite, as rounding can make it, is left out.
    """
    device = splats.means.device
    pose = torch.as_tensor(camera.world_to_camera, dtype=torch.float64, device=device)
    distances = (splats.means.detach().double() @ pose[:3, :3].T + pose[:3, 3])[:, 2]
    order = torch.argsort(distances, stable=True)
    order = order[distances[order] >= camera.near]
    arrays = (splats.means, splats.covariances, splats.opacities, splats.sh)
    means, covariances, opacities, sh = (array.double()[order] for array in arrays)
    turns = None if splats.turns is None else splats.turns.double()[order]
    seen = Splats(means, covariances, opacities, sh, turns)
    centres, spreads, depths = _project(seen, camera, pose, PIXEL if antialiased else BLUR)
    xx, xy, yy = spreads[:, 0, 0], spreads[:, 0, 1], spreads[:, 1, 1]
    determinants = xx * yy - xy * xy
    definite = (determinants > 0) & (xx > 0)
    conics = torch.stack([yy, -xy, xx], dim=-1) / determinants[:, None]
    if antialiased:
        sharp = (xx - PIXEL) * (yy - PIXEL) - xy * xy
        seen = replace(seen, opacities=seen.opacities * (sharp / determinants).clamp_min(LEAST_SHARE).sqrt())
    colours = shade(seen, torch.as_tensor(camera.position, dtype=torch.float64, device=device), sh_degree)
    values = torch.cat([colours, depths[:, None]], dim=1)

    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).to(device, torch.float64) + 0.5
    gaussians = [part[definite] for part in (centres, conics, seen.opacities, values)]
    chunks = [
        checkpoint(_blend, chunk, *gaussians, use_reentrant=False)
        for chunk in pixels.split(max(1, _PAIRS // max(1, len(order))))
    ]
    size = (camera.height, camera.width)
    sums, transmittance = (torch.cat(part).unflatten(0, size) for part in zip(*chunks, strict=True))
    behind = torch.as_tensor(background, dtype=torch.float64, device=device)
    return Picture(
        colour=sums[..., :3] + transmittance[..., None] * behind,
        alpha=1 - transmittance,
        depth=sums[..., 3] if depth else None,
    )


def _project(splats: Splats, camera: Camera, pose: Tensor, blur: float) -> tuple[Tensor, Tensor, Tensor]:
    """Centres [pixel] (N, 2), covariances [pixel^2] (N, 2, 2) and camera z [m] (N,): EWA's local affine projection."""
    points = splats.means @ pose[:3, :3].T + pose[:3, 3]
    x, y, z = points.unbind(-1)
    centres = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], dim=-1)
    root = _jacobian(points, camera) @ pose[:3, :3]
    symmetric = (splats.covariances + splats.covariances.mT) / 2
    return centres, root @ symmetric @ root.mT + blur * torch.eye(2, dtype=pose.dtype, device=pose.device), z


def _jacobian(points: Tensor, camera: Camera) -> Tensor:
    """d pixel / d point, (N, 2, 3), of camera points (N, 3) [m]; x / z and y / z held near the picture."""
    x, y, z = points.unbind(-1)
    slopes = []
    for ratio, size, focal, principal in (
        (x / z, camera.width, camera.fx, camera.cx),
        (y / z, camera.height, camera.fy, camera.cy),
    ):
        margin = JACOBIAN_MARGIN * 0.5 * size / focal
        slopes.append(ratio.clamp(-(principal / focal + margin), (size - principal) / focal + margin))
    zero = torch.zeros_like(z)
    across = torch.stack([camera.fx / z, zero, -camera.fx * slopes[0] / z], dim=-1)
    down = torch.stack([zero, camera.fy / z, -camera.fy * slopes[1] / z], dim=-1)
    return torch.stack([across, down], dim=-2)


def _blend(pixels: Tensor, centres: Tensor, conics: Tensor, opacities: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """sum_i w_i v_i (P, C), and what is left of the background (P,), at pixels (P, 2) of Gaussians from the nearest on.

    w_i = alpha_i T_i with T_i = prod_{j < i} (1 - alpha_j). Conics a, b, c: a x^2 + 2 b x y + c y^2 = x^T Sigma^-1 x.
    """
    dx, dy = (pixels[:, None, :] - centres).unbind(-1)
    a, b, c = conics.unbind(-1)
    power = 0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy)
    alphas = (opacities * torch.exp(-power)).clamp_max(MAX_ALPHA)
    alphas = torch.where(alphas < MIN_ALPHA, 0.0, alphas)
    alphas = torch.where(torch.cumprod(1 - alphas, dim=1) <= MIN_TRANSMITTANCE, 0.0, alphas)
    after = torch.cumprod(torch.nn.functional.pad(1 - alphas, (1, 0), value=1.0), dim=1)
    return (alphas * after[:, :-1]) @ values, after[:, -1]
