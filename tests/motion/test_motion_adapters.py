"""The published prior from the files its users have, with random weights; and motions drawn from a sentence."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib import pyplot as plt

from analysis import strip
from hoi import record
from hoi.body.people import load_person
from hoi.body.skinning import joint_paths, posed_means
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.importers.motions import read_motion
from hoi.motion.prior import load_prior
from hoi.plan import make_plan
from hoi.render.replay import replay
from hoi.reports import Stages
from hoi.runner import sample
from hoi.runner.scene import build_scene
from hoi.stages.motion.hmsd import HMSD
from tests.stmc_files import published_layout, write_stmc


@pytest.fixture(scope="module")
def stmc(tmp_path_factory):
    """A run folder as the published archive unpacks, with CLIP's text tower and SMPL's joints put into it."""
    folder = tmp_path_factory.mktemp("weights") / "mdm-smpl_clip_smplrifke_humanml3d"
    return folder, write_stmc(folder)


def test_published_checkpoint_loads_and_predicts(stmc, tmp_path, recwarn):
    folder, state = stmc
    prior = load_prior(folder, text_cache=tmp_path)
    assert not [warning for warning in recwarn if "prior" in str(warning.message)]
    loaded = {f"denoiser.{name}": value for name, value in prior.denoiser.state_dict().items()}
    assert {name: tuple(value.shape) for name, value in loaded.items()} == {
        name: shape for name, shape in published_layout().items() if name.startswith("denoiser.")
    }
    assert all(torch.equal(value, state[name]) for name, value in loaded.items())
    assert prior.denoiser.architecture.heads == 4 and prior.timesteps == 12
    np.testing.assert_array_equal(prior.rest_joints.numpy(), load_person("man", 100).rest_joints)

    text = prior.encode_text(["a person kicks", ""])
    assert text.shape == (2, 512) and not torch.allclose(text[0], text[1])
    raw = prior.text_encoder.embed(["a person kicks"])
    expected = (raw[0] - state["text_normalizer.mean"]) / (state["text_normalizer.std"] + 1e-12)
    torch.testing.assert_close(text[0], expected)
    x = torch.randn(1, 40, 205, generator=torch.Generator().manual_seed(1))
    first = prior.predict_x0(x, torch.tensor([5]), text[:1], 1.0)
    other = prior.predict_x0(x, torch.tensor([5]), text[1:], 1.0)
    assert first.shape == (1, 40, 205) and first.isfinite().all() and not torch.allclose(first, other)
    torch.testing.assert_close(prior.predict_x0(x, torch.tensor([5]), text[:1], 3.0), other + 3 * (first - other))


def test_clip_of_another_size_is_refused(stmc, tmp_path):
    folder, _ = stmc
    other = tmp_path / "clip"
    other.mkdir()
    for file in (folder / "clip").iterdir():
        (other / file.name).write_bytes(file.read_bytes())
    config = json.loads((other / "config.json").read_text()) | {"projection_dim": 768}
    (other / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="gives 768 numbers a sentence, the prior wants 512"):
        load_prior(folder, clip_folder=other)
    (other / "config.json").write_text("[]")
    with pytest.raises(InputError, match="cannot be read"):
        load_prior(folder, clip_folder=other)


@pytest.mark.parametrize("content", [np.zeros((22, 3)), np.full((24, 3), np.nan), np.array([{}])])
def test_broken_rest_joints_are_refused(stmc, content):
    folder, _ = stmc
    kept = (folder / "rest_joints.npy").read_bytes()
    np.save(folder / "rest_joints.npy", content, allow_pickle=True)
    try:
        with pytest.raises(InputError, match=r"rest_joints\.npy"):
            load_prior(folder)
    finally:
        (folder / "rest_joints.npy").write_bytes(kept)


def test_stage_1_takes_a_motion_file_as_it_is(composed, tmp_path, monkeypatch):
    """Without a prior where none is used."""
    path = tmp_path / "kick.npz"
    assert run(monkeypatch, "a person kicks", "-o", path, "--frames", 30) == 0
    own = ["stage/motion=file", f"stage.motion.path={path}", "stage.motion.start_time=0.25"]
    config = to_config(composed(*own, "stage.coordinate.lambda_hmsd=0", "human.gaussians=2000"))
    assert "motion_prior" not in make_plan(config).uses and isinstance(config.stage.motion, HMSD)
    scene = build_scene(config)
    with Stages().stage("motion", 0) as stage:
        (motion,) = config.stage.motion.motions(scene, None, [0], [stage])
    expected, _ = read_motion(path, scene.body, 40, 20.0, start_time=0.25)
    np.testing.assert_array_equal(motion.body_pose, expected.body_pose)
    np.testing.assert_array_equal(motion.translation, expected.translation)
    late = replace(config.stage.motion, start_time=9.0)
    with pytest.raises(
        InputError, match=r"^stage\.motion\.start_time must be in \[0, 1\.45\] s, which .* lasts, got 9$"
    ):
        late.motions(scene, None, [0], [stage])
    assert len(motion) == 40 and "kick.npz" in stage.notes[0] and "held for 15 of 40 frames" in stage.notes[0]


# --- python -m hoi.runner.sample --------------------------------------------------------------------------------------


def run(monkeypatch, *options) -> int:
    monkeypatch.setattr(sys, "argv", ["sample", *map(str, options)])
    return sample.main()


def test_sample_record_shows_the_motion_of_the_npz(stmc, tmp_path, monkeypatch):
    """The same motion in both files: on the prior's own skeleton, and on a smaller person who stands on the floor."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    common = ("a person kicks", "--prior", stmc[0], "--frames", 12, "--seed", 3)
    assert run(monkeypatch, *common, "-o", tmp_path / "m.npz") == 0
    assert run(monkeypatch, *common, "-o", tmp_path / "m.mcap", "--person", "child") == 0
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        poses, rest = file["poses"].reshape(12, 24, 3), file["rest_joints"]
        assert file["trans"].shape == (12, 3) and float(file["mocap_framerate"]) == 20
        bones = np.linalg.norm(file["joints"][:, 4] - file["joints"][:, 1], axis=-1)
        np.testing.assert_allclose(bones, np.linalg.norm(rest[4] - rest[1]), rtol=1e-5)
    shown = record.read(tmp_path / "m.mcap")
    motion = shown.state.motion
    assert shown.plan.variant == "sample" and shown.scene.body.name == "child" and shown.state.trajectory is None
    np.testing.assert_allclose(motion.body_pose, poses[:, 1:], atol=1e-5)
    assert shown.scene.motion_prompt == "a person kicks" and motion.fps == 20
    points, _ = record.posed_points(tmp_path / "m.mcap")
    assert points.shape == (12, 6000, 3)
    np.testing.assert_allclose(record.joints(tmp_path / "m.mcap"), joint_paths(shown.scene.body, motion), atol=1e-5)
    replayed = replay(shown)
    assert replayed.frames == 12 and len(replayed.parts(0)) == 1
    monkeypatch.setattr(strip, "PANEL_HEIGHT", 60)
    assert strip.main([str(tmp_path / "m.mcap"), "--frames", "2", "-o", str(tmp_path / "s.png")]) == 0
    assert plt.imread(tmp_path / "s.png")[..., :3].std() > 0.02


