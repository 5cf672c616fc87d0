"""Metrics and the table, from records of made-up runs."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.metrics import (
    METRICS,
    closing_speed,
    contact_gap,
    deepest_penetration,
    expected_limb,
    post_impact_error,
)
from analysis.table import collect, summarise
from hoi.data import Run, StageReport
from hoi.errors import InputError
from hoi.record import write
from hoi.refine.fidelity import object_at
from tests.demo_run import make_run


@pytest.fixture(scope="module")
def demo() -> tuple[Run, np.ndarray, np.ndarray]:
    run, points, colours = make_run(gaussians=800, particles=1000)
    facts = {"scene": "kick", "experiment": "demo", "ablation": "full"}
    config = "scene:\n  expected_limb: right_foot\n"
    made = replace(run, config_yaml=config, provenance=run.provenance | facts)
    return replace(made, result=run.result | {"variant": "no_video_sds"}), points, colours


def test_contact_metrics(demo):
    run, points, _ = demo
    push = run.state.contact.push
    assert contact_gap(run, points) == push.gap
    assert closing_speed(run, points) == push.v_in
    assert expected_limb(run, points) == 1
    assert np.isnan(post_impact_error(run, points))
    report = StageReport("resimulate", 1.0, numbers={"v_post_error": 0.013})
    assert post_impact_error(replace(run, reports=(report,)), points) == 0.013


def test_penetration_of_a_known_depth(demo):
    """One point of the skin 3 cm inside the ball, one outside."""
    run, points, _ = demo
    trajectory = run.state.trajectory
    far = np.full((len(points), 2, 3), 50.0)
    surface = trajectory.positions[0, :800]
    outermost = surface[np.linalg.norm(surface - trajectory.com[0], axis=1).argmax()]
    outward = (outermost - trajectory.com[0]) / np.linalg.norm(outermost - trajectory.com[0])
    far[0] = [outermost - 0.03 * outward, outermost + 0.03 * outward]
    assert deepest_penetration(run, far) == pytest.approx(0.03, abs=0.004)
    far[0, 0] = 50
    assert deepest_penetration(run, far) == 0


def test_object_between_frames_jumps_at_the_impulse(demo):
    run, *_ = demo
    push, trajectory = run.state.contact.push, run.state.trajectory
    assert push.frame == 1.5
    com = [object_at(trajectory, push, run.scene.fps, frame).mean(axis=0) for frame in (1.0, 1.4, 1.6, 2.0)]
    np.testing.assert_allclose(com[1] - com[0], 0, atol=1e-6)
    np.testing.assert_allclose(com[3] - com[2], 0.4 / run.scene.fps * trajectory.com_velocity[2], atol=1e-5)


def test_nothing_touched_has_empty_cells(demo):
    run, points, _ = demo
    missed = replace(run, state=replace(run.state, contact=None))
    assert np.isnan(contact_gap(missed, points)) and np.isnan(closing_speed(missed, points))
    assert expected_limb(missed, points) == 0


def test_table_has_a_row_a_variant_and_counts_failures(demo, tmp_path):
    run, points, colours = demo
    for number, (variant, seconds) in enumerate([("no_video_sds", "1"), ("no_video_sds", "3"), ("no_mpm", "5")]):
        (tmp_path / str(number)).mkdir()
        made = replace(run, result=run.result | {"variant": variant, "seconds": seconds})
        write(made, tmp_path / str(number) / "run.mcap", points, colours, plan_text="")
    failed = replace(run, result=run.result | {"variant": "no_mpm", "status": "failed"})
    write(failed, tmp_path / "2" / "run.failed.mcap", points, colours, plan_text="")
    table = summarise(collect(tmp_path)).set_index("variant")
    assert table.loc["no_video_sds", "n"] == 2 and table.loc["no_video_sds", "failed"] == 0
    assert table.loc["no_video_sds", "seconds"] == 2
    assert table.loc["no_mpm", "n"] == 2 and table.loc["no_mpm", "failed"] == 1
    assert table.loc["no_mpm", "seconds"] == 5
    assert set(METRICS) <= set(table.columns)


def test_empty_folder_is_one_line(tmp_path):
    with pytest.raises(InputError, match=r"no run.mcap"):
        collect(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "analysis.table", str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1


def test_analysis_is_light():
    code = "import sys, analysis.table; print([m for m in ('torch', 'taichi', 'transformers') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
