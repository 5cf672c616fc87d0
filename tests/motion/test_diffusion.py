import pytest
import torch

from hoi.motion.diffusion import ancestral_sample, cosine_alphas_cumprod, ddim_sample, guide, posterior, q_sample

PUBLISHED = {
    0: 0.99937, 1: 0.99825, 5: 0.98897, 10: 0.96672, 25: 0.83562, 50: 0.47826, 75: 0.13349, 90: 0.01954, 95: 3.88e-3,
    98: 2.43e-4, 99: 2.4e-7,
}  # fmt: skip


def test_schedule_is_the_published_one():
    abar = cosine_alphas_cumprod(100)
    assert abar.dtype == torch.float64 and abar.shape == (100,)
    for t, value in PUBLISHED.items():
        assert float(abar[t]) == pytest.approx(value, rel=0.02 if t > 90 else 0, abs=6e-6 if t <= 90 else 0)
    assert (abar.diff() < 0).all()
    assert float(1 - abar[99] / abar[98]) == pytest.approx(0.999)


def test_q_sample_mixes_signal_and_noise_by_timestep():
    abar = cosine_alphas_cumprod(100)
    generator = torch.Generator().manual_seed(0)
    x0, noise = torch.randn(2, 3, 4, 5, generator=generator, dtype=torch.float64)
    t = torch.tensor([0, 50, 99])
    x_t = q_sample(x0, t, noise, abar)
    scale = abar[t][:, None, None]
    torch.testing.assert_close((x_t - (1 - scale).sqrt() * noise) / scale.sqrt(), x0, atol=1e-9, rtol=0)
    torch.testing.assert_close(x_t[2], noise[2], atol=2e-3, rtol=0)


def test_guidance_extrapolates():
    without, with_text = torch.tensor([1.0]), torch.tensor([2.0])
    assert guide(without, with_text, 0) == 1 and guide(without, with_text, 1) == 2
    assert guide(without, with_text, 7.5) == 8.5


def test_rescaled_guidance_has_the_conditional_spread():
    generator = torch.Generator().manual_seed(0)
    without, with_text = torch.randn(2, 3, 40, 8, generator=generator)
    guided, plain = guide(without, with_text, 7.5, rescale=1.0), guide(without, with_text, 7.5)
    torch.testing.assert_close(guided.std((1, 2)), with_text.std((1, 2)))
    torch.testing.assert_close(guided / plain, (guided / plain)[:, :1, :1].expand_as(plain))
    torch.testing.assert_close(guide(without, with_text, 7.5, rescale=0.5), (guided + plain) / 2)


def test_posterior_agrees_with_bayes():
    """q(x_{t-1} | x_t, x0) is the product of q(x_t | x_{t-1}) and q(x_{t-1} | x0), both Gaussian."""
    abar, t, x0, x_t = cosine_alphas_cumprod(100), 40, 0.7, -0.4
    before, after = float(abar[t - 1]), float(abar[t])
    alpha = after / before
    precision = alpha / (1 - alpha) + 1 / (1 - before)
    mean = (alpha**0.5 * x_t / (1 - alpha) + before**0.5 * x0 / (1 - before)) / precision
    got, variance = posterior(torch.tensor(x0), torch.tensor(x_t), t, abar)
    assert float(got) == pytest.approx(mean, rel=1e-5) and variance == pytest.approx(1 / precision, rel=1e-9)


@pytest.mark.parametrize(("steps", "compat"), [(100, False), (100, True), (20, False)])
def test_ancestral_sampling_of_gaussian_data(steps, compat):
    """Data N(0.5, 0.3^2) has a linear denoiser, so the variance of the samples is known step by step. The published
    sampler takes the posterior's variance for its deviation and draws too narrow a spread."""
    abar, mean, std = cosine_alphas_cumprod(100), 0.5, 0.3
    gain = abar.sqrt() * std**2 / (abar * std**2 + 1 - abar)

    def predict(x, t):
        return mean + (gain[t][:, None, None] * (x - abar[t].sqrt()[:, None, None] * mean)).float()

    kept = torch.linspace(0, 99, steps).round().long()
    expected = 1.0
    for at in range(steps - 1, 0, -1):
        slope, variance = posterior(gain[kept][at], torch.tensor(1.0, dtype=torch.float64), at, abar[kept])
        expected = float(slope) ** 2 * expected + (variance**2 if compat else variance)
    expected = float(gain[0]) * expected**0.5

    generator = torch.Generator().manual_seed(0)
    x = ancestral_sample(predict, (400, 10, 5), abar, generator, steps, stmc_compat_sigma=compat)
    assert float(x.mean()) == pytest.approx(mean, abs=0.01)
    assert float(x.std()) == pytest.approx(expected, rel=0.02)
    assert (expected < 0.2 * std) if compat else (expected == pytest.approx(std, rel=0.1 if steps == 100 else 0.25))


@pytest.mark.parametrize("sample", [ancestral_sample, ddim_sample])
def test_a_row_is_the_same_in_whatever_batch(sample):
    def draw(seeds) -> torch.Tensor:
        generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        return sample(lambda x, t: 0.5 * x, (len(seeds), 3, 2), cosine_alphas_cumprod(10), generators, 4)

    assert torch.equal(draw([5, 6, 7])[1:2], draw([6]))


def test_sampling_repeats_with_its_seed():
    def draw(seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        return ancestral_sample(lambda x, t: 0.5 * x, (1, 3, 2), cosine_alphas_cumprod(10), generator)

    assert torch.equal(draw(1), draw(1)) and not torch.equal(draw(1), draw(2))


@pytest.mark.parametrize(("steps", "tolerance"), [(100, 0.03), (20, 0.12)])
def test_ddim_of_gaussian_data(steps, tolerance):
    """The deterministic path carries the noise's distribution to that of the data N(0.5, 0.3^2)."""
    abar, mean, std = cosine_alphas_cumprod(100), 0.5, 0.3
    gain = abar.sqrt() * std**2 / (abar * std**2 + 1 - abar)

    def predict(x, t):
        return mean + (gain[t][:, None, None] * (x - abar[t].sqrt()[:, None, None] * mean)).float()

    x = ddim_sample(predict, (400, 10, 5), abar, torch.Generator().manual_seed(0), steps)
    assert float(x.mean()) == pytest.approx(mean, abs=0.01)
    assert float(x.std()) == pytest.approx(std, rel=tolerance)


def test_ddim_counts_its_steps_and_repeats():
    calls: list[int] = []

    def predict(x, t):
        calls.append(int(t[0]))
        return 0.5 * x

    def draw(steps: int) -> torch.Tensor:
        return ddim_sample(predict, (1, 3, 2), cosine_alphas_cumprod(10), torch.Generator().manual_seed(1), steps)

    first = draw(4)
    assert calls == [9, 6, 3, 0]
    assert torch.equal(first, draw(4))
    assert torch.isfinite(draw(1)).all()
    for steps in (0, 11):
        with pytest.raises(ValueError, match="steps must be in"):
            draw(steps)
