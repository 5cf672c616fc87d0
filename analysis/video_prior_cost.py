"""Seconds, memory and operations of an iteration of Video-SDS with CogVideoX, of random weights."""

import time
from collections.abc import Callable
from typing import Any

import pandas as pd
import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from hoi.method.video_sds import distil
from hoi.video_prior.cogvideox import CogVideoX, rotary_embedding
from hoi.video_prior.cogvideox_encode import chunks_of, encode_chunks
from hoi.video_prior.cogvideox_files import Configs, Files, empty_transformer, empty_vae, estimate_memory

SCHEDULER: dict[str, Any] = {
    "num_train_timesteps": 1000, "beta_start": 0.00085, "beta_end": 0.012, "beta_schedule": "scaled_linear",
    "prediction_type": "v_prediction", "rescale_betas_zero_snr": True, "snr_shift_scale": 1.0,
}  # fmt: skip
VAE: dict[str, Any] = {
    "down_block_types": ("CogVideoXDownBlock3D",) * 4, "up_block_types": ("CogVideoXUpBlock3D",) * 4,
    "block_out_channels": (128, 256, 256, 512), "latent_channels": 16, "layers_per_block": 3, "norm_num_groups": 32,
    "scaling_factor": 0.7, "sample_height": 480, "sample_width": 720,
}  # fmt: skip
TRANSFORMER: dict[str, Any] = {
    "num_attention_heads": 48, "attention_head_dim": 64, "in_channels": 16, "out_channels": 16, "time_embed_dim": 512,
    "text_embed_dim": 4096, "num_layers": 42, "sample_width": 90, "sample_height": 60, "sample_frames": 49,
    "patch_size": 2, "temporal_compression_ratio": 4, "max_text_seq_length": 226,
    "use_rotary_positional_embeddings": True,
}  # fmt: skip
T5: dict[str, Any] = {
    "vocab_size": 32128, "d_model": 4096, "d_kv": 64, "d_ff": 10240, "num_layers": 24, "num_heads": 64,
    "feed_forward_proj": "gated-gelu",
}  # fmt: skip
FULL: Configs = {"transformer": TRANSFORMER, "vae": VAE, "text_encoder": T5, "scheduler": SCHEDULER}
"""CogVideoX-5B."""
SCALED: Configs = {
    **FULL,
    "transformer": {**TRANSFORMER, "num_attention_heads": 4, "num_layers": 6, "text_embed_dim": 64},
    "vae": {**VAE, "block_out_channels": (16, 32, 32, 64), "norm_num_groups": 8},
    "text_encoder": {**T5, "vocab_size": 64, "d_model": 64, "d_ff": 64, "num_layers": 1, "num_heads": 2},
}
"""The same layers and tokens, an eighth to a twelfth of the width."""
LENGTHS = (9, 13, 17, 49)
SCENE_FRAMES = 40


class RandomWeights(Files):
    """A model that nobody has trained, for its sizes alone."""

    def load_transformer(self, dtype: torch.dtype) -> Any:
        return _drawn(empty_transformer(self.sizes), dtype)

    def load_vae(self, dtype: torch.dtype) -> Any:
        model = empty_vae(self.configs["vae"])
        del model.decoder, model.post_quant_conv
        return _drawn(model, dtype)

    def encode_text(self, prompts: list[str], dtype: torch.dtype, device: torch.device) -> Tensor:
        length, width = self.sizes["max_text_seq_length"], self.sizes["text_embed_dim"]
        return 0.1 * torch.randn(len(prompts), length, width, dtype=dtype, device=device)


def _drawn(model: nn.Module, dtype: torch.dtype) -> nn.Module:
    nn.Module.to(model, dtype)  # diffusers warns of its own
    model.to_empty(device="cpu")
    for name, parameter in model.named_parameters():
        nn.init.ones_(parameter) if "norm" in name and parameter.ndim == 1 else nn.init.normal_(parameter, std=0.02)
    return model.eval().requires_grad_(False)


# --- measured --------------------------------------------------------------------------------------------------------


