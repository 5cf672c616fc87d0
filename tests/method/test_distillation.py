"""HMSD: its gradient, its sign, its seed."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bodies import cloud_of

from hoi.body.kinematics import leg_length
from hoi.body.skinning import stand_motion
from hoi.data import Body
from hoi.method.hmsd import ScoreDistillation, optimise
from hoi.method.pose import PoseParameters, knots
from hoi.motion import features
from hoi.reports import Stage

FRAMES = 8


@pytest.fixture
def body(skeleton) -> Body:
    return Body("bones", cloud_of(np.zeros((1, 3)), 0.005), np.eye(1, 24), skeleton)


@pytest.fixture
def skeleton() -> np.ndarray:
    """A plain T-pose [m]."""
    offsets = np.zeros((24, 3), dtype=np.float32)
    for side, sign in ((0, 1.0), (1, -1.0)):
        offsets[1 + side], offsets[4 + side], offsets[7 + side] = (0.1 * sign, -0.08, 0), (0, -0.4, 0), (0, -0.4, 0)
        offsets[10 + side], offsets[13 + side] = (0, -0.06, 0.13), (0.06 * sign, 0.1, 0)
        for joint, length in ((16, 0.11), (18, 0.27), (20, 0.25), (22, 0.08)):
            offsets[joint + side] = (length * sign, 0, 0)
    for joint, height in ((3, 0.1), (6, 0.13), (9, 0.06), (12, 0.22), (15, 0.09)):
        offsets[joint] = (0, height, 0)
    from hoi.body.skeleton import PARENTS

    positions = np.zeros_like(offsets)
    for joint in range(1, 24):
        positions[joint] = positions[PARENTS[joint]] + offsets[joint]
    return positions


def distillation_towards(goal: torch.Tensor, rest_joints, dtype=torch.float32) -> ScoreDistillation:
    """A prior that knows one motion: X0_hat is `goal` whatever it is shown."""

    def predict_x0(x_t, t, text, guidance, rescale) -> torch.Tensor:
        short = x_t.shape[1] - len(goal)  # a motion that is too short is shown with its ends held
        held = [goal[:1]] * (short // 2) + [goal] + [goal[-1:]] * (short - short // 2)
        return torch.cat(held).expand_as(x_t).to(x_t)

    prior = SimpleNamespace(
        rest_joints=torch.as_tensor(rest_joints, dtype=dtype),
        normalise=lambda raw: raw,
        alphas_cumprod=torch.linspace(0.99, 0.01, 100, dtype=dtype),
        predict_x0=predict_x0,
    )
    return ScoreDistillation(prior, torch.zeros(1, 4), 1.0, 0.02, 7.5, 0.0, 0, 100)  # pyright: ignore[reportArgumentType]


def perturbed(motion, seed, dtype):
    generator = torch.Generator().manual_seed(seed)
    pose = PoseParameters.of([motion], dtype=dtype)
    for leaf in pose.leaves():
        leaf.data += 0.1 * torch.randn(leaf.shape, generator=generator, dtype=dtype)
    return pose


def test_descending_hmsd_approaches_the_priors_motion(body):
    """The update points from X to X0_hat: the paper's formula is that direction, not the gradient to descend."""
    start = stand_motion(body, FRAMES, 20.0)
    other = perturbed(start, 1, torch.float32)
    distillation = distillation_towards(torch.zeros(FRAMES, features.FEATURE_COUNT), body.rest_joints)
    goal = distillation.features(other)[0].detach()
    distillation = distillation_towards(goal, body.rest_joints)
    pose = PoseParameters.of([start])
    generators = [torch.Generator().manual_seed(0)]

    def distance() -> float:
        return float((distillation.features(pose) - goal).detach().norm())

    before = distance()
    history = []
    stage = Stage("motion", lambda units: None, history)
    optimise(pose, lambda: {"hmsd": distillation.loss(pose, generators)}, {"hmsd": 1.0}, 100, 0.005, [stage])
    assert distance() < 0.3 * before
    assert [row["iteration"] for row in history] == list(range(100))


