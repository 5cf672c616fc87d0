"""Which feet are planted, how far they slide, and the loss that holds them."""

import numpy as np
import pytest
import torch

from hoi.body.footing import FEET, Footing, Stance, slide, stances, sunk

FPS = 20.0
STANDING = np.full(24, 0.5)
STANDING[[10, 11]], STANDING[[7, 8]] = 0.02, 0.08


def walk(frames: int = 12) -> np.ndarray:
    """World joints of a person whose left toes stand in frames 2 to 8 and whose other feet are in the air."""
    joints = np.full((frames, 24, 3), 1.0)
    joints[:, :, 1] += 0.2 * np.arange(frames)[:, None]
    joints[2:9, 10] = (0.3, 1.4, 0.03)
    return joints


def test_a_foot_is_planted_where_it_is_low_and_slow():
    assert stances(walk(), STANDING, FPS) == [Stance(10, 2, 8)]
    fast, high = walk(), walk()
    fast[2:9, 10, 1] += 0.05 * np.arange(7)  # 1 m/s
    high[2:9, 10, 2] += 0.1
    assert stances(fast, STANDING, FPS) == stances(high, STANDING, FPS) == []


def test_slide_is_the_way_from_the_mean_place():
    joints, planted = walk(), [Stance(10, 2, 8)]
    assert slide(joints, planted) == pytest.approx(0, abs=1e-12)
    joints[2:9, 10, 0] += 0.01 * np.arange(7)
    assert slide(joints, planted) == pytest.approx(0.03)
    assert slide(joints, []) == 0


def test_loss_holds_the_place_within_a_stance_and_not_the_stance():
    free, planted = walk(), [Stance(10, 2, 4), Stance(10, 6, 8)]
    footing = Footing(free, planted)
    moved = torch.tensor(free)
    moved[2:5, 10, :2] += 0.5
    assert float(footing.loss(moved)) == pytest.approx(0, abs=1e-12)
    moved[6:9, 10, 1] += torch.tensor([-0.03, 0, 0.03], dtype=torch.float64)
    assert float(footing.loss(moved)) == pytest.approx(2 * 0.03**2 / 6)
    lifted = torch.tensor(free)
    lifted[:, 10, 2] += 0.1
    assert float(footing.loss(lifted)) == pytest.approx(0.1**2)


def test_gradient_of_the_loss():
    footing = Footing(walk(), [Stance(10, 2, 5), Stance(7, 0, 3)])
    joints = torch.randn(12, 24, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert torch.autograd.gradcheck(footing.loss, [joints.requires_grad_()])


def test_feet_in_the_ground_cost_the_square_of_their_depth():
    standing = torch.zeros(24)
    standing[list(FEET)] = torch.tensor([0.08, 0.08, 0.02, 0.02])
    joints = standing[None, None, :, None].repeat(2, 5, 1, 3)
    joints[..., 11, 2] += 0.3  # lifted
    assert float(sunk(joints, standing).abs().max()) == 0
    joints[1, 2, 7, 2] -= 0.1
    torch.testing.assert_close(sunk(joints, standing), torch.tensor([0.0, 0.1**2 / 5]))
