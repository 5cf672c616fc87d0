"""The paper's method and its five ablations, from published layouts of weights to a table, on a CPU.

Weights are tiny and random, in the files of the published ones; budgets are those of `experiment=paper_smoke`, which is
`experiment=paper` but for budgets (tests/config/test_matrix.py). What comes out is no motion to look at: that it runs,
records what it should and ends in a table is what is tested.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("diffusers", reason="CogVideoX is an extra: pip install 'hoi[video]'")
from tiny_cogvideox import build

from analysis.table import main as table
from hoi.config import Ablation
from hoi.config.compose import composed
from hoi.record import read
from hoi.runner.execute import execute
from tests.stmc_files import write_stmc

THROWN = ["scene.placement.position=[0,0.7,1.1]", "scene.placement.velocity=[0,-2,1.5]"]
SCENE = ["scene=kick_soccer_ball", "scene.frames=13", "scene.contact_frame=7", *THROWN]
"""The ball is thrown at the person: who has learned nothing kicks nothing."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """A run a variant, below one folder; the same overrides for all."""
    folder = tmp_path_factory.mktemp("paper")
    write_stmc(folder / "mdm")
    weights = [f"mdm={folder / 'mdm'}", f"cogvideox={build(folder / 'cogvideox')}"]
    for ablation in Ablation:
        own = [f"ablation={ablation.value}", f"out={folder / 'runs' / ablation.value}"]
        execute(composed("experiment=paper_smoke", "device=cpu", *own, *SCENE, *weights), [])
    return folder / "runs"


def test_each_variant_is_what_it_says(runs):
    made = {ablation: read(runs / ablation.value / "run.mcap") for ablation in Ablation}
    stages = {ablation: {report.stage for report in run.reports} for ablation, run in made.items()}
    assert stages[Ablation.full] == {"free motion", "motion", "coordinate", "contact", "resimulate", "refine"}
    for ablation, run in made.items():
        assert (run.result["status"], run.result["variant"]) == ("done", ablation.value)
        assert ("motion" in stages[ablation]) is (ablation is not Ablation.no_mdm)
        assert ("contact" in stages[ablation]) is (ablation is not Ablation.no_contact)
        assert ("refine" in stages[ablation]) is (ablation is not Ablation.no_video_sds)
        losses = {(row["stage"], name) for row in run.history for name in row}
        assert (("coordinate", "attraction") in losses) is (ablation is not Ablation.no_attraction)
        assert (("coordinate", "hmsd") in losses) is (ablation is not Ablation.no_mdm)
        assert {phase for phase in run.state.trajectory.phase} == (
            {"constant_velocity"} if ablation is Ablation.no_mpm else {"mpm"}
        )


def test_the_published_layouts_are_what_moves_the_person(runs):
    """Stage 1 leaves the standing pose; stage 3 changes theta of all joints in the frames around contact."""
    whole, bare = (read(runs / each.value / "run.mcap").state for each in (Ablation.full, Ablation.no_video_sds))
    assert np.ptp(bare.motion.body_pose, axis=0).max() > 0
    changed = (whole.motion.body_pose != bare.motion.body_pose).any(axis=-1)
    frame = round(whole.contact.push.frame)
    assert changed[frame].all() and not changed[[each for each in range(13) if abs(each - frame) > 1]].any()
    np.testing.assert_array_equal(whole.trajectory.com, bare.trajectory.com)


def test_it_ends_in_a_table(runs, capsys):
    assert table([str(runs), "--jobs", "1"]) == 0
    assert "6 records (6 done, 0 failed, 0 unreadable)" in capsys.readouterr().out
    rows = pd.read_csv(runs / "table" / "table.csv")
    assert rows["variant"].tolist() == [ablation.value for ablation in Ablation]
    assert (rows["n"] == 1).all() and rows["depth"].notna().all()
