"""CogVideoX through diffusers, with a few thousand random weights: same classes, same files, same way of loading."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from demo_run import make_run

pytest.importorskip("diffusers", reason="the extra `video` is not installed")
pytest.importorskip("sentencepiece", reason="the extra `video` is not installed")

from diffusers import AutoencoderKLCogVideoX, CogVideoXPipeline, CogVideoXTransformer3DModel
from tiny_cogvideox import SCHEDULER_5B, TRANSFORMER, VAE, build
from transformers import AutoTokenizer, T5EncoderModel

from hoi.errors import InputError
from hoi.refine.window import window_around
from hoi.reports import Stages
from hoi.stages.refine.video_sds import VideoPriorKind, VideoSDS
from hoi.video_prior import files as weights
from hoi.video_prior import load_video_prior
from hoi.video_prior.cogvideox import CogVideoX, clip_of, rotary_embedding
from hoi.video_prior.cogvideox_encode import chunks_of, encode_chunks
from hoi.video_prior.cogvideox_files import estimate_memory, noise_schedule

HEIGHT, WIDTH = 32, 48
PROMPTS = "a man kicks a ball hard with his right foot", "blurry body"
FULL = {
    "transformer": {
        **TRANSFORMER, "num_attention_heads": 48, "attention_head_dim": 64, "in_channels": 16, "out_channels": 16,
        "time_embed_dim": 512, "text_embed_dim": 4096, "num_layers": 42, "sample_width": 90, "sample_height": 60,
        "max_text_seq_length": 226,
    },
    "vae": {
        **VAE, "block_out_channels": (128, 256, 256, 512), "latent_channels": 16, "layers_per_block": 3,
        "norm_num_groups": 32,
    },
    "text_encoder": {
        "vocab_size": 32128, "d_model": 4096, "d_kv": 64, "d_ff": 10240, "num_layers": 24, "num_heads": 64,
        "feed_forward_proj": "gated-gelu",
    },
}  # fmt: skip
"""The 5B's sizes."""


def conf(folder: Path, **changes: object) -> VideoSDS:
    values: dict = dict(
        prior=VideoPriorKind.cogvideox, checkpoint=str(folder), width=WIDTH, height=HEIGHT, clip_frames=9,
        offload=False, iterations=2, learning_rate=0.01, guidance=100.0, guidance_rescale=0.0, t_min=100, t_max=980,
        t_max_end=300, t_max_iterations=1000, viewpoints=2, elevation=0.3, distance=None, lambda_geometry=0.0,
        lambda_smooth=0.0, step=None, views_at_once=1, crop=None,
    )  # fmt: skip
    return VideoSDS(**{**values, **changes})


def load(folder: Path, **changes: int) -> CogVideoX:
    sizes: dict = {"width": WIDTH, "height": HEIGHT, "clip_frames": 9, "offload": False, **changes}
    found = load_video_prior("cogvideox", "cpu", checkpoint=str(folder), **sizes)
    assert isinstance(found, CogVideoX)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("cogvideox") / "tiny")


@pytest.fixture(scope="module")
def prior(folder: Path) -> CogVideoX:
    found = load(folder)
    found.prepare(*PROMPTS)
    return found


@pytest.fixture(scope="module")
def pipeline(folder: Path) -> CogVideoXPipeline:
    """diffusers' own, from the same files."""
    from diffusers import CogVideoXDDIMScheduler

    return CogVideoXPipeline(
        AutoTokenizer.from_pretrained(folder / "tokenizer"),
        T5EncoderModel.from_pretrained(folder / "text_encoder"),
        AutoencoderKLCogVideoX.from_pretrained(folder / "vae"),
        CogVideoXTransformer3DModel.from_pretrained(folder / "transformer"),
        CogVideoXDDIMScheduler.from_pretrained(folder / "scheduler"),
    )


