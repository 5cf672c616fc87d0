import json
import warnings
from dataclasses import asdict
from pathlib import Path

import pytest
import torch

from hoi.body.kinematics import joint_positions
from hoi.errors import InputError
from hoi.motion.diffusion import cosine_alphas_cumprod
from hoi.motion.features import decode
from hoi.motion.mdm import Architecture, MotionDenoiser
from hoi.motion.prior import MotionPrior, load_prior, write_prior
from hoi.motion.text import MINILM_SHA256, TextEncoder

STMC_TINY = Architecture(latent_dim=32, ff_size=64, layers=2, heads=4)
OWN_TINY = Architecture(text_dim=384, latent_dim=32, ff_size=64, layers=1, heads=2)


def tensors(architecture: Architecture, seed: int = 0) -> dict[str, torch.Tensor]:
    torch.manual_seed(seed)
    state = {f"denoiser.{name}": value for name, value in MotionDenoiser(architecture).state_dict().items()}
    for kind, size in (("motion", architecture.features), ("text", architecture.text_dim)):
        state[f"{kind}_normalizer.mean"] = torch.randn(size)
        state[f"{kind}_normalizer.std"] = 0.5 + torch.rand(size)
    return state


def stmc_config(architecture: Architecture = STMC_TINY) -> dict:
    denoiser = {"latent_dim": architecture.latent_dim, "num_heads": architecture.heads}
    return {
        "diffusion": {"denoiser": denoiser, "timesteps": 50},
        "data": {"motion_loader": {"fps": 25.0, "nfeats": 205}},
        "motion_features": "smplrifke",
    }


def write_stmc(folder: Path, state: dict[str, torch.Tensor], config: dict | None = None) -> Path:
    """A run folder as the published one, with a Lightning-like checkpoint and a stand-in for CLIP."""
    checkpoint = folder / "logs" / "checkpoints" / "last.ckpt"
    checkpoint.parent.mkdir(parents=True)
    content = {"state_dict": state, "epoch": 0, "global_step": 0, "pytorch-lightning_version": "2.0.9"}
    torch.save(content, checkpoint)
    if config is not None:
        (folder / "config.json").write_text(json.dumps(config))
    (folder / "clip").mkdir()
    (folder / "clip" / "config.json").write_text("{}")
    (folder / "clip" / "model.safetensors").write_bytes(b"weights")
    return folder


def own_description() -> dict:
    return {
        "architecture": asdict(OWN_TINY),
        "timesteps": 20,
        "fps": 20.0,
        "text_encoder": {"sha256": MINILM_SHA256},
        "rest_joints": torch.arange(72.0).view(24, 3).tolist(),
        "source": "a test",
    }


def synthetic_prior(seed: int = 0) -> MotionPrior:
    state = tensors(STMC_TINY, seed)
    encoder = TextEncoder("minilm", "", lambda s: torch.tensor([[len(x) / 10.0] * 512 for x in s]))
    denoiser = MotionDenoiser(STMC_TINY).eval().requires_grad_(False)
    denoiser.load_state_dict({name.removeprefix("denoiser."): v for name, v in state.items() if "denoiser" in name})
    return MotionPrior(
        denoiser,
        mean=state["motion_normalizer.mean"],
        std=state["motion_normalizer.std"],
        text_mean=state["text_normalizer.mean"],
        text_std=state["text_normalizer.std"],
        text_encoder=encoder,
        rest_joints=torch.zeros(24, 3),
        alphas_cumprod=cosine_alphas_cumprod(10),
        fps=20.0,
        source="a test",
    )


def test_stmc_run_folder_loads_strictly(tmp_path):
    state = tensors(STMC_TINY)
    rest = torch.randn(24, 3)
    prior = load_prior(write_stmc(tmp_path / "run", state, stmc_config()), rest_joints=rest)
    assert prior.denoiser.architecture == STMC_TINY
    assert prior.timesteps == 50 and prior.fps == 25.0 and prior.text_encoder.kind == "clip"
    assert torch.equal(prior.mean, state["motion_normalizer.mean"]) and torch.equal(prior.rest_joints, rest)
    for name, value in prior.denoiser.state_dict().items():
        assert torch.equal(value, state[f"denoiser.{name}"])
    by_file = load_prior(tmp_path / "run" / "logs" / "checkpoints" / "last.ckpt", rest_joints=rest)
    assert by_file.denoiser.architecture == STMC_TINY and by_file.timesteps == 50


