"""Stage 3 in the plan: its label, and weights that are missing."""

import json

import pytest

from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.plan import make_plan
from hoi.stages.refine.video_sds import VideoSDS
from hoi.video_prior.files import COGVIDEOX_PARTS, VIDEO_PRIOR_NAME


@pytest.fixture
def plan(composed):
    return lambda *overrides: make_plan(to_config(composed(*overrides)))


def step(made) -> tuple[str, str]:
    (found,) = (step for step in made.steps if step.name == "refine")
    return found.implementation, found.reason


def test_video_sds_is_the_full_method(plan):
    made = plan()
    assert made.variant == "full"
    kind, reason = step(made)
    assert kind == "video_sds" and "embedded in the package" in reason and "within 1 frames of t_c" in reason
    assert "of t*" in step(plan("ablation=no_contact"))[1]
    assert "0.5 L_geometry" in step(plan("stage.refine.lambda_geometry=0.5"))[1]
    assert plan("ablation=no_mpm").variant == "no_mpm"


def test_geometry_is_neither_full_nor_without_stage_3(plan):
    """The paper's w/o Video-SDS ends with stage 2."""
    made = plan("stage/refine=geometric")
    assert made.variant == "geometric" and step(made)[0] == "geometric"
    assert plan("stage/refine=geometric", "ablation=no_mpm").variant == "no_mpm+geometric"
    with pytest.raises(InputError, match=r"ablation=no_video_sds contradicts .* runs with stage 3"):
        plan("ablation=no_video_sds", "stage/refine=geometric")


@pytest.mark.parametrize("ablation", ["full", "no_video_sds"])
def test_none_ends_with_stage_2(plan, ablation):
    made = plan(f"ablation={ablation}", "stage/refine=none")
    assert made.variant == "no_video_sds" and not made.keeps("refine")
    (omission,) = (o for o in made.omissions if o.what == "refine")
    assert "stage/refine is none" in omission.because


def test_only_what_is_needed_is_said(plan):
    assert "more than 0.002 m deep" in step(plan("stage/refine=geometric"))[1]
    assert "deep" not in step(plan("stage/refine=geometric", "stage.refine.when=always"))[1]


def test_smoke_refines_briefly(composed):
    conf = to_config(composed("experiment=smoke")).stage.refine
    assert isinstance(conf, VideoSDS) and conf.iterations <= 10


def test_the_papers_stage_3(composed):
    conf = to_config(composed("experiment=paper")).stage.refine
    assert isinstance(conf, VideoSDS)
    assert (conf.prior.value, conf.iterations, conf.learning_rate, conf.guidance) == ("cogvideox", 3000, 0.001, 100)
    assert (conf.t_min, conf.t_max, conf.t_max_end, conf.t_max_iterations) == (100, 980, 300, 1000)
    assert (conf.height, conf.width, conf.clip_frames, conf.viewpoints, conf.half_width) == (480, 720, 49, 100, 1)
    assert conf.lambda_geometry == 0 and conf.lambda_smooth == 0 and conf.guidance_rescale == 0


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["stage.refine.checkpoint=nowhere.safetensors"],
            ["stage.refine.checkpoint: no embedded video prior", "nowhere.safetensors; stage.refine.checkpoint=null"],
        ),
        (
            ["stage/refine=cogvideox", "stage.refine.checkpoint=nobody/nothing"],
            ["stage.refine.checkpoint: no CogVideoX-5B", "nobody/nothing", "21 GB", "T5 9.5", "stage/refine=geometric"],
        ),
        (
            ["stage/refine=cogvideox", "stage.refine.checkpoint=not/a/hub/name"],
            ["CogVideoX-5B", "not/a/hub/name", "21 GB", "stage/refine=geometric"],
        ),
    ],
)
def test_missing_weights_are_named(plan, monkeypatch, overrides, words):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    (missing,) = plan(*overrides).missing
    line = str(missing)
    assert "\n" not in line and all(word in line for word in words), line


def test_the_folder_of_a_training_is_an_embedded_prior(plan, tmp_path):
    (missing,) = plan(f"stage.refine.checkpoint={tmp_path}").missing
    assert (missing.what, missing.path) == ("embedded video prior", f"{tmp_path}/video_prior.safetensors")
    (tmp_path / VIDEO_PRIOR_NAME).touch()
    for given in (tmp_path, tmp_path / VIDEO_PRIOR_NAME):
        made = plan(f"stage.refine.checkpoint={given}")
        assert made.keeps("refine") and not made.missing