def measure(files: Files, frames: int, size: tuple[int, int], device: str, turns: int, offload: bool) -> dict[str, Any]:
    """Seconds of an iteration and of its parts, the best of `turns` after one that does not count, and peak memory.

    On a CPU they are seconds of it.
    """
    prior = CogVideoX(files, size, frames, offload, device)
    prior.prepare("", "")
    clip = prior.clip_frames(SCENE_FRAMES // 2 - 1, SCENE_FRAMES // 2 + 1, SCENE_FRAMES)
    places = [place for place, frame in enumerate(clip) if abs(frame - SCENE_FRAMES // 2) <= 1]
    changing = slice(places[0], places[-1] + 1)
    video = torch.rand(frames, 3, *size, device=device)
    window = video[changing].clone().requires_grad_()
    spent: dict[str, list[float]] = {"encode": [], "denoise": [], "backward": []}

    # On a CPU others may be at work too: the time that this process had, on all its threads.
    clock = time.perf_counter if device == "cuda" else time.process_time

    def timed(name: str, step: Callable[[], Any]) -> Any:
        _wait(device)
        began = clock()
        result = step()
        _wait(device)
        spent[name].append(clock() - began)
        return result

    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    for _ in range(1 + turns):
        whole = torch.cat([video[: changing.start], window, video[changing.stop :]])
        z = timed("encode", lambda whole=whole: prior.encode(whole, changing))
        loss = timed("denoise", lambda z=z: distil(z, torch.randn_like(z), 500, prior, 100.0).loss)
        timed("backward", loss.backward)
    row = {f"{name} s": min(values[1:]) for name, values in spent.items()}
    row = {"frames": frames, "s an iteration": sum(float(value) for value in row.values()), **row}
    if device == "cuda":
        row["peak GB"] = torch.cuda.max_memory_allocated() / 1e9
    return row | {"estimated GB": prior.memory.peak / 1e9}


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


# --- counted ---------------------------------------------------------------------------------------------------------


def count(configs: Configs, frames: int, size: tuple[int, int]) -> dict[str, Any]:
    """PFLOP of an iteration, multiplications and additions, from shapes alone: nothing is computed."""
    sizes, vae = configs["transformer"], empty_vae(configs["vae"]).requires_grad_(False)
    transformer = empty_transformer(sizes)
    patch, ratio = 2 ** (len(configs["vae"]["block_out_channels"]) - 1), int(sizes["temporal_compression_ratio"])
    latent = ((frames - 1) // ratio + 1, size[0] // patch, size[1] // patch)
    rotary = rotary_embedding(sizes, latent, torch.device("meta"))
    with torch.device("meta"):
        z = torch.empty(2, latent[0], int(sizes["in_channels"]), *latent[1:])
        text = torch.empty(2, int(sizes["max_text_seq_length"]), int(sizes["text_embed_dim"]))
        t = torch.empty(2, dtype=torch.long)
        video = torch.empty(1, 3, frames, *size)
    with torch.no_grad(), FlopCounterMode(display=False) as denoising:
        transformer(z, text, t, image_rotary_emb=rotary, return_dict=False)
    chunks = chunks_of(frames)
    with FlopCounterMode(display=False) as forwards:
        encode_chunks(vae, video, chunks, range(0))
    part = video[:, :, chunks[len(chunks) // 2]].requires_grad_()  # the window's chunk, as if it were the first
    with FlopCounterMode(display=False) as both:
        encode_chunks(vae, part, [slice(None)], range(1)).sum().backward()
    # It is computed three times: forwards, backwards, and once more because of checkpointing.
    encoding = forwards.get_total_flops() + both.get_total_flops()
    total = (denoising.get_total_flops() + encoding) / 1e15
    return {
        "frames": frames,
        "PFLOP": total,
        "denoise": denoising.get_total_flops() / 1e15,
        "encode and back": encoding / 1e15,
        "estimated GB": estimate_memory(configs, frames, size, torch.bfloat16, False).peak / 1e9,
    }


def with_share(rows: list[dict[str, Any]], of: str) -> pd.DataFrame:
    """A table of the rows, with the share of the longest clip's cost that each has."""
    table = pd.DataFrame(rows)
    table.insert(2, "of the longest", table[of] / table.loc[table["frames"].idxmax(), of])
    return table
