"""The filmstrip: which frames it takes, what it draws, and what it says when it cannot."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from demo_run import make_run

from analysis import strip
from hoi import record
from hoi.data import ContactSearch, State
from hoi.gaussians import sh_from_colours
from hoi.render.film import choose_frames


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(strip, "PANEL_HEIGHT", 90)


@pytest.fixture(scope="module")
def demo():
    return make_run(frames=12, points=600, contact_frame=5.4)


def saved(tmp_path, demo, **state):
    run, points, colours = demo
    path = tmp_path / "run.mcap"
    run = replace(run, state=replace(run.state, **state))
    shown = (None, None) if run.state.motion is None else (points, colours)
    record.write(run, path, *shown, plan_text="")
    return path


def picture(path):
    return plt.imread(path)[..., :3]


@pytest.mark.parametrize(
    "frames, contact", [(40, 18.4), (40, None), (40, 0.0), (40, 39.0), (40, 1.2), (5, 2.5), (1, 0.0)]
)
@pytest.mark.parametrize("count", (1, 2, 3, 8, 24))
def test_frames_hold_the_contact_and_the_ends(frames, contact, count):
    chosen = choose_frames(frames, count, contact)
    assert chosen == sorted(set(chosen)) and 0 <= chosen[0] and chosen[-1] < frames
    assert len(chosen) == min(count, frames)
    if contact is not None:
        assert min(abs(frame - contact) for frame in chosen) <= 0.5
    if count > 2:
        assert {0, frames - 1} <= set(chosen)
    if contact == 18.4 and count == 8:  # finer around the contact than at the ends
        steps = np.diff(chosen)
        assert steps[chosen.index(18) - 1] < steps[0] and steps[chosen.index(18)] < steps[-1]


@pytest.mark.parametrize("view", ("side", "front", "three_quarter", "back", "top"))
def test_strip_shows_the_object(tmp_path, demo, view, capsys):
    pictures = []
    for name, rgb in {"red": (1, 0, 0), "blue": (0, 0, 1)}.items():
        scene = demo[0].scene
        cloud = replace(scene.object.cloud, sh=sh_from_colours(np.tile(rgb, (60, 1))))
        coloured = replace(demo[0], scene=replace(scene, object=replace(scene.object, cloud=cloud)))
        out = tmp_path / f"{name}.png"
        path = saved(tmp_path, (coloured, *demo[1:]))
        assert strip.main([str(path), "--frames", "3", "--view", view, "-o", str(out)]) == 0
        assert capsys.readouterr().out.strip() == str(out)
        pictures.append(picture(out))
    red, blue = pictures
    changed = np.abs(red - blue).sum(-1) > 0.3
    assert red.std() > 0.05 and 30 < np.count_nonzero(changed) < 0.1 * changed.size
    assert (red - blue)[changed][:, 0].min() > 0 > (red - blue)[changed][:, 2].max()
    assert not changed[: strip.HEAD].any() and not changed[-strip.CHART :].any()


def test_parts_that_are_absent(tmp_path, demo):
    for number, state in enumerate(
        (
            {"contact": ContactSearch((), 0.031, 6.0, 11), "target": None},
            {"contact": None},
            {"motion": None, "contact": None},
            {"trajectory": None, "contact": None},
        )
    ):
        out = tmp_path / f"{number}.png"
        assert strip.main([str(saved(tmp_path, demo, **state)), "--frames", "2", "-o", str(out)]) == 0
        assert picture(out).std() > 0.02
    film = strip.load(saved(tmp_path, demo, contact=ContactSearch((), 0.031, 6.0, 11)))
    assert strip._outcome(film) == "no contact: closest 3.1 cm at 0.30 s"


@pytest.mark.parametrize(
    "options, message",
    [
        (["--frames", "0"], "--frames 0: 1 to 24 are allowed"),
        (["--view", "left"], "--view left: allowed are front, side, three_quarter, back, top"),
        (["--view", "follow"], "--view follow: allowed are front"),
        (["-o", "strip.jpg"], "the filmstrip is a .png file"),
        (["-o", "/none/strip.png"], "cannot write /none/strip.png: No such file or directory"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, demo, options, message, capsys):
    assert strip.main([str(saved(tmp_path, demo)), *options]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_bad_records_are_refused_in_one_line(tmp_path, demo, capsys):
    assert strip.main([str(tmp_path / "none.mcap")]) == 2
    record.write(replace(demo[0], state=State()), tmp_path / "failed.mcap", plan_text="")
    assert strip.main([str(tmp_path / "failed.mcap")]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first.endswith("no such file") and "neither a motion nor a trajectory" in second
