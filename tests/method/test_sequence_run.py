"""A whole run with a timeline: strike, answer, strike again where the object is then; and its record."""

from pathlib import Path

import numpy as np
import pytest

from hoi.config.compose import composed
from hoi.record import read
from hoi.runner.execute import execute

KICK = "a person kicks a soccer ball with the right foot"
ACTS = (
    f'[{{prompt:"{KICK}",start:0,end:2,strikes:auto}},{{prompt:"{KICK}",start:2,end:4,strikes:auto,sends:[0,1,0]}},'
    '{prompt:"a person walks forward",start:4,end:5}]'
)
QUICK = (
    "experiment=smoke", "scene=kick_soccer_ball", "stage/refine=geometric", "stage.motion.iterations=5",
    "stage.coordinate.iterations=60", "scene.frames=100", "scene.placement.position=[0,1.5,null]",
    "scene.planes=[{point:[0,4,0],normal:[0,-1,0]}]", "stage.motion.sample_steps=10",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder: Path = tmp_path_factory.mktemp("acts")
    overrides = [*QUICK, f"scene.acts={ACTS}", f"out={folder}"]
    (path,) = execute(composed(*overrides), overrides)
    return read(path)


def test_each_strike_has_its_target_contact_and_reports(run):
    state = run.state
    assert [act.prompt for act in run.scene.acts] == [KICK, KICK, "a person walks forward"]
    assert np.isnan(run.scene.acts[0].at) and run.scene.acts[1].sends == (0.0, 1.0, 0.0)
    assert len(state.later) == 1 and 40 <= state.later[0].frame <= 80 and state.later[0].way == (0.0, 1.0, 0.0)
    first, *others = state.contact.given
    assert first.joint in (8, 11) and abs(first.frame - state.target.frame) < 3
    assert others and others[0].frame > first.frame
    times = [contact.frame for contact in state.contact.contacts]
    assert times == sorted(times)
    stages = [report.stage for report in run.reports]
    assert {"coordinate", "coordinate 2", "contact", "contact 2", "resimulate", "refine 2"} <= set(stages)
    assert stages.index("resimulate") < stages.index("coordinate 2") < len(stages)
    assert "; then right" in run.result["outcome"]


def test_each_impulse_is_the_objects(run):
    """A millisecond after each contact the object has the velocity that its message says."""
    errors = [report.numbers["v_post_error"] for report in run.reports if "v_post_error" in report.numbers]
    assert len(errors) == len(run.state.contact.given) and max(errors) < 0.05, errors
    masses = run.scene.thing.masses.sum()
    for contact in run.state.contact.given:
        np.testing.assert_allclose(contact.v_post, contact.v_object + contact.impulse / masses, atol=1e-6)


def test_the_motion_has_no_pops(run):
    """No joint of the skeleton changes its velocity where a strike is joined on more than where it strikes."""
    from hoi.body.skinning import joint_paths

    joints = joint_paths(run.scene.body, run.state.motion)
    acceleration = np.linalg.norm(np.diff(joints, n=2, axis=0), axis=-1).max(axis=1) * 400
    strikes = [round(contact.frame) for contact in run.state.contact.given]
    near = np.zeros(len(acceleration), bool)
    for frame in strikes:
        near[max(frame - 6, 0) : frame + 6] = True
    assert acceleration[~near].max() <= acceleration[near].max()
