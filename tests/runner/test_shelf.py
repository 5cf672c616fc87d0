"""What runs share is what they would have computed: keys tell what a stage depends on, results are the same bits."""

from pathlib import Path

import numpy as np
import pytest

import hoi
from hoi.config import Config
from hoi.data import State
from hoi.method.optimization import RECALLED, Walk
from hoi.plan import make_plan
from hoi.reports import no_bar
from hoi.runner.jobs import Job, begin, result
from hoi.runner.shelf import STEPS, Shelf, key_of

CHEAP = ("experiment=smoke", "stage.motion.iterations=2", "stage.coordinate.iterations=3", "scene.frames=30")


def shared(*overrides: str, seeds: tuple[int, int] = (0, 0)) -> set[str]:
    """The steps that a run has in common with the default one."""
    one, other = hoi.compose("scene=kick_soccer_ball"), hoi.compose("scene=kick_soccer_ball", *overrides)
    plans = make_plan(one), make_plan(other)
    return {s for s in STEPS if key_of(s, one, plans[0], [seeds[0]]) == key_of(s, other, plans[1], [seeds[1]])}


@pytest.mark.parametrize(
    ("overrides", "steps"),
    [
        (["out=elsewhere", "human_points=100", "render=none", "overwrite=true"], set(STEPS)),
        (["ablation=no_video_sds"], set(STEPS)),
        (["ablation=no_contact"], {"free motion", "motion", "coordinate"}),
        (["stage/contact=collider"], {"free motion", "motion", "coordinate"}),
        (["ablation=no_attraction"], {"free motion", "motion"}),
        (["ablation=no_mdm"], {"free motion"}),
        (["ablation=no_mpm"], {"motion"}),
        (["object=basketball"], {"motion"}),
        (["scene.placement.position=[0.3,1.2,null]"], {"motion"}),
        (["material.restitution=0.5"], {"motion"}),
        (["human=woman"], set()),
        (["threads=2"], set()),
        (["scene.motion_prompt=a person jumps"], set()),
    ],
)
def test_what_runs_have_in_common(overrides: list[str], steps: set[str]) -> None:
    assert shared(*overrides) == steps


def test_another_seed_shares_nothing_and_a_file_that_changed_neither(tmp_path: Path) -> None:
    assert not shared(seeds=(0, 1))
    file = tmp_path / "kick.npz"
    file.write_bytes(b"one")
    config = hoi.compose("scene=kick_soccer_ball")
    plan = make_plan(config)
    config.stage.motion.checkpoint = str(file)
    before = key_of("motion", config, plan, [0])
    assert before == key_of("motion", config, plan, [0])
    file.write_bytes(b"other")
    assert key_of("motion", config, plan, [0]) != before


def walked(config: Config, shelf: Shelf | None) -> Walk:
    walk = begin([Job(config, None, "", {})], make_plan(config), no_bar, None, shelf)
    walk.synthesise()
    walk.coordinate()
    walk.interact(0)
    return walk


def arrays(state: State) -> list[np.ndarray]:
    assert state.motion is not None and state.trajectory is not None
    motion, trajectory = state.motion, state.trajectory
    return [motion.translation, motion.orientation, motion.body_pose, trajectory.positions, trajectory.energy]


def test_a_shared_walk_is_the_same_to_the_bit_and_says_so() -> None:
    full, without = hoi.compose(*CHEAP), hoi.compose(*CHEAP, "ablation=no_video_sds")
    shelf = Shelf()
    walked(full, shelf)
    middle = hoi.compose(*CHEAP, "ablation=no_contact")
    for ours, theirs in zip(*(arrays(walked(middle, each).states[0]) for each in (shelf, None)), strict=True):
        assert np.array_equal(ours, theirs)
    found, alone = walked(without, shelf), walked(without, None)
    assert found.distillation is None, "nothing was left to distil"
    for ours, theirs in zip(arrays(found.states[0]), arrays(alone.states[0]), strict=True):
        assert np.array_equal(ours, theirs)
    reports, fresh = found.stages[0].reports, alone.stages[0].reports
    assert [report.stage for report in reports] == [report.stage for report in fresh]
    assert all(RECALLED in report.notes for report in reports if report.stage != "refine")
    told = result("done", "", found, 0, 0.0)
    assert float(told["seconds"]) == pytest.approx(sum(report.seconds for report in reports))
    assert found.stages[0].history == alone.stages[0].history
    assert [report.numbers.keys() for report in reports] == [report.numbers.keys() for report in fresh]


def test_the_oldest_results_go() -> None:
    config = hoi.compose(*CHEAP)
    plan, shelf, asked = make_plan(config), Shelf(most=2), []
    for step in ("motion", "coordinate", "resimulate", "motion"):
        found, known = shelf.recall(config, plan, [0])(step, lambda step=step: asked.append(step) or step)
        assert found == step and not known
    assert asked == ["motion", "coordinate", "resimulate", "motion"]
    assert shelf.recall(config, plan, [0])("motion", lambda: pytest.fail("it is known"))[1]
