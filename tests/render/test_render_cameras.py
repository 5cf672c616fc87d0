"""Cameras: where they look, that they show everything and no more, how they follow, and their JSON."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from render_scenes import cameras_in

from hoi.data import Camera
from hoi.errors import InputError
from hoi.render.action import LOOK_AHEAD, Action
from hoi.render.cameras import (
    CLOSEST,
    MARGIN,
    VIEWS,
    circle,
    fitting_width,
    frame_action,
    look_at,
    project,
    to_json,
    view,
)

FPS = 20.0
CAMERA = look_at((1, 2, 3), (0, 0, 0))
DIRECTIONS = [*VIEWS.values(), (0.0, 0.0, -1.0), (-0.3, 0.2, -0.9)]


def gaps(camera: Camera, points: np.ndarray) -> np.ndarray:
    """What is free at the left, upper, right and lower border, in shares of the picture."""
    pixels, depths = project(camera, points)
    assert depths.min() > 0
    size = np.array([camera.width, camera.height])
    return np.concatenate([pixels.min(0) / size, 1 - pixels.max(0) / size])


def standing(frames: int, walk: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """A person's outline that walks by `walk` [m] a frame."""
    outline = np.random.default_rng(0).uniform((-0.3, -0.2, 0.0), (0.3, 0.2, 1.8), (60, 3))
    return outline + np.arange(frames)[:, None, None] * np.array(walk)


def ball(centres: np.ndarray) -> np.ndarray:
    directions = np.random.default_rng(1).normal(size=(30, 3))
    return centres[:, None] + 0.11 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def following(action: Action) -> list[Camera]:
    cameras = view("follow", action)
    assert isinstance(cameras, list)
    return cameras


def still(name: str, action: Action) -> Camera:
    camera = view(name, action)
    assert isinstance(camera, Camera)
    return camera


# --- one camera -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("eye", [(3.0, 1.0, 1.4), (0.0, 0.0, 5.0), (0.0, 0.0, -5.0), (1e-12, 0.0, 4.0)])
def test_look_at_puts_the_target_in_the_middle(eye: tuple[float, float, float]) -> None:
    camera = look_at(eye, (0, 0, 0), width=720, height=480, fov_y=0.7)
    pixels, depths = project(camera, np.zeros((2, 3)))
    np.testing.assert_allclose(pixels, [[360, 240]] * 2, atol=1e-9)
    np.testing.assert_allclose(depths, np.linalg.norm(eye))
    np.testing.assert_allclose(camera.position, eye, atol=1e-12)
    np.testing.assert_allclose(camera.forward, -np.array(eye) / np.linalg.norm(eye), atol=1e-12)


def test_the_opening_is_that_between_the_upper_and_the_lower_border() -> None:
    camera = look_at((0, -2, 0), (0, 0, 0), width=600, height=400, fov_y=0.8)
    half = 2 * math.tan(0.4)
    pixels, _ = project(camera, np.array([[0, 0, half], [0, 0, -half], [1.5 * half, 0, 0]]))
    np.testing.assert_allclose(pixels, [[300, 0], [300, 400], [600, 200]], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "right", "up"),
    [
        ("front", (-1, 0, 0), (0, 0, 1)),
        ("side", (0, 1, 0), (0, 0, 1)),
        ("back", (1, 0, 0), (0, 0, 1)),
        ("top", (0, 1, 0), (-1, 0, 0)),
        ("three_quarter", (-1, 1, 0), (0, 0, 1)),
    ],
)
def test_views_are_the_right_way_round(name: str, right: tuple[int, ...], up: tuple[int, ...]) -> None:
    camera = still(name, Action(standing(3), np.zeros((3, 0, 3)), FPS))
    middle = np.array([0, 0, 0.9])
    pixels, _ = project(camera, np.stack([middle, middle + 0.1 * np.array(right), middle + 0.1 * np.array(up)]))
    assert pixels[1, 0] > pixels[0, 0] + 5
    assert pixels[2, 1] < pixels[0, 1] - 5


