"""The embedded video prior: small, in the package, framed on the contact, for a CPU.

It sees silhouettes (`hoi.refine.silhouettes`). Its latents are the pixels themselves, normalised and turned: the
discrete cosine transform of each patch. `encode` is exact and cheap, and white noise stays white.
"""

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor
from torch.nn import functional

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.motion.diffusion import guide
from hoi.motion.text import MINILM_PACKAGE, TextEncoder, default_cache, minilm
from hoi.video_prior.denoiser import Architecture, VideoDenoiser, alphas_cumprod
from hoi.video_prior.files import EMBEDDED_PICTURE, embedded_video_prior

FORMAT = "hoi video prior 1"
CLIP_FRAMES, SIZE, FPS = 5, EMBEDDED_PICTURE, 20.0
CROP = 0.28
"""Half of what a picture shows around the point of contact [m]."""
MEAN, SPREAD = 0.1, 0.27
"""Of the training clips' pixels, about [-]."""
TEXT_MEAN, TEXT_STD, DENOISER_PREFIX = "text_normalizer.mean", "text_normalizer.std", "denoiser."


@cache
def basis(patch: int) -> Tensor:
    """Orthonormal rows, (3 patch^2, 3 patch^2), float64: 2D cosines of each channel."""
    place = torch.arange(patch, dtype=torch.float64)
    cosines = torch.cos(torch.pi / patch * (place + 0.5) * place[:, None]) * (2 / patch) ** 0.5
    cosines[0] *= 0.5**0.5
    return torch.kron(torch.eye(3, dtype=torch.float64), torch.kron(cosines, cosines))


def to_latents(video: Tensor, patch: int) -> Tensor:
    """Silhouettes in [0, 1], (..., 3, height, width) -> z (..., 3 patch^2, height / patch, width / patch)."""
    pixels = (functional.pixel_unshuffle(video, patch) - MEAN) / SPREAD
    return torch.einsum("zc,...chw->...zhw", basis(patch).to(video), pixels)


