"""Every experiment with every ablation in every scene: it composes, says what it is, and differs in one thing alone."""

import sys

import pytest

from hoi.config import CONF, Ablation
from hoi.config.validate import to_config
from hoi.plan import make_plan
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import docs_ablations

EXPERIMENTS, SCENES = (sorted(file.stem for file in (CONF / group).glob("*.yaml")) for group in ("experiment", "scene"))
STAGE = {
    Ablation.full: "nothing",
    Ablation.no_attraction: "stage/attraction",
    Ablation.no_contact: "stage/contact",
    Ablation.no_mdm: "stage/motion",
    Ablation.no_mpm: "stage/object",
    Ablation.no_video_sds: "stage/refine",
}
FOLLOWS = {
    Ablation.full: set(),
    Ablation.no_attraction: {"coordinate"},
    Ablation.no_contact: {"contact", "resimulate", "react", "refine"},
    Ablation.no_mdm: {"motion", "coordinate"},
    Ablation.no_mpm: {"free_motion", "contact", "resimulate"},
    Ablation.no_video_sds: {"refine"},
}
"""The steps that may differ from the full method's: of w/o Contact stage 3 looks for the limb around t*."""

OWN = {"live": {"no_video_sds"}}
"""What an experiment itself does without."""


def test_the_lists_are_whole():
    assert len(EXPERIMENTS) == 6 and len(SCENES) == 13 and set(STAGE) == set(Ablation) == set(FOLLOWS)


@pytest.fixture(scope="module")
def full():
    """The full method of each experiment and scene, composed once."""
    return {}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
@pytest.mark.parametrize("ablation", list(Ablation))
def test_one_thing_differs(composed, full, monkeypatch, ablation, experiment, scene):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    raw = composed(f"experiment={experiment}", f"scene={scene}", f"ablation={ablation.value}")
    config = to_config(raw)
    plan = make_plan(config)
    assert (config.experiment, config.ablation, config.scene.name) == (experiment, ablation, scene)
    assert raw.out == f"runs/{scene}/{experiment}/{ablation.value}/s0"
    if ablation is Ablation.full:
        full[experiment, scene] = config, plan
    if (experiment, scene) not in full:
        whole = to_config(composed(f"experiment={experiment}", f"scene={scene}"))
        full[experiment, scene] = whole, make_plan(whole)
    of_full, plan_of_full = full[experiment, scene]
    own = {*plan_of_full.variant.split("+")} - {"full"}
    assert own == OWN.get(experiment, set())
    assert {*plan.variant.split("+")} == ((own | {ablation.value}) - {"full"} or {"full"})
    assert {key for key, *_ in docs_ablations.chosen(of_full, config)} <= {STAGE[ablation]}
    assert {name for name, *_ in docs_ablations.steps(plan_of_full, plan)} <= FOLLOWS[ablation]
    assert plan.uses.count("approach") == plan_of_full.uses.count("approach")
    if experiment.startswith("paper"):
        assert config.stage.contact.name in ("impulse", "none") and config.scene.approach.value == "none"
        assert config.scene.striking_limb is None and config.material.name == "paper"


def test_the_trial_of_the_papers_run_differs_in_budgets_alone(composed):
    """`experiment=paper_smoke` is the paper's method: iterations, sizes and what is drawn are smaller, nothing else."""
    whole, trial = (
        dict(docs_ablations.values(to_config(composed(f"experiment={name}", "render=none"))))
        for name in ("paper", "paper_smoke")
    )
    differ = {key.rpartition(".")[2] for key in whole | trial if whole.get(key) != trial.get(key)}
    sizes = {"iterations", "width", "height", "clip_frames", "grid", "dt", "gaussians", "max_gaussians", "human_points"}
    assert differ - {"experiment", "out"} == sizes


def test_the_page_says_it():
    """Of each ablation which option differs, in both experiments, and nothing of another stage."""
    page = docs_ablations.page()
    for ablation, name in docs_ablations.NAMES.items():
        part = page.partition(f"## {name}\n")[2].partition("\n## ")[0]
        assert f"| `{STAGE[ablation]}` | " in part and all(f"experiment={each}" in part for each in ("laptop", "paper"))
        assert not [other for other in STAGE.values() if other != STAGE[ablation] and f"`{other}`" in part]
