"""Pushes with both hands: the face, a place on it for each palm, the person square to it, and what is held."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies import carried, cloud_of
from test_touch import box, off, still, thing_of

from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_paths, stand_motion
from hoi.data import Body, Motion, Scene, Target
from hoi.gaussians import fibonacci_sphere
from hoi.method.approach import approach, turned
from hoi.method.attraction import Batch, State, carried_push, pulled_joints, window, windowed_attraction
from hoi.method.contact import find_contact
from hoi.method.push import PUSH, choose_push, face_of, facing, held, places

LEFT, RIGHT, FPS, FRAMES, MEETING = 22, 23, 20.0, 30, 15
BODY = load_person("woman", 3000, 0)
TARGET = Target(LEFT, MEETING - 1, "scene", (LEFT, RIGHT), 6)


def push() -> Motion:
    """Arms that come up and stretch ahead, by 14 the fastest, and go back faster than they came."""
    motion = stand_motion(BODY, FRAMES, FPS)
    frames = np.arange(FRAMES)
    out = np.interp(frames, [0, 10, 20, 25, 26, 29], [0, 0, 1, 1, 0, 0])
    for side, sign in (("left", 1), ("right", -1)):
        shoulder, elbow = (JOINT_NAMES.index(f"{side}_{part}") - 1 for part in ("shoulder", "elbow"))
        motion.body_pose[:, shoulder] = np.stack([0 * out, -sign * 1.3 * out, -sign * 1.2 * (1 - out)], -1)
        motion.body_pose[:, elbow] = np.stack([0 * out, -sign * 1.2 * (1 - out), 0 * out], -1)
    return motion


def scene(yaw: float = 0.0, at=(0.0, 1.2), size=(0.8, 0.8, 0.9)) -> Scene:
    skin, inside = box(size, 0.02, 0.06)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    thing = thing_of(*(points @ turn.T + [*at, size[2] / 2] for points in (skin, inside)))
    return Scene("push", BODY, thing, "", FRAMES, FPS, np.zeros(3))


def test_a_person_who_stands_faces_ahead():
    joints = joint_paths(BODY, stand_motion(BODY, 2, FPS))
    np.testing.assert_allclose(facing(joints), np.tile([0, 1, 0], (2, 1)), atol=1e-3)
    ahead = facing(joint_paths(BODY, turned(stand_motion(BODY, 2, FPS), np.pi / 2)))
    np.testing.assert_allclose(ahead, np.tile([-1, 0, 0], (2, 1)), atol=1e-3)


def test_push_is_when_hands_go_forward_together_not_when_they_are_drawn_back():
    target = choose_push(joint_paths(BODY, push()), (LEFT, RIGHT), 6)
    assert 10 <= target.frame < 20
    assert (target.striking, target.hold) == ((LEFT, RIGHT), 6) and target.joint in (LEFT, RIGHT)


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.5, np.pi / 2])
def test_face_is_the_one_ahead(yaw):
    there = scene(yaw)
    thing, com = there.thing, there.thing.particles.mean(axis=0)
    face = face_of(thing, thing.particles, com, np.zeros(3), 0.5)
    normals = [[-np.sin(yaw + turn), np.cos(yaw + turn), 0] for turn in np.pi / 2 * np.arange(4)]
    assert min(off(face.direction, normal) for normal in normals) < 3
    assert face.direction[1] > 0.7 and face.direction[2] == 0
    assert face.direction @ face.left == pytest.approx(0)


def test_ball_is_pushed_the_way_one_comes():
    skin, thing = 0.4 * fibonacci_sphere(2000) + [1, 1, 0.4], None
    thing = thing_of(skin)
    face = face_of(thing, skin, np.array([1, 1, 0.4]), np.zeros(3), 0.4)
    assert off(face.direction, np.array([1, 1, 0]) / np.sqrt(2)) < 5


@pytest.mark.parametrize("width", [0.8, 0.3, 0.12])
def test_palms_lie_alike_on_both_sides_and_on_the_face(width):
    there = scene(size=(width, 0.8, 0.9))
    thing, com = there.thing, there.thing.particles.mean(axis=0)
    face = face_of(thing, thing.particles, com, np.zeros(3), 0.5)
    hands = np.array([[-0.25, 0.5, 1.3], [0.2, 0.5, 0.6]])
    left, right = places(face, thing.cloud.means, hands, BODY.rest_joints[[LEFT, RIGHT]])
    assert left[0] == pytest.approx(-right[0], abs=1e-6) and -width / 2 < left[0] < 0 < right[0]
    assert left[1] == pytest.approx(0.8, abs=0.01) and right[1] == pytest.approx(0.8, abs=0.01)
    assert left[2] == pytest.approx(0.75 * 0.9) and right[2] == pytest.approx(0.6)  # the one is out of reach


def test_held_paths_go_on_evenly_from_the_meeting_and_arrive_that_way():
    way = np.array([0.0, 1, 0])
    path = np.zeros((2, FRAMES, 3))
    path[:, :, 1] = np.interp(np.arange(FRAMES), [0, 10, 18, 29], [0, 0, 0.8, 0])
    path[1, :, 0] = 0.4
    kept = held(path, 15, 6, way)
    steps = np.diff(kept, axis=1)
    np.testing.assert_allclose(steps[:, 14:21], np.tile(PUSH / 6 * way, (2, 7, 1)), atol=1e-12)
    np.testing.assert_allclose(kept[:, 15], path[:, 15])
    np.testing.assert_allclose(steps[:, :14], np.diff(path, axis=1)[:, :14], atol=1e-12)
    np.testing.assert_allclose(steps[:, 21:], np.diff(path, axis=1)[:, 21:], atol=1e-12)
    np.testing.assert_array_equal(held(path, 15, 0, way), path)
    assert held(path, 15, 40, way).shape == path.shape


def test_window_stays_open_while_the_push_lasts():
    g, short = window(FRAMES, TARGET, 2.0, 6), window(FRAMES, replace(TARGET, hold=0), 2.0, 6)
    np.testing.assert_array_equal(g[14:21], 1)
    np.testing.assert_array_equal(g[:15], short[:15])
    np.testing.assert_array_equal(g[21:27], short[15:21])
    assert not g[27:].any()


@pytest.mark.parametrize("yaw", [0.0, 0.4])
@pytest.mark.parametrize("at", [(0.0, 1.2), (-1.5, 0.4), (0.3, -2.0)])
def test_whoever_pushes_stands_square_to_the_face_with_a_palm_on_either_side(yaw, at):
    there = scene(yaw, at)
    free = still(there.thing)
    free = replace(
        free, **{k: np.repeat(getattr(free, k)[:1], FRAMES, 0) for k in ("positions", "com", "com_velocity")}
    )
    motion, target = approach(there, push(), free, TARGET)
    joints = joint_paths(BODY, motion)[target.meeting_frame(FRAMES)]
    face = face_of(there.thing, there.thing.particles, free.com[0], joints[0], 0.5)
    assert off(facing(joints), face.direction) < 2
    aside = (joints[[LEFT, RIGHT]] - free.com[0]) @ face.left
    assert aside[0] == pytest.approx(-aside[1], abs=0.02) and aside[0] > 0.05
    goals = carried_push(there, motion, free, target)
    assert goals.shape == (len(pulled_joints(target)), FRAMES, 3) == (4, FRAMES, 3)
    at_meeting = goals[:, target.meeting_frame(FRAMES)]
    depth = (at_meeting[:2] - free.com[0]) @ face.direction
    np.testing.assert_allclose(depth, depth[0], atol=0.01)
    assert -0.4 - 0.05 < depth[0] < -0.4  # the palm's skin on the face, the joint behind it
    assert (at_meeting[:2, 2] > at_meeting[2:, 2] + 0.04).all()  # wrists below hands: palms flat

    term, weight = windowed_attraction(
        Batch([there], [0], "cpu"), [State(motion, free, target)], 1.0, 1.02, 2.0, 6, to_com=False
    )
    placed = torch.zeros(1, FRAMES, 24, 3)
    placed[0, :, list(pulled_joints(target))] = torch.as_tensor(goals, dtype=torch.float32).transpose(0, 1)
    assert term(placed) == pytest.approx(0, abs=1e-10) and weight == 1
    placed[0, :, RIGHT] += torch.tensor([0.0, -0.2, 0.0])
    assert term(placed) == pytest.approx(0.04 / 4, rel=1e-4) and weight == pytest.approx(1.02)


def two_fists(behind: float) -> Body:
    """Two hands, the right one so far behind the left [m]."""
    ball = 0.04 * fibonacci_sphere(300)
    weights = np.zeros((600, 24))
    weights[:300, LEFT] = weights[300:, RIGHT] = 1
    means = np.concatenate(
        [ball - np.array([0.15, 0, 0]), ball + np.array([0.15, 0, -behind])]
    )  # the rest frame's z is ahead
    return Body("fists", cloud_of(means, 0.005, dtype=np.float64), weights, np.zeros((24, 3)))


def strike(behind: float, together=(LEFT, RIGHT)):
    skin, inside = box((0.6, 0.6, 0.6), 0.012, 0.05)
    thing = thing_of(skin, inside)
    motion = carried([0, -0.6, 0], [0, 1.5, 0], 12, FPS)
    ahead = np.tile([-1.0, 0, 0, 0, 0, 1], (12, 1))  # the rest frame's z to Y
    fists = Scene("push", two_fists(behind), thing, "", 12, FPS, np.zeros(3))
    settings = {"tau": 0.05, "distance": 0.01, "between_frames": True}
    return find_contact(fists, replace(motion, orientation=ahead), still(thing), **settings, together=together)


@pytest.mark.parametrize("behind", [0.0, 0.03, -0.03])
def test_both_hands_of_a_push_are_contacts_and_one_gives_the_impulse(behind):
    first, second = strike(behind).contacts
    assert {first.part, second.part} == {"left_hand", "right_hand"}
    assert second.frame - first.frame == pytest.approx(abs(behind) / 1.5 * FPS, abs=0.15)
    assert strike(behind).push is not None and strike(behind).push.frame == first.frame
    assert second.v_in == pytest.approx(1.5, rel=0.01) and not second.impulse.any()
    np.testing.assert_array_equal(second.v_post, second.v_object)


def test_a_hand_that_comes_too_late_or_does_not_push_along_is_no_contact():
    assert len(strike(0.3).contacts) == 1
    (alone,) = strike(0.0, together=()).contacts
    (late,) = strike(0.3).contacts
    assert alone.frame == late.frame and alone.v_in > 0
