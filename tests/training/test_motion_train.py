import argparse
import json
import math
from collections import Counter

import numpy as np
import pytest
import torch

from hoi.body.kinematics import joint_positions, rotation_to_6d
from hoi.errors import InputError
from hoi.motion.familiarity import read_captions
from hoi.motion.prior import load_prior
from hoi.runner import sample
from hoi.training import loop
from hoi.training.motion import dataset, deepmimic, train
from hoi.training.motion import training as trainings
from hoi.training.motion.dataset import FRAMES, PEAK_FRAMES, Clip, build_training_set, mirror, window_starts

REST = dataset.rest_joints_of(deepmimic.OFFSETS)


def make_clip(name: str = "a", label: str = "punch", frames: int = 60, strike: int | None = 25, side="left") -> Clip:
    """A standing person whose arm swings."""
    time = np.arange(frames) / 20
    poses = np.zeros((frames, 24, 3), np.float32)
    poses[:, 0] = [0, math.pi / math.sqrt(2), math.pi / math.sqrt(2)]  # upright, facing +Y
    poses[:, 16, 1] = np.sin(3 * time)
    poses[:, 4, 0] = 0.3
    translation = np.stack([0.1 * time, time, 0.9 + 0 * time], axis=-1).astype(np.float32)
    strikes = () if strike is None else (strike,)
    return Clip(name, label, side, (f"punches with the {side} hand",), strikes, False, poses, translation)


def joints_of(clip: Clip) -> torch.Tensor:
    poses = torch.from_numpy(clip.poses)
    root = rotation_to_6d(dataset.roma.rotvec_to_rotmat(poses[:, 0]))
    return joint_positions(torch.from_numpy(clip.translation), root, poses[:, 1:], REST)


def test_mirroring_is_a_mirror():
    clip = make_clip()
    mirrored = mirror(clip)
    expected = joints_of(clip)[:, list(dataset.MIRRORED_JOINTS)] * torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(joints_of(mirrored), expected, atol=1e-5, rtol=0)
    assert mirrored.side == "right" and mirrored.captions == ("punches with the right hand",)
    assert mirror(mirrored).captions == clip.captions and np.array_equal(mirror(mirrored).poses, clip.poses)


@pytest.mark.parametrize(("length", "peak"), [(80, 48), (54, 22), (40, 20), (27, 12), (22, 18), (120, 3), (41, 40)])
def test_every_window_of_a_strike_shows_it(length, peak):
    starts = window_starts(length, (peak,))
    assert starts
    forced = max(0, FRAMES - length)
    for start in starts:
        assert peak - start in PEAK_FRAMES
        overhang = max(0, -start) + max(0, start + FRAMES - length)
        assert overhang <= forced + 2 or len(starts) == 1


def test_windows_of_other_motion_stay_inside_where_they_can():
    assert window_starts(30, ()) == [0]
    assert window_starts(40, ()) == [0]
    starts = window_starts(97, ())
    assert starts[0] == 0 and starts[-1] == 57 and max(np.diff(starts)) <= 10


def test_short_clips_are_held_at_their_ends():
    poses, translation = dataset.cut(make_clip(frames=10), -3)
    assert poses.shape == (FRAMES, 24, 3)
    assert np.array_equal(poses[:4], np.repeat(poses[3:4], 4, 0)) and np.array_equal(translation[20], translation[12])


def test_strikes_are_drawn_most_and_keyframed_less():
    captured, drawn = make_clip("a"), dataset.replace(make_clip("b"), keyframed=True)
    walks = [make_clip(f"w{i}", "walk", strike=None, side="") for i in range(5)]
    weights = dict(zip("ab", dataset.clip_weights([captured, drawn, *walks]), strict=False))
    assert weights["a"] + weights["b"] == pytest.approx(dataset.STRIKE_SHARE) and weights["a"] == 2 * weights["b"]
    assert sum(dataset.clip_weights([captured, drawn, *walks])) == pytest.approx(1)


