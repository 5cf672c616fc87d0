"""The video prior that stage 3 distils from: p(video | prompt) as a diffusion model with v-prediction.

`sqrt(abar_t) z + sqrt(1 - abar_t) eps = z_t` and `v = sqrt(abar_t) eps - sqrt(1 - abar_t) z` (Salimans & Ho 2022), with
timesteps t = 0 .. 999 for every prior.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class VideoPrior(Protocol):
    """What `hoi.method.video_sds` asks of a prior. Nothing is trained there, no gradient flows through `velocity`.

    Whatever the prior, pictures have three channels in [0, 1], channels first: RGB, or what `sees_silhouettes` says.
    """

    @property
    def name(self) -> str:
        """For the report and the record: which model, from where."""
        ...

    @property
    def alphas_cumprod(self) -> Tensor:
        """abar_t, float64, (1000,); may be 0 at the end."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the pictures it wants [pixel]."""
        ...

    @property
    def crop(self) -> float | None:
        """Half of what its pictures show around the point of contact, on their shorter side [m]; None: the action."""
        ...

    @property
    def sees_silhouettes(self) -> bool:
        """Whether it wants `hoi.refine.silhouettes` instead of colours."""
        ...

    def prepare(self, prompt: str, negative_prompt: str) -> None:
        """Work out the text's features, once; the text encoder is freed. Before the first `velocity`."""
        ...

    def clip_frames(self, first: int, last: int, total: int) -> list[int]:
        """Scene frames of the clip it wants to see of a scene of `total` frames whose frames first..last change.

        In order, all of first..last among them; a frame may be there more than once (the ends are held).
        """
        ...

    def encode(self, video: Tensor, changing: slice = slice(None)) -> Tensor:
        """z: latents, of any shape, of a clip (F, 3, height, width); differentiable.

        Args:
            changing: places in the clip that carry gradients; the prior may save the memory of the others' graph.
        """
        ...

    def velocity(self, latents: Tensor, t: int, guidance: float, rescale: float = 0.0) -> Tensor:
        """v(z_t; t, prompt) with classifier-free guidance against the negative prompt, of the latents' shape.

        Args:
            latents: z_t.
            guidance: scale g of `hoi.motion.diffusion.guide`; 1 is the prompt's prediction alone.
            rescale: of the guidance, see there.
        """
        ...


def load_video_prior(
    prior: str,
    device: torch.device | str,
    *,
    checkpoint: str | None,
    width: int,
    height: int,
    clip_frames: int | None,
    offload: bool,
) -> VideoPrior:
    """A prior by its name.

    Args:
        prior: "embedded" or "cogvideox".
        checkpoint: its weights: a file, a folder or a hub name; None: those in the package, of "embedded" alone.
        width, height: of the pictures [pixel]; "embedded" has its own.
        clip_frames: of the clip; None: as many as the prior was trained with.
        offload: whether the weights wait in the computer's memory, on a GPU.

    Raises:
        InputError: weights or a package are missing, or are another model's; one line with the remedy.
    """
    if prior == "cogvideox":
        from hoi.video_prior.cogvideox import CogVideoX
        from hoi.video_prior.cogvideox_files import open_files

        return CogVideoX(open_files(checkpoint), (height, width), clip_frames, offload, device)
    from hoi.video_prior.embedded import load_embedded

    return load_embedded(checkpoint, device)