def test_stmc_defaults_and_the_skeleton_warning(tmp_path):
    architecture = Architecture(latent_dim=32, ff_size=48, layers=1, heads=8)
    folder = write_stmc(tmp_path / "run", tensors(architecture))
    with pytest.warns(UserWarning, match=r"no rest_joints\.npy"):
        prior = load_prior(folder)
    assert prior.denoiser.architecture == architecture and prior.timesteps == 100 and prior.fps == 20.0
    assert float(prior.rest_joints[0, 1] - prior.rest_joints[10, 1]) == pytest.approx(0.92)


def test_stmc_statistics_that_disagree_are_warned_about(tmp_path):
    state = tensors(STMC_TINY)
    folder = write_stmc(tmp_path / "run", state, stmc_config())
    for kind in ("motion", "text"):
        (folder / f"{kind}_stats").mkdir()
        for name in ("mean", "std"):
            torch.save(state[f"{kind}_normalizer.{name}"].clone(), folder / f"{kind}_stats" / f"{name}.pt")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_prior(folder, rest_joints=torch.zeros(24, 3))
    torch.save(state["text_normalizer.std"] + 1, folder / "text_stats" / "std.pt")
    with pytest.warns(UserWarning, match=r"text_stats.*std\.pt"):
        prior = load_prior(folder, rest_joints=torch.zeros(24, 3))
    torch.testing.assert_close(prior.text_std, state["text_normalizer.std"])


class Untrusted:
    """Any object that is no tensor."""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {f"model.{k}": v for k, v in s.items()}, "registers is missing"),
        (lambda s: {"input_process.poseEmbedding.weight": torch.zeros(2, 263)}, "input_process.poseEmbedding"),
        (lambda s: {k: v for k, v in s.items() if k != "motion_normalizer.std"}, "motion_normalizer.std"),
        (lambda s: s | {"denoiser.skel_embedding.weight": torch.zeros(32, 263)}, "263 features"),
        (lambda s: s | {"denoiser.extra.weight": torch.zeros(1)}, r"surplus: denoiser\.extra\.weight$"),
        (lambda s: s | {f"ema.{k}": v for k, v in s.items()}, r"surplus: ema\.denoiser.* and \d+ more$"),
        (
            lambda s: {k: v for k, v in s.items() if "norm1.bias" not in k},
            r"missing: denoiser\.seqTransEncoder\.layers\.0\.norm1\.bias, denoiser\.\S+1\.norm1\.bias$",
        ),
        (
            lambda s: s | {"denoiser.to_skel_layer.bias": torch.zeros(7)},
            r"of shape: denoiser\.to_skel_layer\.bias \(7,\), not \(205,\)$",
        ),
        (lambda s: s | {"text_normalizer.mean": torch.zeros(768)}, r"text_normalizer\.mean \(768,\), not \(512,\)$"),
        (lambda s: s | {"denoiser.registers": torch.zeros(3)}, "registers must be a matrix"),
        (lambda s: s | {"object": Untrusted()}, "re-save it once"),
    ],
)
def test_other_checkpoints_are_refused_in_one_line(tmp_path, change, message):
    folder = write_stmc(tmp_path / "run", change(tensors(STMC_TINY)), stmc_config())
    with pytest.raises(InputError, match=message) as caught:
        load_prior(folder, rest_joints=torch.zeros(24, 3))
    assert "\n" not in str(caught.value)


def test_stmc_without_clip_says_what_is_wanted(tmp_path):
    folder = write_stmc(tmp_path / "run", tensors(STMC_TINY), stmc_config())
    (folder / "clip" / "model.safetensors").unlink()
    with pytest.raises(InputError, match="clip-vit-base-patch32"):
        load_prior(folder, rest_joints=torch.zeros(24, 3))