def test_training_set_holds_both_sides_with_their_captions():
    clips = [make_clip("a"), make_clip("w", "walk", 45, None, "")]
    clips[1] = dataset.replace(clips[1], captions=("walks",))
    data = build_training_set(clips, REST, {"punch/right": ["hits right"], "walk": ["strolls"]})
    assert data.captions[0] == "" and data.features.shape[1:] == (FRAMES, 205)
    assert float(data.weights.sum()) == pytest.approx(1)
    assert len(data.features) == sum(data.summary.values()) == len(data.caption_choices)
    described = [{data.captions[row] for row in rows} for rows in data.caption_choices]
    left = [i for i, texts in enumerate(described) if "punches with the left hand" in texts]
    right = [i for i, texts in enumerate(described) if "hits right" in texts]
    assert len(left) == len(right) and "a person punches with the right hand" in described[right[0]]
    assert not any("left" in text for i in right for text in described[i])
    speeds = data.features[:, :, 136:].unflatten(-1, (23, 3)).diff(dim=1).norm(dim=-1).amax(dim=1)
    assert (speeds[left][:, 21] > speeds[left][:, 22]).all() and (speeds[right][:, 22] > speeds[right][:, 21]).all()


def write_clips(folder, entries: list[dict], poses: np.ndarray, translation: np.ndarray) -> None:
    np.savez(
        folder / "clips.npz", poses=poses, trans=translation, meta=np.array(json.dumps(entries)),
        offsets=deepmimic.OFFSETS,
    )  # fmt: skip


def test_files_are_turned_to_face_plus_y_and_unfree_clips_left_out(tmp_path):
    poses = np.zeros((20, 24, 3), np.float16)
    poses[:, 0, 0] = math.pi / 2  # upright, facing -Y
    translation = np.linspace([0, 0, 0.9], [0.2, -1.0, 0.9], 20).astype(np.float32)
    entry = {"label": "walk", "side": "", "captions": ["walks"], "is_strike": False, "strikes": [], "length": 10}
    entries = [entry | {"name": "x:a", "start": 10}, entry | {"name": "cat:b", "start": 0}]
    write_clips(tmp_path, entries, poses, translation)
    (clip,) = dataset.read_clips(tmp_path / "clips.npz")
    np.testing.assert_allclose(clip.translation, translation[10:] * [-1, -1, 1])
    joints = joints_of(clip)
    assert (joints[:, 10, 1] > joints[:, 7, 1] + 0.1).all()  # toes ahead of the ankle, along +Y
    assert (joints[:, 1, 0] < joints[:, 2, 0]).all() and (joints[:, 15, 2] > joints[:, 0, 2]).all()


def write_deepmimic(path, frames: int = 12, hip: float = 0.0, elbow: float = 0.0, forward: float = 0.0) -> None:
    """An upright person; the right hip and the left elbow flex."""
    rows = np.zeros((frames, 44))
    rows[:, 0] = 1 / 30
    rows[:, 1], rows[:, 2] = forward * np.arange(frames) / 30, 0.9
    for column in (4, 8, 12, 16, 21, 25, 30, 35, 39):
        rows[:, column] = 1
    rows[:, 16], rows[:, 19] = math.cos(hip / 2), math.sin(hip / 2)
    rows[:, 43] = elbow
    path.write_text(json.dumps({"Loop": "none", "Frames": rows.tolist()}))


def test_deepmimic_motion_stands_and_moves_as_ours(tmp_path):
    path = tmp_path / "humanoid3d_kick.txt"
    write_deepmimic(path, hip=math.pi / 2, elbow=math.pi / 2, forward=1.0)
    (clip,) = deepmimic.read_clips(tmp_path)
    assert clip.label == "kick_side" and len(clip.strike_frames) == 1 and len(clip.poses) == 8
    pelvis, left_knee, right_hip, right_knee, left_shoulder, left_elbow, left_wrist = (
        joints_of(clip)[0, [0, 4, 2, 5, 16, 18, 20]].double().unbind()
    )
    torch.testing.assert_close(right_knee - right_hip, torch.tensor([0, 0.38, 0]).double(), atol=1e-4, rtol=0)
    assert left_knee[2] < pelvis[2] - 0.4 and left_knee[0] < 0 < right_knee[0]
    torch.testing.assert_close(left_elbow - left_shoulder, torch.tensor([0, 0, -0.26]).double(), atol=1e-4, rtol=0)
    torch.testing.assert_close(left_wrist - left_elbow, torch.tensor([0, 0.25, 0]).double(), atol=1e-4, rtol=0)
    speed = np.diff(clip.translation, axis=0) * 20
    np.testing.assert_allclose(speed, np.tile([0, 0.78 / 0.831416, 0], (7, 1)), atol=1e-4)
    assert float(joints_of(clip)[..., 2].min()) == pytest.approx(0, abs=1e-5)


