"""Metrics against cases with known answers, and the NumPy judge and kinematics against those in torch."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from analysis.metrics import METRICS, evaluator
from analysis.metrics.features import encode
from analysis.metrics.hulls import hull_of
from analysis.metrics.meeting import Shape, meeting, rigid_motion
from analysis.metrics.person import beyond_limits, skating
from analysis.metrics.prompts import scene_prompts
from analysis.motion import measures
from analysis.posing import local_rotations
from analysis.records import Record
from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Run, StageReport
from hoi.motion import features as torch_features
from hoi.motion.evaluator import load_evaluator
from hoi.motion.text import default_cache, minilm
from hoi.refine.fidelity import object_at
from tests.demo_run import BALL_RADIUS, make_run

G = 9.81
DOCS = Path(__file__).parents[2] / "docs" / "benchmark.md"


@pytest.fixture(scope="module")
def demo() -> Run:
    run, *_ = make_run(gaussians=800, particles=1000)
    return replace(run, config_yaml="scene:\n  expected_limb: right_foot\n")


@pytest.fixture(scope="module")
def long() -> Run:
    """24 frames at 20 a second, contact at 8.5."""
    run, *_ = make_run(frames=24, gaussians=300, particles=500, contact_frame=8.5)
    return run


def record(run: Run, **given) -> Record:
    """A record in memory, with its lazy parts as given."""
    made = Record(Path("run.mcap"), run)
    if given.get("skin") is not None:
        given = {"skin_joints": np.zeros(given["skin"].shape[1], int)} | given
    made.__dict__.update(given)
    return made


def stated(run: Run, **parts) -> Run:
    return replace(run, state=replace(run.state, **parts))


def moving(run: Run, com: np.ndarray, velocity: np.ndarray, *, touched: bool = False, **parts) -> Run:
    """The run with its object moved as one piece along `com` (T, 3), and no contact unless it is to stay."""
    trajectory = run.state.trajectory
    shape = run.scene.object.particles - run.scene.object.particles.mean(axis=0)
    positions = (com[:, None] + shape).astype(np.float32)
    new = replace(trajectory, positions=positions, com=com, com_velocity=velocity, phase=("mpm",) * len(com))
    return stated(run, trajectory=replace(new, **parts), **({} if touched else {"contact": None}))


def away(frames: int) -> np.ndarray:
    """A skin that is nowhere near."""
    return np.full((frames, 40, 3), 50.0, np.float32) + np.random.default_rng(0).random((40, 3), np.float32)


# --- contact ---------------------------------------------------------------------------------------------------------


def test_contact_metrics(demo):
    made, push = record(demo), demo.state.contact.push
    assert METRICS["v_in"](made) == push.v_in
    assert METRICS["contact_expected"](made) == 1 and METRICS["contact_any"](made) == 1
    assert np.isnan(METRICS["v_post"](made))
    report = StageReport("resimulate", 1.0, numbers={"v_post_error": 0.013})
    assert METRICS["v_post"](record(replace(demo, reports=(report,)))) == 0.013
    assert METRICS["timing"](made) == pytest.approx(0.5 / 20)


def test_gap_and_share_of_a_known_skin(demo):
    """Four points of the striking foot: on the ball's surface, 5 mm in, 5 mm out, 3 cm out; another joint's, in."""
    push, trajectory = demo.state.contact.push, demo.state.trajectory
    centre = object_at(trajectory, push, 20.0, push.frame).mean(axis=0)
    out = np.array([0.6, 0.0, 0.8])
    heights = np.array([0.0, -0.005, 0.005, 0.03, -0.01])
    skin = np.tile((centre + (BALL_RADIUS + heights)[:, None] * out).astype(np.float32), (5, 1, 1))
    joints = np.array([push.joint] * 4 + [3])
    made = record(demo, skin=skin, skin_joints=joints)
    assert METRICS["gap"](made) == 0
    assert METRICS["touching"](made) == 0.75
    lifted = record(demo, skin=skin + np.float32(0.02) * out.astype(np.float32), skin_joints=joints)
    assert METRICS["gap"](lifted) == pytest.approx(0.015, abs=0.002)


def test_nothing_touched_has_empty_cells(demo):
    missed = record(stated(demo, contact=None), skin=away(5), skin_joints=np.zeros(40, int))
    assert METRICS["contact_any"](missed) == 0 and METRICS["contact_expected"](missed) == 0
    for metric in (METRICS["v_in"], METRICS["touching"], METRICS["v_post_formula"], METRICS["momentum"]):
        assert np.isnan(metric(missed))
    centre = demo.state.trajectory.com[0]
    assert METRICS["gap"](missed) == pytest.approx(np.linalg.norm(50 - centre), abs=1)


def test_v_post_against_the_formula(demo):
    push = demo.state.contact.push
    v_in = float((push.v_human - push.v_object) @ push.normal)
    formula = push.v_object + 1.8 * v_in * push.normal  # the demo's ball has e = 0.8

    def given(v_post):
        search = replace(demo.state.contact, contacts=(replace(push, v_in=v_in, v_post=v_post),))
        return record(stated(demo, contact=search))

    assert METRICS["v_post_formula"](given(formula)) < 1e-12
    assert METRICS["v_post_formula"](given(1.1 * formula)) == pytest.approx(0.1)


def test_momentum_given_is_momentum_taken(demo):
    """The demo's ball is at rest at frame 1 and flies from 1.5 on: gravity has half of the time that is taken off."""
    made, push = record(demo), demo.state.contact.push
    expected = G * 0.025 / np.linalg.norm(push.v_post)
    assert METRICS["momentum"](made) == pytest.approx(expected, rel=1e-3)
    half = replace(demo.state.contact, contacts=(replace(push, impulse=0.5 * push.impulse),))
    assert METRICS["momentum"](record(stated(demo, contact=half))) == pytest.approx(1, abs=0.1)


