"""Placing the person: the strike ends at the object, and the motion stays what it was."""

import numpy as np
import pytest

from hoi.body.skeleton import CHAINS, chain_of
from hoi.body.skinning import joint_paths, stand_motion
from hoi.config.validate import to_config
from hoi.data import Target
from hoi.method.approach import SOONEST, STRETCH, delay, delayed, hastened, placed, shifted, turned, within_reach
from hoi.method.object_motion import at_rest, free_motion
from hoi.method.push import facing
from hoi.reports import quiet
from hoi.runner.scene import build_scene
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


@pytest.mark.parametrize("joint", [11, 23, 22])
@pytest.mark.parametrize("place", [(0.5, 1.2, None), (-1.0, -0.4, 1.1), (2.0, 0.0, 0.4)])
def test_whoever_stands_still_faces_the_object_within_reach(composed, joint, place):
    """The limb, nine tenths stretched, ends at the surface; with another body the same holds."""
    z = "null" if place[2] is None else place[2]
    position = f"scene.placement.position=[{place[0]},{place[1]},{z}]"
    scene = build_scene(to_config(composed("human.gaussians=2000", "object.max_gaussians=800", position)))
    still, target = stand_motion(scene.body, scene.frames, scene.fps), Target(joint, 20, "scene")
    free, _ = free_motion(scene, at_rest, quiet())
    there = within_reach(scene, still, free, target)
    joints, com = joint_paths(scene.body, there, frames=[21])[0], free.com[21]
    limb = CHAINS[chain_of(joint)][: CHAINS[chain_of(joint)].index(joint) + 1]
    length = np.linalg.norm(np.diff(scene.body.rest_joints[list(limb)], axis=0), axis=1).sum()
    root, way = joints[limb[0]], facing(joints)
    assert way[:2] @ com[:2] / np.linalg.norm(com[:2]) == pytest.approx(1, abs=1e-6)  # as seen from where it stood
    nearest = np.linalg.norm(free.positions[21] - root, axis=1).min()
    assert nearest <= STRETCH * length + 0.02 or abs(com[2] - root[2]) > STRETCH * length
    np.testing.assert_allclose(there.translation[:, 2], still.translation[:, 2], atol=1e-6)
    assert abs(np.cross(way, (com - root) * [1, 1, 0])[2]) < 1e-3  # straight before the limb


@pytest.mark.parametrize("tempo", [0.5, 0.7, 1.0, 1.5, 2.0])
def test_a_strike_is_as_many_times_as_fast_on_the_same_path(body, tempo):
    motion = kick(40, 20.0, 20)
    target = Target(FOOT, 19, "velocity profile")
    warped = hastened(motion, target, tempo)

    def speed(moved):  # at the middle of the fastest step
        return np.linalg.norm(np.diff(joint_paths(body, moved, frames=[19.45, 19.55])[:, FOOT], axis=0), axis=-1)[0]

    assert speed(warped) == pytest.approx(tempo * speed(motion), rel=0.12)
    fine = joint_paths(body, motion, frames=np.linspace(0, 39, 4000))[:, FOOT]
    off = np.linalg.norm(joint_paths(body, warped)[:, None, FOOT] - fine, axis=-1).min(axis=1)
    assert off.max() < 2e-3  # no frame leaves the path
    if tempo == 1:
        np.testing.assert_allclose(warped.translation, motion.translation, atol=1e-6)


def test_an_object_is_met_at_the_height_that_is_asked_for():
    """A ball that is lobbed passes 0.5 m; left to itself the strike waits until it is low."""
    time = np.arange(40) / 20.0
    heights = np.maximum(0.5 + 4.9 * time - 0.5 * 9.81 * time**2, 0.11)
    assert abs(heights[19 + delay(0.5, heights, meeting=19, fps=20.0)] - 0.5) < 0.13
    assert heights[19 + delay(0.15, heights, meeting=19, fps=20.0)] < 0.3
