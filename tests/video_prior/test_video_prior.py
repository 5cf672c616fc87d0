"""The embedded video prior: its training clips, its network, its file, its training."""

import argparse
import hashlib
import json
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from hoi.errors import InputError
from hoi.motion.prior import load_prior
from hoi.motion.text import MINILM_SHA256, TextEncoder
from hoi.training.video import contacts, train
from hoi.training.video import training as trainings
from hoi.training.video.captions import SENTENCES, captions
from hoi.training.video.clips import Clips, draw, load_clips, render, save_clips
from hoi.training.video.contacts import CLEAN, FLAWS, LIMBS, OBJECT_SHARES, PEOPLE, Solid, sample_motions, spoil
from hoi.video_prior.denoiser import Architecture, VideoDenoiser, alphas_cumprod
from hoi.video_prior.embedded import (
    CLIP_FRAMES,
    MEAN,
    SIZE,
    SPREAD,
    Description,
    EmbeddedPrior,
    basis,
    load_embedded,
    save_embedded,
    to_latents,
)
from hoi.video_prior.files import VIDEO_PRIOR_NAME

TINY = Architecture(channels=(16, 16), embedding=16, heads=2, text_dim=8)


def fake_encoder(dim: int = 8) -> TextEncoder:
    """A sentence's numbers come from its digest."""

    def compute(sentences: list[str]) -> torch.Tensor:
        digests = [hashlib.sha256(sentence.encode()).digest()[:dim] for sentence in sentences]
        return torch.tensor([list(digest) for digest in digests], dtype=torch.float32) / 255

    return TextEncoder("fake", MINILM_SHA256, compute)


def random_denoiser(seed: int = 0) -> VideoDenoiser:
    """Tiny; layers that start at zero are given numbers, so that every input matters."""
    torch.manual_seed(seed)
    denoiser = VideoDenoiser(TINY)
    with torch.no_grad():
        for parameter in denoiser.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    return denoiser.eval().requires_grad_(False)


def tiny_prior() -> EmbeddedPrior:
    prior = EmbeddedPrior(random_denoiser(), torch.zeros(8), torch.ones(8), fake_encoder(), "tiny")
    prior.prepare("the foot touches the ball", "foot inside the ball")
    return prior


@pytest.fixture(scope="module")
def staged() -> list[contacts.Contact]:
    prior = load_prior()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contacts, "PERSON_GAUSSIANS", 3000)
        patch.setattr(contacts, "MOTION_STEPS", 10)
        contacts.people.cache_clear()
        motions = sample_motions(prior, 8, seed=3)
        draws = (contacts.stage_contact(motions, prior, np.random.default_rng([3, i])) for i in range(40))
        found = list(islice((contact for contact in draws if contact is not None), 6))
    contacts.people.cache_clear()
    assert len(found) == 6
    return found


# --- contacts ---------------------------------------------------------------------------------------------------------


def test_distance_to_a_turned_box_is_that_to_its_nearest_surface_point() -> None:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    box = Solid(False, np.array([0.2, 0.3, 0.5]), turn)
    centre = np.array([1.0, -2.0, 0.5])
    local = rng.uniform(-1, 1, (40_000, 3)) * box.half
    axis = rng.integers(3, size=len(local))
    local[np.arange(len(local)), axis] = np.sign(local[np.arange(len(local)), axis]) * box.half[axis]
    surface = local @ turn.T + centre
    assert np.abs(box.distance(surface, centre)).max() < 1e-12
    points = centre + rng.uniform(-0.8, 0.8, (30, 3))
    nearest = np.linalg.norm(points[:, None] - surface, axis=2).min(axis=1)
    inside = (np.abs((points - centre) @ turn) < box.half).all(axis=1)
    assert 0 < inside.sum() < len(points)
    np.testing.assert_allclose(box.distance(points, centre), np.where(inside, -nearest, nearest), atol=0.02)


def test_distance_to_a_ball() -> None:
    ball = Solid(True, np.full(3, 0.11), np.eye(3))
    points = np.array([[0.0, 0, 0], [0.11, 0, 0], [0, 0.31, 0]])
    np.testing.assert_allclose(ball.distance(points, np.zeros(3)), [-0.11, 0, 0.2], atol=1e-12)


