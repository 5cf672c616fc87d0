"""Sentences in time: each has its body parts and its time, together they are one motion, without pops."""

import math

import numpy as np
import pytest
import torch
from test_prior import synthetic_prior

from hoi.body.kinematics import forward_kinematics, local_rotations
from hoi.data import Act
from hoi.method.hmsd import ScoreDistillation
from hoi.motion import collage, features
from hoi.motion.collage import Timeline, layout
from hoi.motion.diffusion import ancestral_sample
from hoi.motion.prior import load_prior

FPS, LENGTHS = 20.0, (40, 50)
RUN, KICK, WALK = Act("a person runs", 0, 2), Act("a person kicks", 2, 4), Act("a person walks", 4, 9)
WAVE = Act("a person waves", 1, 3, ("left_arm",))
TIMELINES = {
    "one": (Act("a person kicks", 0, 2),),
    "three": (RUN, KICK, WALK),
    "an arm beside": (Act("a person walks", 0, 5), WAVE),
    "an arm across two": (RUN, KICK, WAVE),
    "gaps": (Act("a person runs", 1, 2), Act("a person kicks", 4, 5.5)),
    "parts alone": (Act("a person kicks", 0, 2, ("legs",)), WAVE),
    "short ones": tuple(Act(f"act {k}", 0.5 * k, 0.5 * k + 0.5) for k in range(8)),
    "one long one": (Act("a person walks", 0, 20),),
    "a strike with a time": (RUN, Act("a person kicks", 2, 4, strikes="right_foot", at=2.2), WALK),
}


def rebuilt(acts, frames, lengths=LENGTHS) -> torch.Tensor:
    """What the windows' shares sum to, (T, 205)."""
    found = layout(acts, frames, FPS, lengths)
    whole = torch.zeros(frames, features.FEATURE_COUNT)
    for start, weights in zip(found.starts, found.weights, strict=True):
        assert 0 <= start <= frames - found.length
        whole[start : start + found.length] += weights
    return whole


def test_each_feature_belongs_to_one_part():
    columns = sorted(column for part in features.PARTS for column in features.columns_of(part))
    assert columns == list(range(features.FEATURE_COUNT))
    assert features.columns_of("head") == [
        76,
        77,
        78,
        79,
        80,
        81,
        *range(94, 100),
        169,
        170,
        171,
        178,
        179,
        180,
    ]  # STMC's


@pytest.mark.parametrize("frames", [40, 61, 180, 400])
@pytest.mark.parametrize("name", TIMELINES)
@pytest.mark.parametrize("lengths", [(40, 50), (40, 200)])
def test_shares_sum_to_one(name, frames, lengths):
    acts = tuple(act for act in TIMELINES[name] if act.start * FPS < frames)
    found = layout(acts, frames, FPS, lengths)
    assert min(lengths[0], frames) <= found.length <= lengths[1] and float(found.weights.min()) >= 0
    torch.testing.assert_close(rebuilt(acts, frames, lengths), torch.ones(frames, features.FEATURE_COUNT))


def test_parts_and_times_are_whose_they_are():
    """In the middle of its time an act has all of its own parts, and none of another's."""
    acts = TIMELINES["an arm beside"]
    found = layout(acts, 100, FPS, LENGTHS)
    arm, legs = features.columns_of("left_arm"), features.columns_of("legs")

    def share(act: int, frame: int, columns: list[int]) -> float:
        of = [c for c, owner in enumerate(found.acts) if owner == act and 0 <= frame - found.starts[c] < found.length]
        return sum(float(found.weights[c, frame - found.starts[c], columns].mean()) for c in of)

    assert share(1, 40, arm) == pytest.approx(1) and share(0, 40, arm) == pytest.approx(0)
    assert share(0, 40, legs) == pytest.approx(1) and share(1, 40, legs) == pytest.approx(0)
    assert share(0, 5, arm) == pytest.approx(1) and share(0, 95, arm) == pytest.approx(1)
    assert share(1, 20, arm) == pytest.approx(0.5, abs=0.1)  # in the middle of its fade


def test_a_strike_with_a_time_lies_where_the_prior_strikes():
    acts = (RUN, Act("a person kicks", 2, 3, strikes="right_foot", at=2.4), Act("a person walks", 3, 5))
    found = layout(acts, 100, FPS, LENGTHS)
    (start,) = [start for act, start in zip(found.acts, found.starts, strict=True) if act == 1]
    assert start / FPS + collage.PEAK == pytest.approx(2.4, abs=0.06)


def test_an_act_that_is_all_is_the_priors_own_prediction():
    prior = synthetic_prior()
    act = Act("a person kicks", 0, 2)
    x, t = torch.randn(2, 40, 205, generator=torch.Generator().manual_seed(0)), torch.tensor([3, 7])
    whole = Timeline.of(prior, (act,)).predict_x0(x, t, 4.0, 0.5)
    alone = prior.predict_x0(x, t, prior.encode_text([act.prompt]), 4.0, 0.5)
    torch.testing.assert_close(whole, alone)


