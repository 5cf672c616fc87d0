"""CogVideoX (Yang et al. 2024) as a video prior, through diffusers: transformer, 3D VAE, T5 and noise schedule."""

import gc
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from hoi.errors import InputError
from hoi.motion.diffusion import guide
from hoi.video_prior.cogvideox_encode import chunks_of, encode_chunks
from hoi.video_prior.cogvideox_files import (
    Files,
    check_memory,
    estimate_memory,
    noise_schedule,
    place,
)

if TYPE_CHECKING:
    from diffusers.models.transformers.cogvideox_transformer_3d import CogVideoXTransformer3DModel


def clip_of(first: int, last: int, total: int, count: int) -> list[int]:
    """`count` scene frames with first..last among them; of a scene that is shorter all, its ends held.

    first..last fall into as few of the VAE's chunks as can be, since those are what a gradient costs, and otherwise as
    near to the clip's middle.

    Raises:
        InputError: first..last does not fit.
    """
    if last - first + 1 > count:
        raise InputError(f"clip_frames {count}: the window of {last - first + 1} frames must fit")

    def frame_at(place: int) -> int:
        return min(max(place, 0), total - 1)

    def cost(start: int) -> tuple[int, int]:
        within = [first <= frame_at(start + place) <= last for place in range(count)]
        return sum(any(within[chunk]) for chunk in chunks_of(count)), abs(first + last - 2 * start - (count - 1))

    if count >= total:
        starts = range(total - count, 1)
    else:
        starts = range(max(0, last - count + 1), min(first, total - count) + 1)
    start = min(starts, key=cost)
    return [frame_at(start + place) for place in range(count)]


class CogVideoX:
    """The prior; see `hoi.video_prior.VideoPrior`. Made by `hoi.video_prior.load_video_prior`.

    Args:
        size: (height, width) of the pictures [pixel].
        clip_frames: None: as many as the model was trained with.

    Raises:
        InputError: weights are missing or another model's, the clip is not one that it takes, or it does not fit the
            device.
    """

    crop = None
    sees_silhouettes = False

    def __init__(
        self, files: Files, size: tuple[int, int], clip_frames: int | None, offload: bool, device: torch.device | str
    ) -> None:
        self.name = f"CogVideoX, {files.folder}"
        self.size = size
        self._files, self._device = files, torch.device(device)
        self._dtype = torch.bfloat16 if self._device.type == "cuda" else torch.float32
        self._offload = offload and self._device.type == "cuda"
        configs, self._sizes = files.configs, files.sizes
        self.alphas_cumprod = noise_schedule(configs["scheduler"])
        self._frames = clip_frames or int(self._sizes["sample_frames"])
        self._check_shapes()
        self.memory = estimate_memory(configs, self._frames, self.size, self._dtype, self._offload)
        check_memory(self.memory, self._device)
        self.vae = files.load_vae(self._dtype)
        place(self.vae, self._device)
        self.vae.enable_gradient_checkpointing()
        if self._offload:
            self.vae.enable_tiling()
        self.transformer: CogVideoXTransformer3DModel | None = None
        self._text = torch.empty(0)
        self._rotary: tuple[Tensor, Tensor] | None = None

    def _check_shapes(self) -> None:
        (height, width), frames = self.size, self._frames
        pixels = 2 ** (len(self._files.configs["vae"]["block_out_channels"]) - 1) * int(self._sizes["patch_size"])
        if height % pixels or width % pixels or min(height, width) < pixels:
            raise InputError(f"width, height {width} x {height}: multiples of {pixels} are allowed with CogVideoX")
        ratio = int(self._sizes["temporal_compression_ratio"])
        if frames < ratio + 1 or frames % ratio != 1:
            raise InputError(f"clip_frames {frames}: {ratio} k + 1 are allowed with CogVideoX (9, 13, ..., 49)")

    def prepare(self, prompt: str, negative_prompt: str) -> None:
        """Features of both prompts by T5, which is freed before the transformer is loaded."""
        self._text = self._files.encode_text([negative_prompt, prompt], self._dtype, self._device)
        gc.collect()
        if self._device.type == "cuda":
            torch.cuda.empty_cache()
        transformer = self._files.load_transformer(self._dtype)
        if self._offload:
            transformer.enable_group_offload(
                self._device, offload_type="block_level", num_blocks_per_group=1, use_stream=True
            )
        else:
            place(transformer, self._device)
        self.transformer = transformer

    def clip_frames(self, first: int, last: int, total: int) -> list[int]:
        """As many frames as configured, at the scene's frame rate, the scene's ends held."""
        return clip_of(first, last, total, self._frames)

    def encode(self, video: Tensor, changing: slice = slice(None)) -> Tensor:
        """z (1, F', C, h, w), float32: the mode of the VAE's posterior, scaled, of a clip (F, 3, height, width).

        Gradients flow through the VAE's chunks that hold frames of `changing`, and not on into later ones.
        """
        video = (2 * video[None].movedim(1, 2) - 1).to(self._dtype)
        chunks = chunks_of(video.shape[2])
        places = range(*changing.indices(video.shape[2]))
        first = next(i for i, chunk in enumerate(chunks) if chunk.stop > places[0])
        last = next(i for i, chunk in enumerate(chunks) if chunk.stop > places[-1])
        means = encode_chunks(self.vae, video, chunks, range(first, last + 1))
        return means.movedim(1, 2).float() * float(self.vae.config["scaling_factor"])

    @torch.no_grad()
    def velocity(self, latents: Tensor, t: int, guidance: float, rescale: float = 0.0) -> Tensor:
        """v of latents (1, F', C, h, w); negative prompt and prompt in one batch."""
        assert self.transformer is not None, "prepare() comes first"
        frames, _, height, width = latents.shape[1:]
        if self._rotary is None:
            self._rotary = rotary_embedding(self._sizes, (frames, height, width), self._device)
        text = self._text if guidance != 1 else self._text[1:]
        v = self.transformer(
            hidden_states=latents.to(self._dtype).repeat(len(text), 1, 1, 1, 1),
            encoder_hidden_states=text,
            timestep=torch.full((len(text),), t, device=self._device),
            image_rotary_emb=self._rotary,
            return_dict=False,
        )[0].float()
        if guidance == 1:
            return v
        without, with_text = v.chunk(2)
        return guide(without, with_text, guidance, rescale)


def rotary_embedding(sizes: dict[str, Any], latent: tuple[int, int, int], device: torch.device) -> Any:
    """cos and sin of the positions of a latent (frames, height, width), (tokens, head_dim) each.

    None for models that have other positions (the 2B). Smaller pictures spread over the grid of the model's training.
    """
    from diffusers.models.embeddings import get_3d_rotary_pos_embed
    from diffusers.pipelines.cogvideo.pipeline_cogvideox import get_resize_crop_region_for_grid

    if not sizes["use_rotary_positional_embeddings"]:
        return None
    patch = int(sizes["patch_size"])
    frames, height, width = latent
    grid = (height // patch, width // patch)
    region = get_resize_crop_region_for_grid(grid, sizes["sample_width"] // patch, sizes["sample_height"] // patch)
    return get_3d_rotary_pos_embed(sizes["attention_head_dim"], region, grid, frames, device=device)