# --- penetration -----------------------------------------------------------------------------------------------------


def test_penetration_of_a_known_depth(demo):
    centre, out = demo.state.trajectory.com[0], np.array([0.0, -0.6, 0.8])
    skin = np.full((5, 2, 3), 50.0, np.float32)
    skin[0] = centre + np.outer([BALL_RADIUS - 0.03, BALL_RADIUS + 0.03], out)
    assert METRICS["depth"](record(demo, skin=skin, skin_joints=np.array([11, 11]))) == pytest.approx(0.03, abs=0.003)
    skin[0, 0] = 50
    assert METRICS["depth"](record(demo, skin=skin, skin_joints=np.array([11, 11]))) == 0


def test_object_between_frames_jumps_at_the_impulse(demo):
    push, trajectory = demo.state.contact.push, demo.state.trajectory
    com = [object_at(trajectory, push, demo.scene.fps, frame).mean(axis=0) for frame in (1.0, 1.4, 1.6, 2.0)]
    np.testing.assert_allclose(com[1] - com[0], 0, atol=1e-6)
    np.testing.assert_allclose(com[3] - com[2], 0.4 / demo.scene.fps * trajectory.com_velocity[2], atol=1e-5)


def test_hull_of_a_cube():
    corners = np.stack(np.meshgrid(*[[-0.1, 0.1]] * 3), -1).reshape(-1, 3)
    points = np.concatenate([corners, np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))])
    hull = hull_of(3, points)
    assert hull is not None
    assert len(hull.lattice(0.02)) * 0.02**3 == pytest.approx(0.2**3)
    assert hull.contains(np.array([[0.099, 0, 0], [0.101, 0, 0], [0.0, 0.0, -0.0999]])).tolist() == [True, False, True]
    assert hull_of(3, points[:4]) is None and hull_of(3, points * (1, 1, 0)) is None


