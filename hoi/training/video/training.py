"""The training of the video prior, of which `.train` is the command: clips, optimiser, checkpoints."""

import argparse
from typing import Any

import torch
from torch import Tensor

from hoi.errors import InputError
from hoi.method.video_sds import predict_z
from hoi.motion.text import minilm
from hoi.training import loop
from hoi.training.video.captions import FLAWED_SHARE, SENTENCES, captions
from hoi.training.video.clips import Clips, provide_clips
from hoi.training.video.contacts import FLAWS, LIMBS, OBJECT_SHARES, PEOPLE
from hoi.training.video.publish import publish
from hoi.video_prior.denoiser import TIMESTEPS, Architecture, VideoDenoiser, alphas_cumprod
from hoi.video_prior.embedded import to_latents

MIRRORED_LIMBS = (1, 0, 3, 2, 5, 4, 6)
"""Of `LIMBS`, as a clip shows them in a mirror."""
SAID = tuple(SENTENCES)
CENTRE_SPREAD, CENTRE_WEIGHT = 0.18, 3.0
"""Where the contact is the loss weighs more: a Gaussian of this width, in shares of the picture, on top of 1."""
HELD_OUT_TIMES = (100, 250, 400, 600)
MEND_FROM = 100
"""Flawed clips are mended from this t on: below it v would have to be far out of its range to give another clip."""
STATISTICS_CLIPS = 256
LEAST_VARIANCE = 1e-4
"""About what rounding to 8 bits leaves."""


class Words:
    """Embeddings of every caption, and which of them suit a clip."""

    def __init__(self) -> None:
        rows: dict[str, int] = {"": 0}
        self.choices: dict[tuple[int, int, int, int], list[int]] = {}
        for limb in range(len(LIMBS)):
            for shape in range(len(OBJECT_SHARES)):
                for person in range(len(PEOPLE)):
                    for said, key in enumerate(SAID):
                        found = captions(limb, shape, person, key)
                        self.choices[limb, shape, person, said] = [rows.setdefault(s, len(rows)) for s in found]
        self.raw = minilm().embed(list(rows))
        self.normalise(self.raw.mean(0), self.raw.std(0))

    def normalise(self, mean: Tensor, std: Tensor) -> None:
        self.mean, self.std = mean, std
        self.rows = (self.raw - mean) / std