def test_other_files_are_no_deepmimic_motion(tmp_path):
    path = tmp_path / "humanoid3d_walk.txt"
    for content in ("no json", '{"Frames": [[0, 1], [0, 2], [0, 3]]}', "{}"):
        path.write_text(content)
        with pytest.raises(InputError, match="DeepMimic"):
            deepmimic.read_clips(tmp_path)


def options(out, *more: str) -> argparse.Namespace:
    small = "--latent-dim 16 --layers 1 --ff-size 16 --heads 2 --batch 8 --warmup 2 --lr 0.01 --threads 1"
    return train.parser().parse_args([*small.split(), "--out", str(out), *more])


@pytest.fixture(scope="module")
def clip_data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    clip = make_clip()
    entry = {"name": "a", "label": "punch", "side": "left", "captions": ["punches"], "is_strike": True, "start": 0}
    entry |= {"strikes": [{"frame": 25}], "length": len(clip.poses)}
    write_clips(folder, [entry], clip.poses, clip.translation)
    return folder


def test_training_learns_resumes_and_publishes(tmp_path, clip_data):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    trainings.train(options(whole, "--data", str(clip_data), "--steps", "100"), "the command")
    log = [json.loads(line) for line in (whole / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in log] == [50, 100] and log[1]["loss"] < 0.9 * log[0]["loss"]
    captions = read_captions(whole)
    assert captions is not None and set(captions.kinds) == {"", *captions.windows}
    assert (whole / "curve.png").read_bytes()[1:4] == b"PNG"
    report = json.loads((whole / "training.json").read_text())
    assert report["steps"] == 100 and report["command"] == "the command" and list(report["data"]) == ["clips.npz"]
    prior = load_prior(whole)
    assert prior.sample("punches", FRAMES, 2.0, torch.Generator().manual_seed(0)).isfinite().all()

    # broken off at step 50 of the same schedule
    chosen = options(parts, "--data", str(clip_data), "--steps", "100")
    parts.mkdir()
    training = trainings.Training(trainings.read_data(chosen)[0], chosen)
    for _ in range(50):
        training.advance()
    loop.save_checkpoint(parts / "checkpoint.pt", training.state())
    trainings.train(options(parts, "--data", str(clip_data), "--steps", "100", "--resume"), "")
    for name, value in load_prior(parts).denoiser.state_dict().items():
        torch.testing.assert_close(value, prior.denoiser.state_dict()[name])

    target = tmp_path / "motion.npz"
    sample.sample(sample.parser().parse_args(["punches", "-o", str(target), "--prior", str(whole), "--frames", "12"]))
    with np.load(target, allow_pickle=False) as file:
        assert (
            file["poses"].shape == (12, 72) and file["trans"].shape == (12, 3) and file["joints"].shape == (12, 24, 3)
        )
        np.testing.assert_allclose(file["joints"][:, 0], file["trans"], atol=1e-6)
        assert file["mocap_framerate"] == 20 and np.array_equal(file["trans"][0, :2], [0, 0])


def test_windows_are_drawn_by_weight_and_some_without_text(clip_data, tmp_path):
    chosen = options(tmp_path, "--data", str(clip_data), "--batch", "4000", "--text-noise", "0")
    training = trainings.Training(trainings.read_data(chosen)[0], chosen)
    x0, noise, t, text = training.batch()
    empty = (text == training.text[0]).all(dim=-1).float().mean()
    assert float(empty) == pytest.approx(0.1, abs=0.02)
    assert x0.shape == noise.shape and Counter(t.tolist()).keys() == set(range(100))
    assert float(x0.mean()) == pytest.approx(0, abs=0.02)


def test_nothing_to_train_on_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="--data"):
        trainings.train(options(tmp_path), "")
    with pytest.raises(InputError, match="holds no"):
        trainings.train(options(tmp_path, "--data", str(tmp_path)), "")
    with pytest.raises(InputError, match="--resume"):
        trainings.train(options(tmp_path, "--resume"), "")
    with pytest.raises(InputError, match="--frames"):
        sample.sample(sample.parser().parse_args(["kick", "-o", str(tmp_path / "x.npz"), "--frames", "2"]))
