"""The files of a CogVideoX, in the layout of diffusers: found, checked and loaded; and what they will take in memory.

All sizes are read from the json files, none is left to a class's default; weights are safetensors alone, nothing is
unpickled. Nothing is downloaded either.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from hoi.errors import InputError
from hoi.video_prior.files import COGVIDEOX, WITHOUT, cogvideox_folder
from hoi.video_prior.memory import Memory, activations

if TYPE_CHECKING:
    from diffusers.models.autoencoders.autoencoder_kl_cogvideox import AutoencoderKLCogVideoX
    from diffusers.models.transformers.cogvideox_transformer_3d import CogVideoXTransformer3DModel

Configs = dict[str, dict[str, Any]]
"""The json files by part: transformer, vae, text_encoder, scheduler."""
TIMESTEPS = 1000
WANTED = {
    "transformer": (
        "num_attention_heads", "attention_head_dim", "in_channels", "out_channels", "time_embed_dim", "text_embed_dim",
        "num_layers", "sample_width", "sample_height", "sample_frames", "patch_size", "temporal_compression_ratio",
        "max_text_seq_length", "use_rotary_positional_embeddings",
    ),
    "vae": ("block_out_channels", "latent_channels", "layers_per_block", "norm_num_groups", "scaling_factor"),
    "scheduler": (
        "num_train_timesteps", "beta_start", "beta_end", "beta_schedule", "prediction_type", "rescale_betas_zero_snr",
        "snr_shift_scale",
    ),
}  # fmt: skip
"""What the json files must say: class defaults are another model's (the 2B's)."""


@dataclass(frozen=True)
class Files:
    """A pipeline's folder; made by `open_files`."""

    folder: Path
    configs: Configs

    @property
    def sizes(self) -> dict[str, Any]:
        """The transformer's json."""
        return self.configs["transformer"]

    def load_transformer(self, dtype: torch.dtype) -> "CogVideoXTransformer3DModel":
        """On the CPU.

        Raises:
            InputError: as `_fill`.
        """
        model = empty_transformer(self.sizes)
        embed = model.patch_embed
        if embed.use_positional_embeddings:  # the 2B's sines are worked out, not stored
            embed.pos_embedding = embed._get_positional_embeddings(
                embed.sample_height, embed.sample_width, embed.sample_frames
            )
        _fill(model, self.folder / "transformer", dtype)
        return model

    def load_vae(self, dtype: torch.dtype) -> "AutoencoderKLCogVideoX":
        """Its encoder alone, on the CPU: nothing is decoded.

        Raises:
            InputError: as `_fill`.
        """
        model = empty_vae(self.configs["vae"])
        del model.decoder, model.post_quant_conv
        _fill(model, self.folder / "vae", dtype, unused=("decoder.", "post_quant_conv."))
        return model

    @torch.no_grad()
    def encode_text(self, prompts: list[str], dtype: torch.dtype, device: torch.device) -> Tensor:
        """T5's features (P, length, text_embed_dim) of prompts; the padding counts, as in training.

        Raises:
            InputError: text_encoder/ or tokenizer/ cannot be loaded.
        """
        from transformers import AutoTokenizer, T5EncoderModel
        from transformers.utils import logging

        logging.disable_progress_bar()  # a stage has a bar of its own
        try:
            tokenizer = AutoTokenizer.from_pretrained(self.folder / "tokenizer", local_files_only=True)
            encoder = T5EncoderModel.from_pretrained(
                self.folder / "text_encoder", dtype=dtype, use_safetensors=True, local_files_only=True
            )
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"CogVideoX: T5 in {self.folder} cannot be loaded: {str(error).splitlines()[0]}"
            ) from error
        length = int(self.sizes["max_text_seq_length"])
        tokens = tokenizer(prompts, padding="max_length", max_length=length, truncation=True, return_tensors="pt")
        place(encoder.eval(), device)
        return encoder(tokens.input_ids.to(device))[0].to(dtype)


def open_files(checkpoint: str | None) -> Files:
    """The model of that name or in that folder, its json files read and checked.

    Raises:
        InputError: there is no such model, a file or an entry is missing, or it is another model.
    """
    folder = cogvideox_folder(checkpoint)
    files = {part: folder / part / "config.json" for part in ("transformer", "vae", "text_encoder")}
    files["scheduler"] = folder / "scheduler" / "scheduler_config.json"
    configs: Configs = {}
    for part, path in files.items():
        try:
            content = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise InputError(f"CogVideoX: {path} cannot be read: {error}") from error
        absent = [name for name in WANTED.get(part, ()) if name not in content]
        if absent:
            raise InputError(f"CogVideoX: {path} lacks {', '.join(absent)}")
        configs[part] = content
    if (patch := configs["transformer"].get("patch_size_t")) is not None:
        raise InputError(
            f"CogVideoX: {folder} is a CogVideoX 1.5 (transformer patch_size_t {patch}), whose latents are laid out"
            f" otherwise; use {COGVIDEOX}; {WITHOUT}"
        )
    return Files(folder, configs)


