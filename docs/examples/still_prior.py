"""A video prior of one's own: it believes that nothing ever moves, and knows nothing else."""

import torch
from torch import Tensor

from hoi.motion.diffusion import cosine_alphas_cumprod


class StillPrior:
    """Every clip's clean latents are its own mean over time."""

    name = "still"
    alphas_cumprod = cosine_alphas_cumprod(1000)
    size = (48, 48)
    crop = 0.3
    sees_silhouettes = True

    def prepare(self, prompt: str, negative_prompt: str) -> None:
        """It cannot read."""

    def clip_frames(self, first: int, last: int, total: int) -> list[int]:
        return list(range(max(first - 1, 0), min(last + 2, total)))

    def encode(self, video: Tensor, changing: slice = slice(None)) -> Tensor:
        return 2 * video - 1

    def velocity(self, latents: Tensor, t: int, guidance: float, rescale: float = 0.0) -> Tensor:
        """v such that sqrt(abar) z_t - sqrt(1 - abar) v is the mean."""
        alpha_bar = self.alphas_cumprod[t].to(latents)
        still = (latents / alpha_bar.sqrt()).mean(dim=0, keepdim=True).expand_as(latents)
        return (alpha_bar.sqrt() * latents - still) / (1 - alpha_bar).sqrt()


def pull(clip: Tensor, t: int = 300, seed: int = 0) -> Tensor:
    """What one estimate of Video-SDS with this prior does to a clip (F, 3, 48, 48): minus its gradient."""
    from hoi.method.video_sds import distil

    prior = StillPrior()
    video = clip.clone().requires_grad_()
    noise = torch.randn(clip.shape, generator=torch.Generator().manual_seed(seed), dtype=clip.dtype)
    distil(prior.encode(video), noise, t, prior, guidance=1.0).loss.backward()
    assert video.grad is not None
    return -video.grad
