"""Kinematic replay: which clip is nearest, where its strike goes, how the object moves; and one whole run."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies import ground
from demo_run import BALL_RADIUS, ball, kick, make_run, person

from analysis.baseline import run as baseline
from analysis.baseline.clips import Clip, clips_of, mirrored, nearest, shipped_clips, with_mirrored
from analysis.baseline.replay import carried_on, free_path, strike_at, strike_of
from analysis.metrics import DYNAMICS, METRICS
from analysis.records import load
from hoi import record
from hoi.body.kinematics import rotation_from_6d
from hoi.body.skeleton import JOINT_NAMES, LIMBS
from hoi.body.skinning import joint_paths
from hoi.errors import InputError
from hoi.motion.text import TextEncoder
from hoi.training.motion import deepmimic
from hoi.training.motion.dataset import MIRRORED_JOINTS

WORDS = "kick punch run left right soccer a".split()


def encoder() -> TextEncoder:
    """A sentence is the words in it."""
    return TextEncoder(
        "words", "", lambda texts: torch.tensor([[float(w in text.split()) for w in WORDS] for text in texts])
    )


def clip(name: str, *captions: str) -> Clip:
    return Clip(name, captions, lambda body, fps: kick(40, fps, 20.0))


def scene(position=(0.0, 2.0, 1.0), velocity=(0.0, 0.0, 0.0), frames=40):
    base = make_run(frames=frames)[0].scene
    assert base is not None
    thing = ball(np.random.default_rng(0), 60, 100, np.array(position))
    return replace(base, frames=frames, object=replace(thing, velocity=np.array(velocity)), planes=(ground(),))


# ---- the clip


def test_the_nearest_caption_wins_and_the_first_of_equals():
    clips = [clip("a", "a run"), clip("b", "a punch", "kick soccer"), clip("c", "kick soccer")]
    chosen, caption, likeness = nearest("a kick soccer", clips, encoder())
    assert (chosen.name, caption) == ("b", "kick soccer")
    assert likeness == pytest.approx(2 / np.sqrt(6), abs=1e-6)


def test_a_named_side_is_kept():
    clips = with_mirrored([clip("a", "right kick"), clip("b", "a run")])
    assert [each.name for each in clips] == ["a", "b", "a (mirrored)"]
    assert nearest("left kick", clips, encoder())[0].name == "a (mirrored)"
    assert nearest("right kick", clips, encoder())[0].name == "a"
    with pytest.raises(InputError, match="all are of the other side"):
        nearest("left kick", clips[:1], encoder())


def test_a_mirrored_motion_has_mirrored_joints():
    body = person(np.random.default_rng(0), 200)
    motion = kick(12, 20.0, 6.0)
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ rotation_from_6d(torch.tensor(motion.orientation)).numpy()
    motion = replace(motion, orientation=turned[:, :2].reshape(-1, 6).astype(np.float32))  # facing -X
    expected = joint_paths(body, motion)[:, list(MIRRORED_JOINTS)] * [-1, 1, 1]
    np.testing.assert_allclose(joint_paths(body, mirrored(motion)), expected, atol=1e-5)


def test_clips_of_a_folder_are_captioned_by_file_or_by_name(tmp_path):
    for name in ("RightFrontKick_03.bvh", "b.npz", "notes.txt"):
        (tmp_path / name).write_text("")
    (tmp_path / "captions.json").write_text(json.dumps({"b.npz": ["a person punches"]}))
    found = {each.name: each.captions for each in clips_of(tmp_path)}
    assert found == {"RightFrontKick_03.bvh": ("right front kick",), "b.npz": ("a person punches",)}
    for text in ("{", "[]", '{"b.npz": "text"}', '{"b.npz": []}', '{"b.npz": [1]}'):
        (tmp_path / "captions.json").write_text(text)
        with pytest.raises(InputError, match=r"captions\.json"):
            clips_of(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.npz or \.bvh"):
        clips_of(tmp_path / "empty")
    with pytest.raises(InputError, match="no such folder"):
        clips_of(tmp_path / "missing")


def test_without_the_extra_one_line_says_so(monkeypatch):
    def missing():
        raise InputError("not installed")

    monkeypatch.setattr(deepmimic, "clip_folder", missing)
    with pytest.raises(InputError, match=r"pip install 'hoi\[train\]', or give --clips DIR"):
        shipped_clips()


def test_shipped_clips_strike_with_the_limb_of_their_caption():
    try:
        clips = shipped_clips()
    except InputError as error:
        pytest.skip(str(error))
    body = person(np.random.default_rng(0), 200)
    kicks = next(each for each in clips if each.name.endswith("_kick"))
    joints = joint_paths(body, kicks.load(body, 20.0))
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1).max(axis=0)
    assert speed[JOINT_NAMES.index("right_foot")] > 1.5 * speed[JOINT_NAMES.index("left_foot")]
    np.testing.assert_allclose(joints[0, 0, :2], 0, atol=1e-6)


# ---- the strike


def test_the_strike_is_the_fastest_step_at_the_height_of_the_object():
    joints = np.zeros((30, 24, 3))
    foot = LIMBS["right_foot"][1]
    joints[:, foot, 1] = np.cumsum(np.where(np.arange(30) == 12, 0.5, np.where(np.arange(30) == 8, 0.3, 0.01)))
    joints[:, foot, 2] = 0.05 * np.arange(30)  # 0.4 m and 0.6 m high after the two
    for height, frame in ((0.4, 7), (0.6, 11), (5.0, 11)):  # a ball that hangs there; out of reach, the fastest counts
        path = free_path(replace(scene((0, 2, height)), gravity=np.zeros(3)))
        found = strike_of(joints, LIMBS["right_foot"], path)
        assert (found.joint, found.frame) == (foot, frame)


def test_ends_are_held():
    motion = kick(10, 20.0, 5.0)
    moved = strike_at(motion, peak=4, frame=20, frames=40)
    assert len(moved) == 40
    np.testing.assert_array_equal(moved.body_pose[20], motion.body_pose[4])
    np.testing.assert_array_equal(moved.body_pose[:16], np.repeat(motion.body_pose[:1], 16, axis=0))
    np.testing.assert_array_equal(moved.translation[26:], np.repeat(motion.translation[-1:], 14, axis=0))


# ---- the object


def test_a_tossed_object_falls_freely_and_stays_on_the_ground():
    path = free_path(scene((0.0, 2.0, 1.0), (1.0, 0.0, 2.0)))
    time = np.arange(40)[:, None] / 20
    free = path.com[0] + [1.0, 0.0, 2.0] * time + [0, 0, -9.81 / 2] * time**2
    lowest = path.positions[0, :, 2].min() - path.com[0, 2]
    flying = np.array(path.phase) == "flight"
    assert 5 < flying.sum() < 40 and not flying[np.argmin(flying) :].any()
    np.testing.assert_allclose(path.com[flying], free[flying], atol=1e-9)
    np.testing.assert_allclose(path.com[:, 0], free[:, 0], atol=1e-9)
    assert (free[~flying, 2] + lowest < 1e-3).all()
    np.testing.assert_allclose(path.com[~flying, 2] + lowest, 0, atol=1e-6)
    np.testing.assert_allclose(path.com_velocity[flying][:, 2], 2.0 - 9.81 * time[flying, 0], atol=1e-9)
    assert set(np.array(path.phase)[~flying]) == {"constant_velocity"}


def test_an_object_at_rest_rests_and_a_rolling_one_rolls():
    at_rest = free_path(scene((0, 2, BALL_RADIUS)))
    lowest = at_rest.positions[0, :, 2].min()
    assert lowest < 2e-3  # of its few points
    still = free_path(scene((0, 2, BALL_RADIUS - float(lowest))))
    assert set(still.phase) == {"rest"} and not np.ptp(still.com, axis=0).any()
    rolling = free_path(scene((0, 2, BALL_RADIUS - float(lowest)), (0, -1.5, 0)))
    assert set(rolling.phase) == {"constant_velocity"}
    np.testing.assert_allclose(rolling.com[-1] - rolling.com[0], [0, -1.5 * 39 / 20, 0], atol=1e-6)


def test_from_contact_on_the_object_keeps_the_limbs_velocity():
    run = make_run(frames=40)[0]
    assert run.state.contact is not None and run.state.contact.push is not None
    push = replace(run.state.contact.push, frame=10.4, v_human=np.array([1.0, 4.0, -2.0]))
    where = replace(scene((0, 2, BALL_RADIUS)), gravity=np.zeros(3))
    free = free_path(where)
    moved = carried_on(where, free, push)
    np.testing.assert_array_equal(moved.positions[:11], free.positions[:11])
    since = (np.arange(11, 40) - 10.4)[:, None] / 20
    np.testing.assert_allclose(moved.com[11:] - moved.com[0], [1.0, 4.0, -2.0] * since, atol=1e-9)
    np.testing.assert_allclose(moved.com_velocity[11:], np.tile([1.0, 4.0, -2.0], (29, 1)))
    assert moved.deformation_gradient is None and set(moved.phase[11:]) == {"constant_velocity"}
    np.testing.assert_allclose(moved.positions - moved.com[:, None], free.positions - free.com[:, None], atol=1e-6)


# ---- a whole run


@pytest.fixture
def clips(tmp_path, monkeypatch):
    """A folder with one motion file, a kick."""
    body, motion = person(np.random.default_rng(0), 200), kick(40, 20.0, 20.0)
    root = rotation_from_6d(torch.tensor(motion.orientation, dtype=torch.float64))
    import roma

    poses = np.concatenate([roma.rotmat_to_rotvec(root).numpy()[:, None], motion.body_pose], axis=1)
    (tmp_path / "clips").mkdir()
    np.savez(
        tmp_path / "clips" / "a_right_kick.npz",
        poses=poses.reshape(40, -1),
        trans=motion.translation,
        mocap_framerate=20.0,
        rest_joints=body.rest_joints,
    )
    monkeypatch.setattr(baseline, "minilm", lambda cache: encoder())
    return tmp_path / "clips"


def test_a_run_is_a_record_like_any_other(composed, clips, tmp_path, capsys):
    words = ["experiment=smoke", "scene=kick_soccer_ball", f"out={tmp_path / 'run'}", "seed=2"]
    path = baseline.execute(composed(*words), words, clips)
    run = record.read(path)
    facts = run.provenance | run.result
    assert (facts["scene"], facts["experiment"], facts["variant"]) == (
        "kick_soccer_ball",
        "baseline",
        "kinematic replay",
    )
    assert (facts["seed"], facts["status"], facts["clip"]) == ("2", "done", "a_right_kick.npz")
    state = run.state
    assert state.motion is not None and state.trajectory is not None and state.target is not None
    assert state.target.joint in LIMBS["right_foot"] and "a_right_kick.npz" in run.plan.steps[0].reason
    push = state.contact.push if state.contact else None
    assert push is not None and push.joint in LIMBS["right_foot"]  # a kick along the ground meets a ball on it
    after = int(push.frame) + 1
    np.testing.assert_allclose(state.trajectory.com_velocity[after:], np.tile(push.v_human, (40 - after, 1)), atol=1e-9)
    assert run.scene is not None
    np.testing.assert_allclose(push.impulse, run.scene.object.masses.sum() * push.v_human, rtol=1e-5)
    made = load(path)  # and what its motion takes is known as of any other
    dynamics = {key: metric(made) for key, metric in METRICS.items() if metric.group == DYNAMICS}
    assert len(dynamics) == 8 and np.isfinite(list(dynamics.values())).all()
    assert dynamics["momentum_gap"] > 0.5 * np.linalg.norm(push.impulse)  # nobody takes the ball's momentum back
    assert baseline.execute(composed(*words), words, clips) == path
    assert "already computed" in capsys.readouterr().out
    with pytest.raises(InputError, match="another config"):
        other = [*words, "scene.placement.yaw=0.1"]
        baseline.execute(composed(*other), other, clips)


def test_ablations_of_the_baseline_are_refused(composed, clips):
    with pytest.raises(InputError, match=r"ablation=no_mpm: .*say ablation=full"):
        baseline.execute(composed("ablation=no_mpm"), [], clips)