def noise_schedule(scheduler: dict[str, Any]) -> Tensor:
    """abar_t of the scheduler's json, float64, (1000,).

    Raises:
        InputError: no v-prediction in 1000 timesteps.
    """
    from diffusers.schedulers.scheduling_ddim_cogvideox import CogVideoXDDIMScheduler

    if scheduler["prediction_type"] != "v_prediction" or scheduler["num_train_timesteps"] != TIMESTEPS:
        raise InputError(
            f"CogVideoX scheduler: prediction_type {scheduler['prediction_type']} in"
            f" {scheduler['num_train_timesteps']} timesteps; v_prediction in {TIMESTEPS} is allowed"
        )
    made = CogVideoXDDIMScheduler.from_config(scheduler)
    assert isinstance(made, CogVideoXDDIMScheduler)
    return made.alphas_cumprod.double()


def estimate_memory(configs: Configs, frames: int, size: tuple[int, int], dtype: torch.dtype, offload: bool) -> Memory:
    """From the sizes in the json files alone, before anything is loaded; an estimate of its order, not measured."""
    sizes, vae = configs["transformer"], configs["vae"]
    transformer, itemsize = empty_transformer(sizes), dtype.itemsize
    blocks = parameters(transformer) if not offload else 2 * parameters(transformer.transformer_blocks[0])
    denoising, encoding = activations(sizes, vae, frames, size, itemsize, offload)
    return Memory(
        transformer=blocks * itemsize,
        encoder=parameters(empty_vae(vae).encoder) * itemsize,
        text=_t5_parameters(configs["text_encoder"]) * itemsize,
        denoising=denoising,
        encoding=encoding,
    )


def place(module: nn.Module, device: torch.device) -> None:
    """Move it there."""
    module.to(device)


def parameters(module: nn.Module) -> int:
    """How many."""
    return sum(p.numel() for p in module.parameters())


def empty_transformer(config: dict[str, Any]) -> "CogVideoXTransformer3DModel":
    from diffusers.models.transformers.cogvideox_transformer_3d import CogVideoXTransformer3DModel

    with torch.device("meta"):
        model = CogVideoXTransformer3DModel.from_config(config)
    assert isinstance(model, CogVideoXTransformer3DModel)
    return model


def empty_vae(config: dict[str, Any]) -> "AutoencoderKLCogVideoX":
    from diffusers.models.autoencoders.autoencoder_kl_cogvideox import AutoencoderKLCogVideoX

    with torch.device("meta"):
        model = AutoencoderKLCogVideoX.from_config(config)
    assert isinstance(model, AutoencoderKLCogVideoX)
    return model


def _t5_parameters(config: dict[str, Any]) -> int:
    from transformers import T5Config, T5EncoderModel

    with torch.device("meta"):
        return parameters(T5EncoderModel(T5Config.from_dict(config)))


def _fill(model: nn.Module, folder: Path, dtype: torch.dtype, unused: tuple[str, ...] = ()) -> None:
    """Give an empty model its weights, shard by shard, to be used and not trained.

    Raises:
        InputError: a file is missing or damaged, or the tensors are another architecture's.
    """
    index = folder / "diffusion_pytorch_model.safetensors.index.json"
    names = ["diffusion_pytorch_model.safetensors"]
    try:
        if index.is_file():
            names = sorted(set(json.loads(index.read_text())["weight_map"].values()))
        state: dict[str, Tensor] = {}
        for name in names:
            tensors = load_file(folder / Path(name).name)
            state |= {key: value.to(dtype) for key, value in tensors.items() if not key.startswith(unused)}
    except (OSError, SafetensorError, ValueError, KeyError) as error:
        raise InputError(f"CogVideoX: weights in {folder} cannot be read: {str(error).splitlines()[0]}") from error
    try:
        model.load_state_dict(state, assign=True)
    except RuntimeError as error:
        said = " ".join(str(error).split())[:200]
        raise InputError(f"CogVideoX: weights in {folder} are not those of its config.json: {said}") from error
    model.eval().requires_grad_(False)


def check_memory(memory: Memory, device: torch.device) -> None:
    """Refuse what cannot fit, before it is loaded.

    Raises:
        InputError: the estimate is above what the GPU has.
    """
    if device.type != "cuda":
        return
    total = torch.cuda.get_device_properties(device).total_memory
    if memory.peak > total:
        raise InputError(
            f"prior=cogvideox would take about {memory.peak / 1e9:.0f} GB, the GPU has"
            f" {total / 1e9:.0f} GB; set offload=true, lower clip_frames, width or height; {WITHOUT}"
        )
