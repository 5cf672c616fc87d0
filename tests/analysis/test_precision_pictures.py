"""The renderer's error against run time: the truth, the measures, the cut-offs and the command."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from analysis.precision import picture_report, pictures
from analysis.splat_scenes import as_type, camera_on, synthetic_cloud
from hoi.render import reference
from hoi.render.rasterise import rasterise
from hoi.render.splats import Picture


@pytest.fixture(scope="module")
def view() -> pictures.View:
    splats = synthetic_cloud(300)
    return pictures.View("cloud", "small", splats, camera_on(splats, 60, 40))


def colour_with(view: pictures.View, **changes) -> torch.Tensor:
    settings = replace(pictures.NOTHING_LEFT_OUT, **changes)
    return rasterise(as_type(view.splats, torch.float64), view.camera, settings=settings).colour


def test_truth_is_brute_force_without_cut_offs(view: pictures.View, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "MIN_ALPHA", 1e-12)
    monkeypatch.setattr(reference, "MIN_TRANSMITTANCE", 0.0)
    brute = rasterise(view.splats, view.camera, backend="reference")
    true = pictures.truth(view)
    assert true.alpha.max() > 0.9
    torch.testing.assert_close(true.colour, brute.colour, rtol=0, atol=1e-9)
    torch.testing.assert_close(true.alpha, brute.alpha, rtol=0, atol=1e-9)


def test_float64_disagrees_with_brute_force_by_round_off_alone(view: pictures.View) -> None:
    larger = replace(view, camera=camera_on(view.splats, 60 * pictures.REFERENCE_SHARE, 40 * pictures.REFERENCE_SHARE))
    off = pictures.disagreement(larger)
    assert 0 < off < picture_report.AGREES
    assert picture_report.verdict(off) == "as expected" and picture_report.verdict(1e-3) == "NOT as expected"


def test_errors_of_a_known_difference() -> None:
    """Half of the picture is covered, and off by 0.1; the bare half is off by 0.5 in one number."""
    alpha = torch.zeros(2, 4)
    alpha[:, :2] = 1
    true = Picture(torch.full((2, 4, 3), 0.3), alpha)
    colour = true.colour.clone()
    colour[:, :2] += 0.1
    colour[1, 3, 0] -= 0.5
    errors = pictures.picture_errors(colour, true)
    assert errors["error"] == pytest.approx(0.1, rel=1e-6) and errors["psnr"] == pytest.approx(20, rel=1e-6)
    assert errors["largest"] == pytest.approx(0.5, rel=1e-6)
    assert pictures.picture_errors(true.colour, true)["psnr"] == float("inf")


def test_each_cut_off_costs_less_the_less_it_cuts(view: pictures.View) -> None:
    true = pictures.truth(view)
    for name, ladder in (("least_alpha", (1 / 16, 1 / 255, 1e-4)), ("least_transmittance", (1e-1, 1e-3, 1e-6))):
        errors = [pictures.picture_errors(colour_with(view, **{name: cut}), true)["error"] for cut in ladder]
        assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_variants_change_what_their_kind_says() -> None:
    base, *others = pictures.variants(3)
    assert base.kind == "base"
    changes = {"harmonics": "sh_degree", "alpha": "least_alpha", "transmittance": "least_transmittance", "tile": "tile"}
    for other in others:
        flat, flat_base = ({**vars(v), **vars(v.settings)} for v in (other, base))
        changed = {name for name in flat if flat[name] != flat_base[name]} - {"kind", "label", "settings"}
        if other.kind in changes:
            assert changed == {changes[other.kind]}
    assert len({variant.label for variant in (base, *others)}) == len(others) + 1
    assert {variant.kind for variant in (base, *others)} == set(picture_report.KINDS)
    assert "harmonics" not in {variant.kind for variant in pictures.variants(0)}
    assert set(pictures.variants(3, quick=True)) < {base, *others}


def test_synthetic_cloud_is_seeded_and_framed() -> None:
    one, two, other = synthetic_cloud(500), synthetic_cloud(500), synthetic_cloud(500, seed=1)
    assert torch.equal(one.sh, two.sh) and torch.equal(one.means, two.means) and not torch.equal(one.means, other.means)
    assert one.sh.shape == (500, 16, 3) and synthetic_cloud(10, degree=1).sh.shape == (10, 4, 3)
    assert bool((one.opacities > 0).all() and (one.opacities < 1).all())
    smallest = torch.linalg.eigvalsh(one.covariances.double())
    assert bool((smallest > 0).all()) and float((smallest[:, 0] / smallest[:, 2]).median()) < 0.1  # flat
    alpha = rasterise(one, camera_on(one, 60, 40)).alpha
    assert float(alpha[20, 30]) > 0.5 and float(alpha[0, 0]) < 0.1


def test_quick_run_writes_table_report_and_picture(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "analysis.precision", "--quick", "--problems", "cloud", "--repeats", "1"]
    done = subprocess.run([*command, "-o", str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rendering.csv", "rendering.md", "rendering.png"]
    table = pd.read_csv(tmp_path / "rendering.csv").set_index("variant")
    assert {"machine", "threads", "taichi", "commit", "disagreement"} <= set(table.columns)
    assert set(table["kind"]) == set(picture_report.KINDS) and bool(table["front"].to_numpy().any())
    seconds, fastest = table["seconds"].to_numpy(), table["fastest"].to_numpy()
    assert (fastest > 0).all() and (fastest <= seconds).all()
    psnr = dict(zip(table.index, table["psnr"].to_numpy(), strict=True))
    assert psnr["SH degree 0"] < psnr["SH degree 1"] < psnr["SH degree 2"] < psnr["base"]
    assert psnr["base"] < psnr["finer"] < psnr["nothing left out, float32"]
    for same in ("float64", "exact exp", "tiles of 8"):
        assert psnr[same] == pytest.approx(psnr["base"], abs=0.05)
    assert np.isfinite(table[["error", "psnr", "largest"]].to_numpy()).all()
    words = (tmp_path / "rendering.md").read_text()
    assert "as expected" in words and "NOT as expected" not in words and "| base" in words
    assert (tmp_path / "rendering.png").read_bytes()[:4] == b"\x89PNG"


def test_unknown_problem_names_those_of_the_renderer() -> None:
    command = [sys.executable, "-m", "analysis.precision", "--problems", "renderer,nonsense"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1
    assert "physics, renderer" in done.stderr and "scene, cloud" in done.stderr and "got nonsense" in done.stderr
