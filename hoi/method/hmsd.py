"""Human motion score distillation (paper, Human Motion Score Distillation), the prior's pull in stages 1 and 2."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hoi.adam import Adam
from hoi.body.kinematics import joint_positions, leg_length
from hoi.body.skinning import sole_height
from hoi.data import Motion, Scene
from hoi.errors import RunError
from hoi.motion import features
from hoi.motion.diffusion import ancestral_sample, ddim_sample, q_sample
from hoi.motion.prior import MotionPrior, load_prior
from hoi.reports import Stage
from hoi.streams import stream_seed

PELVIS_VELOCITY = slice(1, 3)
"""Where `hoi.motion.features` has the pelvis' velocity along the ground."""


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

    @classmethod
    def of(
        cls, motions: Sequence[Motion], device: str = "cpu", dtype: torch.dtype = torch.float32, steps: bool = True
    ) -> "PoseParameters":
        """The motions, which are of one length, one a run."""

        def leaf(arrays: Sequence[np.ndarray]) -> Tensor:
            return torch.tensor(np.stack(arrays), dtype=dtype, device=device, requires_grad=True)

        r = [np.asarray(motion.translation, dtype=np.float64) for motion in motions]
        root = leaf([np.diff(path, axis=0) if steps else path for path in r])
        start = torch.tensor(np.stack([path[:1] for path in r]), dtype=dtype, device=device)
        orientation, body_pose = [motion.orientation for motion in motions], [motion.body_pose for motion in motions]
        return cls(start, root, leaf(orientation), leaf(body_pose), steps)

    @property
    def translation(self) -> Tensor:
        """r [m], (B, T, 3)."""
        if not self.steps:
            return self.root
        return torch.cat([self.start, self.start + self.root.cumsum(dim=-2)], dim=-2)

    def motions(self, fps: float) -> list[Motion]:
        """One motion a run."""
        values = (p.detach().float().cpu().numpy() for p in (self.translation, self.orientation, self.body_pose))
        return [Motion(*parts, fps=fps) for parts in zip(*values, strict=True)]

    def leaves(self) -> tuple[Tensor, Tensor, Tensor]:
        """The tensors that are optimised."""
        return self.root, self.orientation, self.body_pose

    def joints(self, rest_joints: Tensor) -> Tensor:
        """World joint positions p_j(t) [m], (B, T, 24, 3)."""
        return joint_positions(self.translation, self.orientation, self.body_pose, rest_joints)


def stream_generators(seeds: Sequence[int], name: str) -> list[torch.Generator]:
    """The stream `name` of each run (see `hoi.streams`)."""
    return [torch.Generator().manual_seed(stream_seed(seed, name)) for seed in seeds]


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
        """The prior's normalised features of X, (B, T, 205)."""
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

    def loss(self, pose: PoseParameters, generators: Sequence[torch.Generator]) -> Tensor:
        """0.5 w(t) |X - X0_hat|^2, averaged over features and frames, of each run, (B,); X0_hat is held constant.

        The paper's w (X0_hat - X) is the direction of the update; the gradient to descend is its negative, which this
        has. w(t) = 1 - alphas_cumprod[t] (Human Motion Score Distillation Details). Each run draws t and noise from
        its own generator.
        """
        x = self.features(pose)
        drawn = [
            (torch.randint(self.t_min, self.t_max, (), generator=each), torch.randn(x.shape[1:], generator=each))
            for each in generators
        ]
        t, noise = (torch.stack(part).to(x.device) for part in zip(*drawn, strict=True))
        with torch.no_grad():
            x_t = q_sample(x, t, noise.to(x), self.prior.alphas_cumprod)
            x0 = self.predict_x0(x_t, t, self.guidance, self.rescale)
        weights = 1 - self.prior.alphas_cumprod.to(x)[t]
        return 0.5 * weights * ((x - x0) ** 2).mean(dim=(-1, -2))


