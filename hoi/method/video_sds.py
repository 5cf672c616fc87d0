"""Temporally masked Video-SDS (paper, Video-SDS for Contact Fidelity and Video-SDS Details)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

from hoi.adam import Adam
from hoi.data import Motion, ObjectTrajectory, Scene, State
from hoi.errors import RefineStopped
from hoi.refine.clip import Clip, contact_framing, viewpoints
from hoi.refine.contact_clip import TEMPOS, ContactClip
from hoi.refine.geometric import Geometry, Weights
from hoi.refine.meeting import meet
from hoi.refine.steps import LimbSteps
from hoi.refine.window import Window, WindowedPose
from hoi.reports import Stage
from hoi.streams import stream_seed
from hoi.video_prior import VideoPrior

REMEDY = "lower stage.refine.guidance or learning_rate, or use stage/refine=geometric"
SMALLER = (
    "lower stage.refine.clip_frames, width or height, set stage.refine.offload=true, or use stage/refine=geometric"
)

Losses = Callable[[], dict[str, Tensor]]


def predict_z(z_t: Tensor, v: Tensor, alpha_bar: Tensor) -> Tensor:
    """z_hat = sqrt(abar) z_t - sqrt(1 - abar) v, the clean latents that a velocity stands for.

    The paper prints z_hat = sqrt(abar) z_t - v; with v = sqrt(abar) eps - sqrt(1 - abar) z only this one gives z back.
    """
    return alpha_bar.sqrt() * z_t - (1 - alpha_bar).sqrt() * v


def weight(alpha_bar: Tensor) -> Tensor:
    """w(t) = sqrt(abar (1 - abar)), in [0, 1/2]; the paper gives none.

    z - z_hat = sqrt((1 - abar) / abar) (eps_hat - eps) grows without bound as abar falls to 0. With this weight
    w (z - z_hat) = (1 - abar) (eps_hat - eps), DreamFusion's, which is bounded (Poole et al. 2022).
    """
    return (alpha_bar * (1 - alpha_bar)).sqrt()


@dataclass(frozen=True)
class Timesteps:
    """Between which diffusion timesteps, of 1000, are drawn."""

    t_min: int
    t_max: int
    t_max_end: int
    iterations: int
    """In so many t_max falls linearly to t_max_end, where it stays."""

    def latest(self, iteration: int) -> int:
        """t_max(i)."""
        share = min(iteration / self.iterations, 1.0) if self.iterations else 1.0
        return round(self.t_max + share * (self.t_max_end - self.t_max))


@dataclass(frozen=True)
class Viewpoints:
    """The ring of cameras, some of which an iteration looks from."""

    count: int
    at_once: int
    """From so many an iteration looks; the paper: 1."""
    elevation: float
    """Above the horizon [rad]."""
    distance: float | None
    """Radius of the ring [m]; None frames what the prior wants to see."""
    crop: float | None = None
    """Half of what a picture of the contact shows [m]; None: what the prior wants to see."""


@dataclass(frozen=True)
class Residual:
    """One estimate of L_V-SDS."""

    loss: Tensor
    """0.5 w(t) |z - z_hat|^2, mean over the latents' entries; its gradient is the paper's but for that mean."""
    size: float
    """Root mean square of z - z_hat [-]."""


def distil(z: Tensor, noise: Tensor, t: int, prior: VideoPrior, guidance: float, rescale: float = 0.0) -> Residual:
    """L_V-SDS of clean latents z for one noise and timestep; z_hat is held constant, and so is the prior.

    Raises:
        RefineStopped: the prior's velocity is not finite.
    """
    alpha_bar = prior.alphas_cumprod[t].to(z)
    with torch.no_grad():
        z_t = alpha_bar.sqrt() * z + (1 - alpha_bar).sqrt() * noise
        v = prior.velocity(z_t, t, guidance, rescale).to(z)
        if not bool(v.isfinite().all()):
            raise RefineStopped(f"the output of the video prior ({prior.name}) is not finite at t = {t}; {REMEDY}")
        z_hat = predict_z(z_t, v, alpha_bar)
    difference = z - z_hat
    loss = 0.5 * weight(alpha_bar) * difference.square().mean()
    return Residual(loss, float(difference.detach().square().mean().sqrt()))


class Draws:
    """The random streams of stage 3: viewpoints, timesteps and noise, so that none shifts another.

    All on the CPU: every device draws the same.
    """

    def __init__(self, seed: int) -> None:
        names = ("refine.viewpoint", "refine.timestep", "refine.noise")
        self._viewpoint, self._timestep, self._noise = (
            torch.Generator().manual_seed(stream_seed(seed, name)) for name in names
        )

    def viewpoint(self, count: int) -> int:
        return int(torch.randint(count, (), generator=self._viewpoint))

    def timestep(self, first: int, last: int) -> int:
        """Uniform in first..last, both included."""
        # A draw in [0, 1) rather than of integers, so that another range takes as much of the stream.
        share = float(torch.rand((), generator=self._timestep, dtype=torch.float64))
        return first + int(share * (last - first + 1))

    def noise(self, like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=self._noise).to(like)


def video_sds(
    prior: VideoPrior,
    scene: Scene,
    state: State,
    window: Window,
    *,
    timesteps: Timesteps,
    looks: Viewpoints,
    guidance: float,
    rescale: float,
    iterations: int,
    learning_rate: float,
    step: float | None,
    seed: int,
    device: torch.device | str,
    stage: Stage,
    others: Callable[[WindowedPose], Losses] | None = None,
    enough: Callable[[Motion], bool] | None = None,
) -> Motion:
    """The motion with theta in the window refined by a prior.

    Each iteration looks from some viewpoints, from each at one noise level.

    Args:
        prior: prepared for the scene's prompt.
        guidance, rescale: see `hoi.motion.diffusion.guide`.
        learning_rate: of Adam [-].
        step: instead of it, how far the striking limb moves in the first iteration [m], falling linearly to 0
            (`hoi.refine.steps`); None: by Adam.
        others: makes the losses that are added to Video-SDS, already weighted; nothing for the paper.
        enough: whether a motion needs no more of it; None: all iterations are done.

    Raises:
        RefineStopped: the prior's output or a gradient is not finite.
    """
    motion, trajectory = state.motion, state.trajectory
    assert motion is not None and trajectory is not None
    stage.notes.append(f"video prior: {prior.name}")
    pose = WindowedPose(motion, window, device)
    frames = prior.clip_frames(window.frames[0], window.frames[-1], len(motion))
    contact = normal = action = None
    clips: list[Clip] | list[ContactClip]
    if prior.crop is not None:
        contact = contact_framing(scene, motion, trajectory, window, looks.crop or prior.crop)
    if prior.sees_silhouettes:
        assert contact is not None
        normal = window.push.normal if window.push is not None else None
        count = len(frames)
        clips = [ContactClip(scene, motion, trajectory, window, count, contact, device, tempo) for tempo in TEMPOS]
    else:
        action = Clip(scene, motion, trajectory, window, frames, device)
        clips = [action]
    views = viewpoints(action, contact, normal, looks.count, looks.elevation, looks.distance, prior.size)
    draws = Draws(seed)
    rows = torch.tensor(window.frames, device=device)
    other_losses = others(pose) if others is not None else dict

    def estimate(iteration: int, view: int) -> tuple[Residual, int]:
        clip, camera = clips[view % len(clips)], views[view]
        t = draws.timestep(timesteps.t_min, timesteps.latest(iteration))
        z = prior.encode(clip.render(camera, pose.body_pose[rows]), clip.changing)
        return distil(z, draws.noise(z), t, prior, guidance, rescale), t

    adam = Adam([pose.offset], learning_rate)
    limb = LimbSteps(pose, scene.body)
    for iteration in range(iterations):
        first = draws.viewpoint(len(views))  # and others evenly from there
        seen_from = [(first + k * len(views) // looks.at_once) % len(views) for k in range(looks.at_once)]
        found = [estimate(iteration, view) for view in seen_from]
        sds = torch.stack([residual.loss for residual, _ in found]).mean()
        terms = {"sds": sds.to(pose.offset), **other_losses()}
        adam.gradients_of(torch.stack(list(terms.values())).sum())
        if pose.offset.grad is None or not bool(pose.offset.grad.isfinite().all()):
            raise RefineStopped(f"the gradient of Video-SDS is not finite at iteration {iteration}; {REMEDY}")
        if step is None:
            adam.step()
        else:
            limb.follow(step * (1 - iteration / iterations))
        size, t = (sum(values) / len(found) for values in ([r.size for r, _ in found], [t for _, t in found]))
        losses = {name: float(term.detach()) for name, term in terms.items()}
        stage.iteration(iteration, losses | {"residual": size, "timestep": t})
        if enough is not None and enough(pose.motion()):
            stage.notes.append(f"enough after {iteration + 1} of {iterations} iterations")
            break
    return pose.motion()


def geometry_beside(
    scene: Scene, trajectory: ObjectTrajectory, weights: Weights, weight: float, device: torch.device | str
) -> Callable[[WindowedPose], Losses]:
    """What stage/refine=geometric has, `weight` times, and the smoothness, to be added to Video-SDS."""

    def of(pose: WindowedPose) -> Losses:
        meeting = meet(scene, pose.before, trajectory, pose.window) if weight else None
        geometry = Geometry(meeting, weights, device) if meeting is not None else None

        def losses() -> dict[str, Tensor]:
            terms = {"smooth": weights.smooth * pose.roughness()} if weights.smooth else {}
            if geometry is not None:
                terms |= {name: weight * term for name, term in geometry.terms(pose).items()}
            return terms

        return losses

    return of


@contextmanager
def memory_may_run_out() -> Iterator[None]:
    """In here it is no failure of the run: RefineStopped, with what would take less."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not _out_of_memory(error):
            raise
        reason = next(iter(str(error).splitlines()), "no more to be had")
        raise RefineStopped(f"out of memory in stage 3: {reason}; {SMALLER}") from error


def _out_of_memory(error: BaseException) -> bool:
    """Whether memory ran out; of a CPU's, PyTorch says so in a RuntimeError's text alone."""
    return isinstance(error, MemoryError | torch.OutOfMemoryError) or "can't allocate memory" in str(error)
