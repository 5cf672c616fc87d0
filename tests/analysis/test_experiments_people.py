"""The people's rows on the page against reality: what is cheap is measured, what takes a run is worked out from one."""

from dataclasses import replace

import numpy as np
import pytest

from analysis import experiments_people
from analysis.experiments_people import EXPERIMENTS, height_of_centre, share_of
from hoi.body.mass import masses_of
from hoi.body.people import load_person
from hoi.body.skeleton import CHAINS
from hoi.errors import RunError
from tests.demo_run import make_run


def test_limbs_make_up_a_person():
    assert sum(share_of(limb) for limb in CHAINS) == pytest.approx(1)
    assert share_of("left leg") > 2 * share_of("left arm")


@pytest.mark.parametrize("name", ["man", "woman", "child"])
def test_arms_that_hang_have_their_weight_below_the_shoulders(name):
    assert 0.5 < height_of_centre(name) < 0.6


def test_numbers_of_a_run(monkeypatch):
    run, *_ = make_run(frames=5, gaussians=300, particles=400, contact_frame=1.5)
    man = load_person("man")
    assert run.scene is not None and run.state.contact is not None
    given = {"v_human": np.array([0, 3.0, 4.0]), "v_post": np.array([0, 6.0, 0]), "impulse": np.array([30.0, 40, 9])}
    push = replace(run.state.contact.contacts[0], **given, duration=0.2, limb_mass=2.5)
    of_man = replace(run, scene=replace(run.scene, body=man))
    monkeypatch.setattr(experiments_people, "struck", lambda *_: (of_man, push))
    assert experiments_people.ball_over_foot("a") == pytest.approx(6 / 5)
    assert experiments_people.contact_time("a") == pytest.approx(200)
    assert experiments_people.effective_mass("a") == 2.5
    assert experiments_people.push_force("a") == pytest.approx(250)
    weight = masses_of(man).mass.sum() * 9.81
    assert experiments_people.push_over_friction("a") == pytest.approx(250 / (0.8 * weight))


def test_a_run_without_a_contact_is_no_measurement(monkeypatch):
    run, *_ = make_run(frames=5, gaussians=300, particles=400)
    monkeypatch.setattr(experiments_people.api, "run", lambda _: replace(run, state=replace(run.state, contact=None)))
    with pytest.raises(RunError, match="nothing was struck"):
        experiments_people.struck("scene=kick_soccer_ball", "seed=77")


def test_each_row_says_where_its_numbers_come_from():
    assert len({row.title for row in EXPERIMENTS}) == len(EXPERIMENTS) >= 10
    for row in EXPERIMENTS:
        assert row.published[0] <= row.published[1] and len(row.source) > 15
