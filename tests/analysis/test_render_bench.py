"""The benchmark of the renderer: its rows, its peer, its memory, and what it says of bad arguments."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from analysis import render_bench
from analysis.splat_scenes import camera_on, synthetic_cloud, torch_threads


def test_milliseconds_leave_out_the_first_turns() -> None:
    turns = []

    def step() -> None:
        turns.append(len(turns))

    row = render_bench.milliseconds(step, 4)
    assert len(turns) == render_bench.WARM_UP + 4
    assert 0 <= float(row["best ms"]) <= float(row["median ms"])
    assert float(row["FPS"]) == pytest.approx(1e3 / float(row["median ms"]))


def test_rows_of_a_scene_with_and_without_gradients() -> None:
    splats = synthetic_cloud(200)
    with torch_threads(1):
        rows = render_bench.measure("small", splats, camera_on(splats, 60, 40), 2)
    assert [row["what"] for row in rows] == ["picture", "picture and gradients"]
    assert all(row["by"] == "hoi" and row["on"] == "1 thread" and row["Gaussians"] == 200 for row in rows)
    assert splats.means.grad is not None and splats.sh.grad is not None and bool((splats.means.grad != 0).any())
    assert not splats.means.requires_grad


def test_a_film_counts_both_parts() -> None:
    person, ball = synthetic_cloud(100), synthetic_cloud(50, seed=1)
    with torch_threads(2):
        row = render_bench.measure_film("film", person, ball, camera_on(person, 60, 40), 2)
    assert row["Gaussians"] == 150 and row["on"] == "2 threads" and float(row["median ms"]) > 0


def test_ratios_are_of_the_same_work_alone() -> None:
    rows: list[render_bench.Row] = [
        {"scene": "a", "on": "1 thread", "what": "projection alone", "by": "hoi", "median ms": 2.0},
        {"scene": "a", "on": "1 thread", "what": "projection alone", "by": "gsplat's PyTorch", "median ms": 8.0},
        {"scene": "a", "on": "2 threads", "what": "projection alone", "by": "hoi", "median ms": 1.0},
        {"scene": "a", "on": "1 thread", "what": "picture", "by": "hoi", "median ms": 3.0},
    ]
    assert [row.get("times as fast") for row in render_bench.with_ratios(rows)] == [4.0, 1.0, None, None]


def test_the_peer_gets_the_same_gaussians(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package, which refuses what is not as it should be."""
    package = tmp_path / "gsplat" / "cuda"
    package.mkdir(parents=True)
    for folder in (tmp_path / "gsplat", package):
        (folder / "__init__.py").touch()
    (package / "_torch_impl.py").write_text(
        "def _fully_fused_projection(means, covars, viewmats, Ks, width, height):\n"
        "    assert means.shape == (200, 3) and covars.shape == (200, 3, 3)\n"
        "    assert viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3) and (width, height) == (60, 40)\n"
        "    z = means @ viewmats[0, 2, :3] + viewmats[0, 2, 3]\n"
        "    assert (z > 0).all() and means.dtype == covars.dtype == viewmats.dtype == Ks.dtype\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    splats = synthetic_cloud(200)
    camera = camera_on(splats, 60, 40)
    with torch_threads(1):
        ours, theirs = render_bench.projection_rows("small", splats, camera, 1, 2, sys.executable)
    assert {ours["what"], theirs["what"]} == {"projection alone"} and ours["on"] == theirs["on"] == "1 thread"
    assert ours["by"] == "hoi" and str(theirs["by"]).startswith("gsplat") and float(theirs["median ms"]) > 0


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="/proc tells the peak")
def test_memory_grows_with_gradients() -> None:
    plain, with_gradients = (render_bench.memory(20_000, gradients) for gradients in (False, True))
    assert plain["what"] == "picture" and with_gradients["what"] == "picture and gradients"
    assert 60 < float(plain["bytes/Gaussian"]) < float(with_gradients["bytes/Gaussian"]) < 5000


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--turns", "0"), "--gaussians, --turns and --threads must be 1 or more, --memory 0 or more"),
        (("--cloud", "nothing.ply"), "nothing.ply: cannot be read"),
        *([] if torch.cuda.is_available() else [(("--device", "cuda"), "PyTorch finds no CUDA device")]),
    ],
)
def test_bad_arguments_are_one_line(arguments: tuple[str, ...], says: str) -> None:
    command = [sys.executable, "-m", "analysis.render_bench", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("analysis.render_bench: ") and says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
