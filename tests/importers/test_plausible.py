"""Wrong units, rates and axes are noticed by what nobody does, and what people do is left alone."""

import re

import numpy as np
import pytest
from demo_run import person
from scipy.spatial.transform import Rotation
from test_joint_motions import bent
from test_motion_imports import assert_same, made_up, write_bvh, write_npz

from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Body, Motion
from hoi.errors import InputError
from hoi.importers.motions import read_motion
from hoi.importers.plausible import rate_of

FRAMES, FPS = 40, 20.0


@pytest.fixture(scope="module")
def body() -> Body:
    return person(np.random.default_rng(0), 500)


def swaying(body: Body) -> Motion:
    """Somebody who stands, and sways by a centimetre or two."""
    clock = np.arange(FRAMES) / FPS
    pose = np.zeros((FRAMES, 23, 3))
    pose[:, 2, 0] = 0.02 * np.sin(5 * clock)
    root = Rotation.from_euler("ZX", np.stack([np.full(FRAMES, np.pi), np.full(FRAMES, np.pi / 2)], -1))
    path = np.stack([0.012 * np.sin(6 * clock), 0.015 * np.sin(4 * clock), 0.002 * np.cos(5 * clock)], -1)
    motion = Motion(path, root.as_matrix()[:, :2].reshape(FRAMES, 6), pose, FPS)
    motion.translation[:, 2] += sole_height(body) - joint_paths(body, motion)[..., 2].min()
    return motion


@pytest.mark.parametrize(("unit", "size"), [("centimetres", 100), ("millimetres", 1000)])
@pytest.mark.parametrize("place", ["on its floor", "before a camera"])
def test_somebody_who_stands_in_another_unit(tmp_path, body, unit, size, place):
    """Far too slow to be told by speed: the pelvis is too high, or feet that stand would slide."""
    motion = swaying(body)
    shift = (0.3, -2.0, 0.0) if place == "on its floor" else (0.2, 2.5, -motion.translation[0, 2])
    trans = np.load(write_npz(tmp_path / "m.npz", body, motion, shift=shift))["trans"]
    got, notes = read_motion(write_npz(tmp_path / "n.npz", body, motion, trans=size * trans), body, FRAMES, FPS)
    assert_same(got, motion)
    assert any(f"trans read as {unit}: in metres the " in note for note in notes)


def test_metres_stay_metres(tmp_path, body):
    """Walking, standing, gliding over the ground, and far from the origin."""
    gliding = swaying(body)
    gliding.translation[:, 1] += 3.0 * np.arange(FRAMES) / FPS
    gliding.translation[:, :2] -= gliding.translation[0, :2]
    for motion in (bent(body), swaying(body), gliding):
        for shift in ((0, 0, 0), (20.0, -15.0, 0.7)):
            path = write_npz(tmp_path / "m.npz", body, motion, shift=shift)
            _, notes = read_motion(path, body, len(motion), FPS)
            assert len(notes) == 1, notes


def test_of_two_rates_the_possible_one_is_taken_and_said(tmp_path, body):
    motion = bent(body)
    path = write_npz(tmp_path / "m.npz", body, motion, mocap_frame_rate=np.array(500.0))
    got, notes = read_motion(path, body, len(motion), FPS)
    assert_same(got, motion)
    assert any("mocap_framerate is its rate: at mocap_frame_rate of 500 nobody could" in note for note in notes)
    path = write_npz(tmp_path / "m.npz", body, motion, mocap_frame_rate=np.array(30.0))
    with pytest.raises(InputError, match="say which is true"):
        read_motion(path, body, len(motion), FPS)


def test_limbs_that_turn_too_fast_are_said(tmp_path, body):
    """A rate twenty times too high."""
    motion = bent(body)
    motion.translation[:, :2] = 0
    path = write_npz(tmp_path / "m.npz", body, motion, mocap_framerate=np.array(20 * FPS))
    _, notes = read_motion(path, body, 4, FPS)
    assert any(re.search(r"limbs turn at \d+ rad/s, .* is 400 Hz its rate", note) for note in notes)
    path = write_bvh(tmp_path / "m.bvh", body, motion)
    path.write_text(re.sub(r"Frame Time: .*", "Frame Time: 0.0025", path.read_text()))
    assert any("limbs turn at" in note for note in read_motion(path, body, 4, FPS)[1])


@pytest.mark.parametrize(("tilt", "said"), [(20, True), (2, False)])
def test_a_floor_that_slopes_is_said(tmp_path, body, tilt, said):
    """Somebody who shuffles forward, a foot at rest, seen by a camera that looks down."""
    clock = np.arange(80) / FPS
    stride, pose = np.pi * clock, np.zeros((80, 23, 3))
    pose[:, 0, 0], pose[:, 1, 0] = -0.5 * np.sin(stride), 0.5 * np.sin(stride)
    root = Rotation.from_euler("ZX", np.stack([np.full(80, np.pi), np.full(80, np.pi / 2)], -1))
    motion = Motion(np.zeros((80, 3)), root.as_matrix()[:, :2].reshape(80, 6), pose, FPS)
    feet = joint_paths(body, motion)[:, [10, 11]]
    standing = np.where(np.cos(stride) > 0, 0, 1)
    ahead = feet[np.arange(80), standing, 1]
    moved = np.where(standing[1:] == standing[:-1], -np.diff(ahead), 0)
    motion.translation[1:, 1] = np.cumsum(np.abs(moved))
    motion.translation[:, 2] = -feet[..., 2].min(axis=1)
    turned = Rotation.from_euler("x", tilt, degrees=True)
    rows = (turned * root).as_matrix()[:, :2].reshape(80, 6)
    path = write_npz(tmp_path / "m.npz", body, Motion(turned.apply(motion.translation), rows, pose, FPS))
    _, notes = read_motion(path, body, 80, FPS, up="z")
    assert any(f"its floor slopes by {tilt} degrees" in note for note in notes) == said, notes


@pytest.mark.parametrize(
    ("time", "rate", "said"),
    [(1 / 30, 30, ""), (30, 30, "as the rate"), (16.6667, 60, "as milliseconds"), (8.33333, 120, "as milliseconds"),
     (120, 120, "as the rate"), (0.5, 2, "")],
)  # fmt: skip
def test_a_frame_time_that_is_none(time, rate, said):
    got, notes = rate_of(time)
    assert got == pytest.approx(rate, rel=1e-3) and (said in notes[0] if said else not notes)


def test_a_bvh_with_its_rate_for_its_frame_time(tmp_path, body):
    motion = made_up(body)
    path = write_bvh(tmp_path / "m.bvh", body, motion)
    path.write_text(re.sub(r"Frame Time: .*", "Frame Time: 20", path.read_text()))
    got, notes = read_motion(path, body, len(motion), FPS)
    assert_same(got, motion)
    assert any("a frame time of 20 read as the rate: 20 Hz" in note for note in notes)
