"""The training of the judge of motions, `hoi.motion.evaluator`: contrastive, on the windows that priors see."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from hoi.motion.evaluator import DIMENSION, Evaluator, Towers
from hoi.motion.text import default_cache, minilm
from hoi.training.motion.dataset import TrainingSet

TEMPERATURE = 0.1
KNOWN = 1024
"""Real motions that it remembers, for `Evaluator.strangeness`."""
STD_FLOOR = 0.02


def contrast(motion: Tensor, text: Tensor, fits: Tensor) -> Tensor:
    """Cross-entropy both ways, over a batch in which several sentences may fit a motion and the reverse.

    Args:
        motion, text: (B, DIMENSION).
        fits: whether sentence j describes motion i, (B, B).
    """
    likeness = nn.functional.normalize(motion, dim=-1) @ nn.functional.normalize(text, dim=-1).T / TEMPERATURE
    wanted = fits.to(likeness)
    forth = -(wanted / wanted.sum(1, keepdim=True) * likeness.log_softmax(1)).sum(1).mean()
    back = -(wanted / wanted.sum(0, keepdim=True) * likeness.log_softmax(0)).sum(0).mean()
    return (forth + back) / 2


def train_evaluator(data: TrainingSet, steps: int = 600, batch: int = 192, seed: int = 0) -> Evaluator:
    """Train on the windows of `data`, drawn by the root of their weights: evenly enough that rare kinds are learnt."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    encoder = minilm(default_cache())
    text = encoder.embed(data.captions)
    towers = Towers(text.shape[1], dropout=0.2)
    towers.mean = data.features.mean((0, 1))
    towers.std = data.features.std((0, 1)).clamp(min=STD_FLOOR)
    described = torch.zeros(len(data.features), len(data.captions), dtype=torch.bool)
    for window, rows in enumerate(data.caption_choices):
        described[window, rows] = True
    optimiser = torch.optim.AdamW(towers.parameters(), lr=1e-3, weight_decay=0.05)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    towers.train()
    for _ in range(steps):
        windows = torch.multinomial(data.weights.sqrt(), batch, replacement=True, generator=generator)
        captions = torch.multinomial(described[windows].float(), 1, generator=generator)[:, 0]
        noise = 0.05 * torch.randn(batch, text.shape[1], generator=generator) / text.shape[1] ** 0.5
        loss = contrast(
            towers.embed_motion(data.features[windows]),
            towers.embed_text(text[captions] + noise),
            described[windows][:, captions],
        )
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    evaluator = Evaluator(towers.eval().requires_grad_(False), encoder, torch.empty(0, DIMENSION))
    real = torch.multinomial(data.weights.sqrt(), min(KNOWN, len(data.features)), generator=generator)
    return replace(evaluator, known=evaluator.embed_motion(data.features[real]))
