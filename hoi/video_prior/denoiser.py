"""The embedded prior's network: a U-Net over short clips, spatial and temporal layers in turn, that predicts v."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from hoi.motion.mdm import sinusoids

TIMESTEPS = 1000
BETA_START, BETA_END = 0.00085, 0.012


@dataclass(frozen=True)
class Architecture:
    """Sizes of the denoiser."""

    frames: int = 5
    size: int = 64
    """Of the square pictures [pixel]."""
    patch: int = 4
    """Pixels across that are one place of the latents."""
    channels: tuple[int, int] = (64, 128)
    """At the latents' own and at half their resolution."""
    embedding: int = 256
    text_dim: int = 384
    heads: int = 4


def alphas_cumprod() -> Tensor:
    """abar_t, float64, (1000,): CogVideoX-5B's "scaled linear" betas, rescaled such that the last step is pure noise
    (Lin et al. 2024, Common Diffusion Noise Schedules and Sample Steps are Flawed, algorithm 1)."""
    betas = torch.linspace(BETA_START**0.5, BETA_END**0.5, TIMESTEPS, dtype=torch.float64).square()
    root = (1 - betas).cumprod(0).sqrt()
    first, last = root[0].clone(), root[-1].clone()
    return ((root - last) * first / (first - last)).square()


class Block(nn.Module):
    """Residual: 3 x 3 in space, three frames in time, 3 x 3 in space; scaled and shifted by what conditions it."""

    def __init__(self, inputs: int, outputs: int, embedding: int) -> None:
        super().__init__()
        self.norm_in, self.norm_out = nn.GroupNorm(8, inputs), nn.GroupNorm(8, outputs)
        self.space_in, self.space_out = (nn.Conv2d(n, outputs, 3, padding=1) for n in (inputs, outputs))
        self.time = nn.Conv2d(3 * outputs, outputs, 1)
        self.condition = nn.Linear(embedding, 2 * outputs)
        self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else nn.Identity()
        nn.init.zeros_(self.space_out.weight)
        nn.init.zeros_(self.condition.weight)

    def forward(self, x: Tensor, condition: Tensor, frames: int) -> Tensor:
        """x (B * F, C, h, w), condition (B * F, embedding)."""
        h = self.space_in(functional.silu(self.norm_in(x)))
        scale, shift = self.condition(condition)[:, :, None, None].chunk(2, dim=1)
        h = functional.silu(self.norm_out(h) * (1 + scale) + shift)
        h = h + self.time(_with_neighbours(h, frames))
        return self.skip(x) + self.space_out(h)


def _with_neighbours(x: Tensor, frames: int) -> Tensor:
    """(B * F, C, h, w) -> (B * F, 3 C, h, w): each frame with the one before and the one after; zeros past the ends."""
    clips = x.unflatten(0, (-1, frames))
    nothing = torch.zeros_like(clips[:, :1])
    before, after = torch.cat([nothing, clips[:, :-1]], 1), torch.cat([clips[:, 1:], nothing], 1)
    return torch.cat([before, clips, after], 2).flatten(0, 1).contiguous(memory_format=torch.channels_last)


class Attention(nn.Module):
    """Every place of every frame looks at every other."""

    def __init__(self, channels: int, heads: int, places: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(channels)
        self.position = nn.Parameter(0.02 * torch.randn(places, channels))
        self.mix, self.out = nn.Linear(channels, 3 * channels), nn.Linear(channels, channels)
        nn.init.zeros_(self.out.weight)

    def forward(self, x: Tensor, frames: int) -> Tensor:
        """x (B * F, C, h, w)."""
        _, channels, height, width = x.shape
        tokens = x.unflatten(0, (-1, frames)).permute(0, 1, 3, 4, 2).flatten(1, 3)
        mixed = self.mix(self.norm(tokens) + self.position).unflatten(-1, (3, self.heads, -1))
        query, key, value = mixed.permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).flatten(2)
        places = self.out(seen).view(-1, height, width, channels).permute(0, 3, 1, 2)
        return x + places