def test_volume_of_a_leg_in_the_ball(long):
    """The whole ball moved into the thigh for four frames: the share of it that is in the thigh's hull."""
    joints = record(long).joints
    thigh = 0.5 * (joints[:, 2] + joints[:, 5])
    com = np.tile(np.array([0.0, 30.0, 1.0]), (24, 1))
    com[4:8] = thigh[4:8]
    inside = record(moving(long, com, 0 * com))
    volume = METRICS["volume"](inside)
    ball = 4 / 3 * np.pi * BALL_RADIUS**3 * 1e3
    assert 0.1 * ball * 4 / 24 < volume < 0.9 * ball * 4 / 24
    assert METRICS["volume"](record(moving(long, com + np.array([0, 30, 0]), 0 * com))) == 0


def test_object_below_the_ground(demo):
    frames = len(demo.state.trajectory.com)
    com = np.tile([0.0, 5.0, 0.0], (frames, 1))
    com[:, 2] = -demo.scene.object.particles[:, 2].min() + demo.scene.object.particles.mean(axis=0)[2]
    standing = record(moving(demo, com, 0 * com))
    assert METRICS["object_ground_depth"](standing) == pytest.approx(0, abs=1e-6)
    com[2, 2] -= 0.013
    assert METRICS["object_ground_depth"](record(moving(demo, com, 0 * com))) == pytest.approx(0.013, abs=1e-6)
    com[:, 2] = -1
    litres = 1e3 * demo.scene.object.volumes.sum()
    assert METRICS["object_ground_volume"](record(moving(demo, com, 0 * com))) == pytest.approx(litres, rel=1e-5)


def test_feet_below_the_ground():
    demo, *_ = make_run(points=4000)
    lowest = record(demo).skin[:, np.isin(record(demo).skin_joints, (7, 8, 10, 11)), 2].min()
    down = demo.state.motion.translation - np.float32([0, 0, lowest + 0.02])
    sunk = record(stated(demo, motion=replace(demo.state.motion, translation=down)))
    assert METRICS["feet_depth"](sunk) == pytest.approx(0.02, abs=1e-5)
    deep = replace(demo.state.motion, translation=down - np.float32([0, 0, 5]))
    hulls = [hull_of(j, demo.scene.body.cloud.means[record(demo).skin_joints == j]) for j in (7, 8, 10, 11)]
    litres = 1e3 * sum(len(hull.lattice(0.004)) for hull in hulls if hull is not None) * 0.004**3
    assert METRICS["feet_volume"](record(stated(demo, motion=deep))) == pytest.approx(litres, rel=0.05)
    assert 0 < METRICS["feet_volume"](sunk) < 0.5 * litres


# --- the object ------------------------------------------------------------------------------------------------------


def flight(frames: int, start, velocity, gravity: float = G) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(frames)[:, None] / 20
    down = np.array([0, 0, -gravity])
    return np.array(start) + np.array(velocity) * time + 0.5 * down * time**2, np.array(velocity) + down * time


def test_ballistic_residual_of_a_line_and_of_a_parabola(long):
    parabola = record(moving(long, *flight(24, (0, 9, 3), (1, 2, 3))), skin=away(24))
    assert METRICS["ballistic"](parabola) < 1e-6
    line = record(moving(long, *flight(24, (0, 9, 3), (1, 2, 0.1), 0)), skin=away(24))
    # What a straight line leaves of k^2, k = 0 .. n-1: sqrt((n^2 - 1)(n^2 - 4) / 180).
    expected = 0.5 * G / 400 * np.sqrt((24**2 - 1) * (24**2 - 4) / 180)
    assert METRICS["ballistic"](line) == pytest.approx(expected, rel=1e-6)
    grounded = record(moving(long, *flight(24, (0, 9, BALL_RADIUS), (0, 0, 0), 0)), skin=away(24))
    assert np.isnan(METRICS["ballistic"](grounded))