def test_half_a_cogvideox_is_none(plan, tmp_path, monkeypatch):
    """Empty folders are not enough, nor one shard of two; packages count too, and all is said at once."""
    overrides = ("stage/refine=cogvideox", f"stage.refine.checkpoint={tmp_path}")
    for part, *_ in COGVIDEOX_PARTS:
        (tmp_path / part).mkdir()
    (missing,) = plan(*overrides).missing
    for part, config, weights in COGVIDEOX_PARTS:
        assert f"{part}/{config}" in missing.what and (not weights or f"{part}/{weights}" in missing.what)
        (tmp_path / part / config).write_text("{}")
        if weights:
            (tmp_path / part / weights).touch()
    (missing,) = plan(*overrides).missing
    assert missing.what == "whole CogVideoX-5B (tokenizer/spiece.model)" and "21 GB" in missing.size
    (tmp_path / "tokenizer").mkdir()
    (tmp_path / "tokenizer" / "spiece.model").touch()
    assert not plan(*overrides).missing
    shards = {"weight_map": {"a": "one.safetensors", "b": "two.safetensors"}}
    (tmp_path / "transformer" / "diffusion_pytorch_model.safetensors.index.json").write_text(json.dumps(shards))
    (tmp_path / "transformer" / "one.safetensors").touch()
    assert plan(*overrides).missing[0].what == "whole CogVideoX-5B (transformer/two.safetensors)"
    monkeypatch.setattr("hoi.video_prior.files.find_spec", lambda name: None)
    assert [each.what for each in plan(*overrides).missing] == [
        "package diffusers",
        "package sentencepiece",
        "whole CogVideoX-5B (transformer/two.safetensors)",
    ]


def test_the_plan_guesses_the_memory_that_the_loader_estimates(plan, monkeypatch):
    """32 GB for the published sizes, as `estimate_memory` has it of the json files; less in smaller pictures."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")

    def guessed(*overrides: str) -> float:
        (check,) = (c for c in plan("stage/refine=cogvideox", *overrides).checks if c.name == "gpu_memory")
        return float(check.value.removesuffix(" GB"))

    assert guessed("stage.refine.clip_frames=9") == pytest.approx(32, abs=1)
    assert guessed("stage.refine.width=240", "stage.refine.height=160") < guessed()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["stage.refine.t_max=1000"], "stage.refine.t_max must be in [0, 999], got 1000"),
        (["stage.refine.t_max_end=990"], "stage.refine.t_max_end must be in [0, 200], got 990"),
        (["stage.refine.t_min=400"], "stage.refine.t_min must be in [0, 200], got 400"),
        (["stage.refine.iterations=0"], "stage.refine.iterations must be 1 or more, got 0"),
        (["stage.refine.tolerance=-1"], "stage.refine.tolerance must be 0 or more [m], got -1"),
        (["stage.refine.half_width=-1"], "stage.refine.half_width must be 0 or more [frames], got -1"),
        (["stage.refine.viewpoints=0"], "stage.refine.viewpoints must be 1 or more, got 0"),
        (["stage.refine.elevation=2"], "stage.refine.elevation must be in (-pi/2, pi/2), got 2"),
        (["stage.refine.distance=0"], "stage.refine.distance must be greater than 0 [m], or null, got 0"),
        (["stage.refine.width=128"], "stage.refine.width must be 64 with stage.refine.prior=embedded, got 128"),
        (["stage.refine.clip_frames=9"], "stage.refine.clip_frames must be null with stage.refine.prior=emb"),
        (
            ["stage/refine=cogvideox", "stage.refine.width=100"],
            "stage.refine.width must be a multiple of 16 up to 8192, got 100",
        ),
        (["stage/refine=cogvideox", "stage.refine.clip_frames=10"], "stage.refine.clip_frames must be 4 k + 1 frames"),
        (["stage/refine=cogvideox", "stage.refine.checkpoint=null"], "stage.refine.checkpoint must be a folder"),
        (["stage/refine=geometric", "stage.refine.lambda_touch=-1"], "stage.refine.lambda_touch must be 0 or more"),
    ],
)
def test_bad_values_are_named(composed, overrides, message):
    with pytest.raises(InputError) as caught:
        to_config(composed(*overrides))
    assert message in str(caught.value) and "\n" not in str(caught.value)
