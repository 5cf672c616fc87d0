import argparse
import math
from pathlib import Path

import pandas as pd
import pytest
import torch

from analysis.motion import measures, sources
from analysis.motion.report import write
from hoi.training.motion import training as trainings
from hoi.training.motion.dataset import TrainingSet

CLIPS = Path(__file__).parents[3] / "shared" / "data" / "motions"
FPS = 20.0


def standing(motions: int = 1, frames: int = 40) -> torch.Tensor:
    """Joints 0.9 m up, but for the toes at 2 cm and the knees at half a metre."""
    joints = torch.zeros(motions, frames, 24, 3)
    joints[..., 2] = 0.9
    joints[:, :, list(measures.FEET), 2] = 0.02
    joints[:, :, list(measures.KNEES), 2] = 0.5
    return joints


def swing(joints: torch.Tensor, joint: int, speed: float) -> torch.Tensor:
    """The joint goes forward at so many m/s for half a second."""
    way = (torch.arange(joints.shape[1]) / FPS).clamp(max=0.5) * speed
    joints[:, :, joint, 1] += way
    return joints


def test_skating_is_the_speed_of_what_stands():
    joints = swing(swing(standing(), 10, 1.0), 11, 3.0)
    joints[:, :, 11, 2] = 0.3  # in the air
    assert float(measures.skating(joints, FPS)) == pytest.approx(1.0 * 10 / 39, rel=1e-4)
    assert float(measures.ground_error(joints)) == pytest.approx(0.02)
    joints[:, :, 10, 2] = 0.3
    assert math.isnan(float(measures.skating(joints, FPS)))


def test_jerk_of_a_cubic():
    joints = torch.zeros(1, 40, 24, 3, dtype=torch.float64)
    joints[..., 0] = ((torch.arange(40, dtype=torch.float64) / FPS) ** 3 / 6)[None, :, None]
    assert float(measures.jerk(joints, FPS)) == pytest.approx(1.0, rel=1e-6)


def test_the_striking_limb_is_told_from_the_others():
    right_foot = swing(standing(), 11, 8.0)
    assert float(measures.strike_speed(right_foot, "kick_front", "right", FPS)) == pytest.approx(8.0, rel=1e-4)
    assert measures.strikes_as_named(right_foot, "kick_front", "right", FPS).all()
    assert not measures.strikes_as_named(right_foot, "kick_front", "left", FPS).any()
    left_hand = swing(standing(), 22, 5.0)
    assert measures.strikes_as_named(left_hand, "punch_jab", "left", FPS).all()
    assert not measures.strikes_as_named(swing(left_hand, 11, 6.0), "punch_jab", "left", FPS).any()
    assert not measures.strikes_as_named(left_hand, "push", "", FPS).any()
    assert measures.strikes_as_named(swing(swing(standing(), 22, 5.0), 23, 4.0), "push", "", FPS).all()
    knee = standing()
    knee[:, 20:, 4, 2] += 0.3
    assert measures.strikes_as_named(knee, "karate_knee", "left", FPS).all()
    assert not measures.strikes_as_named(swing(knee, 10, 14.0), "karate_knee", "left", FPS).any()


def test_frechet_distance_of_gaussians():
    generator = torch.Generator().manual_seed(0)
    first = torch.randn(4000, 3, generator=generator, dtype=torch.float64)
    assert measures.frechet_distance(first, first) == pytest.approx(0, abs=1e-6)
    assert measures.frechet_distance(first, first + 2) == pytest.approx(12, rel=1e-6)
    scaled = first * torch.tensor([3.0, 1.0, 1.0], dtype=torch.float64)  # |m1 - m2|^2 + (3 - 1)^2
    assert measures.frechet_distance(first, scaled) == pytest.approx(4, rel=0.1)


def test_ranks_count_the_sentences_that_fit_better():
    pools = torch.eye(3)[None].repeat(2, 1, 1)
    motions = torch.tensor([[1.0, 0.5, 0.2], [0.1, 0.5, 0.2]])
    assert measures.ranks(motions, pools).tolist() == [0, 2]
    assert measures.diversity(torch.eye(5), torch.Generator().manual_seed(0)) == pytest.approx(math.sqrt(2))


def a_set(kinds: list[str], captions: list[list[str]]) -> TrainingSet:
    known = ["", *sorted({caption for told in captions for caption in told})]
    features = torch.arange(len(kinds), dtype=torch.float32)[:, None, None].expand(-1, 40, 205)
    choices = [[known.index(caption) for caption in told] for told in captions]
    weights = torch.full((len(kinds),), 1 / len(kinds))
    return TrainingSet(features, weights, choices, known, kinds, torch.zeros(24, 3), {})


def test_pools_hold_one_sentence_of_each_of_32_kinds():
    kinds = [f"k{i}/left" for i in range(40)] + ["unknown"]
    data = a_set(kinds, [[f"does {i} with the left hand", f"does {i}"] for i in range(41)])
    cases = sources.held_out_cases(data, set(kinds) - {"unknown"}, each=2, seed=0)
    assert len(cases) == 80 and cases == sources.held_out_cases(data, set(kinds) - {"unknown"}, 2, 0)
    for case in cases:
        assert "left" in case.caption and len({case.caption, *case.others}) == sources.POOL


def test_retrieval_answers_with_a_clip_of_the_nearest_caption():
    data = a_set(["walk", "kick/left", "kick/right"], [["walks"], ["kicks left"], ["kicks right"]])

    def embed(sentences: list[str]) -> torch.Tensor:
        return torch.tensor([[float(word in text) for word in ("walk", "kick", "left", "right")] for text in sentences])

    case = sources.Case("kick/right", "a person kicks with the right foot", 0)
    answer = sources.nearest_sentence(data, embed, seed=0)([case])
    assert answer.shape == (1, 40, 205) and float(answer[0, 0, 0]) == 2


def test_the_report_has_both_tables(tmp_path):
    table = pd.DataFrame([{"motions": "a", "n": 3, "R@1": 0.5}])
    strike = {"strike": "punch", "n": 2, "named limb": 1.0, "speed [m/s]": 4.0, "10 %": 3.0, "90 %": 5.0}
    strikes = pd.DataFrame([strike | {"motions": name, "skating [m/s]": 0.1} for name in ("real clips", "a")])
    paths = write(tmp_path / "out", table, strikes, argparse.Namespace(seed=0, threads=1))
    assert [path.name for path in paths] == ["motion.csv", "strikes.csv", "motion.md"]
    assert "100%, 4.0 (3.0 to 5.0) m/s, 0.10" in paths[2].read_text() and "commit" in paths[2].read_text()


@pytest.mark.skipif(not CLIPS.is_dir(), reason="no motion clips here")
def test_nothing_of_a_held_out_motion_is_trained_on():
    training, held_out = trainings.read_split(CLIPS)
    positions = [data.features[:, ::8, 136:].flatten(1) for data in (training, held_out)]
    nearest = torch.cdist(positions[1], positions[0]).amin(1) / math.sqrt(5 * 23)
    assert float(nearest.min()) > 0.02  # [m], a joint; another walk of the same gait is as near as 3 cm
    strikes = {kind.partition("/")[0] for kind in held_out.kinds} & set(measures.LIMBS)
    assert {"kick_soccer", "kick_front", "karate_knee", "karate_strike", "punch_jab", "push"} <= strikes
    assert strikes <= {kind.partition("/")[0] for kind in training.kinds}
