"""The study of what stage 2 does to motions, in its smallest form."""

import sys

import numpy as np
import pandas as pd
import pytest

from analysis import strikes

SMALL = ("human.gaussians=1000", "object.max_gaussians=1500", "stage.motion.sample_steps=2",
         "stage.motion.iterations=1", "stage.coordinate.iterations=2")  # fmt: skip


def test_both_stages_are_judged_and_written(tmp_path, monkeypatch):
    monkeypatch.setattr(strikes, "STRIKES", strikes.STRIKES[:1])
    options = ["strikes", "-o", str(tmp_path), "--seeds", "2", "--start", "sample", *SMALL]
    monkeypatch.setattr(sys, "argv", options)
    assert strikes.main() == 0
    table = pd.read_csv(tmp_path / "strikes.csv")
    assert table["stage"].tolist() == [1, 2] and (table["n"] == 2).all()
    assert table["strange"].between(0, 2).all() and table["aligned"].between(-1, 1).all()
    assert table["gap [m]"].isna().tolist() == [True, False]
    assert np.load(tmp_path / "strikes.npz")["sample/0"].shape == (2, 40, 24, 3)
    assert "aligned" in (tmp_path / "strikes.md").read_text()


@pytest.mark.parametrize(
    ("override", "message"),
    [("stage/motion=none", "stage.motion.init: there is no such key"), ("scene.fps=no", "scene.fps")],
)
def test_a_bad_override_is_one_line(tmp_path, monkeypatch, capsys, override, message):
    monkeypatch.setattr(sys, "argv", ["strikes", "-o", str(tmp_path), "--start", "sample", override])
    assert strikes.main() == 2
    said = capsys.readouterr().err
    assert message in said and len(said.splitlines()) == 1
