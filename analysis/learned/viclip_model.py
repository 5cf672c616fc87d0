"""ViCLIP (InternVid, Wang et al. 2024): a CLIP whose image tower attends over space and time together.

Parameter names are those of the published checkpoints.
"""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

HEAD = 64
"""Numbers an attention head, in both towers of all sizes."""


@dataclass(frozen=True)
class Sizes:
    """Of a ViCLIP; a checkpoint's shapes say them all."""

    width: int
    layers: int
    patch: int
    """Side of a patch [pixel]."""
    grid: int
    """Patches along a side of a picture."""
    frames: int
    text_width: int
    text_layers: int
    context: int
    """Tokens of a text, with start and end."""
    vocabulary: int
    embed: int

    @property
    def resolution(self) -> int:
        """Side of a picture [pixel]."""
        return self.grid * self.patch

    @classmethod
    def of(cls, state: Mapping[str, Tensor]) -> "Sizes":
        """From a state dict.

        Raises:
            KeyError, IndexError, ValueError: it is not a ViCLIP's.
        """
        width, _, _, patch, _ = state["vision_encoder.conv1.weight"].shape
        vocabulary, text_width = state["text_encoder.token_embedding.weight"].shape
        return cls(
            width=width,
            layers=_blocks(state, "vision_encoder"),
            patch=patch,
            grid=round((len(state["vision_encoder.positional_embedding"]) - 1) ** 0.5),
            frames=state["vision_encoder.temporal_positional_embedding"].shape[1],
            text_width=text_width,
            text_layers=_blocks(state, "text_encoder"),
            context=len(state["text_encoder.positional_embedding"]),
            vocabulary=vocabulary,
            embed=state["text_encoder.text_projection"].shape[1],
        )


class ViCLIP(nn.Module):
    """Both towers into one space."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        self.sizes = sizes
        self.temp = nn.Parameter(torch.tensor(0.01))
        """The temperature of training; scores do without."""
        self.vision_encoder = VideoTower(sizes)
        self.text_encoder = TextTower(sizes)

    def similarity(self, video: Tensor, tokens: Tensor) -> Tensor:
        """Cosine of videos (B, frames, 3, resolution, resolution) and texts (C, context), shape (B, C)."""
        seen = nn.functional.normalize(self.vision_encoder(video), dim=-1)
        said = nn.functional.normalize(self.text_encoder(tokens), dim=-1)
        return seen @ said.T


class VideoTower(nn.Module):
    """All patches of all frames and one class token attend to one another."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        width, side = sizes.width, (1, sizes.patch, sizes.patch)
        self.conv1 = nn.Conv3d(3, width, side, side, bias=False)
        self.class_embedding = nn.Parameter(width**-0.5 * torch.randn(width))
        self.positional_embedding = nn.Parameter(width**-0.5 * torch.randn(sizes.grid**2 + 1, width))
        self.temporal_positional_embedding = nn.Parameter(torch.zeros(1, sizes.frames, width))
        self.ln_pre = nn.LayerNorm(width)
        self.transformer = Transformer(width, sizes.layers)
        self.ln_post = nn.LayerNorm(width)
        self.proj = nn.Parameter(width**-0.5 * torch.randn(width, sizes.embed))

    def forward(self, video: Tensor) -> Tensor:
        """(B, frames, 3, resolution, resolution) -> (B, embed), not normalised."""
        patches = self.conv1(video.transpose(1, 2)).flatten(3)  # B, width, frames, grid^2
        patches = patches.permute(0, 2, 3, 1) + self.positional_embedding[1:]
        patches = patches + self.temporal_positional_embedding[:, :, None]
        first = (self.class_embedding + self.positional_embedding[0]).expand(len(video), 1, -1)
        tokens = self.transformer(self.ln_pre(torch.cat([first, patches.flatten(1, 2)], dim=1)))
        return self.ln_post(tokens[:, 0]) @ self.proj


class TextTower(nn.Module):
    """CLIP's: each token attends to those before it, and the end token sums it up."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        width = sizes.text_width
        self.token_embedding = nn.Embedding(sizes.vocabulary, width)
        self.positional_embedding = nn.Parameter(0.01 * torch.randn(sizes.context, width))
        self.transformer = Transformer(width, sizes.text_layers)
        self.ln_final = nn.LayerNorm(width)
        self.text_projection = nn.Parameter(width**-0.5 * torch.randn(width, sizes.embed))

    def forward(self, tokens: Tensor) -> Tensor:
        """Ids (C, context), the end's the largest -> (C, embed), not normalised."""
        length = tokens.shape[1]
        later = torch.ones(length, length, dtype=torch.bool, device=tokens.device).triu(1)
        hidden = self.transformer(self.token_embedding(tokens) + self.positional_embedding, later)
        end = self.ln_final(hidden)[torch.arange(len(tokens)), tokens.argmax(-1)]
        return end @ self.text_projection


class Transformer(nn.Module):
    def __init__(self, width: int, layers: int) -> None:
        super().__init__()
        self.resblocks = nn.ModuleList(Block(width) for _ in range(layers))

    def forward(self, hidden: Tensor, mask: Tensor | None = None) -> Tensor:
        for block in self.resblocks:
            hidden = block(hidden, mask)
        return hidden


class Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.attn = nn.MultiheadAttention(width, width // HEAD, batch_first=True)
        self.ln_1 = nn.LayerNorm(width)
        self.mlp = nn.Sequential(
            OrderedDict(c_fc=nn.Linear(width, 4 * width), gelu=QuickGELU(), c_proj=nn.Linear(4 * width, width))
        )
        self.ln_2 = nn.LayerNorm(width)

    def forward(self, hidden: Tensor, mask: Tensor | None) -> Tensor:
        x = self.ln_1(hidden)
        hidden = hidden + self.attn(x, x, x, need_weights=False, attn_mask=mask)[0]
        return hidden + self.mlp(self.ln_2(hidden))


class QuickGELU(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x * torch.sigmoid(1.702 * x)


def _blocks(state: Mapping[str, Tensor], tower: str) -> int:
    prefix = f"{tower}.transformer.resblocks."
    return 1 + max(int(key.removeprefix(prefix).split(".")[0]) for key in state if key.startswith(prefix))
