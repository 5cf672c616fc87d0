"""Films of records: what is in the picture, one clock, several runs side by side, and what is said when it fails."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import av
import numpy as np
import pytest
import torch
from demo_run import make_run
from PIL import Image
from render_scenes import cameras_in

from hoi import record
from hoi.data import Motion, State
from hoi.errors import InputError
from hoi.gaussians import sh_from_colours
from hoi.render import film as film_module
from hoi.render import layout, panels, video
from hoi.render.cameras import project
from hoi.render.film import cameras_of, choose_frames, film
from hoi.render.replay import replay

SIZE = (96, 64)
TINY = ["--size", "96x64"]


@pytest.fixture(scope="module")
def demo():
    return make_run(frames=12, points=600, contact_frame=5.4)


@pytest.fixture(scope="module")
def path(demo, tmp_path_factory):
    return saved(demo, tmp_path_factory.mktemp("record") / "run.mcap")


def saved(demo, path, variant=None, **state):
    run, points, colours = demo
    run = replace(run, state=replace(run.state, **state))
    if variant:
        run = replace(run, plan=replace(run.plan, variant=variant))
    path.parent.mkdir(exist_ok=True)
    record.write(run, path, *((None, None) if run.state.motion is None else (points, colours)), plan_text="")
    return path


def shorter(demo, frames, fps):
    """The first frames of a run, at another rate."""
    run, points, colours = demo
    motion, trajectory = run.state.motion, run.state.trajectory
    cut = {name: getattr(motion, name)[:frames] for name in ("translation", "orientation", "body_pose")}
    arrays = {
        name: getattr(trajectory, name)[:frames] for name in ("positions", "com", "com_velocity", "energy", "phase")
    }
    gradient = trajectory.deformation_gradient
    arrays["deformation_gradient"] = None if gradient is None else gradient[:frames]
    state = replace(run.state, motion=Motion(**cut, fps=fps), trajectory=replace(trajectory, **arrays), contact=None)
    return replace(run, scene=replace(run.scene, frames=frames, fps=fps), state=state), points[:frames], colours


def frames_of(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream.average_rate, [frame.reformat(format="rgb24").to_ndarray() for frame in container.decode(stream)]


def only(message, capsys):
    error = capsys.readouterr().err.splitlines()
    assert message in error[-1] and len([line for line in error if line.startswith("video:")]) == 1
    return True


# --- the film --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", ["side", "front", "three_quarter", "back", "top", "follow"])
def test_person_and_object_are_where_they_should_be(demo, view):
    run = demo[0]
    cloud = replace(run.scene.object.cloud, sh=sh_from_colours(np.tile((1.0, 0, 1.0), (60, 1))))
    pink = replace(run, scene=replace(run.scene, object=replace(run.scene.object, cloud=cloud)))
    shown, coloured = replay(run), replay(pink)
    cameras = cameras_of(shown, view, 180, 120)
    frame = 3
    (plain,), (changed,) = (film(each, [cameras[frame]], frames=[frame]) for each in (shown, coloured))
    rows, columns = np.nonzero(np.abs(plain.astype(int) - changed).sum(-1) > 60)
    place, _ = project(cameras[frame], run.state.trajectory.positions[frame, :60].mean(0))
    assert len(rows) > 5
    if view in ("side", "top", "front"):  # nothing hides the ball there
        np.testing.assert_allclose([columns.mean(), rows.mean()], place - 0.5, atol=2)
    head, foot = (project(cameras[frame], record_joint)[0] for record_joint in joints(shown, frame, (15, 10)))
    if view != "top":
        assert head[1] < foot[1] - 20  # the right way up
        hair = changed[round(head[1]) - 8 : round(head[1]) + 4, round(head[0]) - 5 : round(head[0]) + 5]
        assert hair.min() < 150 and changed[3].min() > 200  # the head is at the head, the sky is light


def joints(shown, frame, which):
    from hoi.body.skinning import joint_paths

    return joint_paths(shown.scene.body, shown.state.motion)[frame, list(which)]


def test_frames_are_those_asked_for(demo):
    shown = replay(demo[0])
    camera = cameras_of(shown, "side", *SIZE)[0]
    every = list(film(shown, [camera] * shown.frames))
    assert len(every) == 12 and all(p.shape == (64, 96, 3) and p.dtype == np.uint8 for p in every)
    some = list(film(shown, [camera] * 4, frames=[7, 2, 2, 11]))
    for picture, frame in zip(some, [7, 2, 2, 11], strict=True):
        np.testing.assert_array_equal(picture, every[frame])


def test_what_stands_still_is_not_worked_out_again(demo, monkeypatch):
    """The ball lies until it is struck; the backdrop of a camera that stands is drawn once."""
    cast, made = [], []
    one_cast, backdrop = film_module.cast, film_module.Backdrop
    monkeypatch.setattr(film_module, "cast", lambda part, beam: cast.append(len(part)) or one_cast(part, beam))
    monkeypatch.setattr(film_module, "Backdrop", lambda *a, **k: made.append(a) or backdrop(*a, **k))
    run = demo[0]
    still = np.repeat(run.state.trajectory.positions[:1], 12, 0)
    trajectory = replace(run.state.trajectory, positions=still, deformation_gradient=None)
    shown = replay(replace(run, state=replace(run.state, trajectory=trajectory)))
    assert len(list(film(shown, cameras_of(shown, "side", *SIZE)))) == 12
    assert cast.count(60) == 2 and cast.count(600) == 24 and len(made) == 1
    assert len(list(film(shown, cameras_of(shown, "follow", *SIZE)))) == 12 and len(made) == 13


def test_without_ground_there_is_sky_and_no_shadow(demo):
    run = demo[0]
    shown, floating = replay(run), replay(replace(run, scene=replace(run.scene, planes=())))
    camera = cameras_of(shown, "top", *SIZE)[0]
    (ground,), (sky,) = (film(each, [camera], frames=[0]) for each in (shown, floating))
    assert ground[:8].std() > 0 and np.ptp(sky[:8]) <= 1
    changed = np.abs(ground.astype(int) - sky) > 60
    assert changed.any()  # the shadow


def test_moments_of_a_strip():
    assert choose_frames(40, 8, None) == [0, 6, 11, 17, 22, 28, 33, 39]
    chosen = choose_frames(40, 8, 18.4)
    assert 18 in chosen and {0, 39} <= set(chosen) and len(chosen) == 8


# --- side by side ----------------------------------------------------------------------------------------------------


def test_one_clock_for_runs_of_any_rate(demo):
    long, short = replay(demo[0]), replay(shorter(demo, 4, 10.0)[0])  # 12 at 20 Hz is 0.6 s, 4 at 10 Hz is 0.4 s
    assert long.fps == 20
    clock = panels.make_clock([short, long], slice(None), 0.5, None)
    assert clock.fps == 10 and len(clock.times) == 12 and clock.times[1] == pytest.approx(0.05)
    assert clock.frames(long) == list(range(12))
    assert clock.frames(short)[::2] == [0, 1, 2, 3, 3, 3] and max(clock.frames(short)) == 3
    assert panels.make_clock([long], slice(-3, None), 1, None).times == pytest.approx([0.45, 0.5, 0.55])
    frozen = panels.make_clock([long], slice(None), 1, 5)
    assert len(frozen.times) == panels.TURN and set(frozen.times) == {0.25}
    for bad in ((slice(12, None), 1, None), (slice(None), 1, 12), (slice(None), 1, -1), (slice(None), 1e9, None)):
        with pytest.raises(InputError, match=r"--(frames|freeze|speed)"):
            panels.make_clock([long], *bad)


def test_runs_are_seen_from_the_same_place(demo):
    runs = [replay(demo[0]), replay(shorter(demo, 6, 20.0)[0])]
    clock = panels.make_clock(runs, slice(None), 1, None)
    for view in ("side", "turntable", "top"):
        one, other = panels.make_panels(runs, ["a", "b"], view, SIZE, clock)
        for a, b in zip(one.cameras, other.cameras, strict=True):
            np.testing.assert_array_equal(a.world_to_camera, b.world_to_camera)
        assert (one.label, other.label) == ("a", "b")
    ring = panels.make_panels(runs[:1], ["a"], "turntable", SIZE, clock)[0]
    angles = np.unwrap([np.arctan2(*camera.forward[:2]) for camera in ring.cameras])
    np.testing.assert_allclose(np.abs(np.diff(angles)), 2 * np.pi / 12, atol=1e-6)
    assert ring.label == ""
    words = [panel.label for panel in panels.make_panels(runs[:1], ["a"], "all", SIZE, clock)]
    assert words == ["front", "side", "three quarter", "back", "top", "follow"]


def test_labels_tell_runs_apart(demo, tmp_path):
    run = demo[0]
    other = replace(run, plan=replace(run.plan, variant="no_mpm"))
    paths = [tmp_path / name / "run.mcap" for name in ("s0", "s1")]
    assert panels.labels_of([run, other], paths) == [run.plan.variant, "no_mpm"]
    assert panels.labels_of([run, run], paths) == ["s0", "s1"]
    assert panels.labels_of([run, run], [paths[0], paths[0]]) == ["run.mcap", "run.mcap"]


@pytest.mark.parametrize("count, columns", [(1, 1), (2, 2), (3, 3), (4, 2), (5, 3), (6, 3), (7, 3), (12, 3)])
def test_tiles(count, columns):
    assert layout.columns_for(count) == columns
    tiles = [np.full((8, 10, 3), index, np.uint8) for index in range(count)]
    page = layout.tile(tiles, columns)
    rows = -(-count // columns)
    assert page.shape == (rows * 8 + (rows - 1) * layout.GAP, columns * 10 + (columns - 1) * layout.GAP, 3)
    for index in range(count):
        row, column = divmod(index, columns)
        assert (page[row * 12 : row * 12 + 8, column * 14 : column * 14 + 10] == index).all()


def test_words_fit_and_leave_the_rest_alone():
    picture = np.full((120, 160, 3), 200, np.uint8)
    for words in ("no_mpm", "no_attraction+no_contact+no_video_sds"):
        changed = (layout.write_on(picture, words) != picture).any(-1)
        rows, columns = np.nonzero(changed)
        assert 30 < len(rows) and rows.max() < 40 and columns.max() < 158 and columns.min() > 2
    rows, _ = np.nonzero((layout.write_on(picture, "0.90 s", bottom=True) != picture).any(-1))
    assert rows.min() > 80 and layout.write_on(picture, "") is picture


# --- the command -----------------------------------------------------------------------------------------------------


def test_a_video_of_a_record(path, tmp_path, capsys):
    out = tmp_path / "out.mp4"
    assert video.main([str(path), "--view", "side", "-o", str(out), *TINY]) == 0
    assert capsys.readouterr().out.split() == [str(out)]
    rate, frames = frames_of(out)
    assert rate == 20 and len(frames) == 12 and frames[0].shape == (64, 96, 3)
    shown = replay(record.read(path))
    for picture, frame in zip(film(shown, cameras_of(shown, "side", *SIZE)), frames, strict=True):
        assert np.abs(picture.astype(int) - frame).mean() < 4
    assert os.listdir(tmp_path) == ["out.mp4"]


def test_without_o_it_lies_beside_the_record(demo, tmp_path, capsys):
    path = saved(demo, tmp_path / "run.mcap")
    assert video.main([str(path), "--view", "top", "--frames", "2:4", *TINY]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "top.mp4")]
    assert len(frames_of(tmp_path / "top.mp4")[1]) == 2


def test_ablations_side_by_side(demo, path, tmp_path):
    other = saved(demo, tmp_path / "no_mpm" / "run.mcap", variant="no_mpm", motion=None, contact=None)
    out, strip, cameras = tmp_path / "out.mp4", tmp_path / "strip.png", tmp_path / "cameras.json"
    outputs = ["-o", str(out), "--png", str(strip), "--cameras", str(cameras)]
    assert video.main([str(path), str(other), *outputs, *TINY, "--speed", "0.5"]) == 0
    rate, frames = frames_of(out)
    assert rate == 10 and len(frames) == 12 and frames[0].shape == (64, 96 * 2 + layout.GAP, 3)
    left, right = frames[6][:, :96].astype(int), frames[6][:, 100:].astype(int)
    assert np.abs(left - right).max() > 60  # no person on the right
    with Image.open(strip) as image:
        assert image.size == (8 * 96 + 7 * layout.GAP, 2 * 64 + layout.GAP)
    found = cameras_in(cameras.read_text())
    assert len(found) == 12 and (found[0].width, found[0].height) == SIZE
    assert "OpenCV" in json.loads(cameras.read_text())["conventions"]["camera_axes"]
    assert sorted(os.listdir(tmp_path)) == ["cameras.json", "no_mpm", "out.mp4", "strip.png"]


def test_all_views_and_a_frozen_turn(path, tmp_path, monkeypatch):
    monkeypatch.setattr(panels, "TURN", 6)
    out = tmp_path / "out.mp4"
    assert video.main([str(path), "--view", "all", "--frames", ":2", "-o", str(out), *TINY]) == 0
    assert frames_of(out)[1][0].shape == (2 * 64 + 4, 3 * 96 + 2 * 4, 3)
    assert video.main([str(path), "--view", "turntable", "--freeze", "5", "-o", str(out), *TINY]) == 0
    frames = frames_of(out)[1]
    assert len(frames) == 6
    assert all(np.abs(a.astype(int) - b).max() > 60 for a, b in pairwise(frames))


def test_parts_that_are_absent(demo, tmp_path):
    for number, state in enumerate(({"motion": None, "contact": None}, {"trajectory": None, "contact": None})):
        path = saved(demo, tmp_path / f"{number}.mcap", **state)
        for view in ("follow", "turntable"):
            out = tmp_path / f"{number}.mp4"
            assert video.main([str(path), "--view", view, "-o", str(out), "--frames", ":2", *TINY]) == 0
            assert frames_of(out)[1][0].std() > 3


@pytest.mark.parametrize(
    "options, message",
    [
        (
            ["--view", "left"],
            "--view left: allowed are action, front, side, three_quarter, back, top, follow, turntable, all",
        ),
        (["--size", "97x64"], "--size 97x64: even numbers from 16 to 8192 are allowed"),
        (["--size", "8x8"], "--size 8x8: even numbers from 16 to 8192 are allowed"),
        (["--frames", "12:"], "--frames: none of the frames 0 to 11 is left"),
        (["--freeze", "2"], "--freeze goes with --view turntable"),
        (["--view", "turntable", "--freeze", "12"], "--freeze 12: frames 0 to 11 are there"),
        (["--speed", "0"], "--speed 0: more than 0 is allowed"),
        (["--speed", "nan"], "--speed nan: more than 0 is allowed"),
        (["--speed", "1e6"], "--speed 1e+06: 2e+07 pictures a second: 0.1 to 1000 are allowed"),
        (["-o", "out.avi"], "-o out.avi: a .mp4 file is allowed"),
        (["--png", "out.jpg"], "--png out.jpg: a .png file is allowed"),
        (["-o", "/none/out.mp4"], "cannot write /none/out.mp4: /none is no folder that can be written to"),
    ],
)
def test_bad_options_are_refused_in_one_line(path, options, message, capsys):
    before = sorted(os.listdir(path.parent))
    assert video.main([str(path), *options]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert sorted(os.listdir(path.parent)) == before


@pytest.mark.parametrize("options", [["--size", "wide"], ["--frames", "a"], ["--sh-degree", "4"], ["--backend", "x"]])
def test_options_that_make_no_sense(path, options, capsys):
    with pytest.raises(SystemExit) as caught:
        video.main([str(path), *options])
    assert caught.value.code == 2 and capsys.readouterr().err.count("\n") == 1


def test_bad_records_are_refused_in_one_line(demo, path, tmp_path, capsys):
    out = ["-o", str(tmp_path / "out.mp4")]
    record.write(replace(demo[0], state=State()), tmp_path / "failed.mcap", plan_text="")
    (tmp_path / "cut.mcap").write_bytes(path.read_bytes()[:-100])
    for name, message in {
        "none.mcap": "no such file",
        "failed.mcap": "neither a motion nor a trajectory",
        "cut.mcap": "unfinished record",
    }.items():
        assert video.main([str(tmp_path / name), *out]) == 2
        error = capsys.readouterr().err
        assert message in error and name in error and error.count("\n") == 1
    assert sorted(os.listdir(tmp_path)) == ["cut.mcap", "failed.mcap"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has CUDA")
def test_no_cuda_no_video(path, tmp_path, capsys):
    assert video.main([str(path), "--device", "cuda", "-o", str(tmp_path / "a.mp4"), *TINY]) == 2
    assert only("no CUDA device found", capsys)
    assert video.main([str(path), "--backend", "gsplat", "-o", str(tmp_path / "a.mp4"), *TINY]) == 2
    assert only("gsplat", capsys) and os.listdir(tmp_path) == []


def test_an_interrupt_leaves_nothing(path, tmp_path):
    command = [sys.executable, "-m", "hoi.render.video", str(path), "--view", "turntable", "--freeze", "3"]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "a.mp4")], stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job inherits it as ignored
    )  # fmt: skip
    assert process.stderr is not None
    while "video" not in process.stderr.read(16):  # the bar of the first picture
        pass
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130 and "interrupted" in error and "Traceback" not in error
    assert os.listdir(tmp_path) == []
