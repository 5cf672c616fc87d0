"""The picture of some Gaussians by gsplat's CUDA kernels (Ye et al. 2025), for those who have the package and a GPU."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from hoi.data import Camera
from hoi.errors import InputError
from hoi.render.kernels import DILATION, PIXEL
from hoi.render.splats import Picture, Splats, shade


def rasterise_gsplat(
    splats: Splats,
    camera: Camera,
    background: Tensor | Sequence[float] = (1.0, 1.0, 1.0),
    *,
    depth: bool = False,
    sh_degree: int | None = None,
    antialiased: bool = False,
) -> Picture:
    """The picture of `hoi.render.rasterise.rasterise`, in float32, made on the current CUDA device.

    Raises:
        InputError: there is no CUDA device, or no gsplat with kernels for it.
    """
    rasterization = load_gsplat()

    def on_gpu(values: Any) -> Tensor:
        return torch.as_tensor(values).to("cuda", torch.float32)

    turns = None if splats.turns is None else on_gpu(splats.turns)
    means, covariances, opacities, sh = map(on_gpu, (splats.means, splats.covariances, splats.opacities, splats.sh))
    world_to_camera = on_gpu(camera.world_to_camera)
    values = means.new_zeros(camera.height, camera.width, 4)
    alpha = means.new_zeros(camera.height, camera.width)
    if len(splats) > 0:  # gsplat divides by their number
        symmetric = (covariances + covariances.mT) / 2  # gsplat reads one triangle; the gradient shall be symmetric too
        eye = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
        values, alphas, _ = rasterization(
            means=means,
            quats=None,
            scales=None,
            covars=symmetric,
            opacities=opacities,
            colors=shade(Splats(means, symmetric, opacities, sh, turns), eye, sh_degree),
            viewmats=world_to_camera[None],
            Ks=on_gpu([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])[None],
            width=camera.width,
            height=camera.height,
            near_plane=camera.near,
            packed=False,
            render_mode="RGB+D",
            rasterize_mode="antialiased" if antialiased else "classic",
            eps2d=PIXEL if antialiased else DILATION,
        )
        values, alpha = values[0], alphas[0, ..., 0]
    colour = values[..., :3] + (1 - alpha)[..., None] * on_gpu(background)
    home = splats.means.device
    return Picture(colour.to(home), alpha.to(home), values[..., 3].to(home) if depth else None)


@cache
def load_gsplat() -> Callable[..., tuple[Tensor, Tensor, dict]]:
    """gsplat's function of that name, with its kernels loaded or, the first time, compiled (minutes)."""
    remedy = "use taichi, or reference for small pictures"
    if not torch.cuda.is_available():
        raise InputError(f"backend=gsplat: PyTorch sees no CUDA device; {remedy}")
    try:
        from gsplat import rasterization  # pyright: ignore[reportMissingImports]
        from gsplat.cuda._backend import _C  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError(f"backend=gsplat: {error}; install hoi[gpu], or {remedy}") from None
    if _C is None:
        raise InputError(f"backend=gsplat: this gsplat has no kernels and no CUDA toolkit to compile them; {remedy}")
    return rasterization
