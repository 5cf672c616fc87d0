"""Jobs with a toy at each stage: what is shared, what is recorded, what is left of a run that fails."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from toys import planned, toyed

from hoi.config.validate import to_config
from hoi.errors import RunError
from hoi.record import read, read_metadata, video
from hoi.runner import jobs

SMALL = ("human.gaussians=1000", "human_points=100", "scene.frames=4", "scene.contact_frame=2", "threads=1")
SMALL = (*SMALL, "scene=punch_blue_ball", "object.max_gaussians=100", "device=cpu")


@pytest.fixture
def run_with(composed, tmp_path):
    """run_with(without, seeds, **toys) -> the folder of each seed's run, what the toys were asked, and the error."""
    config = to_config(composed(*SMALL))

    def run(without="", seeds=(3,), **toys) -> tuple[list[Path], list[tuple], RunError | None]:
        toy, asked = toyed(config, **toys)
        folders = [tmp_path / str(seed) for seed in seeds]
        to_do = [
            jobs.Job(replace(toy, seed=seed), folder / "run.mcap", "seed: 0\n", {"seed": str(seed)})
            for seed, folder in zip(seeds, folders, strict=True)
        ]
        for folder in folders:
            folder.mkdir(exist_ok=True)
        try:
            jobs.run(to_do, planned(without))
        except RunError as error:
            return folders, asked, error
        return folders, asked, None

    return run


def files(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def test_a_run_is_recorded_with_its_video(run_with):
    (folder,), asked, error = run_with()
    assert error is None and asked[-1] == ("draw",)
    assert files(folder) == ["run.mcap", "run.mp4"]
    run = read(folder / "run.mcap")
    assert run.result["status"] == "done" and run.state.contact.push is not None
    assert len(video(folder / "run.mcap").units) == 4


def test_without_the_step_no_video_is_drawn(run_with):
    """Though the config has a renderer."""
    (folder,), asked, error = run_with("render")
    assert error is None and ("draw",) not in asked
    assert files(folder) == ["run.mcap"]


@pytest.mark.parametrize(
    ("fails", "there"),
    [
        ("move", set()),
        ("motions", {"motion", "trajectory"}),
        ("search", {"motion", "trajectory", "target"}),
        ("refine", {"motion", "trajectory", "target", "contact"}),
        ("draw", {"motion", "trajectory", "target", "contact"}),
    ],
)
def test_what_a_failed_run_had_is_recorded(run_with, fails, there):
    (folder,), asked, error = run_with(**{fails: None})
    assert str(error) == f"{fails} broke" and asked[-1][0] == fails
    assert files(folder) == ["run.failed.mcap"]
    run = read(folder / "run.failed.mcap")
    assert (run.result["status"], run.result["outcome"]) == ("failed", f"{fails} broke")
    assert {name for name, value in vars(run.state).items() if value is not None and value != ()} == there


def test_a_failed_run_has_what_the_whole_run_had(run_with, tmp_path):
    """The object has answered, the person is not refined."""
    (folder,), _, _ = run_with()
    whole = read(folder / "run.mcap").state
    (folder,), _, _ = run_with(refine=None)
    failed = read(folder / "run.failed.mcap").state
    np.testing.assert_array_equal(failed.trajectory.com, whole.trajectory.com)
    np.testing.assert_array_equal(failed.motion.translation + np.float32([0, 0, 1]), whole.motion.translation)


def test_a_seed_that_fails_alone_costs_the_others_nothing(run_with):
    folders, _, error = run_with(seeds=(3, 4, 5), refine=4)
    assert str(error) == "1 of 3 runs failed: seed 4: refine broke"
    assert [files(folder)[0] for folder in folders] == ["run.mcap", "run.failed.mcap", "run.mcap"]


def test_what_fails_for_all_is_recorded_for_each(run_with):
    folders, _, error = run_with(seeds=(3, 4), motions=None)
    assert str(error) == "2 of 2 runs failed: seed 3: motions broke; seed 4: motions broke"
    for folder in folders:
        assert files(folder) == ["run.failed.mcap"]
        assert read_metadata(folder / "run.failed.mcap")["outcome"] == "motions broke"


def test_seeds_as_a_batch_are_the_seeds_alone(run_with):
    """Bit by bit where no optimisation lies between: motion, contact, object."""
    seeds = (3, 5)
    folders, asked, _ = run_with("coordinate", seeds)
    assert [what for what, *_ in asked].count("motions") == 1
    together = [read(folder / "run.mcap") for folder in folders]
    for seed, run in zip(seeds, together, strict=True):
        (folder,), _, _ = run_with("coordinate", (seed,))
        alone = read(folder / "run.mcap")
        np.testing.assert_array_equal(run.scene.body.cloud.means, alone.scene.body.cloud.means)
        np.testing.assert_array_equal(run.state.motion.body_pose, alone.state.motion.body_pose)
        np.testing.assert_array_equal(run.state.trajectory.com, alone.state.trajectory.com)
        assert run.state.contact.push.frame == alone.state.contact.push.frame
    assert np.abs(together[0].state.motion.body_pose - together[1].state.motion.body_pose).max() > 0.1


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize("wanted", [1, 3, None])
def test_the_number_of_threads_is_put_back(wanted, fails):
    before = torch.get_num_threads()
    try:
        with jobs.torch_threads(wanted):
            assert torch.get_num_threads() == (wanted or before)
            if fails:
                raise RunError("broke")
    except RunError:
        assert fails
    assert torch.get_num_threads() == before


def test_a_run_works_with_its_threads_and_puts_the_number_back(composed):
    """Also one that ends in a bug."""
    config, _ = toyed(to_config(composed(*SMALL, "threads=3")))
    seen = []
    config.stage.motion.target = lambda *_: seen.append(torch.get_num_threads()) or 1 / 0
    before = torch.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        jobs.run([jobs.Job(config, None, "", {})], planned())
    assert seen == [3] and torch.get_num_threads() == before
