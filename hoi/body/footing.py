"""Feet on the ground: which the free motion plants, and the losses that keep them there and all of them above it."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hoi.body.strength import FEET, LOW
from hoi.data import Array

SLOW = 0.9
"""A planted joint is slower [m/s]: sqrt(0.002) m a frame at 20 FPS, the threshold of HumanML3D's foot contacts."""


@dataclass(frozen=True)
class Stance:
    """One joint on the ground from frame `first` to frame `last`, both included."""

    joint: int
    first: int
    last: int


def stances(joints: Array, standing_heights: Array, fps: float) -> list[Stance]:
    """When the feet stand.

    Args:
        joints: world joint positions [m], (T, 24, 3).
        standing_heights: z of the joints of the standing person [m], (24,).
    """
    found = []
    for joint in FEET:
        path = joints[:, joint]
        low = path[:, 2] < standing_heights[joint] + LOW
        slow = np.linalg.norm(np.diff(path, axis=0), axis=1) * fps < SLOW
        still = np.concatenate([[False], slow & low[1:] & low[:-1], [False]]).astype(int)
        starts, ends = np.flatnonzero(np.diff(still) == 1), np.flatnonzero(np.diff(still) == -1)
        found += [Stance(joint, int(first), int(last)) for first, last in zip(starts, ends, strict=True)]
    return found


class Footing:
    """L_feet of the stances of a motion.

    Only the place of a joint *within* a stance is held, at the mean of that stance, not the place of the stance:
    whoever has further to go takes longer steps. The height is that of the motion it was made from.
    """

    def __init__(self, joints: Array, stances: list[Stance], device: str = "cpu") -> None:
        frames = [np.arange(stance.first, stance.last + 1) for stance in stances]
        lengths = torch.tensor([len(span) for span in frames], device=device)
        self._frame = torch.as_tensor(np.concatenate(frames), device=device)
        self._joint = torch.tensor([stance.joint for stance in stances], device=device).repeat_interleave(lengths)
        self._stance = torch.arange(len(stances), device=device).repeat_interleave(lengths)
        self._lengths = lengths[:, None]
        heights = np.concatenate([joints[span, s.joint, 2] for span, s in zip(frames, stances, strict=True)])
        self._heights = torch.as_tensor(heights, dtype=torch.float32, device=device)

    def deviations(self, joints: Tensor) -> Tensor:
        """From the mean place of the stance, and from the height [m], (planted joint-frames, 3)."""
        at = joints[self._frame, self._joint]
        sums = at.new_zeros(len(self._lengths), 2).index_add(0, self._stance, at[:, :2])
        place = (sums / self._lengths)[self._stance]
        return torch.cat([at[:, :2] - place, (at[:, 2] - self._heights.to(at))[:, None]], dim=-1)

    def loss(self, joints: Tensor) -> Tensor:
        """L_feet: mean squared deviation [m^2]. Joints (T, 24, 3) [m]."""
        return self.deviations(joints).square().sum(-1).mean()


def sunk(joints: Tensor, standing_heights: Tensor) -> Tensor:
    """How deep feet are in the ground: squared depth below where they stand, summed over feet, mean over frames [m^2].

    Args:
        joints: (..., T, 24, 3) [m].
        standing_heights: z of the joints of the standing person [m], (24,).
    """
    feet = list(FEET)
    return (standing_heights[feet] - joints[..., feet, 2]).clamp(min=0).square().sum(-1).mean(-1)


def slide(joints: Array, stances: list[Stance]) -> float:
    """How far planted joints wander within a stance: largest distance from its mean place, averaged [m]."""
    if not stances:
        return 0.0
    spans = (joints[s.first : s.last + 1, s.joint, :2] for s in stances)
    return float(np.mean([np.linalg.norm(span - span.mean(axis=0), axis=1).max() for span in spans]))