def test_gradient_against_finite_differences(body):
    """d/dX of 0.5 w |f(X) - X0_hat|^2 with X0_hat held, float64."""
    goal = torch.zeros(FRAMES, features.FEATURE_COUNT, dtype=torch.float64)
    distillation = distillation_towards(goal, body.rest_joints, torch.float64)
    pose = perturbed(stand_motion(body, FRAMES, 20.0), 2, torch.float64)

    def loss() -> torch.Tensor:
        return distillation.loss(pose, [torch.Generator().manual_seed(3)]).sum()

    loss().backward()
    step = 1e-6
    for leaf in pose.leaves():
        direction = torch.randn(leaf.shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
        analytic = float((leaf.grad * direction).sum())
        with torch.no_grad():
            leaf += step * direction
            above = float(loss())
            leaf -= 2 * step * direction
            below = float(loss())
            leaf += step * direction
        assert analytic == pytest.approx((above - below) / (2 * step), rel=1e-5)


def test_weight_is_one_minus_alpha_bar(body):
    distillation = distillation_towards(torch.zeros(FRAMES, features.FEATURE_COUNT), body.rest_joints)
    at_t = [ScoreDistillation(distillation.prior, distillation.text, 1.0, 0.02, 7.5, 0.0, t, t + 1) for t in (0, 99)]
    pose = perturbed(stand_motion(body, FRAMES, 20.0), 5, torch.float32)
    early, late = (float(d.loss(pose, [torch.Generator().manual_seed(0)])) for d in at_t)
    assert late / early == pytest.approx(0.99 / 0.01, rel=1e-4)


def test_leg_length(body):
    assert float(leg_length(torch.as_tensor(body.rest_joints))) == pytest.approx(0.08 + 0.4 + 0.4 + 0.06)


def test_at_another_frame_rate_what_x_changes_is_added(body):
    """The motion keeps its own detail where X has not changed it, and shows what X changes smoothly."""
    rng = np.random.default_rng(0)
    motion = stand_motion(body, 121, 60.0)
    motion = replace(motion, body_pose=motion.body_pose + 0.01 * rng.standard_normal(motion.body_pose.shape))
    pose = PoseParameters.of([motion], dtype=torch.float64, rate=20.0)
    assert pose.body_pose.shape[1] == 40
    (same,) = pose.motions(60.0)
    np.testing.assert_allclose(same.body_pose, motion.body_pose, atol=1e-6)
    time = torch.arange(40, dtype=torch.float64) / 20
    pose.body_pose.data[..., 3, 0] += 0.2 * torch.sin(3 * time)
    pose.root.data[..., 1] += 0.05
    (moved,) = pose.motions(60.0)
    expected = 0.2 * np.sin(3 * np.arange(121) / 60)
    np.testing.assert_allclose(moved.body_pose[:, 3, 0] - motion.body_pose[:, 3, 0], expected, atol=2e-3)
    np.testing.assert_allclose(moved.translation[:, 1], np.arange(121) / 60, atol=1e-5)
    assert moved.fps == 60.0
    goal = pose.joints(torch.as_tensor(body.rest_joints, dtype=torch.float64))[0, :, 11].square().sum()
    goal.backward()
    assert all(leaf.grad is not None and bool(leaf.grad.any()) for leaf in (pose.root, pose.orientation))


@pytest.mark.parametrize(("frames", "fps", "count"), [(40, 20.0, 40), (120, 60.0, 40), (60, 30.0, 40), (2, 60.0, 3)])
def test_x_covers_the_motion_at_the_priors_rate(frames, fps, count):
    assert knots(frames, fps, 20.0) == count


def test_the_printed_gradient_is_that_of_the_sum(body):
    """w (X - X0_hat) for every entry (paper); the mean's is a (205 T)th of it."""
    goal = torch.zeros(FRAMES, features.FEATURE_COUNT, dtype=torch.float64)
    mean = distillation_towards(goal, body.rest_joints, torch.float64)
    pose = perturbed(stand_motion(body, FRAMES, 20.0), 2, torch.float64)
    losses = [
        float(each.loss(pose, [torch.Generator().manual_seed(3)])[0].detach())
        for each in (mean, replace(mean, summed=True))
    ]
    assert losses[1] == pytest.approx(FRAMES * features.FEATURE_COUNT * losses[0], rel=1e-12)
    t = torch.randint(0, 100, (), generator=torch.Generator().manual_seed(3))
    weight = 1 - float(mean.prior.alphas_cumprod[t])
    residual = mean.features(pose).detach() - goal
    assert losses[1] == pytest.approx(0.5 * weight * float((residual**2).sum()), rel=1e-9)
