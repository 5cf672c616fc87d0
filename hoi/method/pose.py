"""The optimised motion X, at the frame rate of whoever judges it, and the motion that it makes at the scene's."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

from hoi.body.interpolate import interpolate_motion
from hoi.body.kinematics import joint_positions
from hoi.data import Motion

LEAST_KNOTS = 3
"""The motion prior sees velocities and their changes."""


def knots(frames: int, fps: float, rate: float) -> int:
    """How many frames at `rate` last as long as `frames` at `fps`: a prior draws the same then."""
    if math.isclose(rate, fps):
        return frames
    return max(round(frames * rate / fps), LEAST_KNOTS)


def resampled(motion: Motion, frames: int, fps: float) -> Motion:
    """The motion with so many frames, so many a second; its last pose held where it is shorter."""
    if math.isclose(fps, motion.fps):
        return motion
    at = np.minimum(np.arange(frames) * (motion.fps / fps), len(motion) - 1)
    return replace(interpolate_motion(motion, at), fps=fps)


@dataclass
class PoseParameters:
    """The optimised X = (r, omega, theta) of B runs at once; shapes as in `hoi.data.Motion`, after B.

    The root's path is held as its start and its steps from frame to frame, of which the first, r(0), stays where it is.
    The prior sees steps, not places, and Adam moves each variable by about the learning rate an iteration: a pull on
    one frame then bends the whole way there instead of tearing that frame away from its neighbours. Without a prior
    (`steps` False) nothing ties frames together, and r is optimised frame by frame.
    """

    start: Tensor
    root: Tensor
    """Steps (B, T-1, 3) [m] if `steps`, else r (B, T, 3) [m]."""
    orientation: Tensor
    body_pose: Tensor
    steps: bool
    between: "Between | None" = None
    """Where X has another frame rate than its motion."""

    @classmethod
    def of(
        cls,
        motions: Sequence[Motion],
        device: str = "cpu",
        dtype: torch.dtype = torch.float32,
        steps: bool = True,
        rate: float | None = None,
    ) -> "PoseParameters":
        """The motions, which are of one length and frame rate, one a run.

        Args:
            rate: frames a second of X; None is the motions' own.
        """
        shown = None
        if rate is not None and not math.isclose(rate, motions[0].fps):
            shown = motions
            motions = [resampled(motion, knots(len(motion), motion.fps, rate), rate) for motion in motions]

        def leaf(arrays: Sequence[np.ndarray]) -> Tensor:
            return torch.tensor(np.stack(arrays), dtype=dtype, device=device, requires_grad=True)

        r = [np.asarray(motion.translation, dtype=np.float64) for motion in motions]
        root = leaf([np.diff(path, axis=0) if steps else path for path in r])
        start = torch.tensor(np.stack([path[:1] for path in r]), dtype=dtype, device=device)
        orientation, body_pose = [motion.orientation for motion in motions], [motion.body_pose for motion in motions]
        pose = cls(start, root, leaf(orientation), leaf(body_pose), steps)
        return pose if shown is None or rate is None else replace(pose, between=Between.of(shown, pose, rate))

    @property
    def translation(self) -> Tensor:
        """r [m], (B, T, 3)."""
        if not self.steps:
            return self.root
        return torch.cat([self.start, self.start + self.root.cumsum(dim=-2)], dim=-2)

    def shown(self) -> tuple[Tensor, Tensor, Tensor]:
        """r, omega, theta of the motion at its own frame rate."""
        values = (self.translation, self.orientation, self.body_pose)
        return values if self.between is None else self.between(values)

    def motions(self, fps: float) -> list[Motion]:
        """One motion a run."""
        values = (part.detach().float().cpu().numpy() for part in self.shown())
        return [Motion(*parts, fps=fps) for parts in zip(*values, strict=True)]

    def leaves(self) -> tuple[Tensor, Tensor, Tensor]:
        """The tensors that are optimised."""
        return self.root, self.orientation, self.body_pose

    def joints(self, rest_joints: Tensor) -> Tensor:
        """World joint positions p_j(t) [m], (B, T, 24, 3)."""
        return joint_positions(*self.shown(), rest_joints)


@dataclass(frozen=True)
class Between:
    """A motion at another frame rate than that of the X that changes it.

    It has its own detail, which X, at the prior's rate, may be too coarse for; what X has changed is added, from one of
    its frames to the next by a cubic spline.
    """

    motion: tuple[Tensor, Tensor, Tensor]
    """r, omega, theta before anything has changed, (B, T, ...)."""
    begun: tuple[Tensor, Tensor, Tensor]
    """Those of X then, (B, K, ...)."""
    spline: Tensor
    """What each frame of X adds to each of the motion, (T, K)."""

    @classmethod
    def of(cls, motions: Sequence[Motion], pose: PoseParameters, rate: float) -> "Between":
        parts = [[getattr(motion, name) for motion in motions] for name in ("translation", "orientation", "body_pose")]
        r, omega, theta = (torch.as_tensor(np.stack(part)).to(pose.orientation) for part in parts)
        begun = (pose.translation.detach(), pose.orientation.detach().clone(), pose.body_pose.detach().clone())
        count = pose.orientation.shape[1]
        spline = CubicSpline(np.arange(count), np.eye(count), bc_type="natural")
        at = np.arange(len(motions[0])) * (rate / motions[0].fps)
        return cls((r, omega, theta), begun, torch.as_tensor(spline(at)).to(pose.orientation))

    def __call__(self, now: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """The motion of X as it is now."""
        r, omega, theta = (
            motion + torch.einsum("tk,bk...->bt...", self.spline, value - before)
            for motion, value, before in zip(self.motion, now, self.begun, strict=True)
        )
        return r, omega, theta
