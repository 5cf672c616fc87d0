"""The geometric loss against differences, and what stage 3 does with it to a foot in a ball and in a box."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_paths
from hoi.config import Config
from hoi.config.validate import to_config
from hoi.data import ContactSearch
from hoi.errors import RefineStopped
from hoi.plan import make_plan
from hoi.refine.fidelity import instants
from hoi.refine.geometric import Geometry, minimise
from hoi.refine.meeting import meet
from hoi.refine.stage import contact_window
from hoi.refine.window import WindowedPose
from hoi.reports import Stage, Stages
from hoi.runner.jobs import outcome
from hoi.stages.refine import WindowedRefinement
from hoi.stages.refine.geometric import Geometric
from tests.refine_scenes import FOOT, HIT, refine, struck


@pytest.fixture
def config(composed) -> Config:
    return to_config(composed("stage/refine=geometric"))


def conf_of(config: Config) -> WindowedRefinement:
    assert isinstance(config.stage.refine, Geometric)
    return config.stage.refine


def with_conf(config: Config, **values: object) -> Config:
    return replace(config, stage=replace(config.stage, refine=replace(conf_of(config), **values)))


def quiet() -> Stage:
    return Stage("refine", lambda units: None, [])


def test_the_gradient_is_the_slope(config):
    """In float64, off the start so that every term has something to say."""
    scene, state = struck(depth=0.03)
    window = contact_window(state, 1.0, scene.frames)
    meeting = meet(scene, state.motion, state.trajectory, window)
    assert meeting is not None
    geometry = Geometry(meeting, conf_of(config).weights, dtype=torch.float64)
    pose = WindowedPose(state.motion, window, dtype=torch.float64)
    with torch.no_grad():
        pose.offset.normal_(0, 0.02, generator=torch.Generator().manual_seed(0))

    def loss() -> torch.Tensor:
        return torch.stack([*geometry.terms(pose).values(), pose.roughness()]).sum()

    loss().backward()
    gradient, flat = pose.offset.grad.flatten(), pose.offset.detach().view(-1)
    for entry in range(0, len(flat), 5):
        ends = []
        for step in (1e-6, -1e-6):
            flat[entry] += step
            ends.append(float(loss().detach()))
            flat[entry] -= step
        assert gradient[entry] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=2e-3, abs=1e-5)


@pytest.mark.parametrize(("shape", "size"), [("soccer_ball", 0.22), ("cardboard_box", 0.4)])
@pytest.mark.parametrize("depth", [0.01, 0.04])
def test_a_foot_in_an_object_comes_out_and_touches(config, shape, size, depth):
    scene, state = struck(shape, size, depth)
    stage = quiet()
    refine(scene, state, config, "cpu", stage)
    numbers = stage.numbers
    assert numbers["penetration_before"] >= depth - 0.002
    assert numbers["penetration_after"] < 0.002
    assert numbers["gap_after"] < 0.002
    assert numbers["touching_after"] > 0
    assert stage.iterations <= conf_of(config).iterations


def test_a_gap_is_closed(config):
    scene, state = struck(depth=-0.02)
    stage = quiet()
    refine(scene, state, with_conf(config, half_width=0.0, when="always"), "cpu", stage)
    assert stage.numbers["gap_before"] == pytest.approx(0.02, abs=0.002)
    assert stage.numbers["gap_after"] < 1e-3 and stage.numbers["penetration_after"] < 1e-3


def test_only_the_limb_in_the_window_moves_and_the_body_side_least(config):
    scene, state = struck(depth=0.03)
    refined = refine(scene, state, config, "cpu", quiet())
    assert np.array_equal(refined.translation, state.motion.translation)
    assert np.array_equal(refined.orientation, state.motion.orientation)
    turned = np.linalg.norm(refined.body_pose - state.motion.body_pose, axis=-1)
    assert set(np.flatnonzero(turned.max(axis=1))) == {HIT - 1, HIT, HIT + 1}
    limb = [JOINT_NAMES.index(f"right_{part}") - 1 for part in ("hip", "knee", "ankle", "foot")]
    assert set(np.flatnonzero(turned.max(axis=0))) == set(limb)
    assert turned[:, limb[0]].max() < turned[:, limb[1]].max()


def test_no_pop_at_the_edges_of_the_window(config):
    """What is added to the accelerations: nothing beyond the edges, at them less than it is at t_c.

    A joint that is off by d in one frame alone adds d, -2 d and d a squared frame.
    """
    scene, state = struck(depth=0.03)
    refined = refine(scene, state, config, "cpu", quiet())
    moved = joint_paths(scene.body, refined) - joint_paths(scene.body, state.motion)
    largest = np.linalg.norm(moved, axis=-1).max()
    assert largest > 0.02
    added = np.linalg.norm(np.diff(moved, 2, axis=0), axis=-1).max(axis=1)  # of frame 1 + index
    outside = np.concatenate([added[: HIT - 3], added[HIT + 2 :]])
    assert not outside.any()
    edges = added[[HIT - 3, HIT + 1]]
    assert edges.max() < 0.5 * largest
    assert added.max() < 1.6 * largest


def test_not_needed_leaves_the_motion_as_it_is(config):
    scene, state = struck(depth=-0.005)
    for tolerance in (0.002, 10.0):
        stage = quiet()
        assert (
            refine(scene, state, with_conf(config, tolerance=tolerance, half_width=0.0), "cpu", stage) is state.motion
        )
        assert "not needed" in stage.notes[0] and stage.iterations == 0
    scene, state = struck(depth=-0.03)  # a gap wider than d_contact is none to leave
    stage = quiet()
    refine(scene, state, with_conf(config, half_width=0.0), "cpu", stage)
    assert stage.iterations > 0 and stage.numbers["gap_after"] < stage.numbers["gap_before"]


def test_no_contact_is_no_window(config):
    scene, state = struck()
    missed = replace(state, contact=ContactSearch((), 0.3, 2.0, FOOT))
    stage = quiet()
    assert refine(scene, missed, config, "cpu", stage) is state.motion
    assert stage.notes == ["no contact: nothing to refine"]


def test_a_limb_elsewhere_has_nothing_to_refine(config):
    scene, state = struck()
    hand = replace(state.contact.contacts[0], joint=JOINT_NAMES.index("left_hand"))
    stage = quiet()
    assert refine(scene, replace(state, contact=ContactSearch((hand,), 0, 0, 22)), config, "cpu", stage) is state.motion
    assert "not near the object" in stage.notes[0]


@pytest.mark.parametrize(
    ("error", "words"),
    [(RefineStopped("the loss is not finite"), "the loss is not finite"), (MemoryError("8 GB"), "out of memory: 8 GB")],
)
def test_a_stop_keeps_the_motion_and_says_so(config, monkeypatch, error, words):
    scene, state = struck()

    def stop(*_: object) -> None:
        raise error

    monkeypatch.setattr("hoi.refine.geometric.minimise", stop)
    stages = Stages()
    with stages.stage("refine", 1) as stage:
        assert refine(scene, state, config, "cpu", stage) is state.motion
    (report,) = stages.reports
    assert "penetration_before" in report.numbers and "penetration_after" not in report.numbers
    assert f"stage 3 stopped, the motion from before is kept: {words}" in outcome(
        config, make_plan(config), state, stages.reports
    )


def test_a_loss_that_is_not_finite_stops(config, monkeypatch):
    scene, state = struck()
    window = contact_window(state, 1.0, scene.frames)
    meeting = meet(scene, state.motion, state.trajectory, window)
    assert meeting is not None
    broken = replace(conf_of(config), lambda_pose=float("nan"))
    with pytest.raises(RefineStopped, match="not finite after 0 iterations"):
        minimise(WindowedPose(state.motion, window), Geometry(meeting, broken.weights), broken.iterations, quiet())


def test_the_instants_hold_the_contact():
    frames = instants(4, 6, [5.37])
    assert frames[0] == 4 and frames[-1] == 6 and 5.37 in frames and {4, 5, 6} <= set(frames)
    assert (np.diff(frames) > 0).all()


def test_the_same_again(config):
    scene, state = struck(depth=0.02)
    first, second = (refine(scene, state, config, "cpu", quiet()) for _ in range(2))
    assert np.array_equal(first.body_pose, second.body_pose)