def test_own_format_round_trip(tmp_path):
    state = tensors(OWN_TINY)
    write_prior(tmp_path, state, own_description())
    for path in (tmp_path, tmp_path / "prior.json", tmp_path / "prior.safetensors"):
        prior = load_prior(path)
        assert prior.denoiser.architecture == OWN_TINY and prior.timesteps == 20
        assert torch.equal(prior.std, state["motion_normalizer.std"])
        assert torch.equal(prior.denoiser.registers, state["denoiser.registers"].half().float())
        assert prior.rest_joints[1].tolist() == [3, 4, 5]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["prior.json", "prior.safetensors"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "something else"}, "format"),
        ({"architecture": {"width": 3}}, "width"),
        ({"timesteps": None}, "timesteps|NoneType"),
        ({"text_encoder": {"sha256": "0"}}, "text encoder"),
        ({"architecture": asdict(OWN_TINY) | {"layers": 2}}, "another architecture"),
    ],
)
def test_damaged_descriptions_are_refused(tmp_path, change, message):
    write_prior(tmp_path, tensors(OWN_TINY), own_description() | change)
    with pytest.raises(InputError, match=message) as caught:
        load_prior(tmp_path)
    assert "\n" not in str(caught.value)


def test_damaged_weights_are_refused(tmp_path):
    write_prior(tmp_path, tensors(OWN_TINY), own_description())
    weights = tmp_path / "prior.safetensors"
    weights.write_bytes(weights.read_bytes()[:-10])
    with pytest.raises(InputError, match="cannot be read"):
        load_prior(tmp_path)
    weights.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        load_prior(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        load_prior(tmp_path / "nowhere")


def test_guidance_in_one_pass_is_the_formula():
    prior = synthetic_prior()
    generator = torch.Generator().manual_seed(0)
    x, t = torch.randn(3, 8, 205, generator=generator), torch.tensor([0, 4, 9])
    text = prior.encode_text(["kick"])
    with torch.no_grad():
        with_text = prior.denoiser(x, t, text.expand(3, -1))
        without = prior.denoiser(x, t, prior.encode_text([""]).expand(3, -1))
    got = prior.predict_x0(x, t, text, 7.5)
    torch.testing.assert_close(got, without + 7.5 * (with_text - without), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(prior.predict_x0(x, t, text, 1.0), with_text, atol=1e-5, rtol=1e-4)
    x.requires_grad_()
    assert not prior.predict_x0(x, t, text, 7.5).requires_grad
    assert prior.predict_x0(x.double(), t, text, 2.0).dtype == torch.float64


def test_normalising_is_undone():
    prior = synthetic_prior()
    features = torch.randn(4, 205, dtype=torch.float64)
    torch.testing.assert_close(prior.denormalise(prior.normalise(features)), features)
    rows = prior.encode_text(["", "kick"])
    torch.testing.assert_close(rows, (torch.tensor([[0.0], [0.4]]) - prior.text_mean) / prior.text_std)


def test_sampling_repeats_with_its_seed():
    prior = synthetic_prior()
    first, again, other = (prior.sample("kick", 6, 2.0, torch.Generator().manual_seed(s)) for s in (0, 0, 1))
    assert first.shape == (6, 205) and torch.equal(first, again) and not torch.equal(first, other)


LEFT_FOOT, RIGHT_FOOT, LEFT_HAND, RIGHT_HAND = 10, 11, 22, 23


@pytest.mark.parametrize(
    ("prompt", "limb", "slowest"),
    [
        ("a person kicks a soccer ball with the right foot", RIGHT_FOOT, 4.0),
        ("a person punches with the left hand", LEFT_HAND, 2.5),
    ],
)
def test_the_embedded_prior_strikes_with_the_limb_it_is_told(prompt, limb, slowest):
    prior = load_prior()
    features = prior.sample(prompt, 40, 2.5, torch.Generator().manual_seed(0))
    translation, orientation, body_pose = decode(features)
    joints = joint_positions(translation, orientation, body_pose, prior.rest_joints)
    speed = prior.fps * joints.diff(dim=0).norm(dim=-1).amax(dim=0)
    strikers = [LEFT_FOOT, RIGHT_FOOT, LEFT_HAND, RIGHT_HAND]
    assert strikers[int(speed[strikers].argmax())] == limb
    assert slowest < float(speed[limb]) < 16
    assert 0.6 < float(translation[:, 2].mean()) < 1.2  # on its feet
    positions = features[:, 136:].unflatten(-1, (23, 3))[0]  # the first frame faces +Y: turned by pi
    torch.testing.assert_close(positions[..., 2], joints[0, 1:, 2] - joints[0, 0, 2], atol=0.15, rtol=0)
