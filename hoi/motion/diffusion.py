"""Diffusion of motions: cosine schedule, forward noising, classifier-free guidance, ancestral and DDIM sampling.

As STMC has it (Petrovich et al. 2024, after Nichol & Dhariwal 2021); indices t = 0 .. timesteps - 1, t = 0 is already
slightly noised.
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor


def cosine_alphas_cumprod(timesteps: int, offset: float = 0.008, max_beta: float = 0.999) -> Tensor:
    """abar_t = prod_{k <= t} (1 - beta_k) of the cosine schedule, float64, (timesteps,)."""
    grid = torch.arange(timesteps + 1, dtype=torch.float64) / timesteps
    curve = torch.cos((grid + offset) / (1 + offset) * math.pi / 2).square()
    betas = (1 - curve[1:] / curve[:-1]).clamp(0, max_beta)
    return (1 - betas).cumprod(0)


def q_sample(x0: Tensor, t: Tensor, noise: Tensor, alphas_cumprod: Tensor) -> Tensor:
    """x_t = sqrt(abar_t) x0 + sqrt(1 - abar_t) eps, for x0 (B, T, F) and t (B,)."""
    abar = alphas_cumprod.to(x0)[t][:, None, None]
    return abar.sqrt() * x0 + (1 - abar).sqrt() * noise


def guide(unconditional: Tensor, conditional: Tensor, guidance: float, rescale: float = 0.0) -> Tensor:
    """Classifier-free guidance: uncond + g (cond - uncond).

    With `rescale` phi the result's spread is brought back by the share phi to the conditional one's, which a large g
    overshoots (Lin et al. 2024, Common Diffusion Noise Schedules and Sample Steps are Flawed, section 3.4).
    """
    guided = unconditional + guidance * (conditional - unconditional)
    if rescale == 0:
        return guided
    axes = tuple(range(1, guided.ndim))
    spread = conditional.std(axes, keepdim=True) / guided.std(axes, keepdim=True)
    return guided * (rescale * spread + 1 - rescale)


def posterior(x0: Tensor, x_t: Tensor, t: int, alphas_cumprod: Tensor) -> tuple[Tensor, float]:
    """Mean and variance of q(x_{t-1} | x_t, x0), for t >= 1 (Ho et al. 2020, eq. 7)."""
    abar, previous = float(alphas_cumprod[t]), float(alphas_cumprod[t - 1])
    beta = 1 - abar / previous
    mean = (math.sqrt(previous) * beta * x0 + math.sqrt(1 - beta) * (1 - previous) * x_t) / (1 - abar)
    return mean, beta * (1 - previous) / (1 - abar)


Generators = torch.Generator | Sequence[torch.Generator]
"""Of the noise, on the CPU, so that every device draws the same: one, or one a row, whose rows are then the same in
whatever batch."""


def _noise(shape: tuple[int, int, int], generators: Generators) -> Tensor:
    if isinstance(generators, torch.Generator):
        return torch.randn(shape, generator=generators)
    return torch.stack([torch.randn(shape[1:], generator=each) for each in generators])


def _times(timesteps: int, steps: int | None) -> list[int]:
    """Evenly spaced timesteps, the last first, 0 last; all of them for None."""
    steps = timesteps if steps is None else steps
    if not 1 <= steps <= timesteps:
        raise ValueError(f"steps must be in [1, {timesteps}], got {steps}")
    return torch.linspace(timesteps - 1, 0, steps).round().int().tolist()


@torch.no_grad()
def ancestral_sample(
    predict_x0: Callable[[Tensor, Tensor], Tensor],
    shape: tuple[int, int, int],
    alphas_cumprod: Tensor,
    generators: Generators,
    steps: int | None = None,
    device: torch.device | str = "cpu",
    stmc_compat_sigma: bool = False,
) -> Tensor:
    """Sample x0 (B, T, F) from noise, with fresh noise at every step.

    Args:
        predict_x0: (x_t (B, T, F), t (B,)) -> x0, guidance included.
        shape: (B, T, F).
        alphas_cumprod: abar, (timesteps,).
        generators: of the noise.
        steps: predictions, at evenly spaced timesteps from the last to 0; None: at every timestep.
        device: where x lives.
        stmc_compat_sigma: scale the noise by the posterior *variance*, as the published code does, not by its root.
    """
    times = _times(len(alphas_cumprod), steps)
    kept = alphas_cumprod[times[::-1]]  # the schedule of the steps taken
    x = _noise(shape, generators).to(device)
    for at, t in zip(range(len(times) - 1, -1, -1), times, strict=True):
        x0 = predict_x0(x, torch.full(shape[:1], t, device=device))
        if at == 0:
            return x0
        mean, variance = posterior(x0, x, at, kept)
        sigma = variance if stmc_compat_sigma else math.sqrt(variance)
        x = mean + sigma * _noise(shape, generators).to(device)
    raise AssertionError("unreachable: there is at least one step")


@torch.no_grad()
def ddim_sample(
    predict_x0: Callable[[Tensor, Tensor], Tensor],
    shape: tuple[int, int, int],
    alphas_cumprod: Tensor,
    generators: Generators,
    steps: int | None = None,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Sample x0 (B, T, F) from noise along the deterministic path (Song et al. 2021, DDIM, eta = 0).

    The arguments are those of `ancestral_sample`.
    """
    times = _times(len(alphas_cumprod), steps)
    x = _noise(shape, generators).to(device)
    for t, following in zip(times, [*times[1:], None], strict=True):
        x0 = predict_x0(x, torch.full(shape[:1], t, device=device))
        if following is None:
            return x0
        abar, after = float(alphas_cumprod[t]), float(alphas_cumprod[following])
        noise = (x - math.sqrt(abar) * x0) / math.sqrt(1 - abar)
        x = math.sqrt(after) * x0 + math.sqrt(1 - after) * noise
    raise AssertionError("unreachable: there is at least one step")
