"""The training of a motion prior, of which `.train` is the command: data, batches, loss, what is left behind."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hoi.errors import InputError
from hoi.motion.diffusion import cosine_alphas_cumprod, q_sample
from hoi.motion.mdm import Architecture, MotionDenoiser
from hoi.motion.prior import DENOISER_PREFIX, STATISTICS, write_prior
from hoi.motion.text import MINILM_PACKAGE, MINILM_SHA256, file_sha256, minilm
from hoi.training import loop
from hoi.training.motion import deepmimic
from hoi.training.motion.captions import write_captions
from hoi.training.motion.dataset import (
    FPS,
    HELD_OUT,
    Clip,
    TrainingSet,
    build_training_set,
    is_held_out,
    read_captions,
    read_clips,
    rest_joints_of,
    with_knee_strikes,
)
from hoi.training.motion.losses import MotionLoss

STD_FLOOR = 0.005
"""Features that hardly vary (wrists, the hips' offset) are not blown up to unit variance [m or -]."""


def weighted_stats(values: Tensor, weights: Tensor, floor: float) -> tuple[Tensor, Tensor]:
    """Mean and floored standard deviation of values (N, ..., F) with weights (N,) that sum to 1."""
    flat = values.flatten(1, -2) if values.ndim > 2 else values[:, None]
    mean = torch.einsum("n,nf->f", weights, flat.mean(1))
    variance = torch.einsum("n,nf->f", weights, (flat - mean).square().mean(1))
    return mean, variance.sqrt().clamp(min=floor)


class Training(loop.Training[MotionDenoiser]):
    """The state of one training: the loop's, and the windows with their statistics."""

    cosine = staticmethod(lambda angle: torch.cos(torch.tensor(angle)).item())  # in single precision, ever since

    def __init__(self, data: TrainingSet, options: argparse.Namespace):
        torch.manual_seed(options.seed)
        text = minilm().embed(data.captions)
        architecture = Architecture(
            features=data.features.shape[-1],
            text_dim=text.shape[-1],
            latent_dim=options.latent_dim,
            ff_size=options.ff_size,
            layers=options.layers,
            heads=options.heads,
        )
        super().__init__(options, MotionDenoiser(architecture, token_dropout=0.1), MotionDenoiser(architecture))
        self.data = data
        self.alphas_cumprod = cosine_alphas_cumprod(options.timesteps)
        self.raw_text = text
        self.standardise(*weighted_stats(data.features, data.weights, STD_FLOOR), text.mean(0), text.std(0))
        self.choice_count = torch.tensor([len(rows) for rows in data.caption_choices])
        self.choices = torch.nn.utils.rnn.pad_sequence(
            [torch.tensor(rows) for rows in data.caption_choices], batch_first=True
        )

    def standardise(self, mean: Tensor, std: Tensor, text_mean: Tensor, text_std: Tensor) -> None:
        """Set the statistics and what is computed with them."""
        self.mean, self.std, self.text_mean, self.text_std = mean, std, text_mean, text_std
        self.features = (self.data.features - mean) / std
        self.loss = MotionLoss(mean, std, self.data.rest_joints)
        self.text = (self.raw_text - text_mean) / text_std

    def batch(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """x0, noise, t and text of one batch; a tenth of the texts is empty."""
        options, generator = self.options, self.generator
        rows = torch.multinomial(self.data.weights, options.batch, replacement=True, generator=generator)
        x0 = self.features[rows]
        pick = (torch.rand(options.batch, generator=generator) * self.choice_count[rows]).long()
        caption = self.choices[rows, pick]
        caption[torch.rand(options.batch, generator=generator) < options.drop_text] = 0
        text = self.text[caption]
        text = text + options.text_noise * torch.randn(text.shape, generator=generator)
        t = torch.randint(options.timesteps, (options.batch,), generator=generator)
        return x0, torch.randn(x0.shape, generator=generator), t, text

    def objective(self) -> tuple[Tensor, Tensor]:
        """The loss, and the MSE of the normalised x0 without its other terms."""
        x0, noise, t, text = self.batch()
        predicted = self.denoiser(q_sample(x0, t, noise, self.alphas_cumprod), t, text)
        return self.loss(predicted, x0, self.alphas_cumprod.to(x0)[t])

    def state(self) -> dict[str, Any]:
        return super().state() | {
            "dropout_generator": torch.get_rng_state(),
            "mean": self.mean,
            "std": self.std,
            "text_mean": self.text_mean,
            "text_std": self.text_std,
            "rest_joints": self.data.rest_joints,
            "timesteps": self.options.timesteps,
            "fps": FPS,
        }

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self.standardise(state["mean"], state["std"], state["text_mean"], state["text_std"])
        torch.set_rng_state(state["dropout_generator"])

    def publish(self, facts: dict[str, Any], command: str) -> None:
        """Write prior.safetensors and prior.json (of the moving average), captions, training.json and curve.png."""
        out = self.options.out
        tensors = {DENOISER_PREFIX + name: value for name, value in self.average.state_dict().items()}
        tensors |= dict(zip(STATISTICS, (self.mean, self.std, self.text_mean, self.text_std), strict=True))
        description = {
            "source": f"embedded prior, {self.step} steps",
            "features": "smplrifke",
            "architecture": asdict(self.average.architecture),
            "timesteps": self.options.timesteps,
            "fps": FPS,
            "text_encoder": {"name": "all-MiniLM-L6-v2", "package": MINILM_PACKAGE, "sha256": MINILM_SHA256},
            "rest_joints": [[round(value, 6) for value in row] for row in self.data.rest_joints.tolist()],
        }
        write_prior(out, tensors, description)
        write_captions(out, self.data, minilm())
        self.report(command, **facts)
        log = self.log()
        with loop.curves(out, 1, (6, 3.5)) as (axes,):
            axes.semilogy([row["step"] for row in log], [row["loss"] for row in log], linewidth=1)
            axes.set(ylabel="MSE of the normalised $x_0$", title="training loss")


def clip_files(folder: Path) -> list[Path]:
    """The clip files of --data.

    Raises:
        InputError: there is none.
    """
    files = sorted(folder.glob("*.npz"))
    if not files:
        raise InputError(f"--data {folder}: holds no .npz clip file")
    return files


def split(clips: list[Clip], rest_joints: Tensor) -> tuple[list[Clip], list[Clip]]:
    """What priors are trained on, with knee strikes, and what is held out."""
    clips = with_knee_strikes(clips, rest_joints)
    return [clip for clip in clips if not is_held_out(clip)], [clip for clip in clips if is_held_out(clip)]


def read_split(folder: Path) -> tuple[TrainingSet, TrainingSet]:
    """What priors are trained on and what is held out, of a folder of clip files.

    Raises:
        InputError: there is no clip file, or all or none of the clips is held out.
    """
    rest_joints, sentences = rest_joints_of(deepmimic.OFFSETS), read_captions(folder)
    parts = split([clip for file in clip_files(folder) for clip in read_clips(file)], rest_joints)
    training, held_out = (build_training_set(part, rest_joints, sentences) for part in parts)
    return training, held_out


def read_data(options: argparse.Namespace) -> tuple[TrainingSet, dict[str, Any]]:
    """The training set that the command line asks for, and what to say about it in training.json."""
    files = clip_files(options.data) if options.data else []
    clips = [clip for file in files for clip in read_clips(file)]
    if options.pybullet:
        folder = deepmimic.clip_folder()
        clips += deepmimic.read_clips(folder)
        files += sorted(folder.glob("humanoid3d_*.txt"))
    if not clips:
        raise InputError("--data, --pybullet: give at least one of them")
    rest_joints = rest_joints_of(deepmimic.OFFSETS)
    training, held_out = split(clips, rest_joints)
    data = build_training_set(training, rest_joints, read_captions(options.data))
    return data, {
        "clips": len(training),
        "held_out": {"clips": len(held_out), "names_begin_with": HELD_OUT},
        "windows": data.summary,
        "data": {file.name: file_sha256(file) for file in files},
    }


def train(options: argparse.Namespace, command: str) -> None:
    """The whole of it: data, training, publication.

    Raises:
        InputError: no data, or nothing to resume from.
    """
    loop.begin(options)
    data, facts = read_data(options)
    training = Training(data, options)
    training.run()
    training.publish(facts, command)
