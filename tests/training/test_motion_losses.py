import math

import pytest
import roma
import torch

from hoi.body.kinematics import joint_positions, rotation_to_6d
from hoi.motion.features import encode
from hoi.training.motion import deepmimic
from hoi.training.motion.dataset import rest_joints_of
from hoi.training.motion.losses import CONTACT_WEIGHT, MotionLoss, joints_of, velocities_of

REST = rest_joints_of(deepmimic.OFFSETS).double()


def some_motion(seed: int = 0, frames: int = 12) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """A person who walks a curve, bending all joints but the hands."""
    generator = torch.Generator().manual_seed(seed)
    time = torch.linspace(0, 1, frames, dtype=torch.float64)
    swing = torch.randn(24, 3, generator=generator, dtype=torch.float64) * 0.5
    pose = torch.sin(3 * time)[:, None, None] * swing
    upright = roma.rotvec_to_rotmat(torch.tensor([math.pi / 2, 0, 0], dtype=torch.float64))
    turn = roma.rotvec_to_rotmat(torch.stack([0 * time, 0 * time, 2 * time], dim=-1))
    pose[:, 22:] = 0
    translation = torch.stack([time**2, time, 0.9 + 0.1 * torch.sin(time)], dim=-1)
    return translation, rotation_to_6d(turn @ upright), pose[:, 1:]


def test_joints_and_steps_are_those_of_the_body():
    motion = some_motion()
    features = encode(*motion, REST)
    joints = joints_of(features, REST)
    torch.testing.assert_close(joints, features[:, 136:].unflatten(-1, (23, 3)))
    steps = velocities_of(features, joints)
    world = joint_positions(*motion, REST)[:, 1:].diff(dim=0)
    torch.testing.assert_close(steps.norm(dim=-1), world.norm(dim=-1))
    torch.testing.assert_close(steps[..., 2], world[..., 2])


def loss_of(x0: torch.Tensor, rest: torch.Tensor = REST) -> MotionLoss:
    return MotionLoss(torch.zeros_like(x0[0, 0]), torch.ones_like(x0[0, 0]), rest)


def test_the_loss_vanishes_at_the_truth_alone():
    x0 = encode(*some_motion(), REST)[None]
    loss = loss_of(x0)
    alphas = torch.tensor([0.5], dtype=torch.float64)
    total, plain = loss(x0, x0, alphas)
    assert float(total) == pytest.approx(0, abs=1e-20) and float(plain) == 0
    for feature in (0, 1, 3, 4 + 6 * 4, 140):
        wrong = x0.clone()
        wrong[..., feature] += 0.1
        assert float(loss(wrong, x0, alphas)[0]) > 1e-5


def test_the_gradient_is_that_of_finite_differences():
    x0 = encode(*some_motion(), REST)[None]
    loss = loss_of(x0)
    alphas = torch.tensor([0.3], dtype=torch.float64)
    guess = (x0 + 0.1 * torch.randn(x0.shape, generator=torch.Generator().manual_seed(1))).requires_grad_()
    loss(guess, x0, alphas)[0].backward()
    direction = torch.randn(x0.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    ahead, behind = (loss(guess.detach() + sign * 1e-6 * direction, x0, alphas)[0] for sign in (1, -1))
    assert guess.grad is not None
    assert float((guess.grad * direction).sum()) == pytest.approx(float(ahead - behind) / 2e-6, rel=1e-5)


def cost_of_sliding(height: float) -> float:
    """Geometric loss of a standing person who slides at 1 cm a frame, so high above the ground [m]."""
    upright = rotation_to_6d(roma.rotvec_to_rotmat(torch.tensor([math.pi / 2, 0, 0], dtype=torch.float64)))
    translation = torch.tensor([0, 0, 0.9], dtype=torch.float64).expand(12, 3)
    still = encode(translation, upright.expand(12, 6), torch.zeros(12, 23, 3, dtype=torch.float64), REST)[None]
    still[..., 0] += height
    sliding = still.clone()
    sliding[..., 1] += 0.01
    loss, one = loss_of(still), torch.ones(1, dtype=torch.float64)
    return float(loss(sliding, still, one)[0] - loss(sliding, still, 0 * one)[0])


def test_a_sliding_foot_costs_more_where_it_should_stand():
    feet = 4 / 23
    assert cost_of_sliding(0.0) == pytest.approx(cost_of_sliding(1.0) * (1 + feet * (CONTACT_WEIGHT - 1)))


def test_geometry_does_not_count_where_nothing_is_known():
    x0 = encode(*some_motion(), REST)[None]
    guess = x0 + 0.1
    total, _ = loss_of(x0)(guess, x0, torch.zeros(1, dtype=torch.float64))
    assert float(total) == pytest.approx(0.01)