def optimise(
    pose: PoseParameters,
    losses: Callable[[], dict[str, Tensor]],
    weights: Mapping[str, float | Tensor],
    iterations: int,
    learning_rate: float,
    stages: Sequence[Stage],
    decay: float = 0.0,
) -> None:
    """Adam on X, in place (paper, Optimization Details).

    `losses` names the terms, each (B,); what is descended is their sum with `weights`, a number or (B,) each. The runs
    do not act on each other.

    Over the last `decay` of the iterations the learning rate falls linearly to 0: Adam's steps are about as large as
    it whatever the loss, so that X would otherwise tremble by that much from frame to frame at the end.

    Raises:
        RunError: a loss or X is not finite.
    """
    adam = Adam(pose.leaves(), learning_rate)
    for iteration in range(iterations):
        left = (iterations - iteration) / (decay * iterations) if decay else 1.0
        adam.learning_rate = learning_rate * min(left, 1.0)
        terms = losses()
        total = torch.stack([(weights[name] * value).sum() for name, value in terms.items()]).sum()
        adam.gradients_of(total)
        adam.step()
        if not bool(total.isfinite()):
            raise RunError(
                f"the motion is not finite after {iteration} iterations; lower the guidance or learning rate"
            )
        values = {name: value.detach().tolist() for name, value in terms.items()}
        for row, stage in enumerate(stages):
            stage.iteration(iteration, {name: value[row] for name, value in values.items()})
    if not all(bool(leaf.isfinite().all()) for leaf in pose.leaves()):
        raise RunError("the motion is not finite after the last iteration; lower the guidance or learning rate")


@dataclass(frozen=True)
class Sampling:
    """How a motion is drawn from the prior."""

    guidance: float
    """Scale [-]."""
    rescale: float
    """Share of its overshoot that is taken back [-]."""
    sampler: str
    """"ancestral" or "ddim"."""
    steps: int | None
    """Evenly spaced timesteps; None takes all."""


def load_distillation(
    scene: Scene,
    device: str,
    *,
    checkpoint: str | None,
    guidance: float,
    rescale: float,
    t_min: int,
    t_max: int,
    stand: bool = False,
    clip: Path | None = None,
) -> ScoreDistillation:
    """The motion prior, made ready for this scene's prompt and person; see `ScoreDistillation`.

    Args:
        checkpoint, clip: of the prior and its text encoder, see `hoi.motion.prior.load_prior`.
    """
    prior = load_prior(Path(checkpoint) if checkpoint else None, device, clip)
    body_leg = leg_length(torch.as_tensor(scene.body.rest_joints))
    return ScoreDistillation(
        prior=prior,
        text=prior.encode_text([scene.motion_prompt]),
        leg_ratio=float(leg_length(prior.rest_joints) / body_leg),
        sole_height=sole_height(scene.body),
        guidance=guidance,
        rescale=rescale,
        t_min=t_min,
        t_max=min(t_max, prior.timesteps),
        stand=stand,
    )


def synthesise(
    distillation: ScoreDistillation,
    starts: Sequence[Motion],
    seeds: Sequence[int],
    stages: Sequence[Stage],
    *,
    iterations: int,
    learning_rate: float,
) -> list[Motion]:
    """N_init iterations of L_HMSD. One motion a seed, optimised as one batch; `stages` are told of one each."""
    pose = PoseParameters.of(starts, str(distillation.prior.device))
    generators = stream_generators(seeds, "motion")

    def losses() -> dict[str, Tensor]:
        return {"hmsd": distillation.loss(pose, generators)}

    optimise(pose, losses, {"hmsd": 1.0}, iterations, learning_rate, stages)
    return pose.motions(starts[0].fps)


def sample_features(distillation: ScoreDistillation, how: Sampling, frames: int, seeds: Sequence[int]) -> Tensor:
    """One motion a seed drawn from the prior, as its features (B, T, 205), for its own skeleton.

    Raises:
        RunError: they are not finite.
    """
    prior = distillation.prior

    def predict(x: Tensor, t: Tensor) -> Tensor:
        return distillation.predict_x0(x, t, how.guidance, how.rescale)

    sample = ddim_sample if how.sampler == "ddim" else ancestral_sample
    steps = None if how.steps is None else min(how.steps, prior.timesteps)
    generators = stream_generators(seeds, "sample")
    shape = (len(seeds), frames, features.FEATURE_COUNT)
    drawn = prior.denormalise(sample(predict, shape, prior.alphas_cumprod, generators, steps, prior.device))
    if not bool(drawn.isfinite().all()):
        raise RunError("the prior's sample is not finite; lower stage.motion.sample_guidance or use another prior")
    return drawn


def sample_motions(
    distillation: ScoreDistillation, how: Sampling, frames: int, fps: float, seeds: Sequence[int]
) -> list[Motion]:
    """One motion a seed drawn from the prior, on this body, from the origin facing +Y.

    Raises:
        RunError: as `sample_features`.
    """
    drawn = sample_features(distillation, how, frames, seeds)
    translation, orientation, body_pose = (part.cpu().numpy() for part in features.decode(drawn))
    translation = translation / distillation.leg_ratio + np.array([0, 0, distillation.sole_height], translation.dtype)
    return [Motion(*parts, fps=fps) for parts in zip(translation, orientation, body_pose, strict=True)]