def distillation(acts) -> ScoreDistillation:
    prior = synthetic_prior()
    text = prior.encode_text([acts[0].prompt])
    return ScoreDistillation(prior, text, 1.0, 0.0, 2.0, 0.0, 4, 5, timeline=Timeline.of(prior, acts))


@pytest.mark.parametrize("at_once", [1, 2, 8])
def test_windows_drawn_give_the_gradient_of_the_whole(monkeypatch, at_once):
    """Of 0.5 w |X - X0_hat|^2, X0_hat of the whole timeline, on average over all draws of windows; float64."""
    acts = (RUN, KICK, Act("a person walks", 4, 6), WAVE)
    told = distillation(acts)
    assert told.timeline is not None
    frames = 120
    found = told.timeline.layout(frames)
    count = len(found.starts)
    x = torch.randn(1, frames, 205, generator=torch.Generator().manual_seed(1)).double().requires_grad_()
    noise = torch.randn(frames, 205, generator=torch.Generator().manual_seed(2))
    monkeypatch.setattr(collage, "ROWS", 3)
    monkeypatch.setattr("hoi.method.hmsd.AT_ONCE", at_once)
    monkeypatch.setattr(torch, "randn", lambda *shape, **_: noise)

    gradients = []
    for first in range(count):
        monkeypatch.setattr(torch, "randperm", lambda n, first=first, **_: torch.arange(first, first + n) % n)
        loss = told._loss_of_windows(x, told.timeline, [torch.Generator()]).sum()
        gradients.append(torch.autograd.grad(loss, x)[0])
    abar = told.prior.alphas_cumprod[4]
    x_t = abar.sqrt() * x.detach() + (1 - abar).sqrt() * noise.double()
    x0 = told.timeline.predict_x0(x_t, torch.tensor([4]), 2.0, 0.0)
    wanted = (1 - abar) * (x.detach() - x0) / x.numel()
    torch.testing.assert_close(torch.stack(gradients).mean(0), wanted, rtol=1e-4, atol=1e-8)


def test_only_windows_near_are_looked_at():
    told = distillation((RUN, KICK, Act("a person walks", 4, 20))).between(6.5, 7.0)
    assert told.timeline is not None
    length = told.timeline.layout(400).length
    x = torch.zeros(1, 400, 205, requires_grad=True)
    for seed in range(5):
        loss = told._loss_of_windows(x, told.timeline, [torch.Generator().manual_seed(seed)]).sum()
        moved = torch.autograd.grad(loss, x)[0].abs().sum(-1)[0]
        assert moved[: 130 - length].sum() == 0 and moved[140 + length :].sum() == 0 and moved.sum() > 0


@pytest.mark.parametrize("arm", [False, True])
def test_no_pops_where_acts_meet(arm):
    """Velocities and accelerations of the joints within a fade of a seam are no larger than elsewhere."""
    prior = load_prior()
    acts = (
        Act("a person runs forward", 0, 2),
        Act("a person kicks a soccer ball with the right foot", 2, 4),
        Act("a person walks forward", 4, 7),
        *([Act("a person throws a left jab", 5, 6.5, ("left_arm",))] if arm else []),
        Act("a person throws a right cross", 7, 9),
    )
    timeline, frames, runs = Timeline.of(prior, acts), 180, 3
    generators = [torch.Generator().manual_seed(seed) for seed in range(runs)]
    x0 = ancestral_sample(
        lambda x, t: timeline.predict_x0(x, t, 4.0, 1.0),
        (runs, frames, features.FEATURE_COUNT),
        prior.alphas_cumprod,
        generators,
        20,
    )
    translation, orientation, body_pose = features.decode(prior.denormalise(x0))
    joints = forward_kinematics(local_rotations(orientation, body_pose), translation, prior.rest_joints)[1].numpy()
    seams = {round(time * FPS) for act in acts for time in (act.start, act.end)} - {0, frames}
    seams |= {85}  # the walk is longer than a window: of two
    fade = math.ceil(collage.OVERLAP * FPS / 2)
    near = np.zeros(frames, bool)
    for seam in seams:
        near[seam - fade : seam + fade] = True
    for order in (1, 2):
        size = np.linalg.norm(np.diff(joints, n=order, axis=1), axis=-1) * FPS**order
        at = near[order:] if order == 1 else near[1:-1]
        for share in (50, 90, 99):
            here, elsewhere = np.percentile(size[:, at], share), np.percentile(size[:, ~at], share)
            assert here <= 1.15 * elsewhere, (order, share, here, elsewhere)
