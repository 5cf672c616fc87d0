"""Which frames may change, and that nothing else does."""

import numpy as np
import pytest
import torch

from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Motion
from hoi.refine.window import WindowedPose, bones_apart, taper, window_around

FOOT = JOINT_NAMES.index("right_foot")


def motion(frames: int = 12) -> Motion:
    rng = np.random.default_rng(0)
    shapes = ((frames, 3), (frames, 6), (frames, 23, 3))
    return Motion(*(rng.standard_normal(shape).astype(np.float32) for shape in shapes), fps=20.0)


@pytest.mark.parametrize(
    ("t_c", "half_width", "frames"),
    [
        (5.0, 1.0, (4, 5, 6)),
        (5.4, 1.0, (4, 5, 6)),
        (5.6, 1.0, (5, 6, 7)),
        (5.4, 0.0, (5, 6)),
        (5.0, 0.0, (5,)),
        (5.0, 2.0, (3, 4, 5, 6, 7)),
        (0.0, 1.0, (0, 1)),
        (10.7, 1.0, (10, 11)),
    ],
)
def test_frames_of_a_window(t_c, half_width, frames):
    window = window_around(t_c, FOOT, half_width, 12)
    assert window.frames == frames
    assert window.limb == tuple(JOINT_NAMES.index(f"right_{part}") for part in ("hip", "knee", "ankle", "foot"))
    weights = taper(window)
    assert (weights > 0).all() and (weights <= 1).all()
    nearest = np.abs(np.array(frames) - t_c).argmin()
    assert weights.argmax() == nearest


def test_the_pelvis_never_turns():
    assert 0 not in window_around(3.0, JOINT_NAMES.index("spine3"), 1.0, 12).moving


def test_all_outside_the_window_is_bit_for_bit_as_before():
    before, window = motion(), window_around(5.4, FOOT, 1.0, 12)
    pose = WindowedPose(before, window)
    with torch.no_grad():
        pose.offset.normal_(generator=torch.Generator().manual_seed(0))
    after = pose.motion()
    assert np.array_equal(after.translation, before.translation)
    assert np.array_equal(after.orientation, before.orientation)
    changed = np.zeros(before.body_pose.shape[:2], bool)
    changed[np.ix_(window.frames, np.array(window.moving) - 1)] = True
    assert np.array_equal(after.body_pose[~changed], before.body_pose[~changed])
    assert (after.body_pose[changed] != before.body_pose[changed]).any(axis=-1).all()
    np.testing.assert_allclose(pose.body_pose.detach(), after.body_pose, atol=1e-6)


def test_nothing_is_changed_at_the_start():
    before = motion()
    after = WindowedPose(before, window_around(5.4, FOOT, 1.0, 12)).motion()
    assert np.array_equal(after.body_pose, before.body_pose)


def test_the_gradient_reaches_the_window_alone():
    pose = WindowedPose(motion(), window_around(5.0, FOOT, 1.0, 12))
    pose.body_pose.square().sum().backward()
    assert pose.offset.grad is not None and bool((pose.offset.grad != 0).all())
    assert not any(leaf.requires_grad for leaf in (pose.translation, pose.orientation, pose.start))


def test_roughness_counts_the_edges():
    """A change in one frame alone is second differences of 1, -2 and 1: one at t_c, two at the edges."""
    pose = WindowedPose(motion(), window_around(5.0, FOOT, 0.0, 12), dtype=torch.float64)
    with torch.no_grad():
        pose.offset[0, 0, 0] = 0.1
    assert pose.roughness().item() == pytest.approx((1 + 4 + 1) * 0.01 / 3)


def test_bones_apart():
    apart = bones_apart(FOOT)
    names = ["right_foot", "right_ankle", "right_knee", "right_hip", "pelvis", "left_hip", "spine1"]
    assert [apart[JOINT_NAMES.index(name)] for name in names] == [0, 1, 2, 3, 4, 5, 5]


def test_the_papers_window_is_of_all_joints_and_without_a_taper():
    before, window = motion(), window_around(5.4, FOOT, 1.0, 12, whole_body=True, tapered=False)
    assert window.moving == tuple(range(1, 24))
    np.testing.assert_array_equal(taper(window), np.ones(3))
    pose = WindowedPose(before, window)
    with torch.no_grad():
        pose.offset += 0.1
    after = pose.motion()
    np.testing.assert_allclose(after.body_pose[4:7] - before.body_pose[4:7], 0.1, atol=1e-6)
    np.testing.assert_array_equal(
        np.delete(after.body_pose, range(4, 7), 0), np.delete(before.body_pose, range(4, 7), 0)
    )
