"""The encoder of CogVideoX's 3D VAE, piece by piece, with a gradient only where one is wanted."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_cogvideox import AutoencoderKLCogVideoX

CHUNK = 8
"""Frames that the VAE encodes at a time; the first chunk also takes what is left over."""


def chunks_of(frames: int) -> list[slice]:
    """How the VAE cuts a clip: CHUNK frames each, what is left over with the first."""
    rest = frames % CHUNK if frames >= CHUNK else frames - CHUNK
    return [slice(0 if i == 0 else CHUNK * i + rest, CHUNK * (i + 1) + rest) for i in range(max(frames // CHUNK, 1))]


def encode_chunks(vae: "AutoencoderKLCogVideoX", video: Tensor, chunks: list[slice], changing: range) -> Tensor:
    """Mean of the VAE's posterior, (1, C, F', h, w), of a video (1, 3, F, height, width) in [-1, 1].

    Only the chunks `changing` keep a graph. Earlier ones do not depend on what changes; of later ones it is cut off:
    they see the last two frames before them through the convolutions' caches, for several times the memory.
    With tiling each tile is encoded by itself and blended with its neighbours, as diffusers does.
    """

    def encode(tile: Tensor) -> Tensor:
        cache, parts = None, []
        for index, chunk in enumerate(chunks):
            with torch.set_grad_enabled(torch.is_grad_enabled() and index in changing):
                part, cache = vae.encoder(tile[:, :, chunk], conv_cache=cache)
                parts.append(part if vae.quant_conv is None else vae.quant_conv(part))
        return torch.cat(parts, dim=2).chunk(2, dim=1)[0]

    height, width = video.shape[-2:]
    tall, wide = vae.tile_sample_min_height, vae.tile_sample_min_width
    if not vae.use_tiling or (height <= tall and width <= wide):
        return encode(video)
    # Overlaps and blending as in AutoencoderKLCogVideoX.tiled_encode.
    tops = range(0, height, int(tall * (1 - vae.tile_overlap_factor_height)))
    lefts = range(0, width, int(wide * (1 - vae.tile_overlap_factor_width)))
    rows = [[encode(video[..., y : y + tall, x : x + wide]) for x in lefts] for y in tops]
    blend_y = int(vae.tile_latent_min_height * vae.tile_overlap_factor_height)
    blend_x = int(vae.tile_latent_min_width * vae.tile_overlap_factor_width)
    kept_y, kept_x = vae.tile_latent_min_height - blend_y, vae.tile_latent_min_width - blend_x
    blended = []
    for i, row in enumerate(rows):
        tiles = []
        for j, tile in enumerate(row):
            tile = tile.clone()  # blending writes into it
            tile = vae.blend_v(rows[i - 1][j], tile, blend_y) if i else tile
            tile = vae.blend_h(row[j - 1], tile, blend_x) if j else tile
            row[j] = tile
            tiles.append(tile[..., :kept_y, :kept_x])
        blended.append(torch.cat(tiles, dim=-1))
    return torch.cat(blended, dim=-2)
