"""The denoiser: a transformer over [time, text, registers, frames] that predicts the clean motion.

Names and shapes of the state dict are those of the published STMC "MDM-SMPL" (Petrovich et al. 2024; MDM: Tevet et al.
2022), so that its weights load strictly; the sizes are free.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Architecture:
    """Sizes of the denoiser."""

    features: int = 205
    text_dim: int = 512
    latent_dim: int = 512
    ff_size: int = 2048
    layers: int = 8
    heads: int = 8
    registers: int = 2


def sinusoids(length: int, dim: int) -> Tensor:
    """Positional encoding (length, dim): sine at even, cosine at odd entries, base 10000."""
    position = torch.arange(length)[:, None]
    rate = torch.exp(torch.arange(0, dim, 2) * (-math.log(10000.0) / dim))
    table = torch.zeros(length, dim)
    table[:, 0::2] = torch.sin(position * rate)
    table[:, 1::2] = torch.cos(position * rate)
    return table


class TimestepEncoder(nn.Module):
    """MLP of the sinusoid of t."""

    def __init__(self, dim: int):
        super().__init__()
        self.time_embed = nn.Sequential(nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, dim))

    def forward(self, rows: Tensor) -> Tensor:
        return self.time_embed(rows)


class MotionDenoiser(nn.Module):
    """x0 of (x_t, t, text), all normalised."""

    positions: Tensor

    def __init__(self, architecture: Architecture, token_dropout: float = 0.0, max_length: int = 5000):
        super().__init__()
        a, dim = architecture, architecture.latent_dim
        self.architecture = architecture
        self.tx_embedding = nn.Sequential(
            nn.Linear(a.text_dim, 2 * dim), nn.GELU(), nn.Linear(2 * dim, dim), nn.LayerNorm(dim)
        )
        self.skel_embedding = nn.Linear(a.features, dim)
        self.registers = nn.Parameter(torch.randn(a.registers, dim))
        self.register_buffer("positions", sinusoids(max_length, dim), persistent=False)
        self.dropout = nn.Dropout(token_dropout)
        self.timestep_encoder = TimestepEncoder(dim)
        layer = nn.TransformerEncoderLayer(
            dim, a.heads, a.ff_size, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.seqTransEncoder = nn.TransformerEncoder(layer, a.layers, enable_nested_tensor=False)
        self.to_skel_layer = nn.Linear(dim, a.features)

    def forward(self, x: Tensor, t: Tensor, text: Tensor, frame_mask: Tensor | None = None) -> Tensor:
        """x (B, T, F), t (B,) integers, text (B, text_dim), frame_mask (B, T) true where one counts -> (B, T, F)."""
        batch, frames, _ = x.shape
        time = self.timestep_encoder(self.positions[t])
        registers = self.registers.expand(batch, -1, -1)
        tokens = torch.cat([time[:, None], self.tx_embedding(text)[:, None], registers, self.skel_embedding(x)], dim=1)
        tokens = self.dropout(tokens + self.positions[: tokens.shape[1]])
        padding = None
        if frame_mask is not None:
            padding = torch.cat([frame_mask.new_ones(batch, tokens.shape[1] - frames), frame_mask], dim=1).logical_not()
        encoded = self.seqTransEncoder(tokens, src_key_padding_mask=padding)
        return self.to_skel_layer(encoded[:, -frames:])
