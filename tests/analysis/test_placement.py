"""Who strikes with what left out: the ways differ as they say, and the summary counts them."""

import numpy as np
import pandas as pd
import pytest

from analysis.placement import ALWAYS, WAYS, measure, scenes, summary
from hoi.config.compose import config_of
from hoi.plan import make_plan


def test_each_way_leaves_out_what_it_says():
    for way, differs in WAYS.items():
        plan = make_plan(config_of(*differs, *ALWAYS))
        assert ("attraction" in plan.uses) is (way not in ("w/o Attraction", "w/o both"))
        assert ("approach" in plan.uses) is ("placement" not in way and "both" not in way)
        assert plan.keeps("motion") is ("MDM" not in way)
    assert len(scenes()) == 10


def test_the_summary_has_shares_and_their_spread_over_seeds():
    rows = [
        {"scene": scene, "way": "full", "seed": seed, "any": True, "expected": expected, "v_in": 2.0, "gap": 0.0}
        for (scene, seed), expected in {("a", 0): True, ("b", 0): True, ("a", 1): True, ("b", 1): False}.items()
    ]
    table = summary(pd.DataFrame(rows))
    assert table.loc["full", ["n", "any", "expected"]].tolist() == [4, 1, 0.75]
    assert table.loc["full", "expected_sd"] == pytest.approx(np.std([1, 0.5], ddof=1))


def test_a_scene_is_measured_in_every_way():
    small = ["human.gaussians=2000", "object.max_gaussians=800", "stage.coordinate.iterations=2"]
    runs = measure(["kick_soccer_ball"], [0], small)
    assert runs["way"].tolist() == list(WAYS) and runs["gap"].notna().all()