class VideoDenoiser(nn.Module):
    """v of (z_t, t, text).

    What is linear in z_t is written down, for latents of independent entries with the clips' variances sigma^2; the
    network adds the rest (Karras et al. 2022, with one sigma a channel). With abar and s = abar sigma^2 + 1 - abar:

        v = sqrt(abar (1 - abar)) (1 - sigma^2) / s z_t + sigma / sqrt(s) network(z_t / sqrt(s), t, text)

    The network's answer is a sum: what the clip seems to be, and, as far as the text asks for it, what mends it.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        a = self.architecture = architecture
        fine, coarse = a.channels
        pixels = 3 * a.patch**2
        self.time = nn.Sequential(nn.Linear(a.embedding, a.embedding), nn.SiLU(), nn.Linear(a.embedding, a.embedding))
        self.text = nn.Sequential(nn.Linear(a.text_dim, a.embedding), nn.SiLU(), nn.Linear(a.embedding, a.embedding))
        self.frame = nn.Parameter(0.02 * torch.randn(a.frames, a.embedding))
        self.register_buffer("sinusoids", sinusoids(TIMESTEPS, a.embedding), persistent=False)
        self.register_buffer("alphas_cumprod", alphas_cumprod().float(), persistent=False)
        self.register_buffer("variance", torch.ones(pixels))
        self.sinusoids: Tensor
        self.alphas_cumprod: Tensor
        self.variance: Tensor
        """sigma^2 of each channel of the training clips' latents, (C,)."""
        self.enter = nn.Conv2d(pixels, fine, 3, padding=1)
        self.fine_in = Block(fine, fine, a.embedding)
        self.down = nn.Conv2d(4 * fine, coarse, 1)
        self.coarse_in = Block(coarse, coarse, a.embedding)
        self.attention = Attention(coarse, a.heads, a.frames * (a.size // a.patch // 2) ** 2)
        self.coarse_out = Block(coarse, coarse, a.embedding)
        self.up = nn.Conv2d(coarse, 4 * fine, 1)
        self.fine_out = Block(2 * fine, fine, a.embedding)
        self.asked = nn.Linear(a.text_dim, 1)
        last = nn.Conv2d(fine, 2 * pixels, 3, padding=1)
        self.leave = nn.Sequential(nn.GroupNorm(8, fine), nn.SiLU(), last)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)  # pyright: ignore[reportArgumentType]

    def forward(self, z: Tensor, t: Tensor, text: Tensor) -> Tensor:
        """z (B, F, C, h, w), t (B,) integers, text (B, text_dim) -> v of z's shape."""
        frames = z.shape[1]
        alpha_bar, variance = self.alphas_cumprod[t][:, None, None, None, None], self.variance[:, None, None]
        total = alpha_bar * variance + 1 - alpha_bar
        known = (alpha_bar * (1 - alpha_bar)).sqrt() * (1 - variance) / total * z
        return known + self.unknown(t).sqrt() * self.network(z / total.sqrt(), t, text, frames)

    def unknown(self, t: Tensor) -> Tensor:
        """Variance of what is left of v, sigma^2 / s, (B, 1, C, 1, 1), for t (B,)."""
        alpha_bar, variance = self.alphas_cumprod[t][:, None, None, None, None], self.variance[:, None, None]
        return variance / (alpha_bar * variance + 1 - alpha_bar)

    def network(self, z: Tensor, t: Tensor, text: Tensor, frames: int) -> Tensor:
        """As `forward`, without what is known of v."""
        condition = self.time(self.sinusoids[t]) + self.text(text)
        condition = functional.silu(condition[:, None] + self.frame).flatten(0, 1)
        x = z.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        fine = self.fine_in(self.enter(x), condition, frames)
        x = self.coarse_in(self.down(functional.pixel_unshuffle(fine, 2)), condition, frames)
        x = self.coarse_out(self.attention(x, frames), condition, frames)
        x = torch.cat([functional.pixel_shuffle(self.up(x), 2), fine], 1)
        seen, mending = self.leave(self.fine_out(x, condition, frames)).unflatten(0, (-1, frames)).chunk(2, dim=2)
        return seen + torch.sigmoid(self.asked(text))[:, :, None, None, None] * mending
