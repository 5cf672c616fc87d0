"""j*, t*, the window, the loss and its gradient."""

import numpy as np
import pytest
import torch

from hoi.body.kinematics import joint_positions
from hoi.body.skeleton import LIMBS
from hoi.data import Target
from hoi.gaussians import fibonacci_sphere
from hoi.method.attraction import attraction_loss, choose_target, strike_offset, striking_limb, window


def test_target_is_the_busiest_joint_at_its_fastest():
    joints = np.zeros((40, 24, 3))
    time = np.arange(40)
    joints[:, 7, 0] = 0.02 * time  # steady, moves far, but less than ...
    joints[:, 11, 1] = 2 / (1 + np.exp(-(time - 25.5) / 1.5))  # ... the foot that kicks between frames 25 and 26
    assert choose_target(joints) == Target(11, 25, "velocity profile")
    assert choose_target(joints, candidates=(4, 7, 10)).joint == 7


@pytest.mark.parametrize(
    ("moved", "named", "limb"),
    [
        ("left_foot", [], "left_foot"), ("left_foot", ["right_foot"], "left_foot"), ("right_hand", [], "right_hand"),
        ("left_hand", ["hands"], "left_hand"), ("left_hand", ["right_foot"], "left_hand"),
    ],
)  # fmt: skip
def test_the_limb_that_moves_in_a_file_strikes(moved, named, limb):
    """Whatever side the sentence says, and the other limb where it is far faster."""
    joints = np.zeros((40, 24, 3))
    for each, reach in {"right_foot": 0.3, "left_foot": 0.3, moved: 1.0}.items():
        joints[:, list(LIMBS[each]), 1] = reach / (1 + np.exp(-(np.arange(40) - 20)[:, None] / 1.5))
    assert striking_limb(joints, named) == limb


def test_window_is_a_truncated_gaussian():
    g = window(40, Target(11, 20, ""), sigma=2.0, half_width=6)
    assert g[20] == 1
    assert g[22] == pytest.approx(np.exp(-0.5))
    assert g[14] > 0 == g[13]
    np.testing.assert_allclose(g[20:27], g[20:13:-1])


def test_loss_is_the_weighted_mean_of_squared_distances():
    positions = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 3, 0]])
    weights = torch.tensor([1.0, 0.5, 0.0])
    assert float(attraction_loss(positions, torch.zeros(3, 3), weights)) == pytest.approx(0.5 / 1.5)


def test_gradient_reaches_the_pose_parameters():
    """Finite differences in float64, through forward kinematics."""
    generator = torch.Generator().manual_seed(0)

    def randn(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    rest, goal = randn(24, 3), randn(6, 3)
    weights = torch.as_tensor(window(6, Target(11, 3, ""), 2.0, 6))
    orientation = torch.tensor([1.0, 0, 0, 0, 0, 1], dtype=torch.float64) + 0.1 * randn(6, 6)
    inputs = [randn(6, 3), orientation, 0.5 * randn(6, 23, 3)]
    for tensor in inputs:
        tensor.requires_grad_()

    def loss(*x):
        return attraction_loss(joint_positions(*x, rest)[:, 11], goal, weights)

    assert torch.autograd.gradcheck(loss, inputs)


def test_carried_strike_brings_skin_to_skin_and_keeps_the_swing():
    """A round limb whose joint is off its centre, striking a ball along +Y: at the meeting the two spheres touch."""
    com = np.array([0.0, 2, 0.5])
    path = np.array([0.0, 1, 0.5]) + np.arange(-2, 3)[:, None] * [0, 0.4, 0]
    limb = path[2] + np.array([0, 0.02, 0]) + 0.05 * fibonacci_sphere(2000)
    goal = path + strike_offset(com, com + 0.11 * fibonacci_sphere(4000), limb, path, 2)
    np.testing.assert_allclose(goal[2], [0, 2 - 0.11 - 0.05 - 0.02, 0.5], atol=2e-3)
    np.testing.assert_allclose(np.diff(goal, axis=0), np.diff(path, axis=0), atol=1e-12)


def test_meeting_is_the_end_of_the_fastest_step():
    assert Target(11, 20, "").meeting_frame(40) == 21
    assert Target(11, 39, "").meeting_frame(40) == 39


def test_carried_strike_of_a_still_limb_comes_from_where_it_is():
    com, path = np.array([0.0, 2, 0.5]), np.tile([0.0, 1, 0.5], (5, 1))
    goal = path + strike_offset(
        com, com + 0.11 * fibonacci_sphere(4000), path[2] + 0.05 * fibonacci_sphere(2000), path, 2
    )
    np.testing.assert_allclose(goal, np.tile([0, 2 - 0.11 - 0.05, 0.5], (5, 1)), atol=2e-3)