def test_straight_down_continues_a_camera_that_faced_forwards() -> None:
    tilted, down = look_at((0, -1e-4, 5), (0, 0, 0)), look_at((0, 0, 5), (0, 0, 0))
    np.testing.assert_allclose(tilted.world_to_camera[:3, :3], down.world_to_camera[:3, :3], atol=1e-4)
    tilted, upwards = look_at((0, -1e-4, -5), (0, 0, 0)), look_at((0, 0, -5), (0, 0, 0))
    np.testing.assert_allclose(tilted.world_to_camera[:3, :3], upwards.world_to_camera[:3, :3], atol=1e-4)


# --- framing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize(("width", "height", "fov_y"), [(720, 480, 0.6), (300, 700, 0.3), (64, 64, 1.8)])
def test_framing_is_exact(direction: tuple[float, ...], width: int, height: int, fov_y: float) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(200, 3)) * rng.uniform(0.2, 2.0, 3) + rng.normal(size=3)
    camera = frame_action(points, direction, width=width, height=height, fov_y=fov_y, margin=0.1)
    free = gaps(camera, points)
    assert free.min() == pytest.approx(0.1, abs=1e-9), "two borders are touched, none is crossed"
    touched = np.isclose(free, 0.1, atol=1e-9)
    assert (touched[0] and touched[2]) or (touched[1] and touched[3])
    np.testing.assert_allclose(camera.forward, -np.array(direction) / np.linalg.norm(direction), atol=1e-12)
    # A step closer, wherever to the sides, loses a point: the two touched borders cannot both be kept.
    axes = camera.world_to_camera[:3, :3]
    for shift in rng.uniform(-0.05, 0.05, (50, 2)):
        pose = camera.world_to_camera.copy()
        pose[:3, 3] = -axes @ (camera.position + np.append(shift, 1e-3) @ axes)
        assert gaps(replace(camera, world_to_camera=pose), points).min() < 0.1


@pytest.mark.parametrize("points", [np.ones((1, 3)), np.zeros((5, 3)), np.linspace(0, 1, 9)[:, None] * np.ones(3)])
def test_points_without_extent_are_framed_from_a_distance(points: np.ndarray) -> None:
    camera = frame_action(points, (0, 1, 0))
    _, depths = project(camera, points)
    assert depths.min() >= CLOSEST - 1e-12
    assert gaps(camera, points).min() > MARGIN - 1e-9


def test_a_fitting_width_fills_the_picture() -> None:
    points = np.random.default_rng(4).uniform((-0.4, -0.3, 0), (0.4, 0.3, 1.8), (300, 3))
    width = fitting_width(points, VIEWS["three_quarter"], 2000, (0.2, 1.5))
    assert 400 < width < 3000
    camera = frame_action(points, VIEWS["three_quarter"], width=width, height=2000)
    np.testing.assert_allclose(gaps(camera, points), MARGIN, atol=1e-3)
    assert fitting_width(points, VIEWS["side"], 400, (0.9, 1.5)) == 360
    assert fitting_width(points * (1, 50, 1), VIEWS["side"], 400, (0.5, 1.5)) == 600


# --- the paper's circle -----------------------------------------------------------------------------------------------


def test_the_circle_is_even_level_and_shows_everything() -> None:
    points = np.random.default_rng(5).uniform((-0.5, -1.0, 0), (0.6, 2.5, 1.8), (400, 3))
    cameras = circle(points, elevation=0.3)
    assert len(cameras) == 100
    positions = np.stack([camera.position for camera in cameras])
    assert np.ptp(positions[:, 2]) < 1e-9
    around = positions - positions.mean(0)
    distances = np.linalg.norm(around[:, :2], axis=1)
    np.testing.assert_allclose(distances, distances[0], rtol=1e-9)
    turns = np.unwrap(np.arctan2(around[:, 1], around[:, 0]))
    np.testing.assert_allclose(np.diff(turns), 2 * np.pi / 100, rtol=1e-9)
    np.testing.assert_allclose(around[0, :2], [0, distances[0]], atol=1e-9)
    for camera in cameras:
        assert camera.forward[2] == pytest.approx(-math.sin(0.3))
    # They look at one point ...
    target = positions[0] + distances[0] / math.cos(0.3) * cameras[0].forward
    for camera in cameras:
        np.testing.assert_allclose(project(camera, target)[0], [360, 240], atol=1e-6)
    # ... and no point is lost, while none of the circle could be smaller.
    free = np.array([gaps(camera, points).min() for camera in cameras])
    assert free.min() == pytest.approx(MARGIN, abs=1e-6)
    rng = np.random.default_rng(6)
    for shift in rng.normal(size=(20, 3)) * 0.05:
        closer = [look_at(target + shift + (p - target) * 0.999, target + shift) for p in positions]
        assert min(gaps(camera, points).min() for camera in closer) < MARGIN


