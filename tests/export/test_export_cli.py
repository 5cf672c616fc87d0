"""`python -m hoi.export`: what is written when, what is said when it fails, and the pictures."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from demo_run import make_run
from PIL import Image

from hoi import record
from hoi.data import State
from hoi.export import pictures
from hoi.export.__main__ import CHOICES, USUAL, main
from hoi.render.cameras import look_at
from hoi.render.encode import encode

FRAMES = 6
ROOT = Path(__file__).parents[2]


def noisy(count: int, height: int = 96, width: int = 144) -> list[np.ndarray]:
    rng = np.random.default_rng(2)
    return [rng.integers(0, 255, (height, width, 3), np.uint8) for _ in range(count)]


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A record with a video."""
    run, points, colours = make_run(frames=FRAMES, points=200, gaussians=60, particles=90)
    camera = look_at((5.0, -3.0, 2.0), (0.0, 1.0, 0.8), width=144, height=96)
    shades = [np.full((96, 144, 3), 40 * shade, np.uint8) for shade in range(FRAMES)]
    path = tmp_path_factory.mktemp("runs") / "run.mcap"
    record.write(
        run, path, points, colours, plan_text="", footage=record.Footage(encode(shades, 20).units, (camera,) * FRAMES)
    )
    return path


def test_nothing_named_writes_the_usual_beside_the_record(path, capsys):
    assert main([str(path)]) == 0
    written = [path.with_name("export") / CHOICES[name][0] for name in USUAL]
    assert capsys.readouterr().out.split() == [str(file) for file in written]
    assert all(file.stat().st_size > 1000 for file in written)
    assert len(list(path.with_name("export").iterdir())) == len(USUAL)


def test_named_ones_alone_are_written(path, tmp_path):
    assert main([str(path), "--spz", "--csv", "-o", str(tmp_path / "new/folder")]) == 0
    assert sorted(p.name for p in (tmp_path / "new/folder").iterdir()) == ["spz", "trajectories.csv"]


