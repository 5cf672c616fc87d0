"""What an iteration of Video-SDS with CogVideoX takes on the device, from sizes alone: light enough for a plan."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BFLOAT16 = 2
"""[bytes]"""
PUBLISHED = {
    "transformer": {
        "num_attention_heads": 48, "attention_head_dim": 64, "num_layers": 42, "patch_size": 2, "sample_frames": 49,
        "temporal_compression_ratio": 4, "max_text_seq_length": 226,
    },
    "vae": {"block_out_channels": [128, 256, 256, 512], "layers_per_block": 3},
}  # fmt: skip
"""CogVideoX-5B's json files, as far as they matter here."""
PARAMETERS = {"transformer": 5.570e9, "text_encoder": 4.762e9, "vae": 0.2156e9}
"""CogVideoX-5B's."""
ENCODER_SHARE = 0.43
"""Of the VAE's parameters, its encoder's: the decoder is left out."""


@dataclass(frozen=True)
class Memory:
    """Of one iteration on the device, estimated from sizes, not measured [bytes]."""

    transformer: int
    """Its weights, or with offload those of two blocks."""
    encoder: int
    """The VAE encoder's weights."""
    text: int
    """T5's weights, freed before the transformer comes."""
    denoising: int
    """Activations of the transformer, for prompt and negative prompt, without gradients."""
    encoding: int
    """Activations of the VAE encoder with gradients: what checkpointing keeps, and one block recomputed."""

    @property
    def peak(self) -> int:
        held = self.transformer + self.encoder
        return max(self.text + self.encoder, held + self.denoising, held + self.encoding)


def activations(
    sizes: dict[str, Any], vae: dict[str, Any], frames: int, size: tuple[int, int], itemsize: int, offload: bool
) -> tuple[int, int]:
    """Of the transformer and of the VAE's encoder [bytes].

    Args:
        sizes, vae: the json files of the transformer and the VAE.
        frames: of the clip. size: (height, width) of the pictures [pixel]. itemsize: of a number [bytes].
    """
    height, width = size
    spatial = 2 ** (len(vae["block_out_channels"]) - 1) * int(sizes["patch_size"])
    latents = (frames - 1) // int(sizes["temporal_compression_ratio"]) + 1
    tokens = latents * (height // spatial) * (width // spatial) + int(sizes["max_text_seq_length"])
    inner = int(sizes["num_attention_heads"]) * int(sizes["attention_head_dim"])
    # Stream, norm, q, k, v, output and the feed-forward's 4: some 12 times the stream, twice for both prompts.
    denoising = 2 * tokens * inner * 12 * itemsize
    pixels = largest_chunk(frames) * height * width // (4 if offload else 1)
    # A residual block holds about 8 activations for its gradient; only those of one level are there at a time.
    encoding = vae["block_out_channels"][0] * pixels * (8 * int(vae["layers_per_block"]) + 2) * itemsize
    return denoising, encoding


def largest_chunk(frames: int) -> int:
    """Frames that the VAE encodes at a time: 8, and what is left over with the first of them."""
    return frames if frames < 8 else 8 + frames % 8


def guess(folder: Path | None, frames: int | None, size: tuple[int, int], offload: bool) -> Memory:
    """Of a CogVideoX in bfloat16, from the sizes of its files; of the published 5B where there are none."""
    configs = PUBLISHED if folder is None else {part: PUBLISHED[part] | _config(folder / part) for part in PUBLISHED}
    weights = {part: _weights(folder, part) or int(count * BFLOAT16) for part, count in PARAMETERS.items()}
    sizes = configs["transformer"]
    blocks = 2 * weights["transformer"] // int(sizes["num_layers"]) if offload else weights["transformer"]
    count = frames or int(sizes["sample_frames"])
    encoder = int(ENCODER_SHARE * weights["vae"])
    return Memory(
        blocks, encoder, weights["text_encoder"], *activations(sizes, configs["vae"], count, size, BFLOAT16, offload)
    )


def _config(place: Path) -> dict[str, Any]:
    """A part's json; nothing of one that cannot be read, which the plan names as missing."""
    try:
        content = json.loads((place / "config.json").read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _weights(folder: Path | None, part: str) -> int:
    """All safetensors of a part [bytes]; 0 where there are none."""
    return 0 if folder is None else sum(file.stat().st_size for file in (folder / part).glob("*.safetensors"))