def test_a_bounce_ends_a_flight(long):
    """Down from 1.5 m and up again with the same speed, the bounce between two frames."""
    run = replace(long, scene=replace(long.scene, object=replace(long.scene.object, velocity=np.array([1.0, 0, 0]))))
    time = np.arange(24) / 20
    fall = np.sqrt(2 * (1.5 - BALL_RADIUS) / G)
    since = (time + fall) % (2 * fall) - fall  # 0 at the top
    com = np.stack([time, 9 + 0 * time, 1.5 - 0.5 * G * since**2], -1)
    velocity = np.stack([1 + 0 * time, 0 * time, -G * since], -1)
    made = record(moving(run, com, velocity), skin=away(24))
    assert METRICS["ballistic"](made) < 1e-6
    assert METRICS["ghosting"](made) < 1e-6


def test_bend_of_an_arc_and_of_a_line(long):
    after = 9
    time = np.maximum(np.arange(24) - after, 0)[:, None] / 20
    line = np.array([0, 9, 3.0]) + np.array([1.0, 2, 0.5]) * time
    assert METRICS["bend"](record(moving(long, line, 0 * line, touched=True))) < 1e-6
    arc = line * (1, 1, 0) + [0, 0, 3]
    arc[:, 2] += (time * (time[-1] - time))[:, 0]
    height, length = (time[-1] ** 2 / 4).item(), np.linalg.norm(arc[-1] - arc[after])
    made = METRICS["bend"](record(moving(long, arc, 0 * arc, touched=True)))
    assert made == pytest.approx(height / length, rel=0.02)  # its top is between two frames


@pytest.mark.parametrize("frames", [3, 10])
def test_ghosting_of_an_object_that_goes_by_itself(long, frames):
    """On the ground, at rest, then at 2 m/s for some frames, with nobody near."""
    com = np.tile([0.0, 9.0, BALL_RADIUS], (24, 1))
    rest = record(moving(long, com, 0 * com), skin=away(24))
    assert METRICS["ghosting"](rest) == 0 and METRICS["causality"](rest) == 0
    com[:, 0] = 0.1 * np.maximum(np.arange(24) - (23 - frames), 0)
    gone = record(moving(long, com, 0 * com), skin=away(24))
    assert METRICS["ghosting"](gone) == pytest.approx(0.1 * frames)
    assert METRICS["causality"](gone) == pytest.approx(2.0)


def test_ghosting_of_an_object_that_hangs_in_the_air(long):
    com = np.tile([0.0, 9.0, 20.0], (24, 1))
    time = 23 / 20
    expected = 0.5 * G * time**2
    assert METRICS["ghosting"](record(moving(long, com, 0 * com), skin=away(24))) == pytest.approx(expected)


def test_the_ground_slows_and_stops_but_does_not_drive(long):
    run = replace(long, scene=replace(long.scene, object=replace(long.scene.object, velocity=np.array([2.0, 0, 0]))))
    time = np.arange(24) / 20
    slowing = np.where(time < 0.5, 2 * time - 2 * time**2, 0.5)
    com = np.stack([slowing, 9 + 0 * time, BALL_RADIUS + 0 * time], -1)
    assert METRICS["ghosting"](record(moving(run, com, 0 * com), skin=away(24))) < 1e-9


