"""All that a run needs and that is not there is said at once, before anything is computed; and where to get it."""

import numpy as np
import pytest

from hoi.errors import InputError
from hoi.gpu import gpus
from hoi.motion.files import CHECKPOINT, missing_prior
from hoi.record import read
from hoi.runner.execute import execute
from hoi.stages.refine.geometric import Geometric

PAPER = "experiment=paper"
QUICK = ("stage/object=constant_velocity", "stage.motion.iterations=1", "stage.coordinate.iterations=20")


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Nothing lies about here, and no GPU is found."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("hoi.plan.gpus", lambda: [])


def lines_of(composed, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        execute(composed(*overrides), [])
    return str(caught.value).splitlines()


def test_everything_that_the_papers_run_lacks_is_said_at_once(composed, tmp_path, monkeypatch):
    monkeypatch.setattr("hoi.video_prior.files.find_spec", lambda name: None)
    wants = ["human=smpl", "human.path=SMPL_NEUTRAL.npz", "object=from_file", "object.path=ball.ply", "object.size=0.2"]
    lines = lines_of(composed, PAPER, *wants)
    starts = [
        "human.path: no SMPL model file at SMPL_NEUTRAL.npz; ",
        "object.path: no 3DGS file at ball.ply; ",
        "device: no CUDA device; ",
        "stage.motion.checkpoint: no STMC's MDM-SMPL, the published motion prior (about 0.3 GB) at pretrained_models/",
        "stage.motion.checkpoint: no CLIP's text encoder (config.json, model.safetensors, vocab.json and merges.txt)",
        "stage.motion.checkpoint: no T-pose joints of the prior's skeleton (1 kB) at pretrained_models/",
        "stage.refine.checkpoint: no package diffusers; pip install 'hoi[video]'",
        "stage.refine.checkpoint: no package sentencepiece; ",
        "stage.refine.checkpoint: no CogVideoX-5B (21 GB: transformer 11.1, T5 9.5, VAE 0.4) at THUDM/CogVideoX-5b; ",
    ]
    assert len(lines) == len(starts)
    assert all(line.startswith(start) for line, start in zip(lines, starts, strict=True)), lines
    assert [line for line in lines if "not necessary" in line] == [lines[5]]
    assert not list(tmp_path.iterdir())


def test_the_plan_is_shown_all_the_same(composed, capsys):
    assert execute(composed(PAPER, "plan_only=true"), []) == []
    rows = [line.split(maxsplit=3) for line in capsys.readouterr().out.splitlines() if line]
    assert ["RUN", "refine", "video_sds"] in [row[:3] for row in rows]
    lacking = [row for row in rows if row[0] == "LACK"]
    assert [row[2] for row in lacking] == ["needed", "needed", "needed", "optional", "needed"]
    assert any("nv-tlabs/stmc" in row[3] for row in lacking) and any("hf download THUDM" in row[3] for row in lacking)
    assert ["CHECK", "gpu_memory", "32"] in [row[:3] for row in rows]


@pytest.mark.parametrize(
    ("ablation", "keys"),
    [
        ("no_mdm", ["device", "stage.refine.checkpoint"]),
        ("no_video_sds", ["device"] + ["stage.motion.checkpoint"] * 3),
    ],
)
def test_what_an_ablation_leaves_out_is_not_missed(composed, ablation, keys):
    assert [line.partition(":")[0] for line in lines_of(composed, PAPER, f"ablation={ablation}")] == keys


def test_where_nothing_needed_is_missing_the_run_goes_on(tmp_path):
    """Rest joints are better to have; a folder of our own format needs neither them nor CLIP."""
    run = tmp_path / "run"
    assert [each.needed for each in missing_prior("key", str(run), str(run))] == [True, True, False]
    (run / CHECKPOINT).parent.mkdir(parents=True)
    (run / CHECKPOINT).touch()
    (run / "clip").mkdir()
    for name in ("config.json", "pytorch_model.bin", "tokenizer.json"):
        (run / "clip" / name).touch()
    (missing,) = missing_prior("key", str(run), "elsewhere")
    assert not missing.needed and "python -m hoi.importers.rest_joints" in missing.remedy
    np.save(run / "rest_joints.npy", np.zeros((24, 3)))
    assert not missing_prior("key", str(run), "elsewhere")
    assert not missing_prior("key", str(run / CHECKPOINT), "elsewhere")

    own = tmp_path / "own"
    own.mkdir()
    (own / "prior.json").touch()
    (missing,) = missing_prior("key", str(own), "elsewhere")
    assert missing.path == str(own / "prior.safetensors")
    (own / "prior.safetensors").touch()
    assert not missing_prior("key", str(own), "elsewhere") and not missing_prior("key", None, "elsewhere")
    assert missing_prior("key", "nowhere", "elsewhere")[0].remedy == "key=null: the one in the package"


@pytest.mark.parametrize("kind", [InputError, KeyError])
def test_what_was_computed_is_kept_whatever_ends_a_stage(composed, tmp_path, monkeypatch, kind):
    """Damaged weights that only stage 3 can find, or a fault of ours: motion, contact and the object's answer stay."""

    def refuse(*_):
        raise kind("weights are damaged")

    monkeypatch.setattr(Geometric, "refine", refuse)
    with pytest.raises(kind, match="weights are damaged"):
        execute(composed("experiment=smoke", *QUICK, "stage/refine=geometric", "out=out"), [])
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["run.failed.mcap"]
    failed = read(tmp_path / "out" / "run.failed.mcap")
    assert failed.result["status"] == "failed" and "weights are damaged" in failed.result["outcome"]
    assert failed.state.motion is not None and failed.state.contact is not None and failed.state.trajectory is not None
    assert {"motion", "coordinate", "contact"} <= {report.stage for report in failed.reports}


def test_no_driver_is_no_gpu():
    assert gpus("libnothing.so.1") == []
