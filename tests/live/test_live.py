"""A scene that is being set up: the last wish counts, and what is seen is a run, which can be recorded."""

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

import hoi
from hoi.data import Run
from hoi.errors import InputError
from hoi.live.rehearsal import OWN, Rehearsal, Wish, first_wish
from hoi.method.optimization import RECALLED
from hoi.runner.shelf import Shelf
from tests.browser import chromium, until

BASE = [
    "experiment=live", "scene=kick_soccer_ball", "scene.frames=26", "stage.motion.iterations=2",
    "stage.coordinate.iterations=3", "stage.object.cells_across=4", "human.gaussians=4000", "object.max_gaussians=500",
]  # fmt: skip


def test_the_first_wish_is_the_command_lines() -> None:
    wish = first_wish([*BASE, "object=basketball", "seed=4", "stage.attraction.lambda_attr=2"])
    assert (wish.object, wish.material, wish.seed, wish.pull, wish.place) == ("basketball", OWN, 4, 2.0, (0.5, 1.05))
    assert first_wish([*BASE, "ablation=no_attraction"]).pull in (None, 0.0)
    with pytest.raises(InputError, match="scene"):
        first_wish(["scene=nowhere"])


def test_a_wish_is_a_config_whatever_the_sentence() -> None:
    sentence = "a person's kick, hard: ${seed} = {1} 'é' ☃"
    wish = Wish(sentence, "basketball", "rubber", 7, 2.5, (0.3, 1.2))
    config = wish.config(BASE)
    assert config.scene.motion_prompt == sentence and config.seed == 7 and config.object.name == "basketball"
    assert config.material.name == "rubber" and config.stage.attraction.lambda_attr == 2.5
    assert config.scene.placement.position == [0.3, 1.2, None]
    with pytest.raises(InputError, match="seed must be 0 or more"):
        Wish("a kick", "basketball", OWN, -1, None, (0, 0)).config(BASE)
    with pytest.raises(InputError, match="granite"):
        Wish("a kick", "basketball", "granite", 0, None, (0, 0)).config(BASE)


class Seen:
    """What a rehearsal tells."""

    def __init__(self) -> None:
        self.runs: list[Run] = []
        self.said: list[str] = []
        self.done = threading.Event()

    def see(self, run: Run) -> None:
        self.runs.append(run)

    def say(self, text: str) -> None:
        self.said.append(text)
        if " must be " in text or (self.runs and text == self.runs[-1].result["outcome"]):
            self.done.set()

    def wait(self) -> None:
        assert self.done.wait(120)
        self.done.clear()


def test_only_the_last_wish_is_made_and_what_is_known_is_not_made_again() -> None:
    seen, base = Seen(), [*(each for each in BASE if "cells" not in each), "stage/object=constant_velocity"]
    rehearsal, wish = Rehearsal(base, Shelf(), seen.see, seen.say), first_wish(base)
    try:
        for seed in range(5):
            rehearsal.want(Wish(wish.sentence, wish.object, OWN, seed, wish.pull, wish.place))
        seen.wait()
        assert [run.provenance["seed"] for run in seen.runs] == ["4", "4"]
        assert [run.result["status"] for run in seen.runs] == ["going on", "done"]
        assert seen.said[-1] == seen.runs[-1].result["outcome"]

        rehearsal.want(Wish(wish.sentence, wish.object, OWN, -1, wish.pull, wish.place))
        seen.wait()
        assert seen.said[-1] == "seed must be 0 or more, got -1" and len(seen.runs) == 2

        rehearsal.want(Wish(wish.sentence, wish.object, OWN, 4, wish.pull, (0.3, 1.2)))
        seen.wait()
        moved = seen.runs[-1]
        known = {report.stage for report in moved.reports if RECALLED in report.notes}
        assert known == {"motion"}
        assert np.allclose(moved.scene.thing.particles.mean(0)[:2], (0.3, 1.2), atol=0.02)
    finally:
        rehearsal.stop()


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.live.studio import Studio

    made = Studio(BASE, tmp_path_factory.mktemp("live"), port=0)
    yield made
    made.stop()


def finished(studio) -> Run:
    """The run that is seen, once the object has answered."""
    return until(lambda: studio.run if studio.run.result["status"] == "done" else None, "the object's answer")


def test_what_is_seen_is_a_run_and_is_recorded_as_one(studio) -> None:
    run = finished(studio)
    alone = hoi.run(studio.wish.config(BASE))
    for name in ("translation", "body_pose"):
        assert np.array_equal(getattr(run.state.motion, name), getattr(alone.state.motion, name))
    assert np.array_equal(run.state.trajectory.positions, alone.state.trajectory.positions)

    path = studio.record()
    assert path.parent.name == "001" and studio.record().parent.name == "002"
    read = hoi.read(path)
    assert read.config_yaml == run.config_yaml and read.result["outcome"] == run.result["outcome"]
    assert np.array_equal(read.state.motion.body_pose, run.state.motion.body_pose)
    again = OmegaConf.create(read.config_yaml)
    assert again.scene.motion_prompt == studio.wish.sentence and again.experiment == "live"


def test_a_change_in_the_browser_makes_another_run(studio) -> None:
    typed = "a person's kick, with the right foot: hard!"
    finished(studio)
    with chromium() as browser:
        browser.get(f"http://localhost:{studio.viewer.port}")
        boxes = until(lambda: browser.find_elements("css selector", "textarea"), "the sentence")
        boxes[0].clear()
        boxes[0].send_keys(typed)
        until(lambda: studio.run.scene.motion_prompt == typed, "a run of what was typed")
        after = finished(studio)
        until(lambda: after.result["outcome"].split(",")[0] in browser.page_source, "what came of it")


def test_the_command_line(tmp_path: Path) -> None:
    def live(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "hoi.live", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=120)

    wrong = live("scene=nowhere")
    assert wrong.returncode == 2 and "nowhere" in wrong.stderr and "Traceback" not in wrong.stderr
    assert live("--port", "99999").returncode == 2
    assert not list(tmp_path.iterdir())