def test_a_limb_that_passes_through_is_a_cause_without_effect(demo):
    """The foot enters the resting ball at 4 m/s: the ball stays (w/o Contact), or goes."""
    com = np.tile(demo.state.trajectory.com[0], (5, 1))
    joints = np.zeros((5, 24, 3))
    joints[:, 11] = com[0] + [0, -0.5, 0] + np.outer(np.arange(5), [0, 0.2, 0])
    skin = (joints[:, [11, 11, 11]] + np.array([[0, 0.01, 0], [0, 0, 0], [0, 0, 0.01]])).astype(np.float32)
    given = {"skin": skin, "joints": joints, "skin_joints": np.array([11, 11, 11])}
    stays = record(moving(demo, com, 0 * com), **given)
    assert METRICS["contact_expected"](stays) == 1 and METRICS["contact_any"](stays) == 1
    assert METRICS["causality"](stays) == pytest.approx(4.0, rel=1e-3)
    gone = com.copy()
    gone[2:, 1] += 0.2 * np.arange(3)
    speed = np.zeros((5, 3))
    speed[2:, 1] = 4
    assert METRICS["causality"](record(moving(demo, gone, speed), **given)) < 0.1


def test_energy_from_nowhere(long):
    """A push of 1 J of work, then 10 J kinetic that grow by 2 J."""
    push, mass = long.state.contact.push, float(long.scene.object.masses.sum())
    energy = np.zeros((24, 3))
    energy[9:, 0] = 10
    run = stated(long, trajectory=replace(long.state.trajectory, energy=energy))
    speed = np.sqrt(2 * 10 / mass)
    search = replace(long.state.contact, contacts=(replace(push, v_post=np.array([0, speed, 0])),))
    assert METRICS["energy_gain"](record(stated(run, contact=search))) == pytest.approx(0, abs=1e-9)
    weak = replace(long.state.contact, contacts=(replace(push, v_post=np.array([0, speed / np.sqrt(10), 0])),))
    assert METRICS["energy_gain"](record(stated(run, contact=weak))) == pytest.approx(0.9)
    energy[15:, 1] = 2
    assert METRICS["energy_gain"](record(stated(run, contact=search))) == pytest.approx(0.2)


def test_deformation_is_the_largest_stretch_after_contact(long):
    gradient = np.tile(np.eye(3, dtype=np.float32), (24, 500, 1, 1))
    gradient[:8] = 3  # before contact, nobody asks
    turned = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    gradient[10] = turned @ np.diag([1.3, 0.9, 1.0])
    made = moving(long, long.state.trajectory.com, long.state.trajectory.com_velocity, touched=True)
    trajectory = replace(made.state.trajectory, deformation_gradient=gradient)
    assert METRICS["deformation"](record(stated(made, trajectory=trajectory))) == pytest.approx(0.3, abs=1e-5)
    none = replace(trajectory, deformation_gradient=None)
    assert METRICS["deformation"](record(stated(made, trajectory=none))) == 0
    assert np.isnan(METRICS["deformation"](record(stated(made, trajectory=none, contact=None))))


def test_object_path_of_a_square(long):
    com = np.concatenate([[(0, 0, 5), (1, 0, 5), (1, 1, 5), (0, 1, 5)], np.tile([0, 0, 5], (20, 1))]).astype(float)
    assert METRICS["object_path"](record(moving(long, com, 0 * com))) == pytest.approx(4)


def test_a_shape_that_only_moves_is_made_once(demo):
    thing, rng = demo.scene.object, np.random.default_rng(0)
    angle, offset = 0.7, np.array([1.0, -2, 0.5])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    found = rigid_motion(thing.particles, thing.particles @ turn.T + offset)
    np.testing.assert_allclose(found[0], turn, atol=1e-6)
    np.testing.assert_allclose(found[1], offset, atol=1e-5)
    points = thing.particles.mean(axis=0) + rng.normal(0, 0.08, (40, 3))
    shape = Shape(thing)
    first, surface = shape.distance(thing.particles, points), shape._surface
    moved = shape.distance(thing.particles @ turn.T + offset, points @ turn.T + offset)
    assert shape._surface is surface
    np.testing.assert_allclose(moved, first, atol=1e-5)
    flat = thing.particles * (1, 1, 0.8)
    np.testing.assert_allclose(shape.distance(flat, points), Shape(thing).distance(flat, points), atol=2e-3)
    assert shape._surface is surface and np.abs(shape.distance(flat, points) - first).max() > 5e-3