def test_a_circle_of_one_is_a_view_from_the_front() -> None:
    (camera,) = circle(np.random.default_rng(7).normal(size=(50, 3)), 1, 0.0)
    np.testing.assert_allclose(camera.forward, (0, -1, 0), atol=1e-12)


# --- what the views show over time ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in VIEWS if name != "follow"])
def test_a_standing_view_shows_the_person_in_all_frames_and_the_object_while_near(name: str) -> None:
    frames = 40
    centres = np.array([0.1, 1.0, 0.11]) + np.maximum(np.arange(frames) - 20, 0)[:, None] * (0, 0.6, 0.1)
    action = Action(standing(frames, (0, 0.02, 0)), ball(centres), FPS)
    camera = still(name, action)
    assert gaps(camera, action.person.reshape(-1, 3)).min() >= MARGIN - 1e-9
    assert gaps(camera, action.thing[:22].reshape(-1, 3)).min() >= MARGIN - 1e-9
    assert camera.position @ camera.position < 10**2, "the ball, which flies 12 m, does not push the camera away"


def test_an_outlying_frame_moves_no_camera() -> None:
    person, frames = standing(40, (0.01, 0.05, 0)), np.arange(40)
    calm = Action(person, ball(np.tile([0.2, 1.0, 0.11], (40, 1))), FPS)
    for frame in (0, 17, 39):
        jumped = replace(calm, person=person + (frames == frame)[:, None, None] * np.array([4.0, 3.0, 1.0]))
        for name in ("side", "three_quarter", "top"):
            np.testing.assert_allclose(still(name, jumped).position, still(name, calm).position, atol=0.1)
        ways = [np.stack([camera.position for camera in following(action)]) for action in (jumped, calm)]
        np.testing.assert_allclose(ways[0], ways[1], atol=0.1)


def test_some_frames_frame_tighter_than_all() -> None:
    action = Action(standing(40, (0, 0.1, 0)), np.zeros((40, 0, 3)), FPS)
    few = action.points([3, 30, 9])
    assert len(few) == 3 * 60 * 2
    assert few[:, 1].max() == pytest.approx(action.person[30, :, 1].max())


def test_following_keeps_the_person_in_the_picture() -> None:
    times = np.arange(60)[:, None, None] / FPS
    person = standing(60) + np.concatenate([1.2 * times, 0.6 * np.sin(4 * times), 0.15 * np.sin(9 * times) ** 2], -1)
    action = Action(person, ball(np.tile([1.0, 1.0, 0.11], (60, 1))), FPS)
    cameras = following(action)
    assert len(cameras) == 60
    free = np.array([gaps(camera, outline).min() for camera, outline in zip(cameras, person, strict=True)])
    assert free.min() >= MARGIN - 1e-9
    for camera in cameras:
        np.testing.assert_allclose(camera.world_to_camera[:3, :3], cameras[0].world_to_camera[:3, :3])


def test_following_is_smooth_where_the_action_is_not() -> None:
    """The person stops dead from 3 m/s, and the ball leaves at 15 m/s."""
    frames = np.arange(80)
    person = standing(80) + np.minimum(frames, 40)[:, None, None] * np.array([0, 3 / FPS, 0])
    centres = np.array([0, 6.5, 0.11]) + np.maximum(frames - 40, 0)[:, None] * np.array([15 / FPS, 0, 0])
    action = Action(person, ball(centres), FPS)
    path = np.stack([camera.position for camera in following(action)])
    acceleration = np.linalg.norm(np.diff(path, 2, axis=0), axis=1) * FPS**2
    jerk = np.linalg.norm(np.diff(path, 3, axis=0), axis=1) * FPS**3
    raw = np.linalg.norm(np.diff(action._middle(), 2, axis=0), axis=1) * FPS**2
    assert raw.max() > 30
    assert acceleration.max() < 6, "3 m/s given up with a standard deviation of 0.3 s is 4 m/s^2"
    assert jerk.max() < 25
    ahead = np.linalg.norm(action.path()[-1] - person[-1].mean(0))
    assert ahead <= LOOK_AHEAD + 1e-6


