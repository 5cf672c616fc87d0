"""Human motion score distillation (paper, Human Motion Score Distillation), the prior's pull in stages 1 and 2."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from hoi.body.kinematics import joint_positions
from hoi.data import Motion
from hoi.errors import RunError
from hoi.motion import features
from hoi.motion.prior import MotionPrior

PELVIS_VELOCITY = slice(1, 3)
"""Where `hoi.motion.features` has the pelvis' velocity along the ground."""


@dataclass
class PoseParameters:
    """The optimised X = (r, omega, theta); shapes as in `hoi.data.Motion`.

    The root's path is held as its start and its steps from frame to frame, of which the first, r(0), stays where it is.
    The prior sees steps, not places, and Adam moves each variable by about the learning rate an iteration: a pull on
    one frame then bends the whole way there instead of tearing that frame away from its neighbours. Without a prior
    (`steps` False) nothing ties frames together, and r is optimised frame by frame.
    """

    start: Tensor
    root: Tensor
    """Steps (T-1, 3) [m] if `steps`, else r (T, 3) [m]."""
    orientation: Tensor
    body_pose: Tensor
    steps: bool

    @classmethod
    def of(
        cls, motion: Motion, device: str = "cpu", dtype: torch.dtype = torch.float32, steps: bool = True
    ) -> "PoseParameters":
        def leaf(array: np.ndarray) -> Tensor:
            return torch.tensor(array, dtype=dtype, device=device, requires_grad=True)

        r = np.asarray(motion.translation, dtype=np.float64)
        root = np.diff(r, axis=0) if steps else r
        start = torch.tensor(r[:1], dtype=dtype, device=device)
        return cls(start, leaf(root), leaf(motion.orientation), leaf(motion.body_pose), steps)

    @property
    def translation(self) -> Tensor:
        """r [m], (T, 3)."""
        if not self.steps:
            return self.root
        return torch.cat([self.start, self.start + self.root.cumsum(dim=0)])

    def motion(self, fps: float) -> Motion:
        values = (p.detach().float().cpu().numpy() for p in (self.translation, self.orientation, self.body_pose))
        return Motion(*values, fps=fps)

    def leaves(self) -> tuple[Tensor, Tensor, Tensor]:
        """The tensors that are optimised."""
        return self.root, self.orientation, self.body_pose

    def joints(self, rest_joints: Tensor) -> Tensor:
        """World joint positions p_j(t) [m], (T, 24, 3)."""
        return joint_positions(self.translation, self.orientation, self.body_pose, rest_joints)


def leg_length(rest_joints: Tensor) -> Tensor:
    """Height of the pelvis above the lowest joint in the T-pose [m]."""
    return rest_joints[0, 1] - rest_joints[:, 1].min()


@dataclass(frozen=True)
class ScoreDistillation:
    """L_HMSD for one prior, prompt and body."""

    prior: MotionPrior
    text: Tensor
    """Features of the prompt."""
    leg_ratio: float
    """The prior's leg length over the body's: the prior knows one skeleton, people come in sizes."""
    sole_height: float
    """Height of the body's lowest joint when its soles stand on the ground [m]."""
    guidance: float
    rescale: float
    """Of the guidance, see `hoi.motion.diffusion.guide`."""
    t_min: int
    t_max: int
    stand: bool = False
    """Whether the person stays where they are: the prior is held to a pelvis that does not travel."""

    def features(self, pose: PoseParameters) -> Tensor:
        """The prior's normalised features of X, (T, 205)."""
        raw = features.encode(
            pose.translation * self.leg_ratio,
            pose.orientation,
            pose.body_pose,
            self.prior.rest_joints,
            ground=self.sole_height * self.leg_ratio,
        )
        return self.prior.normalise(raw)

    def predict_x0(self, x_t: Tensor, t: Tensor, guidance: float, rescale: float) -> Tensor:
        """X0_hat of the prior for the prompt, (B, T, 205); with `stand`, of a pelvis that does not travel."""
        x0 = self.prior.predict_x0(x_t, t, self.text, guidance, rescale)
        if not self.stand:
            return x0
        still = self.prior.normalise(torch.zeros_like(x0[0, 0]))[PELVIS_VELOCITY]
        x0[..., PELVIS_VELOCITY] = still  # as MDM edits motions: what is known replaces the prediction
        return x0

    def loss(self, pose: PoseParameters, generator: torch.Generator) -> Tensor:
        """0.5 w(t) |X - X0_hat|^2, averaged over features and frames; X0_hat is held constant.

        The paper's w (X0_hat - X) is the direction of the update; the gradient to descend is its negative, which this
        has. w(t) = 1 - alphas_cumprod[t] (Human Motion Score Distillation Details).
        """
        x = self.features(pose)
        t = int(torch.randint(self.t_min, self.t_max, (), generator=generator))
        noise = torch.randn(x.shape, generator=generator).to(x)
        alpha_bar = self.prior.alphas_cumprod[t].to(x)
        with torch.no_grad():
            x_t = alpha_bar.sqrt() * x + (1 - alpha_bar).sqrt() * noise
            steps = torch.full((1,), t, device=x.device)
            x0 = self.predict_x0(x_t[None], steps, self.guidance, self.rescale)[0]
        return 0.5 * (1 - alpha_bar) * ((x - x0) ** 2).mean()


def optimise(
    pose: PoseParameters,
    losses: Callable[[], dict[str, Tensor]],
    weights: dict[str, float],
    iterations: int,
    learning_rate: float,
    on_iteration: Callable[[int, dict[str, float]], None],
    decay: float = 0.0,
) -> None:
    """Adam on X, in place (paper, Optimization Details). `losses` names the terms; their weighted sum is descended.

    Over the last `decay` of the iterations the learning rate falls linearly to 0: Adam's steps are about as large as
    it whatever the loss, so that X would otherwise tremble by that much from frame to frame at the end.

    Raises:
        RunError: a loss or X is not finite.
    """
    optimiser = torch.optim.Adam(pose.leaves(), lr=learning_rate)
    for iteration in range(iterations):
        left = (iterations - iteration) / (decay * iterations) if decay else 1.0
        optimiser.param_groups[0]["lr"] = learning_rate * min(left, 1.0)
        optimiser.zero_grad()
        terms = losses()
        total = torch.stack([weights[name] * value for name, value in terms.items()]).sum()
        total.backward()
        optimiser.step()
        values = {name: float(value.detach()) for name, value in terms.items()}
        if not all(math.isfinite(value) for value in values.values()):
            raise RunError(
                f"the motion is not finite after {iteration} iterations; lower the guidance or learning rate"
            )
        on_iteration(iteration, values)
    if not all(bool(leaf.isfinite().all()) for leaf in pose.leaves()):
        raise RunError("the motion is not finite after the last iteration; lower the guidance or learning rate")