def test_a_fast_limb_is_seen_between_frames(demo):
    """It crosses the ball within one frame."""
    com = demo.state.trajectory.com[0]
    skin = np.full((5, 1, 3), 50, np.float32)
    skin[2:, 0] = com + np.array([0, 0.5, 0])
    skin[:2, 0] = com - np.array([0, 0.5, 0])
    still = moving(demo, np.tile(com, (5, 1)), np.zeros((5, 3)))
    met = meeting(record(still, skin=skin, skin_joints=np.array([11])))
    assert met is not None and met.first is not None and 1 < met.frames[met.first] < 2
    assert met.depth.max() > 0.08


# --- the person ------------------------------------------------------------------------------------------------------


def test_skating_and_jerk_are_those_of_the_motion_report():
    rng = np.random.default_rng(0)
    joints = rng.normal(0, 0.05, (30, 24, 3)).cumsum(axis=0)
    expected = measures.skating(torch.from_numpy(joints), 20.0)
    heights = np.full(2, measures.STANDING_HEIGHT)
    assert skating(joints[:, [10, 11]], heights, 20.0) == pytest.approx(float(expected))
    assert np.isnan(skating(joints[:, [10, 11]] + 9, heights, 20.0))


def test_jerk_of_a_cubic(long):
    time = np.arange(24)[:, None, None] / 20
    cubic = np.array([1.0, 2.0, 2.0]) * time**3 * np.ones((24, 1))
    assert METRICS["jerk"](record(long, joints=cubic)) == pytest.approx(6 * 3)


def test_foot_skating_of_a_person_who_slides(long):
    still = replace(long.state.motion, body_pose=np.zeros((24, 23, 3), np.float32))
    slide = np.stack([0.03 * np.arange(24), 0 * np.arange(24), np.full(24, 0.97)], -1).astype(np.float32)
    assert METRICS["skating"](record(stated(long, motion=replace(still, translation=slide)))) == pytest.approx(0.6)


def test_joint_limits():
    pose = np.zeros((2, 23, 3))
    left_knee, hip = JOINT_NAMES.index("left_knee") - 1, JOINT_NAMES.index("right_hip") - 1
    assert not beyond_limits(pose).any()
    pose[0, left_knee, 0], pose[0, hip, 0] = np.radians(150), np.radians(-100)
    assert not beyond_limits(pose).any()
    pose[0, left_knee, 0] = np.radians(-20)
    pose[1, hip, 1] = np.radians(140)
    assert np.argwhere(beyond_limits(pose)).tolist() == [[0, left_knee], [1, hip]]
    pose[1, hip, 1] = np.radians(340)
    assert not beyond_limits(pose)[1].any()


def test_judge_is_the_one_of_torch(long):
    """Features to 1e-5, embeddings and both scores to 1e-4."""
    motion, body = long.state.motion, long.scene.body
    known, shipped = evaluator.judge(), load_evaluator()
    rest = known.rest_joints
    ratio = evaluator.leg_length(rest) / evaluator.leg_length(body.rest_joints)
    parts = [torch.from_numpy(p).double() for p in (motion.translation * ratio, motion.orientation, motion.body_pose)]
    expected = torch_features.encode(*parts, torch.from_numpy(rest))
    found = encode(local_rotations(motion), np.float64(motion.translation) * ratio, rest)
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-5)
    embedding = shipped.embed_motion(expected[None])
    np.testing.assert_allclose(known.embed_motion(found), embedding[0].numpy(), atol=1e-4)
    prompt = scene_prompts()[0]
    made = record(replace(long, scene=replace(long.scene, motion_prompt=prompt)))
    assert METRICS["naturalness"](made) == pytest.approx(float(shipped.strangeness(expected[None])), abs=1e-4)
    likeness = float(embedding[0] @ shipped.embed_text([prompt])[0])
    assert METRICS["alignment"](made) == pytest.approx(likeness, abs=1e-4)