def test_clean_contacts_touch_and_do_not_enter(staged: list[contacts.Contact]) -> None:
    for contact in staged:
        still = np.zeros((CLIP_FRAMES, 3))
        distances = contact.distances(still)
        assert distances.min() >= -CLEAN
        # Where they touch is on the object as it stands at t_c, which between frames is a little before it left.
        arrived = contact.centres[contact.times <= 0][-1]
        velocity = (contact.centres[1] - contact.centres[0]) * -contact.times[contact.times <= 0][-1]
        assert abs(contact.solid.distance(contact.point, arrived + velocity)) <= CLEAN
        if 0 in contact.times:
            assert abs(distances[contact.times == 0][0]) <= CLEAN
        after = contact.centres[-1] - contact.centres[contact.times <= 0][-1]
        assert after @ contact.strike > 0


def test_flaws_are_as_deep_or_as_wide_as_told(staged: list[contacts.Contact]) -> None:
    rng = np.random.default_rng(1)
    made = 0
    for contact in staged:
        for kind in FLAWS:
            flaw = spoil(contact, kind, rng)
            if flaw is None:
                continue
            made += 1
            shift, amount = flaw
            distances = contact.distances(shift)
            if kind == "inside":
                assert contacts.LEAST_FLAW <= amount <= contacts.FLAW[1]
                assert distances.min() == pytest.approx(-amount)
            else:
                assert distances[np.abs(contact.times).argmin()] == pytest.approx(-amount)
                assert amount <= -contacts.LEAST_FLAW
    assert made >= 6


def test_clean_and_flawed_differ_by_the_contact_alone(staged: list[contacts.Contact]) -> None:
    contact = staged[0]
    still = np.zeros((CLIP_FRAMES, 3))
    pushed = 0.05 * np.exp(-(contact.times[:, None] ** 2)) * contact.strike
    clips = draw(contact, [still, pushed], np.random.default_rng(5))
    assert clips.shape == (2, 2, CLIP_FRAMES, SIZE, SIZE, 3) and clips.dtype == np.uint8
    np.testing.assert_array_equal(clips[0, 0], clips[0, 1])
    assert (clips[1, 0] != clips[1, 1]).any()
    assert clips[0].std() > 5
    np.testing.assert_array_equal(clips, draw(contact, [still, pushed], np.random.default_rng(5)))


def test_pictures_follow_the_push(staged: list[contacts.Contact]) -> None:
    from hoi.refine.views import Framing, viewpoint

    contact = staged[0]
    azimuth = np.arctan2(contact.strike[1], contact.strike[0]) + np.pi / 2
    camera = viewpoint(Framing(contact.point, 0.28), azimuth, width=SIZE, height=SIZE)
    shift = torch.zeros(CLIP_FRAMES, 3, requires_grad=True)
    video = render(contact, shift, camera)
    video[2].square().sum().backward()
    assert shift.grad is not None
    assert shift.grad[2].abs().sum() > 0
    assert (shift.grad[[0, 1, 3, 4]] == 0).all()


def test_captions_say_what_is_seen() -> None:
    for limb, _ in enumerate(LIMBS):
        for shape, name in enumerate(OBJECT_SHARES):
            said = {key: captions(limb, shape, 0, key) for key in SENTENCES}
            everything = [sentence for sentences in said.values() for sentence in sentences]
            assert len(set(everything)) == len(everything)
            assert not any("{" in sentence for sentence in everything)
            assert any(name.replace("_", " ") in sentence for sentence in said["clean"])
            assert any(LIMBS[limb].name in sentence for sentence in said["clean"])
            assert all("gap" in s.lower() and "penetration" in s.lower() for s in said["flawed"])


def test_clips_survive_the_disk(tmp_path) -> None:
    clips = random_clips(3)
    save_clips(clips, tmp_path / "clips.npz")
    again = load_clips(tmp_path / "clips.npz")
    np.testing.assert_array_equal(clips.video, again.video)
    np.testing.assert_array_equal(clips.amount, again.amount)
    save_clips(replace(clips, video=clips.video[:, :, :, :2]), tmp_path / "short.npz")
    (tmp_path / "broken.npz").write_bytes(b"PK nothing")
    for name in ("short.npz", "broken.npz", "none.npz"):
        with pytest.raises(InputError, match=name):
            load_clips(tmp_path / name)