def test_following_leaves_steady_motion_as_it_is() -> None:
    action = Action(standing(30, (0.02, 0.06, 0)), np.zeros((30, 0, 3)), FPS)
    np.testing.assert_allclose(np.diff(action.path(), axis=0), np.tile([0.02, 0.06, 0], (29, 1)), atol=1e-9)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames_are_enough(frames: int) -> None:
    for action in (
        Action(standing(frames), np.zeros((frames, 0, 3)), FPS),
        Action(np.zeros((frames, 0, 3)), ball(np.zeros((frames, 3))), FPS),
        Action(standing(frames), ball(np.ones((frames, 3))), FPS),
    ):
        assert len(following(action)) == frames
        assert np.isfinite(still("side", action).position).all()


def test_a_motion_that_only_jumps_is_framed_whole() -> None:
    jumps = np.random.default_rng(8).uniform(-20, 20, (12, 1, 3))
    action = Action(standing(12) + jumps, np.zeros((12, 0, 3)), FPS)
    assert not np.isnan(still("front", action).position).any()


# --- exchange ---------------------------------------------------------------------------------------------------------


def test_json_gives_the_same_cameras_back() -> None:
    cameras = [
        *circle(np.random.default_rng(9).normal(size=(20, 3)), 3),
        replace(look_at((1, 2, 3), (0, 0, 0)), near=0.5),
    ]
    text = to_json(cameras)
    assert "OpenCV" in json.loads(text)["conventions"]["camera_axes"]
    again = cameras_in(text)
    assert len(again) == 4
    for before, after in zip(cameras, again, strict=True):
        assert (before.width, before.height, before.near) == (after.width, after.height, after.near)
        assert (before.fx, before.fy, before.cx, before.cy) == (after.fx, after.fy, after.cx, after.cy)
        np.testing.assert_array_equal(before.world_to_camera, after.world_to_camera)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: look_at((1, 1, 1), (1, 1, 1)), "direction"),
        (lambda: look_at((1, 1, float("nan")), (1, 1, 1)), "direction"),
        (lambda: look_at((1, 1, 1), (0, 0, 0), fov_y=4.0), "fov_y"),
        (lambda: look_at((1, 1, 1), (0, 0, 0), width=0), "width"),
        (lambda: replace(CAMERA, height=3.5), "height"),
        (lambda: replace(CAMERA, fx=-1.0), "fx"),
        (lambda: replace(CAMERA, near=-1.0), "near"),
        (lambda: replace(CAMERA, cx=float("nan")), "centre"),
        (lambda: replace(CAMERA, world_to_camera=np.eye(2)), "world_to_camera"),
        (lambda: replace(CAMERA, world_to_camera=np.diag([1.0, 1, 2, 1])), "world_to_camera"),
        (lambda: replace(CAMERA, world_to_camera=np.diag([1.0, 1, -1, 1])), "world_to_camera"),
        (lambda: frame_action(np.zeros((0, 3)), (0, 1, 0)), "0 points"),
        (lambda: frame_action(np.full((2, 3), np.inf), (0, 1, 0)), "finite"),
        (lambda: frame_action(np.zeros((2, 3)), (0, 1, 0), margin=0.5), "margin"),
        (lambda: frame_action(np.zeros((2, 3)), (0, 1, 0), height=0), "720 x 0"),
        (lambda: circle(np.zeros((2, 3)), 0), "0"),
        (lambda: circle(np.zeros((2, 3)), 4, 2.0), "elevation"),
        (lambda: view("inside", Action(standing(2), np.zeros((2, 0, 3)), FPS)), "inside"),
    ],
)
def test_bad_input_is_said_in_one_line(make, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        make()
    assert "\n" not in str(caught.value)