def test_judge_knows_its_frame_rate_alone(long):
    fast = record(stated(long, motion=replace(long.state.motion, fps=30.0)))
    assert np.isnan(METRICS["naturalness"](fast)) and np.isnan(METRICS["alignment"](fast))


def test_shipped_prompts_are_all_there_and_right():
    shipped = evaluator.shipped_prompts()
    assert sorted(shipped) == scene_prompts(), "run python -m analysis.metrics.prompts"
    sentences = sorted(shipped)
    expected = minilm(default_cache()).embed(sentences).numpy()
    np.testing.assert_allclose(np.stack([shipped[s] for s in sentences]), expected, atol=1e-5)


def test_other_prompts_come_from_the_cache_or_the_encoder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    row = torch.arange(384) / 384
    calls = []
    monkeypatch.setattr(evaluator, "_computed", lambda sentence: calls.append(sentence))
    evaluator.sentence_embedding.cache_clear()
    encoder = minilm(tmp_path / "hoi" / "text")
    file = encoder._file("a person juggles")
    file.parent.mkdir(parents=True)
    save_file({"embedding": row}, file, {"sentence": "a person juggles"})
    np.testing.assert_array_equal(evaluator.sentence_embedding("a person juggles"), row.numpy())
    assert evaluator.sentence_embedding("a person dances") is None and calls == ["a person dances"]
    evaluator.sentence_embedding.cache_clear()


# --- cost, and the whole ---------------------------------------------------------------------------------------------


def test_cost(long):
    reports = (StageReport("free motion", 2.0, numbers={"steps_left_out": 200.0}), StageReport("motion", 3.0))
    reports = (*reports, StageReport("resimulate", 4.0, numbers={"steps": 50.0, "steps_left_out": 150.0}))
    result = long.result | {"peak_memory_mb": "512.5"}
    made = record(replace(long, reports=reports, result=result))
    assert METRICS["seconds"](made) == 1.25 and METRICS["memory"](made) == 512.5
    assert METRICS["seconds_motion"](made) == 3.0
    assert np.isnan(METRICS["seconds_refine"](made))
    assert METRICS["left_out"](made) == 350 / 400
    assert METRICS["left_out"](record(replace(made.run, reports=reports[:1]))) == 1  # never simulated
    assert np.isnan(METRICS["left_out"](record(replace(made.run, reports=reports[1:2]))))  # without the MPM


@pytest.mark.parametrize("lacks", ["scene", "motion", "trajectory", "contact", "target"])
def test_what_a_record_lacks_is_nan_and_no_error(demo, lacks):
    made = replace(demo, scene=None, state=type(demo.state)()) if lacks == "scene" else stated(demo, **{lacks: None})
    shown = {"points": record(demo).skin} if lacks != "scene" else {"skin": None}
    values = {key: metric(record(made, **shown)) for key, metric in METRICS.items()}
    assert all(isinstance(value, float) for value in values.values())
    if lacks in ("scene", "trajectory"):
        assert np.isnan(values["depth"]) and np.isnan(values["ballistic"]) and np.isnan(values["ghosting"])
    if lacks == "motion":
        assert np.isnan(values["naturalness"]) and np.isnan(values["skating"]) and not np.isnan(values["depth"])


def test_every_metric_is_documented():
    for key, metric in METRICS.items():
        assert metric.key == key and metric.better in ("lower", "higher", "") and metric.unit
        assert len(metric.definition) > 20, key
    assert len({metric.heading for metric in METRICS.values()}) == len(METRICS)


def test_docs_say_what_the_registry_says():
    done = subprocess.run([sys.executable, "-m", "analysis.metrics"], capture_output=True, text=True, check=True)
    assert done.stdout in DOCS.read_text(encoding="utf-8"), "paste python -m analysis.metrics into docs/benchmark.md"
