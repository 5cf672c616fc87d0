"""Video-SDS against closed forms: its gradient, its schedule, its mask, its streams, and how it stops."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from demo_run import make_run
from torch import Tensor

from hoi.body.skinning import pose_means, posed_means
from hoi.data import Motion, Run
from hoi.errors import InputError, RefineStopped
from hoi.method.video_sds import Draws, Timesteps, distil, memory_may_run_out, predict_z, weight
from hoi.motion.diffusion import guide
from hoi.refine.clip import Clip, contact_framing, moved_by, subset, viewpoints
from hoi.refine.steps import LimbSteps
from hoi.refine.views import Framing, edge_on, ring, viewpoint
from hoi.refine.window import Window, WindowedPose, window_around
from hoi.render.cameras import project
from hoi.render.rasterise import render_frames
from hoi.render.replay import replay
from hoi.reports import Stages
from hoi.stages.refine.video_sds import VideoSDS

ALPHAS = torch.linspace(0.999, 0.0, 1000, dtype=torch.float64) ** 2
SIZE = 24


class GaussianPrior:
    """p(z | prompt) = N(mean, covariance), p(z) = N(0, covariance), whose v is known: latents are the pixels."""

    name, crop, size, alphas_cumprod = "a Gaussian", 0.25, (SIZE, SIZE), ALPHAS
    sees_silhouettes = False

    def __init__(self, mean: Tensor, covariance: Tensor | float = 1e-4, frames: int = 5) -> None:
        self.mean, self.covariance, self.frames = mean, covariance, frames
        self.broken_at: int | None = None
        self.asked: list[int] = []

    def prepare(self, prompt: str, negative_prompt: str) -> None:
        pass

    def clip_frames(self, first: int, last: int, total: int) -> list[int]:
        return [min(max(first - 1 + place, 0), total - 1) for place in range(self.frames)]

    def encode(self, video: Tensor, changing: slice = slice(None)) -> Tensor:
        return video

    def posterior_mean(self, z_t: Tensor, t: int, mean: Tensor) -> Tensor:
        """E[z | z_t] = mean + sqrt(abar) S (abar S + (1 - abar) I)^-1 (z_t - sqrt(abar) mean)."""
        abar = ALPHAS[t].to(z_t)
        off = z_t - abar.sqrt() * mean
        if isinstance(self.covariance, float):
            return mean + abar.sqrt() * self.covariance / (abar * self.covariance + 1 - abar) * off
        noisy = abar * self.covariance + (1 - abar) * torch.eye(len(off)).to(off)
        return mean + abar.sqrt() * self.covariance @ torch.linalg.solve(noisy, off)

    def velocity(self, latents: Tensor, t: int, guidance: float, rescale: float = 0.0) -> Tensor:
        self.asked.append(t)
        if self.broken_at == len(self.asked):
            return torch.full_like(latents, torch.nan)
        abar = ALPHAS[t].to(latents)
        means = (torch.zeros_like(self.mean), self.mean)
        without, with_text = (
            (abar.sqrt() * latents - self.posterior_mean(latents, t, mean)) / (1 - abar).sqrt() for mean in means
        )
        return guide(without[None], with_text[None], guidance, rescale)[0]


def gaussian(size: int = 6) -> tuple[Tensor, Tensor, torch.Generator]:
    """Mean (n,) and covariance (n, n), float64."""
    generator = torch.Generator().manual_seed(3)
    root = torch.randn(size, size, generator=generator, dtype=torch.float64)
    return torch.randn(size, generator=generator, dtype=torch.float64), 0.1 * root @ root.T, generator


def conf(**changes: object) -> VideoSDS:
    values: dict = dict(
        iterations=6, learning_rate=0.02, guidance=1.0, guidance_rescale=0.0, t_min=100, t_max=980, t_max_end=300,
        t_max_iterations=4, viewpoints=3, elevation=0.3, distance=None, width=SIZE, height=SIZE, clip_frames=None,
        offload=False, lambda_geometry=0.0, lambda_penetration=1.0, lambda_touch=1.0, lambda_pose=0.0,
        lambda_smooth=0.0, step=None, views_at_once=1, crop=None,
    )  # fmt: skip
    return VideoSDS(**{**values, **changes})


@pytest.fixture(scope="module")
def run() -> Run:
    return make_run(frames=7, points=900, gaussians=120, particles=150, contact_frame=3.0)[0]


@pytest.fixture(scope="module")
def window(run: Run) -> Window:
    push = run.state.contact.push
    return window_around(push.frame, push.joint, 1.0, 7, push)


def clip_of(run: Run, window: Window, frames: list[int]) -> Clip:
    return Clip(run.scene, run.state.motion, run.state.trajectory, window, frames)


def refine(run: Run, window: Window, prior: GaussianPrior, seed: int = 0, **changes: object):
    stages = Stages()
    with stages.stage("refine", 1) as stage:
        motion = conf(**changes).distilled(prior, run.scene, run.state, window, seed, "cpu", stage)
    return motion, stages


def test_v_prediction_gives_the_latents_back() -> None:
    _, _, generator = gaussian()
    z, eps = torch.randn(2, 40, generator=generator, dtype=torch.float64)
    for t in (0, 100, 500, 980, 999):
        abar = ALPHAS[t]
        z_t = abar.sqrt() * z + (1 - abar).sqrt() * eps
        v = abar.sqrt() * eps - (1 - abar).sqrt() * z
        assert torch.allclose(predict_z(z_t, v, abar), z, atol=1e-14)


def test_the_weight_is_bounded_and_makes_dreamfusions() -> None:
    w = weight(ALPHAS)
    assert w.max() <= 0.5 and w.min() >= 0 and w[-1] == 0
    eps_error = 0.7
    residual = ((1 - ALPHAS) / ALPHAS).sqrt() * eps_error  # of z - z_hat, for an error of eps
    assert torch.allclose((w * residual)[:-1], ((1 - ALPHAS) * eps_error)[:-1], rtol=1e-9)


@pytest.mark.parametrize("guidance", [1.0, 7.5, 100.0])
def test_the_gradient_is_the_closed_form_of_a_gaussian(guidance: float) -> None:
    """For each noise: w(t) J^T ((I - K)(z - m) - sqrt((1 - abar) / abar) K eps), K = abar S (abar S + (1 - abar) I)^-1.

    m is the guided mean: of v, and so of z_hat, CFG makes an affine mixture, of which only the mean's part differs.
    """
    mean, covariance, generator = gaussian()
    prior = GaussianPrior(mean, covariance)
    jacobian = torch.randn(6, 4, generator=generator, dtype=torch.float64)
    theta = torch.randn(4, generator=generator, dtype=torch.float64, requires_grad=True)
    eye = torch.eye(6, dtype=torch.float64)
    for t in (100, 300, 700, 980):
        abar = ALPHAS[t]
        noise = torch.randn(6, generator=generator, dtype=torch.float64)
        residual = distil(jacobian @ theta, noise, t, prior, guidance)
        (gradient,) = torch.autograd.grad(6 * residual.loss, theta)  # the loss is the mean of 6 entries
        keeps = abar * covariance @ torch.linalg.inv(abar * covariance + (1 - abar) * eye)
        z = (jacobian @ theta).detach()
        difference = (eye - keeps) @ (z - guidance * mean) - ((1 - abar) / abar).sqrt() * keeps @ noise
        assert torch.allclose(gradient, weight(abar) * jacobian.T @ difference, rtol=1e-9, atol=1e-12)
        assert residual.size == pytest.approx(float(difference.square().mean().sqrt()), rel=1e-9)


def test_averaged_over_noise_it_follows_the_score() -> None:
    """E_eps = w(t) (1 - abar) (abar S + (1 - abar) I)^-1 (z - m): the score of the noised density, but for a factor."""
    mean, covariance, generator = gaussian()
    prior, t, count = GaussianPrior(mean, covariance), 600, 4000
    abar = ALPHAS[t]
    z = torch.randn(6, generator=generator, dtype=torch.float64, requires_grad=True)
    draws = torch.stack(
        [
            torch.autograd.grad(6 * distil(z, noise, t, prior, 1.0).loss, z)[0]
            for noise in torch.randn(count, 6, generator=generator, dtype=torch.float64)
        ]
    )
    noisy = abar * covariance + (1 - abar) * torch.eye(6, dtype=torch.float64)
    expected = weight(abar) * (1 - abar) * torch.linalg.solve(noisy, z.detach() - mean)
    error = (draws.mean(0) - expected) / (draws.std(0) / math.sqrt(count))
    assert error.abs().max() < 4
    assert (draws.mean(0) - expected).norm() < 0.1 * expected.norm()


def test_the_latest_timestep_falls_linearly_and_stays() -> None:
    paper = Timesteps(100, 980, 300, 1000)
    assert [paper.latest(i) for i in (0, 500, 1000, 2999)] == [980, 640, 300, 300]
    assert Timesteps(100, 980, 300, 0).latest(0) == 300


def test_streams_are_uniform_and_do_not_shift_each_other() -> None:
    draws = Draws(0)
    times = np.array([draws.timestep(100, 980) for _ in range(4000)])
    assert times.min() == pytest.approx(100, abs=3) and times.max() == pytest.approx(980, abs=3)
    assert abs(times.mean() - 540) < 4 * 881 / math.sqrt(12 * 4000)
    assert {Draws(1).timestep(5, 5)} == {5}
    other = Draws(0)
    other.viewpoint(100)
    other.noise(torch.zeros(1000))
    assert [other.timestep(100, 980) for _ in range(5)] == times[:5].tolist()
    views = [other.viewpoint(100) for _ in range(2000)]
    assert set(views) == set(range(100))


def test_the_ring_frames_a_ball_from_all_sides() -> None:
    framing = Framing(np.array([1.0, 2.0, 0.5]), 0.3)
    for size in ((64, 64), (48, 72), (72, 48)):
        cameras = ring(framing, 8, 0.3, height=size[0], width=size[1])
        away = np.array([camera.position for camera in cameras]) - framing.centre
        turns = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
        assert np.allclose(turns[0], np.pi / 2) and np.allclose(np.diff(turns), np.pi / 4)
        assert np.allclose(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1)), 0.3)
        for camera in cameras:
            axes = camera.world_to_camera[:3, :3]
            points = framing.centre + framing.radius * np.stack([np.zeros(3), axes[0], axes[1]])
            pixels, _ = project(camera, points)
            middle, half = np.array([size[1], size[0]]) / 2, min(size) / 2
            assert np.allclose(pixels - middle, [[0, 0], [half, 0], [0, half]], atol=1e-6)
    near = viewpoint(framing, 0.0, 0.0, width=64, height=64, distance=0.6)
    assert np.allclose(near.position, framing.centre + np.array([0.6, 0, 0]))
    pixels, _ = project(near, (framing.centre + np.array([0, 0.3, 0]))[None])
    assert np.allclose(pixels, [[64, 32]])
    for broken in ({"count": 0}, {"elevation": 2.0}, {"distance": -1.0}):
        with pytest.raises(InputError):
            ring(framing, **broken, width=8, height=8)
    with pytest.raises(InputError):
        ring(Framing(np.zeros(3), 0.0), width=8, height=8)


def test_only_what_a_limb_moves_is_posed_again(run: Run, window: Window) -> None:
    body, motion = run.scene.body, run.state.motion
    moved = moved_by(body, window.moving)
    assert 0 < moved.sum() < len(moved) / 2
    turned = motion.body_pose.copy()
    turned[:, np.array(window.moving) - 1] += 0.3
    before, after = posed_means(body, motion), posed_means(body, replace(motion, body_pose=turned))
    assert np.array_equal(before[:, ~moved], after[:, ~moved])
    assert (np.abs(after - before)[:, moved].max(axis=(0, 2)) > 0).all()
    limb = subset(body, np.flatnonzero(moved))
    assert np.array_equal(limb.cloud.means, body.cloud.means[moved]) and len(limb.skinning_weights) == moved.sum()
    corrected = np.zeros((len(moved), 3, 207), np.float32)
    corrected[0, 1, (window.moving[0] - 1) * 9 + 4] = 0.01
    assert not moved[0] and moved_by(replace(body, pose_directions=corrected), window.moving)[0]


def test_a_clip_shows_the_scene_and_only_the_window_has_gradients(run: Run, window: Window) -> None:
    frames = [0, 0, 1, 2, 3, 4, 5, 6, 6]
    clip = clip_of(run, window, frames)
    assert clip.changing == slice(3, 6)
    shown = replay(run)
    for size, crop in (((SIZE, SIZE), 0.7), ((32, 48), None)):
        framing = crop and contact_framing(run.scene, run.state.motion, run.state.trajectory, window, crop)
        camera = viewpoints(clip, framing, None, 4, 0.3, None, size)[1]
        pose = WindowedPose(run.state.motion, window)
        body_pose = pose.body_pose[list(window.frames)]
        video = clip.render(camera, body_pose)
        assert video.shape == (9, 3, *size)
        behind = clip._constant(camera)[0]
        whole = render_frames((shown.parts(frame) for frame in frames), camera, behind)
        expected = torch.stack([picture.colour for picture in whole]).movedim(-1, 1).clamp(0, 1)
        assert torch.allclose(video, expected, atol=2e-3)
        assert (video - behind.movedim(-1, 0)).abs().max() > 0.3  # there is something to see
        weights = torch.rand(video.shape, generator=torch.Generator().manual_seed(0))
        for place in range(9):
            if place not in (3, 4, 5):
                (none,) = torch.autograd.grad((weights * video)[place].sum(), pose.offset, retain_graph=True)
                assert not none.any()
        (gradient,) = torch.autograd.grad((weights * video).sum(), pose.offset)
        assert (gradient.abs().amax(dim=(1, 2)) > 0).all()
    assert torch.equal(clip.render(camera, body_pose), video)  # from the cache
    assert not any(t.requires_grad for t in (clip._limb.sh, clip._limb.opacities, clip._limb.body.means))


def test_the_ring_around_the_action_holds_it(run: Run, window: Window) -> None:
    clip = clip_of(run, window, [2, 3, 4])
    for distance in (None, 6.0):
        for camera in viewpoints(clip, None, None, 5, 0.3, distance, (48, 72)):
            pixels, depth = project(camera, clip.action())
            assert (depth > 0).all() and (pixels >= -0.5).all() and (pixels <= (72.5, 48.5)).all()


def target_of(run: Run, window: Window, turn: float) -> tuple[GaussianPrior, Motion]:
    """A prior that knows the one video of the scene with the hip turned by `turn` around t_c."""
    clip = clip_of(run, window, GaussianPrior(torch.empty(0)).clip_frames(window.frames[0], window.frames[-1], 7))
    pose = WindowedPose(run.state.motion, window)
    with torch.no_grad():
        pose.offset[:, 0, 0] = turn
    framing = contact_framing(run.scene, run.state.motion, run.state.trajectory, window, GaussianPrior.crop)
    camera = viewpoints(clip, framing, None, 1, 0.3, None, (SIZE, SIZE))[0]
    return GaussianPrior(clip.render(camera, pose.body_pose[list(window.frames)]).detach()), pose.motion()


def test_the_motion_goes_where_the_prior_says_and_nothing_else_moves(run: Run, window: Window) -> None:
    prior, wanted = target_of(run, window, turn=0.15)
    motion, stages = refine(run, window, prior, iterations=40, viewpoints=1, t_max_iterations=10)
    before = run.state.motion

    def apart(other: Motion) -> float:
        return float(np.linalg.norm(posed_means(run.scene.body, other) - posed_means(run.scene.body, wanted)))

    assert apart(motion) < 0.6 * apart(before)
    losses = [row["residual"] for row in stages.history]
    assert len(losses) == 40 and np.mean(losses[-5:]) < np.mean(losses[:5])
    assert motion.translation.tobytes() == before.translation.tobytes()
    assert motion.orientation.tobytes() == before.orientation.tobytes()
    masked = np.zeros((7, 23), dtype=bool)
    masked[np.ix_(window.frames, np.array(window.moving) - 1)] = True
    assert motion.body_pose[~masked].tobytes() == before.body_pose[~masked].tobytes()
    assert (motion.body_pose != before.body_pose)[masked].any()


def test_the_same_seed_gives_the_same_bits_and_the_config_does_not_shift_the_draws(run: Run, window: Window) -> None:
    prior, _ = target_of(run, window, turn=0.1)
    first, _ = refine(run, window, prior)
    asked, prior.asked = prior.asked, []
    second, _ = refine(run, window, prior)
    assert first.body_pose.tobytes() == second.body_pose.tobytes() and prior.asked == asked
    prior.asked = []
    other, _ = refine(run, window, prior, seed=1)
    assert other.body_pose.tobytes() != first.body_pose.tobytes() and prior.asked != asked
    prior.asked = []
    refine(run, window, prior, guidance=5.0, viewpoints=2)
    assert prior.asked == asked


def test_it_ends_when_it_is_enough(run: Run, window: Window) -> None:
    prior, _ = target_of(run, window, turn=0.15)
    whole, _ = refine(run, window, prior, iterations=3)
    seen: list[Motion] = []

    def enough(motion: Motion) -> bool:
        seen.append(motion)
        return len(seen) == 3

    stages = Stages()
    with stages.stage("refine", 1) as stage:
        motion = conf(iterations=40).distilled(prior, run.scene, run.state, window, 0, "cpu", stage, enough)
        assert stage.notes[-1] == "enough after 3 of 40 iterations"
    assert stages.reports[0].iterations == 3
    assert motion.body_pose.tobytes() == whole.body_pose.tobytes() == seen[-1].body_pose.tobytes()


@pytest.mark.parametrize("normal", [(1.0, 1.0, 0.4), (0.0, -1.0, 0.0), (0.1, 0.0, -0.9), (0.0, 0.0, 1.0)])
def test_edge_on_the_cameras_look_along_the_surface_from_both_sides(normal: tuple[float, float, float]) -> None:
    framing, normal = Framing(np.array([1.0, 2.0, 0.5]), 0.2), np.array(normal) / np.linalg.norm(normal)
    cameras = edge_on(framing, normal, 6, 0.3, width=32, height=32)
    looks = np.array([camera.forward for camera in cameras])
    assert np.allclose(looks @ normal, 0, atol=1e-9)
    assert (looks[:3] @ looks[0] > 0).all() and (looks[3:] @ looks[0] < 0.9).all()
    # A point of the touched plane is on one line of the picture, wherever in the plane it is.
    along = np.cross(normal, looks[0])
    pixels, _ = project(cameras[0], framing.centre + np.outer((-0.1, 0.1), looks[0]) + 0.05 * along)
    off = (pixels - 16) @ (cameras[0].world_to_camera[:2, :3] @ normal)
    assert np.allclose(off, 0, atol=1e-6)
    for broken in ({"count": 0}, {"elevation": 2.0}):
        with pytest.raises(InputError):
            edge_on(framing, normal, **{"count": 2, **broken}, width=8, height=8)


def test_an_iteration_looks_from_several_sides_and_averages(run: Run, window: Window) -> None:
    prior, _ = target_of(run, window, turn=0.1)
    one, _ = refine(run, window, prior, iterations=1, viewpoints=4)
    asked, prior.asked = prior.asked, []
    _, together = refine(run, window, prior, iterations=1, viewpoints=4, views_at_once=4)
    assert len(asked) == 1 and len(prior.asked) == 4 and prior.asked[0] == asked[0]
    assert together.history[0]["timestep"] == np.mean(prior.asked)
    assert one.body_pose.tobytes() != run.state.motion.body_pose.tobytes()


def test_a_step_moves_the_skin_that_strikes_so_far_along_the_normal(run: Run, window: Window) -> None:
    """Whatever the gradient's length, and to first order with nothing aside."""
    body, motion, length = run.scene.body, run.state.motion, 1e-4
    normal, frame = np.asarray(window.push.normal), round(window.t_c)
    near = np.flatnonzero(np.isin(body.dominant_joints, window.limb))
    for scale in (1e-6, 1e3):
        pose = WindowedPose(motion, window, dtype=torch.float64)
        steps = LimbSteps(pose, body)
        arms = steps.arms()
        assert arms.shape[:2] == (len(window.frames), 3 * len(window.moving))
        # Down the gradient of how far the skin is along the normal: it goes against it.
        pull = torch.from_numpy(np.tile(normal, arms.shape[2] // 3)).to(arms)
        pose.offset.grad = scale * (pose.taper[:, None] * (arms @ pull)).view_as(pose.offset)
        steps.follow(length)
        rows = steps.skin
        assert np.isin(rows, near).all()
        moved = (posed_means(body, pose.motion(), subset=rows) - posed_means(body, motion, subset=rows))[frame].mean(0)
        assert -1.05 * length < moved @ normal < -0.5 * length
        outside = [f for f in range(len(motion)) if f not in window.frames]
        assert np.array_equal(pose.motion().body_pose[outside], motion.body_pose[outside])


def test_what_is_not_finite_stops_the_stage(run: Run, window: Window) -> None:
    prior, _ = target_of(run, window, turn=0.1)
    prior.broken_at = 3
    with pytest.raises(
        RefineStopped, match=r"output of the video prior \(a Gaussian\) is not finite at t = \d+; .*geom"
    ):
        refine(run, window, prior)
    prior.broken_at = None
    prior.encode = lambda video, changing: video + 0 * (video - video).sqrt()  # finite, its gradient is not
    with pytest.raises(RefineStopped, match=r"gradient of Video-SDS is not finite at iteration 0; .*stage/refine"):
        refine(run, window, prior)


@pytest.mark.parametrize(
    "error", [MemoryError(), torch.OutOfMemoryError("CUDA out of memory. Tried\nto allocate"), "DefaultCPUAllocator"]
)
def test_out_of_memory_stops_the_stage(
    run: Run, window: Window, monkeypatch: pytest.MonkeyPatch, error: BaseException | str
) -> None:
    def refuse(*_: object) -> None:
        raise error if isinstance(error, BaseException) else RuntimeError(f"{error}: can't allocate memory: you tried")

    prior, _ = target_of(run, window, turn=0.1)
    monkeypatch.setattr(prior, "encode", refuse, raising=False)
    with pytest.raises(RefineStopped, match=r"out of memory[^\n]*geometric$"), memory_may_run_out():
        refine(run, window, prior)


def test_geometry_and_smoothness_join_when_the_config_says_so(run: Run, window: Window) -> None:
    window = replace(window, joint=8)  # no Gaussian of this person belongs to the foot's joint
    prior, _ = target_of(run, window, turn=0.1)
    _, plain = refine(run, window, prior, iterations=1)
    _, more = refine(run, window, prior, iterations=2, lambda_smooth=0.5, lambda_geometry=2.0)
    assert {"sds", "residual", "timestep"} == set(plain.history[0]) - {"stage", "iteration"}
    assert {"smooth", "penetration", "touch", "pose"} <= set(more.history[0])
    assert plain.history[0]["sds"] == more.history[0]["sds"]


def test_the_limbs_pose_is_that_of_the_whole_body(run: Run, window: Window) -> None:
    clip = clip_of(run, window, [2, 3, 4])
    pose = WindowedPose(run.state.motion, window)
    rows = list(window.frames)
    means = pose_means(clip._limb.body, pose.translation[rows], pose.orientation[rows], pose.body_pose[rows])
    moved = moved_by(run.scene.body, window.moving)
    assert np.allclose(means.detach(), posed_means(run.scene.body, run.state.motion)[rows][:, moved], atol=1e-5)