def video(frames: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(frames, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(seed))


def test_the_noise_schedule_is_the_5bs() -> None:
    abar = noise_schedule(SCHEDULER_5B)
    known = {100: 0.887, 300: 0.565, 500: 0.241, 700: 0.055, 980: 7.7e-5, 999: 0.0}
    assert abar.dtype == torch.float64 and len(abar) == 1000 and (abar.diff() < 0).all()
    for t, value in known.items():
        assert float(abar[t]) == pytest.approx(value, rel=0.006, abs=1e-12)
    # Scaled-linear betas, sqrt(abar) stretched to end at 0 (Lin et al. 2024).
    root = np.sqrt(np.cumprod(1 - np.linspace(0.00085**0.5, 0.012**0.5, 1000) ** 2))
    expected = ((root - root[-1]) * root[0] / (root[0] - root[-1])) ** 2
    assert np.allclose(abar, expected, rtol=1e-9, atol=1e-15)
    for wrong in ({"prediction_type": "epsilon"}, {"num_train_timesteps": 500}):
        with pytest.raises(InputError, match="v_prediction in 1000"):
            noise_schedule({**SCHEDULER_5B, **wrong})


def test_clips_hold_their_ends_and_go_around_the_window() -> None:
    whole = clip_of(19, 21, 40, 49)
    assert len(whole) == 49 and set(whole) == set(range(40))
    assert whole == sorted(whole) and abs(whole.count(0) - whole.count(39)) <= 3
    assert clip_of(19, 21, 40, 9) == list(range(16, 25))
    assert clip_of(19, 21, 40, 13) == list(range(14, 27))
    assert clip_of(0, 1, 40, 9) == list(range(9)) and clip_of(38, 39, 40, 9) == list(range(31, 40))
    for frames in (9, 13, 17, 25, 45, 49):
        for middle in range(1, 39):
            clip = clip_of(middle - 1, middle + 1, 40, frames)
            changing = [abs(frame - middle) <= 1 for frame in clip]
            assert len(clip) == frames and sum(any(changing[chunk]) for chunk in chunks_of(frames)) == 1
    with pytest.raises(InputError, match=r"clip_frames 9.*11 frames"):
        clip_of(10, 20, 40, 9)


@pytest.mark.parametrize(("frames", "latents"), [(5, 2), (9, 3), (13, 4), (17, 5), (49, 13)])
def test_latents_are_those_of_the_pipelines_vae(
    prior: CogVideoX, pipeline: CogVideoXPipeline, frames: int, latents: int
) -> None:
    clip = video(frames)
    with torch.no_grad():
        z = prior.encode(clip)
        pixels = 2 * clip[None].movedim(1, 2) - 1
        expected = pipeline.vae.encode(pixels).latent_dist.mode() * pipeline.vae.config.scaling_factor
    assert z.shape == (1, latents, 4, HEIGHT // 8, WIDTH // 8) and prior.vae.config["scaling_factor"] == 0.7
    assert torch.allclose(z, expected.movedim(1, 2), atol=1e-6)


def test_tiles_are_blended_as_diffusers_does(prior: CogVideoX, pipeline: CogVideoXPipeline) -> None:
    pixels = torch.rand(1, 3, 9, 64, 64, generator=torch.Generator().manual_seed(1), requires_grad=True)
    for vae in (prior.vae, pipeline.vae):
        vae.enable_tiling(48, 40)
    try:
        tiled = encode_chunks(prior.vae, pixels, chunks_of(9), range(1))
        expected = pipeline.vae.encode(pixels).latent_dist.mode()
    finally:
        for vae in (prior.vae, pipeline.vae):
            vae.use_tiling = False
    assert torch.allclose(tiled, expected, atol=1e-6)
    factors = torch.rand(tiled.shape, generator=torch.Generator().manual_seed(2))
    gradients = [torch.autograd.grad((factors * z).sum(), pixels)[0] for z in (tiled, expected)]
    assert torch.allclose(*gradients, rtol=1e-4, atol=1e-6)
    with torch.no_grad():
        whole = encode_chunks(prior.vae, pixels, chunks_of(9), range(1))
    assert whole.shape == tiled.shape and not torch.allclose(tiled, whole, atol=1e-3)


@pytest.mark.parametrize("first", [9, 16, 17])
def test_gradients_go_through_the_chunks_that_change(prior: CogVideoX, pipeline: CogVideoXPipeline, first: int) -> None:
    """Frames 0-8, 9-16, 17-24 are chunks. What is kept is exact; the last chunk is the whole."""
    clip, places = video(25), slice(first, first + 2)
    changing = clip[places].clone().requires_grad_()
    whole = torch.cat([clip[:first], changing, clip[first + 2 :]])
    z = prior.encode(whole, places)
    weights = torch.rand(z.shape, generator=torch.Generator().manual_seed(2))
    (gradient,) = torch.autograd.grad((weights * z).sum(), changing)
    pixels = 2 * whole[None].movedim(1, 2) - 1
    full = pipeline.vae.encode(pixels).latent_dist.mode().movedim(1, 2) * 0.7
    within = slice(3, 5) if first == 9 else slice(3, 7)  # the latents of the chunks that change
    (expected,) = torch.autograd.grad((weights * full)[:, within].sum(), changing, retain_graph=True)
    assert gradient.abs().min() > 0 and torch.allclose(gradient, expected, rtol=1e-4, atol=1e-6)
    (everything,) = torch.autograd.grad((weights * full).sum(), changing)
    assert torch.allclose(gradient, everything, rtol=1e-4, atol=1e-6) == (first != 9)


def test_velocity_is_the_pipelines_guided_output(prior: CogVideoX, pipeline: CogVideoXPipeline) -> None:
    with torch.no_grad():
        z = prior.encode(video(9))
        text = torch.cat(
            pipeline.encode_prompt(PROMPTS[0], PROMPTS[1], True, max_sequence_length=16, device="cpu")[::-1]
        )
        assert torch.allclose(prior._text, text, atol=1e-6) and not torch.allclose(text[0], text[1], atol=1e-3)
        rotary = pipeline._prepare_rotary_positional_embeddings(HEIGHT, WIDTH, 3, torch.device("cpu"))
        both = torch.cat([z, z])
        t = torch.tensor([640, 640])
        outputs = pipeline.transformer(both, text, t, image_rotary_emb=rotary, return_dict=False)[0]
    without, with_text = outputs.chunk(2)
    assert (without - with_text).abs().max() > 1e-3
    assert torch.allclose(prior.velocity(z, 640, 1.0), with_text, atol=1e-5)
    assert torch.allclose(prior.velocity(z, 640, 100.0), without + 100 * (with_text - without), atol=1e-3)
    rescaled = prior.velocity(z, 640, 100.0, rescale=1.0)
    assert float(rescaled.std()) == pytest.approx(float(with_text.std()), rel=1e-4)


def test_rotary_embeddings_have_the_tokens_of_the_grid() -> None:
    cpu = torch.device("cpu")
    cos, sin = rotary_embedding(FULL["transformer"], (13, 60, 90), cpu)
    assert cos.shape == sin.shape == (13 * 30 * 45, 64) == (17550, 64)
    small, _ = rotary_embedding(FULL["transformer"], (3, 30, 44), cpu)
    assert small.shape == (3 * 15 * 22, 64)
    assert rotary_embedding({**TRANSFORMER, "use_rotary_positional_embeddings": False}, (3, 4, 6), cpu) is None


def test_memory_counts_the_parameters_of_the_5b_and_falls_with_the_clip() -> None:
    def estimated(frames: int, offload: bool = False, size: tuple[int, int] = (480, 720)):
        return estimate_memory(FULL, frames, size, torch.bfloat16, offload)

    full = estimated(49)
    assert full.transformer == pytest.approx(2 * 5.570e9, rel=1e-3)
    assert full.encoder == pytest.approx(2 * 92.2e6, rel=2e-3)
    assert full.text == pytest.approx(2 * 4.762e9, rel=1e-3)
    assert full.denoising > 3.5 * estimated(9).denoising
    assert estimated(49, size=(240, 360)).encoding < 0.3 * full.encoding
    assert estimated(49, offload=True).peak < full.peak and full.peak > full.transformer + full.encoder


def test_stage_3_moves_theta_in_the_window_and_nothing_else(prior: CogVideoX) -> None:
    run = make_run(frames=6, points=300, gaussians=60, particles=80, contact_frame=3.0)[0]
    before, trajectory = run.state.motion, run.state.trajectory
    positions = trajectory.positions.copy()
    window = window_around(3.0, 8, 1.0, 6)
    frozen = [p.clone() for model in (prior.vae, prior.transformer) for p in model.parameters()]
    stages = Stages()
    with stages.stage("refine", 2) as stage:
        motion = conf(prior._files.folder).distilled(prior, run.scene, run.state, window, 0, "cpu", stage)
    changed = np.zeros((6, 23), dtype=bool)
    changed[np.ix_(window.frames, np.array(window.moving) - 1)] = True
    assert motion.body_pose[~changed].tobytes() == before.body_pose[~changed].tobytes()
    assert (motion.body_pose != before.body_pose)[[2, 3, 4]].any(axis=(1, 2)).all()
    assert motion.translation is before.translation and motion.orientation is before.orientation
    assert np.array_equal(trajectory.positions, positions)
    after = [p for model in (prior.vae, prior.transformer) for p in model.parameters()]
    assert all(torch.equal(a, b) and b.grad is None and not b.requires_grad for a, b in zip(frozen, after, strict=True))
    assert [row["iteration"] for row in stages.history] == [0.0, 1.0]


def test_the_2bs_positions_are_worked_out(tmp_path: Path) -> None:
    folder = build(tmp_path / "2b", transformer={"use_rotary_positional_embeddings": False, "sample_frames": 9})
    prior = load(folder)
    prior.prepare(*PROMPTS)
    z = torch.randn(1, 3, 4, HEIGHT // 8, WIDTH // 8, generator=torch.Generator().manual_seed(0))
    whole = CogVideoXTransformer3DModel.from_pretrained(folder / "transformer")
    with torch.no_grad():
        expected = whole(z, prior._text[1:], torch.tensor([300]), return_dict=False)[0]
    assert torch.allclose(prior.velocity(z, 300, 1.0), expected, atol=1e-5)


def test_missing_weights_say_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    for checkpoint in (str(tmp_path / "nowhere"), "THUDM/CogVideoX-5b-not-here", str(tmp_path)):
        with pytest.raises(InputError) as caught:
            load(Path(checkpoint))
        line = str(caught.value)
        for said in (checkpoint, "CogVideoX-5B", "hf download THUDM/CogVideoX-5b", "21 GB", "stage/refine=geometric"):
            assert said in line
        assert "\n" not in line


def test_missing_packages_are_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "find_spec", lambda name: None if name == "sentencepiece" else name)
    with pytest.raises(InputError, match=r"no package sentencepiece; pip install 'hoi\[video\]'.*geometric"):
        load(folder)


def edit(path: Path, **changes: object) -> None:
    content = {k: v for k, v in {**json.loads(path.read_text()), **changes}.items() if v is not ...}
    path.write_text(json.dumps(content))


def test_other_models_and_sizes_are_refused(folder: Path, tmp_path: Path) -> None:
    broken = {
        "1.5": ("transformer/config.json", {"patch_size_t": 2}, r"CogVideoX 1\.5.*geometric"),
        "lacks": ("vae/config.json", {"scaling_factor": ...}, "lacks scaling_factor"),
        "shift": ("scheduler/scheduler_config.json", {"snr_shift_scale": ...}, "lacks snr_shift_scale"),
        "other": ("transformer/config.json", {"num_layers": 3}, "not those of its config"),
    }
    for name, (file, changes, message) in broken.items():
        copy = Path(shutil.copytree(folder, tmp_path / name))
        edit(copy / file, **changes)
        with pytest.raises(InputError, match=message) as caught:
            load(copy).prepare(*PROMPTS)
        assert "\n" not in str(caught.value)
    for changes, message in (
        ({"width": 50}, "multiples of 16"),
        ({"height": 8}, "multiples of 16"),
        ({"clip_frames": 10}, r"4 k \+ 1"),
        ({"clip_frames": 1}, r"4 k \+ 1"),
    ):
        with pytest.raises(InputError, match=message):
            load(folder, **changes)


def test_nothing_is_unpickled(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("unpickled")

    monkeypatch.setattr(torch, "load", refuse)
    load(folder).prepare(*PROMPTS)
    for part, name in (("vae", "diffusion_pytorch_model"), ("transformer", "diffusion_pytorch_model")):
        copy = Path(shutil.copytree(folder, tmp_path / part))
        weights = copy / part / f"{name}.safetensors"
        weights.rename(weights.with_suffix(".bin"))
        with pytest.raises(InputError, match=f"no whole CogVideoX-5B .{part}/{name}.safetensors"):
            load(copy).prepare(*PROMPTS)
    copy = Path(shutil.copytree(folder, tmp_path / "text"))
    (copy / "text_encoder" / "model.safetensors").rename(copy / "text_encoder" / "pytorch_model.bin")
    with pytest.raises(InputError, match="T5"):
        load(copy).prepare(*PROMPTS)


def test_shards_are_put_together(folder: Path, tmp_path: Path, prior: CogVideoX) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / "sharded"))
    shutil.rmtree(copy / "transformer")
    CogVideoXTransformer3DModel.from_pretrained(folder / "transformer").save_pretrained(
        copy / "transformer", max_shard_size="200KB"
    )
    assert len(list((copy / "transformer").glob("*.safetensors"))) > 1
    sharded = load(copy)
    sharded.prepare(*PROMPTS)
    state = prior.transformer.state_dict()
    assert all(torch.equal(value, state[name]) for name, value in sharded.transformer.state_dict().items())
