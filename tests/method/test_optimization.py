"""The walk with a toy at each stage: what runs, in which order, on what, and what is there when a stage fails."""

import numpy as np
import pytest
from demo_run import make_run
from toys import planned, toyed

from hoi.config.validate import to_config
from hoi.data import State
from hoi.errors import RunError
from hoi.method.attraction import Batch
from hoi.method.optimization import Walk
from hoi.reports import Stages


@pytest.fixture
def walk_of(composed):
    """walk_of(without, seeds, **toys) -> a walk that has not begun, and what its toys are asked."""
    scene = make_run()[0].scene

    def make(without="", seeds=(3,), **toys):
        config, asked = toyed(to_config(composed()), **toys)
        batch, move = Batch([scene] * len(seeds), seeds, "cpu"), config.stage.object.mover(0.2, 1, "cpu")
        stages, states = [Stages() for _ in seeds], [State() for _ in seeds]
        return Walk(config, planned(without), batch, move, stages, states), asked

    return make


def gone(walk: Walk) -> Walk:
    walk.synthesise()
    walk.coordinate()
    for run in range(len(walk.states)):
        walk.interact(run)
    return walk


WHOLE = [
    ("move", 0.0, 5), ("prior", "cpu"), ("motions", 3), ("target",), ("term", 1), ("search",), ("answer", 5),
    ("refine", 3),
]  # fmt: skip


def test_the_stages_go_in_the_papers_order(walk_of):
    walk, asked = walk_of()
    gone(walk)
    assert asked == WHOLE
    names = ["free motion", "motion", "coordinate", "contact", "resimulate", "refine"]
    assert [report.stage for report in walk.stages[0].reports] == names
    (state,) = walk.states
    assert state.target is not None and state.contact is not None and state.contact.push is not None
    assert state.trajectory.phase == ("toy",) * 5 and state.motion.translation[:, 2].min() > 1


@pytest.mark.parametrize(
    ("without", "left_out"),
    [
        ("free_motion", {"move"}),
        ("motion", {"prior", "motions"}),
        ("motion_prior", {"prior"}),
        ("coordinate", {"term"}),
        ("attraction", {"term"}),
        ("contact", {"search", "answer"}),
        ("refine", {"refine"}),
        ("render", set()),
    ],
)
def test_the_plan_alone_decides_what_runs(walk_of, without, left_out):
    """The config has an option for every stage; what the plan leaves out is not asked of it."""
    walk, asked = walk_of(without)
    gone(walk)
    assert asked == [each for each in WHOLE if each[0] not in left_out]


def test_what_is_left_out_leaves_its_part_of_the_state(walk_of):
    assert gone(walk_of("free_motion")[0]).states[0].trajectory.phase == ("rest",) * 5
    assert not gone(walk_of("motion")[0]).states[0].motion.body_pose[:, 0].any(), "nothing but the pulled leg moves"
    assert gone(walk_of("contact")[0]).states[0].contact is None
    pulled, left = (gone(walk_of(without)[0]).states[0].motion for without in ("", "attraction"))
    assert np.abs(pulled.body_pose - left.body_pose).max() > 0.01


def test_a_contact_that_does_not_push_leaves_the_object_alone(walk_of):
    walk, asked = walk_of(v_in=-1.0)
    gone(walk)
    assert asked == [each for each in WHOLE if each[0] != "answer"]
    (state,) = walk.states
    assert state.contact is not None and state.contact.push is None
    np.testing.assert_array_equal(state.trajectory.com, gone(walk_of("contact")[0]).states[0].trajectory.com)


@pytest.mark.parametrize(
    ("fails", "there"),
    [
        ("move", set()),
        ("motions", {"motion", "trajectory"}),
        ("target", {"motion", "trajectory"}),
        ("term", {"motion", "trajectory", "target"}),
        ("search", {"motion", "trajectory", "target"}),
        ("answer", {"motion", "trajectory", "target", "contact"}),
        ("refine", {"motion", "trajectory", "target", "contact"}),
    ],
)
def test_what_was_computed_before_a_failure_is_there(walk_of, fails, there):
    walk, asked = walk_of(**{fails: None})
    with pytest.raises(RunError, match=f"{fails} broke"):
        gone(walk)
    assert asked[-1][0] == fails
    (state,) = walk.states
    assert {name for name, value in vars(state).items() if name != "later" and value is not None} == there


def test_each_stage_before_a_failure_has_done_its_part(walk_of):
    """The object has answered, and the person has not been refined."""
    whole, _ = walk_of()
    gone(whole)
    failed, _ = walk_of(refine=None)
    with pytest.raises(RunError):
        gone(failed)
    np.testing.assert_array_equal(failed.states[0].trajectory.com, whole.states[0].trajectory.com)
    np.testing.assert_array_equal(
        failed.states[0].motion.translation[:, 2] + 1, whole.states[0].motion.translation[:, 2]
    )


def test_seeds_as_a_batch_are_the_seeds_alone(walk_of):
    """What they share is the object's free motion; the rest is each one's own, to rounding in stage 2."""
    seeds = (3, 1, 4)
    together, asked = walk_of(seeds=seeds)
    gone(together)
    counts = {what: [each[0] for each in asked].count(what) for what, *_ in WHOLE}
    assert counts == {
        "move": 1, "prior": 1, "motions": 1, "target": 3, "term": 1, "search": 3, "answer": 3, "refine": 3
    }  # fmt: skip
    assert [each for each in asked if each[0] == "refine"] == [("refine", seed) for seed in seeds]
    for seed, state in zip(seeds, together.states, strict=True):
        (alone,) = gone(walk_of(seeds=(seed,))[0]).states
        np.testing.assert_array_equal(state.trajectory.positions, alone.trajectory.positions)
        for part in ("translation", "orientation", "body_pose"):
            np.testing.assert_allclose(getattr(state.motion, part), getattr(alone.motion, part), atol=1e-5)
    assert np.abs(together.states[0].motion.body_pose - together.states[1].motion.body_pose).max() > 0.1
    without = gone(walk_of("coordinate", seeds)[0])
    for seed, state in zip(seeds, without.states, strict=True):
        (alone,) = gone(walk_of("coordinate", (seed,))[0]).states
        np.testing.assert_array_equal(state.motion.body_pose, alone.motion.body_pose)