class EmbeddedPrior:
    """A `hoi.video_prior.VideoPrior`; made by `load_embedded`."""

    size = (SIZE, SIZE)
    crop = CROP
    sees_silhouettes = True

    def __init__(
        self, denoiser: VideoDenoiser, text_mean: Tensor, text_std: Tensor, encoder: TextEncoder, name: str
    ) -> None:
        self.name = name
        self.alphas_cumprod = alphas_cumprod().to(text_mean.device)
        self._denoiser, self._encoder = denoiser, encoder
        self._text_mean, self._text_std = text_mean, text_std
        self._patch = denoiser.architecture.patch
        self._texts: Tensor | None = None

    def prepare(self, prompt: str, negative_prompt: str) -> None:
        """Embeds both sentences; the encoder's model is in memory only meanwhile."""
        texts = self._encoder.embed([negative_prompt, prompt]).to(self._text_mean)
        self._texts = (texts - self._text_mean) / self._text_std

    def clip_frames(self, first: int, last: int, total: int) -> list[int]:
        """The five frames around the middle of first..last.

        Raises:
            InputError: there are more than five frames in first..last.
        """
        if last - first >= CLIP_FRAMES:
            raise InputError(
                f"half_width: a window of {last - first + 1} frames; the embedded video prior sees "
                f"{CLIP_FRAMES}: at most {(CLIP_FRAMES - 1) / 2:g} is allowed"
            )
        middle = (first + last) // 2
        return [min(max(middle + i - CLIP_FRAMES // 2, 0), total - 1) for i in range(CLIP_FRAMES)]

    def encode(self, video: Tensor, changing: slice = slice(None)) -> Tensor:
        """(5, 3, 64, 64) -> z (5, 48, 16, 16). There is no graph to save, so that `changing` does not matter."""
        return to_latents(video, self._patch)

    @torch.no_grad()
    def branches(self, latents: Tensor, t: int) -> tuple[Tensor, Tensor]:
        """v for the negative prompt and for the prompt, both (5, 48, 16, 16)."""
        if self._texts is None:
            raise RuntimeError("prepare(prompt, negative_prompt) comes first")
        z = latents.to(self._text_mean)[None].expand(2, *latents.shape)
        negative, positive = self._denoiser(z, torch.full((2,), t, device=z.device), self._texts)
        return negative, positive

    def velocity(self, latents: Tensor, t: int, guidance: float, rescale: float = 0.0) -> Tensor:
        """As `hoi.video_prior.VideoPrior.velocity`; both branches in one forward pass."""
        negative, positive = self.branches(latents, t)
        return guide(negative[None], positive[None], guidance, rescale)[0].to(latents)


@dataclass(frozen=True)
class Description:
    """What the weights' file says of itself."""

    architecture: Architecture
    steps: int
    text_encoder: str
    """Digest of its weights."""


def save_embedded(
    path: Path, average: dict[str, Tensor], text: tuple[Tensor, Tensor], description: Description
) -> None:
    """One .safetensors, replaced in one piece; the denoiser in half precision.

    Args:
        average: the denoiser's state. text: mean and deviation of the captions' embeddings.
    """
    tensors = {DENOISER_PREFIX + name: value.half().contiguous() for name, value in average.items()}
    tensors |= {TEXT_MEAN: text[0].float(), TEXT_STD: text[1].float()}
    about = {"package": MINILM_PACKAGE, **asdict(description)}
    with whole_file(path) as part:
        part.write_bytes(save(tensors, {"format": FORMAT, "description": json.dumps(about)}))


def load_embedded(
    path: str | Path | None = None, device: torch.device | str = "cpu", text_cache: Path | None = None
) -> EmbeddedPrior:
    """The prior in the package, or one that `hoi.training.video.train` has left behind.

    Args:
        path: a .safetensors, or a folder with a `hoi.video_prior.files.VIDEO_PRIOR_NAME`.
        text_cache: where sentence embeddings are kept; default: the user's cache folder.

    Raises:
        InputError: the file is missing, damaged or of another kind, or the text encoder is another one.
    """
    file = embedded_video_prior(path)
    tensors, description = _read(file)
    encoder = minilm(text_cache or default_cache())
    if encoder.sha256 != description.text_encoder:
        raise InputError(
            f"video prior: {file} was trained with text encoder {description.text_encoder}, not {encoder.sha256}"
        )
    weights = {n.removeprefix(DENOISER_PREFIX): v for n, v in tensors.items() if n.startswith(DENOISER_PREFIX)}
    try:
        denoiser = VideoDenoiser(description.architecture)
        denoiser.load_state_dict(weights)
        text = tensors[TEXT_MEAN].to(device), tensors[TEXT_STD].to(device)
    except (RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"video prior: {file}: {' '.join(str(error).split())[:200]}") from error
    denoiser = denoiser.to(device).eval().requires_grad_(False)
    return EmbeddedPrior(denoiser, *text, encoder, f"embedded video prior, {description.steps} training steps")


def _read(file: Path) -> tuple[dict[str, Tensor], Description]:
    try:
        with safe_open(file, framework="pt") as opened:
            about: dict[str, Any] = opened.metadata() or {}
            tensors = {name: opened.get_tensor(name).float() for name in opened.keys()}
    except (OSError, SafetensorError) as error:
        raise InputError(f"video prior: {file} cannot be read: {error}") from error
    if about.get("format") != FORMAT:
        raise InputError(f"video prior: {file}: format is {about.get('format')!r}, not {FORMAT!r}")
    try:
        said = json.loads(about["description"])
        sizes = {**said["architecture"], "channels": tuple(said["architecture"]["channels"])}
        return tensors, Description(Architecture(**sizes), int(said["steps"]), str(said["text_encoder"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"video prior: {file}: its description is damaged: {error!r}") from error
