"""The examples that the docs show are these very files, and they work."""

import os
import shutil
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir

from analysis.metrics import METRICS
from analysis.table import collect
from hoi.config import CONF, register
from hoi.config.validate import to_config
from hoi.plan import make_plan
from hoi.record import read, write
from hoi.video_prior import VideoPrior
from tests.conftest import ROOT
from tests.demo_run import make_run

EXAMPLES = ROOT / "docs" / "examples"


def example(name: str):
    """The module docs/examples/NAME.py."""
    spec = spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "says", "leaves"),
    [
        pytest.param("whole_method", "contact by right_foot", [], marks=pytest.mark.slow),
        pytest.param("object_alone", "basketball: ", [], marks=pytest.mark.slow),
        ("person_alone", "right leg: up to ", []),
        ("picture", "", ["picture.png"]),
        pytest.param("plot_record", "", ["kick", "kick.png"], marks=pytest.mark.slow),
    ],
)
def test_an_example_of_the_python_api_runs_in_an_empty_folder(name, says, leaves, tmp_path):
    file = EXAMPLES / f"{name}.py"
    assert len([line for line in file.read_text().splitlines() if line]) <= 12
    shutil.copy(file, tmp_path)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, file.name], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert says in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != file.name) == leaves


def test_every_example_is_shown():
    pages = "".join(page.read_text() for page in (ROOT / "docs").glob("*.md"))
    files = [file.relative_to(ROOT) for file in EXAMPLES.rglob("*.*") if "__pycache__" not in file.parts]
    assert len(files) >= 6
    assert not [str(file) for file in files if f'\n--8<-- "{file}"\n' not in pages]


def test_a_material_an_object_and_a_scene_need_files_alone():
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        composed = compose("config", [f"hydra.searchpath=[file://{EXAMPLES / 'conf'}]", "scene=kick_ice"])
    config = to_config(composed)
    plan = make_plan(config)
    assert (config.scene.name, config.object.name, config.material.name) == ("kick_ice", "ice_block", "ice")
    assert config.material.density == 917 and plan.variant == "full"
    assert "free_motion" in {omission.what for omission in plan.omissions}, "it lies still until it is kicked"


def test_a_metric_becomes_a_column(tmp_path, monkeypatch):
    run, *_ = make_run()
    path = tmp_path / "run.mcap"
    write(run, path, plan_text="")
    metric = example("apex").METRIC
    monkeypatch.setitem(METRICS, metric.key, metric)
    height = read(path).state.trajectory.com[:, 2]
    assert metric.heading == "apex [m]" and metric.definition.startswith("Greatest height")
    assert collect(tmp_path)["apex"].item() == pytest.approx(height.max() - height[0])


def test_a_video_prior_pulls_a_clip_to_what_it_believes():
    module = example("still_prior")
    prior: VideoPrior = module.StillPrior()
    assert prior.clip_frames(3, 5, 40) == [2, 3, 4, 5, 6]
    clip = torch.zeros(5, 3, 48, 48, dtype=torch.float64)
    clip[2, 0, 20:28, 20:28] = 1.0  # something flashes up in one frame
    pulled = sum(module.pull(clip, seed=seed) for seed in range(20))
    inside = pulled[:, 0, 20:28, 20:28].mean(dim=(1, 2))
    assert inside[2] < 0 and bool((inside[[0, 1, 3, 4]] > 0).all()), "it fades where it is and appears where it is not"


def test_a_stage_option_is_a_file_of_python_and_a_file_of_values(tmp_path):
    """Dropped into the tree as it is, both make an option that is planned, labelled and runs."""
    leave = shutil.ignore_patterns("__pycache__")
    for folder in ("hoi", "conf", "hydra_plugins"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=leave)
    for file in ("hoi/stages/object/ballistic.py", "conf/stage/object/ballistic.yaml"):
        assert not (ROOT / file).exists()
        shutil.copy(EXAMPLES / file, tmp_path / file)
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "OMP_NUM_THREADS": "1"}
    quick = "experiment=smoke stage/motion=none stage/refine=none stage.coordinate.iterations=1 human.gaussians=1000"
    quick = f"{quick} scene.frames=8 scene.contact_frame=4 object.max_gaussians=500"
    run = [sys.executable, "-m", "hoi.run", "scene=punch_blue_ball", "stage/object=ballistic", *quick.split()]
    done = subprocess.run([*run, "out=here"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    record = read(tmp_path / "here" / "run.mcap")
    assert record.plan.variant == "no_mdm+ballistic+no_video_sds"
    time = np.arange(record.scene.frames) / record.scene.fps
    path = record.state.trajectory.com[0] + np.outer(time, [0, 0, 4.7]) + 0.5 * np.outer(time**2, [0, 0, -9.81])
    free = time <= (record.state.contact.push.frame if record.state.contact.push else np.inf) / record.scene.fps
    np.testing.assert_allclose(record.state.trajectory.com[free], path[free], atol=1e-4)
