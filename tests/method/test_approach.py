"""Placing the person: the strike ends at the object, and the motion stays what it was."""

import numpy as np
import pytest

from hoi.body.skinning import joint_paths
from hoi.method.approach import SOONEST, delay, delayed, placed, shifted, turned
from tests.demo_run import kick, person

FOOT, MEETING = 11, 12


@pytest.fixture(scope="module")
def body():
    return person(np.random.default_rng(0), 500)


@pytest.mark.parametrize("com", [(0.05, 1.2, 0.11), (-2.0, 0.3, 0.11), (0.4, -0.7, 1.5), (0.0, 0.0, 0.11)])
def test_the_strike_ends_where_it_should(body, com):
    motion, com = kick(24, 20.0, MEETING), np.array(com)
    short = np.array([0.0, -0.1, 0.3])  # the goal is not the centre of mass

    def struck(moved):
        return joint_paths(body, moved, frames=[MEETING])[0, FOOT]

    there = placed(motion, struck, lambda moved: com + short, com)
    np.testing.assert_allclose(struck(there)[:2], (com + short)[:2], atol=1e-5)
    assert struck(there)[2] == pytest.approx(struck(motion)[2], abs=1e-5)  # no one is lifted off the ground
    before, after = joint_paths(body, motion), joint_paths(body, there)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(after, axis=0), axis=-1), np.linalg.norm(np.diff(before, axis=0), axis=-1), atol=1e-5
    )
    np.testing.assert_allclose(after[..., 2], before[..., 2], atol=1e-5)


def test_whoever_is_placed_comes_from_the_side_of_the_origin(body):
    """The strike goes from the origin to the object: as it went ahead before, it goes that way after."""
    motion, com = kick(24, 20.0, MEETING), np.array([-3.0, 1.0, 0.11])
    there = placed(motion, lambda m: joint_paths(body, m, frames=[MEETING])[0, FOOT], lambda m: com, com)
    start, end = there.translation[0, :2], com[:2]
    cosine = (end - start) @ end / np.linalg.norm(end - start) / np.linalg.norm(end)
    assert cosine > 0.95
    assert np.linalg.norm(start) < np.linalg.norm(end)


def test_turning_and_moving_are_those_of_the_world(body):
    motion = kick(6, 20.0, 3)
    before, quarter = joint_paths(body, motion), joint_paths(body, turned(motion, np.pi / 2))
    np.testing.assert_allclose(quarter, before @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-5)
    offset = np.array([1.0, 2, 0])
    np.testing.assert_allclose(joint_paths(body, shifted(motion, offset)), before + offset, atol=1e-5)


def test_a_strike_waits_for_what_falls_into_its_reach():
    """A ball thrown up passes 1.3 m twice; one that lies is met when the strike comes."""
    time = np.arange(40) / 20.0
    heights = 1.2 + 4.7 * time - 0.5 * 9.81 * time**2
    later = delay(1.3, heights, 20, 20.0)
    assert abs(heights[20 + later] - 1.3) < 0.15 and heights[20 + later] < heights[19 + later]
    assert delay(0.4, np.full(40, 0.11), 17, 20.0) == 0
    assert delay(0.0, -np.arange(40.0)[::-1], 12, 20.0) == 39 - 12
    assert delay(0.0, np.arange(40.0), 12, 20.0) == round(20 * SOONEST) - 12


@pytest.mark.parametrize("frames", [-5, 0, 7])
def test_a_motion_later_or_earlier_holds_its_ends(frames):
    motion = kick(24, 20.0, MEETING)
    moved = delayed(motion, frames)
    for part in ("translation", "orientation", "body_pose"):
        before, after = getattr(motion, part), getattr(moved, part)
        for frame in range(24):
            np.testing.assert_array_equal(after[frame], before[min(max(frame - frames, 0), 23)])
