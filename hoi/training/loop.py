"""The loop of a training, whatever is trained: optimiser, moving average, schedule, checkpoints and log."""

import argparse
import json
import math
import time
from abc import ABC, abstractmethod
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor

from hoi.errors import InputError
from hoi.files import whole_file
from hoi.motion.mdm import MotionDenoiser
from hoi.video_prior.denoiser import VideoDenoiser

LOG_EVERY, TEST_EVERY = 50, 300
CHECKPOINT, LOG = "checkpoint.pt", "log.jsonl"
Denoiser = TypeVar("Denoiser", MotionDenoiser, VideoDenoiser)


def begin(options: argparse.Namespace) -> None:
    """Set the threads, and see that there is something to resume from.

    Raises:
        InputError: there is not.
    """
    torch.set_num_threads(options.threads)
    checkpoint = options.out / CHECKPOINT
    if options.resume and not checkpoint.is_file():
        raise InputError(f"--resume: {checkpoint} does not exist")


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """As torch does, replaced in one piece."""
    with whole_file(path) as part:
        torch.save(state, part)


class Training(ABC, Generic[Denoiser]):
    """The state of one training: denoiser, its moving average, optimiser, counters."""

    cosine = staticmethod(math.cos)
    """Of the schedule."""

    def __init__(self, options: argparse.Namespace, denoiser: Denoiser, average: Denoiser) -> None:
        """`average` is of the same architecture and takes the denoiser's values."""
        self.options, self.denoiser = options, denoiser
        self.average = average.requires_grad_(False).eval()
        self.average.load_state_dict(denoiser.state_dict())
        self.optimiser = torch.optim.AdamW(
            denoiser.parameters(), lr=options.lr, betas=(0.9, 0.99), weight_decay=0.01, fused=True
        )
        self.generator = torch.Generator().manual_seed(options.seed)
        self.step, self.seconds = 0, 0.0

    @abstractmethod
    def objective(self) -> tuple[Tensor, Tensor]:
        """Of the next batch: what is descended, and the plain squared error for the log."""

    def test(self) -> dict[str, float]:
        """What the log says now and then besides the loss."""
        return {}

    def progress(self) -> float:
        """How much of the training is done, by steps or by time, whichever is further."""
        done = self.step / self.options.steps
        return max(done, self.seconds / (60 * self.options.minutes)) if self.options.minutes else done

    def learning_rate(self) -> float:
        """Linear warm-up, then half a cosine down to a hundredth."""
        warm = min(1.0, (self.step + 1) / self.options.warmup)
        return self.options.lr * warm * max(0.01, 0.5 * (1 + self.cosine(math.pi * min(1.0, self.progress()))))

    def advance(self) -> float:
        """One optimiser step; returns the plain squared error."""
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate()
        loss, plain = self.objective()
        self.optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.denoiser.parameters(), 1.0)
        self.optimiser.step()
        self.step += 1
        decay = min(self.options.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for slow, fast in zip(self.average.parameters(), self.denoiser.parameters(), strict=True):
                slow.lerp_(fast, 1 - decay)
        return float(plain.detach())

    def state(self) -> dict[str, Any]:
        """All that resuming and exporting need; plain tensors and numbers."""
        return {
            "denoiser": self.denoiser.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "step": self.step,
            "seconds": self.seconds,
            "architecture": asdict(self.denoiser.architecture),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint of `state`, with its statistics even where the data has changed since."""
        self.denoiser.load_state_dict(state["denoiser"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"])
        self.step, self.seconds = state["step"], state["seconds"]

    def run(self) -> dict[str, Any]:
        """Train to the end, from the checkpoint where the options say so; log and checkpoint on the way.

        Returns:
            The state at the end.
        """
        out = self.options.out
        out.mkdir(parents=True, exist_ok=True)
        if self.options.resume:
            self.restore(torch.load(out / CHECKPOINT, weights_only=True))
        else:
            (out / LOG).unlink(missing_ok=True)
        start, already = time.monotonic(), self.seconds
        last_save, losses = start, []
        while self.progress() < 1:
            losses.append(self.advance())
            now = time.monotonic()
            self.seconds = already + now - start
            ends = self.progress() >= 1
            if self.step % LOG_EVERY == 0 or ends:
                row = {
                    "step": self.step,
                    "minutes": round(self.seconds / 60, 2),
                    "loss": round(sum(losses) / len(losses), 5),
                    "lr": round(self.learning_rate(), 7),
                }
                if self.step % TEST_EVERY == 0 or ends:
                    row |= self.test()
                losses = []
                with (out / LOG).open("a") as log:
                    log.write(json.dumps(row) + "\n")
            if now - last_save > 60 * self.options.save_minutes:
                save_checkpoint(out / CHECKPOINT, self.state())
                last_save = now
        state = self.state()
        save_checkpoint(out / CHECKPOINT, state)
        return state