# --- the prior --------------------------------------------------------------------------------------------------------


def test_schedule_is_cogvideox_5b_s() -> None:
    alpha_bar = alphas_cumprod()
    assert alpha_bar.shape == (1000,) and alpha_bar.dtype == torch.float64
    assert (alpha_bar.diff() < 0).all()
    for t, value in {100: 0.887, 300: 0.565, 500: 0.241, 700: 0.055}.items():
        assert float(alpha_bar[t]) == pytest.approx(value, rel=0.01)
    assert float(alpha_bar[980]) == pytest.approx(8.2e-5, rel=0.1)  # in float32 there
    assert float(alpha_bar[-1]) == pytest.approx(0, abs=1e-12)


def test_latents_are_the_pixels() -> None:
    video = torch.rand(CLIP_FRAMES, 3, SIZE, SIZE, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    latents = to_latents(video, 4)
    assert latents.shape == (CLIP_FRAMES, 48, 16, 16)
    pixels = torch.einsum("zc,fzhw->fchw", basis(4).to(latents), latents)
    torch.testing.assert_close(torch.nn.functional.pixel_shuffle(pixels * SPREAD + MEAN, 4), video)
    assert torch.autograd.gradcheck(lambda v: to_latents(v, 4), torch.rand(1, 3, 8, 8).double().requires_grad_())


def test_denoiser_sees_time_text_and_the_other_frames() -> None:
    denoiser, generator = random_denoiser(), torch.Generator().manual_seed(1)
    z = torch.randn(2, CLIP_FRAMES, 48, 16, 16, generator=generator)
    t, text = torch.tensor([10, 900]), torch.randn(2, 8, generator=generator)
    v = denoiser(z, t, text)
    assert v.shape == z.shape
    torch.testing.assert_close(denoiser(z[1:], t[1:], text[1:]), v[1:], rtol=1e-3, atol=1e-4)
    for changed in (denoiser(z, t + 50, text), denoiser(z, t, -text)):
        assert (changed - v).abs().max() > 1e-3
    other = z.clone()
    other[:, 4] += 1
    assert (denoiser(other, t, text) - v)[:, 0].abs().max() > 1e-5


def test_guidance_leads_away_from_the_negative_prompt() -> None:
    prior = tiny_prior()
    z = torch.randn(CLIP_FRAMES, 48, 16, 16, generator=torch.Generator().manual_seed(2))
    negative, positive = prior.branches(z, 300)
    assert (positive - negative).abs().max() > 1e-3
    for guidance in (0.0, 1.0, 7.5, 100.0):
        expected = negative + guidance * (positive - negative)
        torch.testing.assert_close(prior.velocity(z, 300, guidance), expected, rtol=1e-4, atol=1e-3)
    rescaled = prior.velocity(z, 300, 100.0, rescale=1.0)
    assert float(rescaled.std()) == pytest.approx(float(positive.std()), rel=1e-3)


def test_text_comes_first() -> None:
    prior = EmbeddedPrior(random_denoiser(), torch.zeros(8), torch.ones(8), fake_encoder(), "tiny")
    with pytest.raises(RuntimeError, match="prepare"):
        prior.velocity(torch.zeros(CLIP_FRAMES, 48, 16, 16), 10, 1.0)


@pytest.mark.parametrize(
    ("first", "last", "total", "frames"),
    [
        (19, 21, 40, [18, 19, 20, 21, 22]),
        (12, 13, 40, [10, 11, 12, 13, 14]),
        (0, 1, 40, [0, 0, 0, 1, 2]),
        (38, 39, 40, [36, 37, 38, 39, 39]),
        (3, 7, 40, [3, 4, 5, 6, 7]),
    ],
)
def test_clip_is_around_the_window(first: int, last: int, total: int, frames: list[int]) -> None:
    assert tiny_prior().clip_frames(first, last, total) == frames


def test_a_window_of_more_frames_than_the_clip_is_refused() -> None:
    with pytest.raises(InputError, match="half_width"):
        tiny_prior().clip_frames(3, 8, 40)


def test_prior_survives_the_disk(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("hoi.video_prior.embedded.minilm", lambda cache: fake_encoder())
    denoiser, text = random_denoiser(), (torch.full((8,), 0.5), torch.full((8,), 0.25))
    file = tmp_path / VIDEO_PRIOR_NAME
    save_embedded(file, denoiser.state_dict(), text, Description(TINY, 7, MINILM_SHA256))
    prior = load_embedded(tmp_path)
    assert "7 training steps" in prior.name
    prior.prepare("a man kicks the ball", "")
    z = torch.randn(CLIP_FRAMES, 48, 16, 16, generator=torch.Generator().manual_seed(3))
    embedded = (fake_encoder().embed(["a man kicks the ball"]) - text[0]) / text[1]
    expected = denoiser(z[None], torch.tensor([200]), embedded)[0]
    assert (prior.velocity(z, 200, 1.0) - expected).abs().max() < 0.05 * expected.abs().max()  # half precision

    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match="cannot be read"):
        load_embedded(file)
    save_embedded(
        file, denoiser.state_dict(), text, Description(replace(TINY, heads=1, embedding=32), 7, MINILM_SHA256)
    )
    with pytest.raises(InputError, match="size mismatch"):
        load_embedded(file)
    save_embedded(file, denoiser.state_dict(), text, Description(TINY, 7, "0" * 64))
    with pytest.raises(InputError, match="text encoder"):
        load_embedded(file)
    for none in (tmp_path / "none.safetensors", tmp_path.parent):
        with pytest.raises(InputError, match="no embedded video prior at"):
            load_embedded(none)


# --- training ---------------------------------------------------------------------------------------------------------


def random_clips(views: int, seed: int = 0) -> Clips:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (views, len(FLAWS), 2, 1, 2, 2, 3), dtype=np.uint8)
    video = coarse.repeat(CLIP_FRAMES, 3).repeat(SIZE // 2, 4).repeat(SIZE // 2, 5)
    numbers = (rng.integers(len(names), size=views).astype(np.int16) for names in (LIMBS, OBJECT_SHARES, PEOPLE))
    return Clips(video, rng.normal(size=(views, len(FLAWS))).astype(np.float32), *numbers)


def options_for(*words: str) -> argparse.Namespace:
    small = ["--channels", "16", "16", "--batch", "6", "--warmup", "2", "--test-clips", "2", "--threads", "1"]
    return train.parser().parse_args([*small, *words])


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """Training on random clips with a text encoder that costs nothing."""
    monkeypatch.setattr(trainings, "minilm", lambda: fake_encoder())
    monkeypatch.setattr(trainings, "provide_clips", lambda folder, views, seed: random_clips(views, seed))
    threads = torch.get_num_threads()
    yield tmp_path
    torch.set_num_threads(threads)


def test_a_view_is_seen_clean_and_flawed_and_flawed_is_mended(quick) -> None:
    training = trainings.Training(random_clips(8), options_for("--out", str(quick)))
    z, wanted, noise, t, text = training.batch()
    assert z.shape == wanted.shape == noise.shape == (6, CLIP_FRAMES, 48, 16, 16)
    assert text.shape == (6, 8)
    clean, flawed, mended = z.split(2)
    torch.testing.assert_close(torch.cat([clean, flawed, clean]), wanted)
    torch.testing.assert_close(mended, flawed)
    assert (clean - flawed).abs().max() > 0
    torch.testing.assert_close(noise[:2], noise[4:])
    torch.testing.assert_close(t[:2].clamp(min=trainings.MEND_FROM), t[4:])


def test_the_velocity_asked_for_gives_what_is_wanted(quick) -> None:
    """A denoiser that answers exactly that velocity has no loss, and its z_hat is the clean clip."""
    from hoi.method.video_sds import predict_z

    training = trainings.Training(random_clips(8), options_for("--out", str(quick)))
    z, wanted, noise, t, text = training.batch()
    alpha_bar = training.alphas_cumprod.to(z)[t][:, None, None, None, None]
    told = []

    class Perfect(torch.nn.Module):
        unknown = staticmethod(training.denoiser.unknown)

        def forward(self, z_t, t, text):
            v = (alpha_bar.sqrt() * z_t - wanted) / (1 - alpha_bar).sqrt()
            told.append(predict_z(z_t, v, alpha_bar))
            return v

    weighted, plain = training.losses(Perfect(), z, wanted, noise, t, text)
    assert float(weighted.max()) == float(plain.max()) == 0
    torch.testing.assert_close(told[0], wanted, rtol=1e-3, atol=1e-3)


def test_training_resumes_exactly_and_leaves_a_prior(quick, monkeypatch) -> None:
    whole, broken = quick / "whole", quick / "broken"
    base = ("--clips", "12", "--lr", "3e-3", "--save-minutes", "0")
    trainings.train(options_for("--out", str(whole), "--steps", "8", *base), "whole")
    # The schedule is fitted to the steps, so that the first half is run as a part of the same whole.
    monkeypatch.setattr(trainings.Training, "progress", lambda self: self.step / 8 if self.step < stop else 1.0)
    stop = 3
    trainings.train(options_for("--out", str(broken), "--steps", "8", *base), "first part")
    stop = 8
    trainings.train(options_for("--out", str(broken), "--steps", "8", *base, "--resume"), "second part")
    one, two = (torch.load(f / "checkpoint.pt", weights_only=True) for f in (whole, broken))
    assert one["step"] == two["step"] == 8
    assert all(torch.equal(value, two["denoiser"][name]) for name, value in one["denoiser"].items())
    torch.manual_seed(0)
    fresh = VideoDenoiser(Architecture(channels=(16, 16), text_dim=8)).state_dict()
    assert max(float((value - fresh[name]).abs().max()) for name, value in one["denoiser"].items()) > 1e-3
    report = json.loads((broken / "training.json").read_text())
    assert report["steps"] == 8 and report["clips"]["views"] == 12
    assert (broken / "curve.png").stat().st_size > 1000
    monkeypatch.setattr("hoi.video_prior.embedded.minilm", lambda cache: fake_encoder())
    prior = load_embedded(broken)
    prior.prepare("a", "b")
    assert prior.velocity(torch.zeros(CLIP_FRAMES, 48, 16, 16), 500, 2.0).isfinite().all()


def test_nothing_to_resume_is_told_in_one_line(quick) -> None:
    with pytest.raises(InputError, match="--resume"):
        trainings.train(options_for("--out", str(quick), "--resume"), "")


def test_training_learns(quick) -> None:
    options = options_for("--out", str(quick), "--lr", "4e-3", "--batch", "9", "--steps", "100", "--time-power", "1")
    training = trainings.Training(random_clips(4), options)
    training.denoiser.variance.fill_(1)  # nothing is known of the clips
    batch = training.batch()

    def loss() -> float:
        return float(training.losses(training.denoiser, *batch)[1].detach().mean())

    before = loss()
    for _ in range(20):
        training.advance()
    assert loss() < 0.9 * before


def test_an_untrained_denoiser_is_the_best_linear_one() -> None:
    torch.manual_seed(0)
    denoiser, generator = VideoDenoiser(TINY), torch.Generator().manual_seed(4)
    denoiser.variance.copy_(torch.linspace(0.1, 3, 48))
    shape = (64, CLIP_FRAMES, 48, 16, 16)
    z = denoiser.variance[:, None, None].sqrt() * torch.randn(shape, generator=generator)
    noise = torch.randn(shape, generator=generator)
    alpha_bar = alphas_cumprod()[400].float()
    z_t, v = (
        alpha_bar.sqrt() * z + (1 - alpha_bar).sqrt() * noise,
        alpha_bar.sqrt() * noise - (1 - alpha_bar).sqrt() * z,
    )
    with torch.no_grad():
        told = denoiser(z_t, torch.full((64,), 400), torch.zeros(64, 8))
    slope = (v * z_t).mean((0, 1, 3, 4)) / z_t.square().mean((0, 1, 3, 4))
    torch.testing.assert_close(told, slope[:, None, None] * z_t, rtol=0.05, atol=0.05)