class Training(loop.Training[VideoDenoiser]):
    """The state of one training: the loop's, and the clips with their captions."""

    def __init__(self, clips: Clips, options: argparse.Namespace) -> None:
        torch.manual_seed(options.seed)
        self.words = Words()
        held_out = max(1, int(options.held_out * len(clips)))
        self.clips, self.video = clips, torch.from_numpy(clips.video)
        self.training, self.held_out = range(len(clips) - held_out), range(len(clips) - held_out, len(clips))
        self.architecture = Architecture(channels=tuple(options.channels), text_dim=self.words.rows.shape[1])
        denoiser = VideoDenoiser(self.architecture)
        denoiser.variance.copy_(self.variance())
        super().__init__(options, denoiser, VideoDenoiser(self.architecture))
        self.alphas_cumprod = alphas_cumprod()
        places = self.architecture.size // self.architecture.patch
        from_centre = (torch.arange(places) + 0.5) / places - 0.5
        bell = torch.exp(-from_centre.square() / (2 * CENTRE_SPREAD**2))
        weight = 1 + CENTRE_WEIGHT * bell[:, None] * bell
        self.weight = weight / weight.mean()

    def variance(self) -> Tensor:
        """Of the latents of the training clips, (C,); of some of them."""
        some = self.training[:: max(1, len(self.training) // STATISTICS_CLIPS)]
        z = self.latents(list(some), [0] * len(some), [False] * len(some))
        return z.square().mean((0, 1, 2, 4, 5)).clamp(min=LEAST_VARIANCE)

    def _draw(self, high: int) -> int:
        return int(torch.randint(high, (), generator=self.generator))

    def _chance(self, share: float) -> bool:
        return float(torch.rand((), generator=self.generator)) < share

    def _caption(self, row: int, said: str, mirrored: bool) -> int:
        """One of the captions of a clip under a key of `SENTENCES`."""
        limb, clips = int(self.clips.limb[row]), self.clips
        limb = MIRRORED_LIMBS[limb] if mirrored else limb
        choices = self.words.choices[limb, int(clips.shape[row]), int(clips.person[row]), SAID.index(said)]
        return choices[self._draw(len(choices))]

    def latents(self, rows: list[int], flaws: list[int], mirrored: list[bool]) -> Tensor:
        """Clean and flawed clips, (2, B, F, C, h, w)."""
        video = self.video[rows, flaws].float().div_(255).movedim(-1, 3)
        flipped = torch.tensor(mirrored)[:, None, None, None, None, None]
        return to_latents(torch.where(flipped, video.flip(-1), video), self.architecture.patch).movedim(1, 0)

    def batch(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """z, what the denoiser should make of it, noise, t and text.

        A view is seen three times with one noise: clean and called clean; flawed and called flawed (both now and then
        not called at all), which the denoiser should give back as they are; and flawed but called clean, of which it
        should make the clean one.
        """
        options, views = self.options, self.options.batch // 3
        rows = [self.training[self._draw(len(self.training))] for _ in range(views)]
        flaws = [self._draw(len(FLAWS)) for _ in range(views)]
        mirrored = [self._chance(0.5) for _ in range(views)]
        words: list[list[int]] = [[], [], []]
        for row, flaw, flip in zip(rows, flaws, mirrored, strict=True):
            bad = "flawed" if self._chance(FLAWED_SHARE) else FLAWS[flaw]
            for said, found in zip(("clean", bad), words, strict=False):
                found.append(0 if self._chance(options.drop_text) else self._caption(row, said, flip))
            words[2].append(self._caption(row, "clean", flip))
        clean, flawed = self.latents(rows, flaws, mirrored)
        noise = torch.randn(clean.shape, generator=self.generator)
        # More of the little noise with which a contact can be told from a near miss.
        t = (TIMESTEPS * torch.rand(views, generator=self.generator) ** options.time_power).long()
        text = self.words.rows[[word for column in words for word in column]]
        text = text + options.text_noise * torch.randn(text.shape, generator=self.generator)
        z, wanted = torch.cat([clean, flawed, flawed]), torch.cat([clean, flawed, clean])
        return z, wanted, noise.repeat(3, 1, 1, 1, 1), torch.cat([t, t, t.clamp(min=MEND_FROM)]), text

    def losses(
        self, denoiser: VideoDenoiser, z: Tensor, wanted: Tensor, noise: Tensor, t: Tensor, text: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Squared errors of v of each clip, (B,): weighted towards the contact, and plain.

        v is what gives `wanted` as z_hat, which is the usual one where z itself is wanted.
        """
        alpha_bar = self.alphas_cumprod.to(z)[t][:, None, None, None, None]
        z_t = alpha_bar.sqrt() * z + (1 - alpha_bar).sqrt() * noise
        v = (alpha_bar.sqrt() * z_t - wanted) / (1 - alpha_bar).sqrt()
        error = (denoiser(z_t, t, text) - v).square()
        # Half way to equal weights of all channels: else the mean colours of patches are all that is learned.
        spread = denoiser.unknown(t).sqrt()
        weight = self.weight / spread * (spread.mean(2, keepdim=True))
        return (error * weight).mean((1, 2, 3, 4)), error.mean((1, 2, 3, 4))

    def objective(self) -> tuple[Tensor, Tensor]:
        weighted, plain = self.losses(self.denoiser, *self.batch())
        return weighted.mean(), plain.mean()

    @torch.no_grad()
    def test(self) -> dict[str, float]:
        """On held-out clips: the loss, and how much of a flaw z_hat has mended.

        0: the flawed clip itself; 1: all the way to the clean one, measured along that way alone. Called clean that
        should be much, called flawed nothing: guidance lives on the difference.
        """
        count = min(self.options.test_clips, len(self.held_out))
        generator = torch.Generator().manual_seed(0)
        t = torch.tensor(HELD_OUT_TIMES)
        losses: list[Tensor] = []
        mended: dict[str, list[Tensor]] = {"clean": [], "flawed": []}
        for i in range(count):
            row = self.held_out[i * len(self.held_out) // count]
            key = int(self.clips.limb[row]), int(self.clips.shape[row]), int(self.clips.person[row])
            good, bad = (
                self.words.rows[self.words.choices[(*key, SAID.index(said))][0]].expand(len(t), -1)
                for said in ("clean", "flawed")
            )
            clean, flawed = (
                part.expand(len(t), -1, -1, -1, -1) for part in self.latents([row], [i % len(FLAWS)], [False])
            )
            noise = torch.randn(clean.shape, generator=generator)
            losses.append(self.losses(self.average, clean, clean, noise, t, good)[1])
            alpha_bar = self.alphas_cumprod.to(clean)[t][:, None, None, None, None]
            z_t, way = alpha_bar.sqrt() * flawed + (1 - alpha_bar).sqrt() * noise, clean - flawed
            for said, text in (("clean", good), ("flawed", bad)):
                z_hat = predict_z(z_t, self.average(z_t, t, text), alpha_bar)
                mended[said].append(((z_hat - flawed) * way).sum((1, 2, 3, 4)) / way.square().sum((1, 2, 3, 4)))
        means = {f"mended_{said}": round(float(torch.cat(shares).median()), 4) for said, shares in mended.items()}
        return {"held_out": round(float(torch.cat(losses).mean()), 5), **means}

    def state(self) -> dict[str, Any]:
        return super().state() | {"text_mean": self.words.mean, "text_std": self.words.std}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self.words.normalise(state["text_mean"], state["text_std"])


def train(options: argparse.Namespace, command: str) -> None:
    """The whole of it: clips, training, publication.

    Raises:
        InputError: nothing to resume from, or clips in OUT that are damaged.
    """
    loop.begin(options)
    if options.clips < 2:
        raise InputError(f"--clips {options.clips}: at least 2")
    if options.batch < 3 or options.batch % 3:
        raise InputError(f"--batch {options.batch}: a multiple of 3")
    options.out.mkdir(parents=True, exist_ok=True)
    clips = provide_clips(options.out, options.clips, options.seed)
    training = Training(clips, options)
    publish(training.run(), clips, len(training.held_out), options, command)
