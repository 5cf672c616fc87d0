"""The camera of the action keeps who strikes and what is struck in its picture, and shows the contact."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies import carried, cloud_of, fist

from hoi.data import Contact, ContactSearch, Material, ObjectTrajectory, Scene, SceneObject, State
from hoi.gaussians import fibonacci_sphere
from hoi.render import director
from hoi.render.director import _judged, contact_frame, contact_seen, directed, in_picture, limb_path
from hoi.render.replay import Replay

FRAMES, FPS, MEET = 30, 20.0, 12
RUBBER = Material("rubber", "fixed_corotated", 1e5, 0.3, 100.0, 0.8, 0.5)


def punch(direction=(0.0, 1.0, 0.0), speed=12.0, wall=False) -> Replay:
    """A fist that meets a ball, which leaves in a direction [m/s]; a wall beside them hides both from one side."""
    direction = np.array(direction)
    start = np.array([0, 0, 1.2])
    motion = carried(start - direction * 0.1 * MEET, direction * 0.1 * FPS, FRAMES, FPS)
    ball = 0.11 * fibonacci_sphere(300)
    if wall:
        y, z = np.meshgrid(np.arange(-1.2, 1.2, 0.03), np.arange(-1.2, 1.2, 0.03))
        ball = np.concatenate([ball, np.column_stack([np.full(y.size, -0.4), y.ravel(), z.ravel()])])
    leaving = np.clip(np.arange(FRAMES) - MEET, 0, None)[:, None] / FPS * speed * direction
    com = start + 0.16 * direction + leaving
    positions = (com[:, None] + ball).astype(np.float32)
    velocity = np.gradient(com, axis=0) * FPS
    cloud = cloud_of(positions[0].astype(np.float64), 0.012)
    thing = SceneObject("ball", cloud, positions[0], np.full(len(ball), 1e-5), RUBBER, np.zeros(3), np.zeros(3), 0.22)
    touch = Contact(float(MEET), 22, 1.0, start + 0.05 * direction, direction, direction, np.zeros(3), 2.0,
                    speed * direction,
                    direction, 0.0)  # fmt: skip
    scene = Scene("punch", fist(), thing, "", FRAMES, FPS, np.array([0, 0, -9.81]))
    search = ContactSearch((touch,), 0.0, MEET, 22)
    trajectory = ObjectTrajectory(positions, com, velocity, np.zeros((FRAMES, 3)))
    return Replay(scene, State(motion, trajectory, None, search))


@pytest.mark.parametrize("direction", [(0, 1, 0), (1, 0, 0), (-0.6, -0.8, 0)])
@pytest.mark.parametrize("speed", [0.5, 12.0])
def test_both_stay_in_the_picture_and_the_contact_is_seen(direction, speed):
    replay = punch(direction, speed)
    cameras, moment = directed(replay, 180, 120), contact_frame(replay)
    path, thing = limb_path(replay), replay.action().thing.mean(1)
    inside = [in_picture(c, path[at]) and in_picture(c, thing[at]) for at, c in enumerate(cameras)]
    assert moment == MEET and np.mean(inside) >= 0.9
    assert contact_seen(replay, cameras[moment], moment) > 0.3
    assert _judged(replay, cameras, moment).speed < 6


def test_what_hides_the_contact_is_looked_around():
    replay = punch(wall=True, speed=0.0)
    camera = directed(replay, 180, 120)[MEET]
    assert camera.position[0] > 0  # the wall stands at x = -0.4
    aside = replace(camera, world_to_camera=camera.world_to_camera @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert contact_seen(replay, camera, MEET) > 0.3 > contact_seen(replay, aside, MEET) + 0.2


def test_the_visible_share_against_what_is_in_front():
    """A ball alone hides its own back half; behind a plate nothing is left."""
    replay = punch(speed=0.0)
    shares = [contact_seen(replay, camera, MEET) for camera in (directed(replay, 180, 120)[MEET],)]
    assert all(0.2 < share < 0.8 for share in shares)


def test_a_camera_that_stands_is_one_object_and_the_same_each_time(monkeypatch):
    monkeypatch.setattr(director, "LARGE", 0.0)
    replay = punch(speed=0.2)
    first, again = directed(replay, 180, 120), directed(replay, 180, 120)
    assert all(camera is first[0] for camera in first)
    assert np.array_equal(first[0].world_to_camera, again[0].world_to_camera)


def test_without_contact_or_person_there_is_a_view_all_the_same():
    replay = punch(speed=0.2)
    for state in (replace(replay.state, contact=None), replace(replay.state, contact=None, motion=None)):
        cameras = directed(Replay(replay.scene, state), 96, 64)
        assert len(cameras) == FRAMES and torch.isfinite(torch.as_tensor(cameras[0].world_to_camera)).all()
