"""`python -m hoi.importers.convert` makes folders that a run takes."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from hugs_files import Tiny
from smpl_files import make_model, pickle_model

from hoi.body.avatar import load_avatar
from hoi.config import HumanKind
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.importers.convert import main, read_betas
from hoi.importers.smpl import load_smpl
from hoi.runner.scene import load_body


@pytest.fixture
def smpl(tmp_path):
    return pickle_model(tmp_path / "SMPL_FEMALE.pkl", make_model())


def convert(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["convert", *map(str, arguments)])
    return main()


def test_smpl_to_a_folder_that_a_run_takes(smpl, tmp_path, monkeypatch, capsys, composed):
    folder = tmp_path / "made" / "ann"
    options = ("--betas=-0.5,1", "--gaussians", 300, "--outfit", "woman", "--seed", 3)
    assert convert(monkeypatch, "--smpl", smpl, *options, "-o", folder) == 0
    printed = capsys.readouterr().out
    assert "300 Gaussians" in printed and "with pose blend shapes" in printed and "non-commercial" in printed
    assert sorted(file.name for file in folder.iterdir()) == ["gaussians.ply", "skinning.npz"]
    config = to_config(composed("human=avatar", f"human.path={folder}"))
    assert config.human.kind is HumanKind.avatar
    body, expected = load_body(config.human, 0), load_smpl(smpl, [-0.5, 1.0], 300, 3, "woman")
    np.testing.assert_allclose(body.cloud.means, expected.cloud.means, atol=1e-6)
    np.testing.assert_array_equal(body.pose_directions, expected.pose_directions)
    assert body.name == "ann" and body.source == expected.source

    assert convert(monkeypatch, "--smpl", smpl, "--gaussians", 300, "--no-pose-correctives", "-o", folder) == 0
    assert "without pose blend shapes" in capsys.readouterr().out
    assert load_avatar(folder / "gaussians.ply").pose_directions is None


def test_hugs_to_a_folder(smpl, tmp_path, monkeypatch, capsys):
    checkpoint, video = tmp_path / "human_final.pth", tmp_path / "smpl_optimized_aligned_scale.npz"
    torch.save(Tiny().checkpoint(), checkpoint)
    np.savez(video, betas=np.tile(np.linspace(-0.3, 0.3, 10), (5, 1)), scale=np.ones(5))
    folder = tmp_path / "person"
    given = ("--smpl", smpl, "--hugs", checkpoint, "-o", folder)
    assert convert(monkeypatch, *given, "--betas", video) == 0
    assert "HUGS, human_final.pth, betas [-0.3" in capsys.readouterr().out
    assert len(load_avatar(folder).cloud) == 60
    assert convert(monkeypatch, *given) == 2
    assert "--hugs needs --betas" in capsys.readouterr().err
    assert convert(monkeypatch, *given, "--betas=0", "--outfit", "man") == 2
    assert "--outfit is for SMPL bodies" in capsys.readouterr().err


def test_betas_from_text_and_files(tmp_path):
    assert read_betas("0.5,-1") == read_betas("[0.5, -1]") == [0.5, -1.0]
    np.savez(tmp_path / "one.npz", betas=np.array([1.0, 2.0]))
    assert read_betas(str(tmp_path / "one.npz")) == [1.0, 2.0]
    np.savez(tmp_path / "none.npz", poses=np.zeros(3))
    for text, message in (
        ("tall", "--betas must be numbers"),
        ("", "--betas must be numbers"),
        ("nan", "--betas must be finite"),
        (str(tmp_path / "none.npz"), "betas: missing"),
        (str(tmp_path / "gone.npz"), "cannot be read"),
    ):
        with pytest.raises(InputError, match=message):
            read_betas(text)


def test_bad_input_is_one_line_and_exit_code_2(smpl, tmp_path):
    (tmp_path / "file").write_text("in the way")
    for arguments, words in (
        (["--smpl", "gone.npz", "-o", "out"], "gone.npz: cannot be read"),
        (["--smpl", str(smpl), "--betas=1e9", "-o", "out"], "m tall"),
        (["--smpl", str(smpl), "--gaussians", "300", "-o", "file/out"], "-o: cannot write"),
        (["--smpl", str(smpl), "--seed", "-1", "-o", "out"], "--seed must be 0 or more"),
    ):
        command = [sys.executable, "-m", "hoi.importers.convert", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
        assert done.returncode == 2 and words in done.stderr, done.stderr
        assert len(done.stderr.splitlines()) == 1
        assert not (tmp_path / "out").exists()