def test_mp4_and_gif_are_the_recorded_video(path, tmp_path):
    assert main([str(path), "--mp4", "--gif", "-o", str(tmp_path)]) == 0
    with av.open(str(tmp_path / "video.mp4")) as clip:
        shades = [int(frame.to_ndarray(format="rgb24").mean()) for frame in clip.decode(video=0)]
        assert clip.streams.video[0].average_rate == 20
    np.testing.assert_allclose(shades, np.arange(FRAMES) * 40, atol=4)
    with Image.open(tmp_path / "video.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (FRAMES, (144, 96), 0)
        for frame in range(FRAMES):
            gif.seek(frame)
            assert gif.info["duration"] == 50
            assert abs(np.asarray(gif.convert("RGB")).mean() - 40 * frame) < 6


def test_gif_gets_narrower_until_it_fits(tmp_path):
    video = encode(noisy(8), 30)
    pictures.write_gif(video, tmp_path / "wide.gif")
    most = (tmp_path / "wide.gif").stat().st_size // 2
    pictures.write_gif(video, tmp_path / "narrow.gif", most)
    assert (tmp_path / "narrow.gif").stat().st_size <= most
    with Image.open(tmp_path / "narrow.gif") as gif:
        assert gif.size[0] < 144
        lasts = []
        for frame in range(8):
            gif.seek(frame)
            lasts.append(gif.info["duration"])
    assert sum(lasts) == 270 and set(lasts) <= {30, 40}, "the clock holds over all frames: 8 / 30 s"


def test_gif_of_a_fast_video_leaves_pictures_out(tmp_path):
    pictures.write_gif(encode(noisy(20), 100), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.info["duration"]) == (10, 20)


def test_without_a_video_the_run_is_drawn(tmp_path, monkeypatch):
    run, points, colours = make_run(frames=2, points=200, gaussians=60, particles=90)
    record.write(run, tmp_path / "run.mcap", points, colours, plan_text="")
    monkeypatch.setattr("hoi.render.cameras.WIDTH", 96)
    monkeypatch.setattr("hoi.render.cameras.HEIGHT", 64)
    video = pictures.video_of(run, tmp_path / "run.mcap")
    assert (len(video), video.width, video.height, float(video.fps)) == (2, 96, 64, 20)


def test_a_run_without_a_person_leaves_out_what_needs_one(path, tmp_path, capsys):
    run = record.read(path)
    record.write(replace(run, state=replace(run.state, motion=None)), tmp_path / "run.mcap", None, None, plan_text="")
    assert main([str(tmp_path / "run.mcap"), "--bvh", "--glb", "-o", str(tmp_path / "out")]) == 2
    assert one_line(capsys).endswith("has no motion of a person, which --bvh needs")
    assert not (tmp_path / "out").exists()
    assert main([str(tmp_path / "run.mcap"), "--glb", "--csv", "-o", str(tmp_path / "out")]) == 0


def test_a_video_alone_can_be_taken_out(path, tmp_path, capsys):
    run = replace(record.read(path), scene=None, state=State())
    footage = record.Footage(encode(noisy(4), 10).units, (), 10.0)
    record.write(run, tmp_path / "run.mcap", None, None, plan_text="", footage=footage)
    assert main([str(tmp_path / "run.mcap"), "--mp4", "--gif", "-o", str(tmp_path)]) == 0
    with av.open(str(tmp_path / "video.mp4")) as clip:
        assert (clip.streams.video[0].frames, clip.streams.video[0].average_rate) == (4, 10)
    capsys.readouterr()
    assert main([str(tmp_path / "run.mcap")]) == 2
    assert "neither a motion nor a trajectory" in one_line(capsys)


def test_pose_blend_shapes_that_are_lost_are_said(path, tmp_path, capsys):
    run = record.read(path)
    body = replace(run.scene.body, pose_directions=np.zeros((200, 3, 207), np.float16))
    record.write(replace(run, scene=replace(run.scene, body=body)), tmp_path / "run.mcap", None, None, plan_text="")
    assert main([str(tmp_path / "run.mcap"), "--glb", "-o", str(tmp_path)]) == 0
    assert "pose blend shapes are left out" in capsys.readouterr().err


def one_line(capsys) -> str:
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "Traceback" not in said.err
    return said.err.strip()


@pytest.mark.parametrize("what", ["missing", "truncated", "garbage", "foreign", "part", "folder"])
def test_what_is_no_record_is_one_line_and_2(path, tmp_path, capsys, what):
    from mcap.writer import Writer

    bad = tmp_path / ("run.mcap.part" if what == "part" else "bad.mcap")
    data = path.read_bytes()
    if what == "truncated":
        bad.write_bytes(data[: len(data) // 2])
    elif what == "garbage":
        bad.write_bytes(np.random.default_rng(0).bytes(5000))
    elif what == "part":
        bad.write_bytes(data)
    elif what == "foreign":
        with bad.open("wb") as file:
            writer = Writer(file)
            writer.start()
            writer.finish()
    elif what == "folder":
        bad.mkdir()
    assert main([str(bad), "--glb", "-o", str(tmp_path / "out")]) == 2
    assert str(bad) in one_line(capsys)
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_written_is_one_line_and_2(path, tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    assert main([str(path), "-o", str(tmp_path / "file")]) == 2
    assert "cannot write to" in one_line(capsys)
    (tmp_path / "out/scene.glb").mkdir(parents=True)
    assert main([str(path), "--glb", "-o", str(tmp_path / "out")]) == 2
    assert "scene.glb" in one_line(capsys)
    monkeypatch.setitem(sys.modules, "pxr", None)
    assert main([str(path), "--usd", "-o", str(tmp_path / "out")]) == 2
    assert "usd-core" in one_line(capsys)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["scene.glb"]


def test_a_full_disk_is_one_line_and_3_and_leaves_the_old_file(path, tmp_path, capsys, monkeypatch):
    assert main([str(path), "--glb", "-o", str(tmp_path)]) == 0
    before = (tmp_path / "scene.glb").read_bytes()
    capsys.readouterr()

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert main([str(path), "--glb", "-o", str(tmp_path)]) == 3
    assert "No space left" in one_line(capsys)
    assert (tmp_path / "scene.glb").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["scene.glb"]


def test_help_names_every_choice_within_a_second():
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "hoi.export", "--help"], capture_output=True, text=True, cwd=ROOT)
    assert time.perf_counter() - start < 3  # on a loaded machine; what it imports is what counts
    assert done.returncode == 0 and all(f"--{name}" in done.stdout for name in CHOICES) and "example" in done.stdout
    code = "import sys, hoi.export.__main__; print({'numpy', 'torch', 'taichi', 'mcap'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "set()"


def test_ctrl_c_is_130_and_leaves_nothing_half_done(tmp_path):
    run, points, colours = make_run(frames=120, points=1500, gaussians=1500, particles=1600)
    record.write(run, tmp_path / "run.mcap", points, colours, plan_text="")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "hoi.export", str(tmp_path / "run.mcap"), "--ply", "-o", str(out)]
    started = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, preexec_fn=_default_sigint)
    deadline = time.monotonic() + 60
    while not (out / ".ply.part/frame_0001.ply").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    started.send_signal(signal.SIGINT)
    _, said = started.communicate(timeout=60)
    assert started.returncode == 130 and "interrupted" in said
    assert not list(out.iterdir())


def _default_sigint() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.setpgrp()