def test_sampled_kick_stands_on_the_ground_and_is_read_as_a_motion_file(tmp_path, monkeypatch):
    out = tmp_path / "kick.npz"
    assert run(monkeypatch, "a person kicks with the right foot", "-o", out) == 0
    assert run(monkeypatch, "a person kicks with the right foot", "-o", tmp_path / "kick.mcap") == 0
    shown = record.read(tmp_path / "kick.mcap")
    body, motion = shown.scene.body, shown.state.motion
    assert np.abs(posed_means(body, motion, frames=[0, 20])[..., 2].min(axis=1)).max() < 0.12
    read, _ = read_motion(out, body, 40, 20.0)
    np.testing.assert_allclose(read.body_pose, motion.body_pose, atol=1e-4)
    np.testing.assert_allclose(read.orientation, motion.orientation, atol=1e-4)
    # The one scales by the hips' height, too.
    np.testing.assert_allclose(read.translation, motion.translation, rtol=0.15, atol=0.08)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "m.bvh"], "--out m.bvh: must end in .npz or .mcap"),
        (["-o", "/none/m.npz", "--frames", "4"], "cannot write /none/m.npz"),
        (["-o", "/none/m.mcap", "--frames", "4"], "cannot write /none/m.mcap"),
        (["-o", "m.npz", "--frames", "2"], "--frames 2: must be at least 3"),
        (["-o", "m.npz", "--guidance", "nan", "--frames", "4"], "--guidance nan: the motion is not finite"),
        (["-o", "m.mcap", "--person", "bob"], "no such person"),
        (["-o", "m.npz", "--prior", "/none"], "/none does not exist"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "a person kicks", *options) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("sample: ") and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_help_says_what_it_writes():
    done = subprocess.run(
        [sys.executable, "-m", "hoi.runner.sample", "--help"], capture_output=True, text=True, check=True
    )
    assert ".mcap" in done.stdout
