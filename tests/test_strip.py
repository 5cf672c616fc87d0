"""The filmstrip: which frames it takes, what it draws, and what it says when it cannot."""

import subprocess
import sys
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from demo_run import make_run

from analysis import strip
from analysis.points import draw, frame_points
from hoi import record
from hoi.data import ContactSearch, State
from hoi.gaussians import sh_from_colours


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
    chosen = strip.choose_frames(frames, count, contact)
    assert chosen == sorted(set(chosen)) and 0 <= chosen[0] and chosen[-1] < frames
    assert len(chosen) == min(count, frames)
    if contact is not None:
        assert min(abs(frame - contact) for frame in chosen) <= 0.5
    if count > 2:
        assert {0, frames - 1} <= set(chosen)
    if contact == 18.4 and count == 8:  # finer around the contact than at the ends
        steps = np.diff(chosen)
        assert steps[chosen.index(18) - 1] < steps[0] and steps[chosen.index(18)] < steps[-1]


def test_the_object_is_where_it_should_be(demo):
    run, points, colours = demo
    thing = run.state.trajectory.positions[5, :60]
    everything = np.concatenate([points[5], thing])
    camera = frame_points(np.concatenate([everything, everything * (1, 1, 0)]), "side", 120)
    radii = np.full(len(everything), 0.02)
    red = np.concatenate([colours, np.tile([1.0, 0, 0], (60, 1))])
    blue = np.concatenate([colours, np.tile([0, 0, 1.0], (60, 1))])
    changed = np.abs(draw(camera, everything, red, radii) - draw(camera, everything, blue, radii)).sum(-1) > 0.3
    rows, columns = np.nonzero(changed)
    (place,), _ = camera.project(thing.mean(0, keepdims=True))
    np.testing.assert_allclose([columns.mean(), rows.mean()], place, atol=2)
    radius = 0.13 * camera.focal / camera.project(thing)[1].mean()
    assert np.count_nonzero(changed) == pytest.approx(np.pi * radius**2, rel=0.25)


def test_nearer_points_hide_farther_ones():
    line = np.array([[0.0, 0, 1], [-1.0, 0, 1], [0, 0.5, 0], [0, -0.5, 2]])  # the camera stands at +x
    colours = np.eye(4, 3)
    camera = frame_points(line, "side", 100)
    for order in ([0, 1, 2, 3], [1, 0, 2, 3]):
        image = draw(camera, line[order], colours[order], np.full(4, 0.1))
        x, y = camera.project(line[:1])[0][0].astype(int)
        assert image[y, x, 0] > 0.3 > image[y, x, 1]


def test_the_camera_shows_all_points():
    points = np.random.default_rng(0).normal(size=(200, 3)) * (0.4, 1.5, 0.8)
    for view in ("side", "front", "three_quarter"):
        camera = frame_points(points, view, 200)
        pixels, depths = camera.project(points)
        assert (pixels > 0).all() and (pixels < (camera.width, camera.height)).all() and (depths > 0).all()
        used = np.ptp(pixels, axis=0) / (camera.width, camera.height)
        assert used.max() > 0.85


def test_shadow_lies_below_and_sharpens_near_the_ground():
    square = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 30), np.linspace(-0.2, 0.2, 30)), -1).reshape(-1, 2)
    depth = []
    for height in (0.05, 1.5):
        points = np.column_stack([square, np.full(len(square), height)])
        camera = frame_points(np.concatenate([points, [[-1, -1.5, 0], [1, 1.5, 2]]]), "side", 120)
        bare = draw(camera, np.add(points, (0, 0, 50)), np.ones((900, 3)), np.full(900, 0.01))
        image = draw(camera, points, np.zeros((900, 3)), np.full(900, 1e-4))
        depth.append((bare - image).max())
    assert depth[0] > 0.2 and depth[0] > 1.05 * depth[1] > 0.05


@pytest.mark.parametrize("view", ("side", "front", "three_quarter"))
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
        (["--view", "top"], "--view top: allowed are side, front, three_quarter"),
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


def test_needs_no_torch(tmp_path, demo):
    path = saved(tmp_path, demo)
    code = (
        "import sys; from analysis import strip; strip.PANEL_HEIGHT = 60; "
        f"strip.main([{str(path)!r}, '--frames', '1']); print(sorted({{'torch', 'taichi'}} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [str(tmp_path / "strip.png"), "[]"]
