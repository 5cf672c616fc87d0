"""The benchmark of films: what moves in them, and what it says of bad arguments."""

import numpy as np
import pytest

from analysis import film_bench
from hoi.config import compose
from hoi.runner.scene import build_scene


def test_all_moves_in_every_frame_and_the_plain_person_is_no_smaller() -> None:
    scene = build_scene(compose.config_of("human.gaussians=2000"))
    motion, trajectory = film_bench.swinging(scene)
    assert (np.abs(np.diff(motion.body_pose, axis=0)).max((1, 2)) > 0).all()
    assert (np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=-1).max(1) > 0).all()
    turns = trajectory.deformation_gradient
    assert turns is not None and np.allclose(turns @ turns.transpose(0, 1, 3, 2), np.eye(3), atol=1e-6)
    bare = film_bench.plain(scene.body, 3000)
    assert len(bare.cloud) == 3000 and bare.cloud.surface is None and (bare.skinning_weights.sum(1) == 1).all()
    assert np.ptp(bare.cloud.means[:, 1]) == pytest.approx(np.ptp(scene.body.cloud.means[:, 1]), rel=0.05)


def test_bad_arguments_are_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["film_bench", "--rounds", "0"])
    assert film_bench.main() == 2
    assert capsys.readouterr().err.splitlines() == ["analysis.film_bench: --threads and --rounds must be 1 or more"]
