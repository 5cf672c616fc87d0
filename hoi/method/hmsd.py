"""Human motion score distillation (paper, Human Motion Score Distillation), the prior's pull in stages 1 and 2."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hoi.adam import Adam
from hoi.body.kinematics import forward_kinematics, leg_length, local_rotations
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import sole_height
from hoi.data import Motion, Scene
from hoi.errors import InputError, RunError
from hoi.method.pose import PoseParameters, knots, resampled
from hoi.motion import features
from hoi.motion.collage import Timeline
from hoi.motion.diffusion import ancestral_sample, ddim_sample, q_sample
from hoi.motion.prior import MotionPrior, load_prior
from hoi.reports import Stage
from hoi.streams import stream_seed

PELVIS_VELOCITY, MOVING = slice(1, 3), slice(1, 4)
"""Where `hoi.motion.features` has the pelvis' velocity along the ground, and with it its turning."""
ENDS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
"""What strikes, mostly."""
LEAST_FRAMES, MOST_FRAMES = 40, 4000
"""Frames of the prior: shorter motions than those it was trained on it knows only as a piece of one, held at its ends;
the denoiser has places for some thousand."""

AT_ONCE = 4
"""Windows of a timeline that an iteration of L_HMSD looks at, drawn anew each time: its gradient is on average that of
all, and a long scene costs an iteration no more than a short one does."""


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
    summed: bool = False
    """Whether the loss is the sum over features and frames, or their mean."""
    stand: bool = False
    """Whether the person stays where they are: the prior is held to a pelvis that does not travel."""
    timeline: Timeline | None = None
    """The acts, where there are any: their sentences stand in the place of `text`."""
    frames: tuple[float, float] = (0.0, math.inf)
    """Of a timeline, L_HMSD looks from here to there alone [s]."""

    def between(self, first: float, last: float) -> "ScoreDistillation":
        """The same that looks from here to there alone [s]."""
        return replace(self, frames=(first, last))

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

    def pose(self, motions: Sequence[Motion], device: str) -> PoseParameters:
        """X of motions of any frame rate, at the prior's.

        Raises:
            InputError: they are longer than the prior can see.
        """
        pose = PoseParameters.of(motions, device, rate=self.prior.fps)
        if pose.orientation.shape[1] > MOST_FRAMES:
            seconds = MOST_FRAMES / self.prior.fps
            raise InputError("scene.frames", len(motions[0]), f"at most {seconds:g} s long, {MOST_FRAMES} of the prior")
        return pose

    def predict_x0(self, x_t: Tensor, t: Tensor, guidance: float, rescale: float) -> Tensor:
        """X0_hat of the prior for the prompt, (B, T, 205); with `stand`, of a pelvis that does not travel."""
        if self.timeline is None:
            return self._standing(self.prior.predict_x0(x_t, t, self.text, guidance, rescale))
        return self._standing(self.timeline.predict_x0(x_t, t, guidance, rescale))

    def _standing(self, x0: Tensor) -> Tensor:
        """Predictions (..., 205); with `stand`, of a pelvis that does not travel."""
        if not self.stand:
            return x0
        still = self.prior.normalise(x0.new_zeros(x0.shape[-1]))[PELVIS_VELOCITY]
        x0[..., PELVIS_VELOCITY] = still  # as MDM edits motions: what is known replaces the prediction
        return x0

    def loss(self, pose: PoseParameters, generators: Sequence[torch.Generator]) -> Tensor:
        """0.5 w(t) |X - X0_hat|^2, mean (or sum) over features and frames, of each run, (B,); X0_hat is held constant.

        The paper's w (X0_hat - X) is the direction of the update; the gradient to descend is its negative, which the
        sum has; the mean has a (205 T)th of it. w(t) = 1 - alphas_cumprod[t] (Human Motion Score Distillation
        Details). Each run draws t and noise from its own generator.
        """
        x = self.features(pose)
        if self.timeline is not None:
            return self._loss_of_windows(x, self.timeline, generators)
        short = max(LEAST_FRAMES - x.shape[1], 0)
        own = slice(short // 2, short // 2 + x.shape[1])
        x = _held(x, short // 2, short - short // 2, self.prior)
        drawn = [
            (torch.randint(self.t_min, self.t_max, (), generator=each), torch.randn(x.shape[1:], generator=each))
            for each in generators
        ]
        t, noise = (torch.stack(part).to(x.device) for part in zip(*drawn, strict=True))
        with torch.no_grad():
            x_t = q_sample(x, t, noise.to(x), self.prior.alphas_cumprod)
            x0 = self.predict_x0(x_t, t, self.guidance, self.rescale)
        weights = 1 - self.prior.alphas_cumprod.to(x)[t]
        squared = (x - x0)[:, own] ** 2
        return 0.5 * weights * (squared.sum(dim=(-1, -2)) if self.summed else squared.mean(dim=(-1, -2)))

    def _loss_of_windows(self, x: Tensor, timeline: Timeline, generators: Sequence[torch.Generator]) -> Tensor:
        """The same for a timeline, of `AT_ONCE` windows that each run draws: what each keeps of its own prediction is
        what it pulls, so that the mean over all draws has the gradient of the whole."""
        layout, rate = timeline.layout(x.shape[1]), self.prior.fps
        near = layout.near(int(self.frames[0] * rate), int(min(self.frames[1] * rate, x.shape[1])))
        drawn, times, noise = [], [], []
        for each in generators:
            times.append(torch.randint(self.t_min, self.t_max, (), generator=each))
            noise.append(torch.randn(x.shape[1:], generator=each))
            order = torch.randperm(len(near), generator=each)[:AT_ONCE]
            drawn.append(sorted(near[k] for k in order.tolist()))
        t = torch.stack(times).to(x.device)
        with torch.no_grad():
            x_t = q_sample(x, t, torch.stack(noise).to(x), self.prior.alphas_cumprod)
            x0 = self._standing(timeline.windows(x_t, t, drawn, self.guidance, self.rescale))
        seen = torch.stack(
            [
                torch.stack([x[row, (start := layout.starts[c]) : start + layout.length] for c in windows])
                for row, windows in enumerate(drawn)
            ]
        )
        kept = torch.stack([layout.weights[windows] for windows in drawn]).to(x)
        squared = (kept * (seen - x0) ** 2).sum(dim=(-1, -2, -3)) * (len(near) / len(drawn[0]))
        weights = 1 - self.prior.alphas_cumprod.to(x)[t]
        return 0.5 * weights * (squared if self.summed else squared / x[0].numel())


def _held(x: Tensor, before: int, after: int, prior: MotionPrior) -> Tensor:
    """Normalised features (B, T, 205) with the first pose held for so many frames, and the last."""
    if not before + after:
        return x
    still = prior.normalise(torch.zeros_like(x[0, 0]))

    def held(frame: Tensor, count: int) -> Tensor:
        frame = frame.detach().clone()
        frame[..., MOVING] = still[MOVING]
        return frame.expand(-1, count, -1)

    return torch.cat([held(x[:, :1], before), x, held(x[:, -1:], after)], dim=1)


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
    summed: bool = False,
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
        summed=summed,
        stand=stand,
        timeline=Timeline.of(prior, scene.acts) if scene.acts else None,
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
    pose = distillation.pose(starts, str(distillation.prior.device))
    generators = stream_generators(seeds, "motion")

    def losses() -> dict[str, Tensor]:
        return {"hmsd": distillation.loss(pose, generators)}

    optimise(pose, losses, {"hmsd": 1.0}, iterations, learning_rate, stages)
    return pose.motions(starts[0].fps)


def sample_features(distillation: ScoreDistillation, how: Sampling, frames: int, seeds: Sequence[int]) -> Tensor:
    """One motion a seed drawn from the prior at its frame rate, as its features (B, T, 205), for its own skeleton.

    Fewer frames than `LEAST_FRAMES` are a piece of as many: its strike lies in it where it lies in the whole.

    Raises:
        InputError: so many frames the prior cannot see.
        RunError: they are not finite.
    """
    prior = distillation.prior
    if frames > MOST_FRAMES:
        raise InputError("frames", frames, f"at most {MOST_FRAMES} of the prior")

    def predict(x: Tensor, t: Tensor) -> Tensor:
        return distillation.predict_x0(x, t, how.guidance, how.rescale)

    sample = ddim_sample if how.sampler == "ddim" else ancestral_sample
    steps = None if how.steps is None else min(how.steps, prior.timesteps)
    generators = stream_generators(seeds, "sample")
    shape = (len(seeds), max(frames, LEAST_FRAMES), features.FEATURE_COUNT)
    drawn = prior.denormalise(sample(predict, shape, prior.alphas_cumprod, generators, steps, prior.device))
    if not bool(drawn.isfinite().all()):
        raise RunError("the prior's sample is not finite; lower stage.motion.sample_guidance or use another prior")
    if frames >= LEAST_FRAMES:
        return drawn
    strikes = _strike_frames(drawn, prior).tolist()
    starts = [round(strike * (LEAST_FRAMES - frames) / (LEAST_FRAMES - 1)) for strike in strikes]
    return torch.stack([each[start : start + frames] for each, start in zip(drawn, starts, strict=True)])


def _strike_frames(drawn: Tensor, prior: MotionPrior) -> Tensor:
    """The frame at which a hand or foot of each motion is fastest, (B,)."""
    translation, orientation, body_pose = features.decode(drawn)
    _, joints = forward_kinematics(local_rotations(orientation, body_pose), translation, prior.rest_joints)
    ends = joints[:, :, [JOINT_NAMES.index(name) for name in ENDS]]
    return ends.diff(dim=1).norm(dim=-1).amax(dim=-1).argmax(dim=-1)


def sample_motions(
    distillation: ScoreDistillation, how: Sampling, frames: int, fps: float, seeds: Sequence[int]
) -> list[Motion]:
    """One motion a seed drawn from the prior at its frame rate, resampled to `fps`, on this body, from the origin
    facing +Y.

    Raises:
        InputError, RunError: as `sample_features`.
    """
    rate = distillation.prior.fps
    drawn = sample_features(distillation, how, knots(frames, fps, rate), seeds)
    translation, orientation, body_pose = (part.cpu().numpy() for part in features.decode(drawn))
    translation = translation / distillation.leg_ratio + np.array([0, 0, distillation.sole_height], translation.dtype)
    parts = zip(translation, orientation, body_pose, strict=True)
    return [resampled(Motion(*each, fps=rate), frames, fps) for each in parts]
