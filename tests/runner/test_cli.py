"""The front door, as a user meets it: runs, repeats, ablations, bad input, interruption."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
import torch

from analysis.metrics import METRICS
from analysis.records import load
from hoi.config.validate import to_config
from hoi.errors import InputError, RunError
from hoi.method import contact
from hoi.plan import make_plan
from hoi.record import message_digest, read, video
from hoi.render.cameras import project
from hoi.reports import Stages
from hoi.runner import jobs

SMOKE = ["experiment=smoke"]
TINY_VIDEO = ["render=video", "render.width=96", "render.height=64"]


def hoi(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "hoi.run", *arguments], capture_output=True, text=True, cwd=cwd)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """record(ablation) -> the smoke run of an ablation, computed once."""
    folder, done = tmp_path_factory.mktemp("runs"), {}

    def record(ablation: str):
        if ablation not in done:
            out = folder / ablation
            result = hoi(*SMOKE, f"ablation={ablation}", f"out={out}", cwd=folder)
            assert result.returncode == 0, result.stderr
            done[ablation] = (read(out / "run.mcap"), out, result)
        return done[ablation]

    return record


def push(run):
    return run.state.contact.push


def test_default_scene_kicks_the_ball(runs):
    run, out, result = runs("full")
    assert run.result["status"] == "done"
    assert run.plan.variant == "full"
    assert sorted(file.name for file in out.iterdir()) == ["run.mcap"]
    assert str(out / "run.mcap") in result.stdout
    contact = push(run)
    assert contact is not None
    assert contact.joint in (8, 11), "the right foot should strike"


def test_ball_leaves_with_v_post(runs):
    """Within 2% of the formula, at the first frame after the impulse."""
    _, out, _ = runs("full")
    assert METRICS["v_post"](load(out / "run.mcap")) < 0.02


def test_same_seed_same_bytes(runs, tmp_path):
    _, out, _ = runs("full")
    again = hoi(*SMOKE, f"out={tmp_path}", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert message_digest(tmp_path / "run.mcap") == message_digest(out / "run.mcap")


def test_several_seeds_make_a_record_each(runs, tmp_path):
    """As those of runs of their own, but for rounding; what is there already is not done again."""
    shown, quick = runs("full")[0], ("ablation=no_mpm", "stage.motion.sample_steps=5", "stage.coordinate.iterations=20")
    first = hoi(*SMOKE, *quick, f"out={tmp_path}/s1", "seed=1", cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    before = (tmp_path / "s1" / "run.mcap").stat().st_mtime_ns
    several = hoi(*SMOKE, *quick, f"out={tmp_path}", "seed=0", "seeds=3", cwd=tmp_path)
    assert several.returncode == 0, several.stderr
    assert (tmp_path / "s1" / "run.mcap").stat().st_mtime_ns == before
    records = [read(tmp_path / f"s{seed}" / "run.mcap") for seed in range(3)]
    assert [record.provenance["seed"] for record in records] == ["0", "1", "2"]
    assert all(record.state.contact is not None for record in records)
    assert np.abs(records[0].state.motion.body_pose - records[2].state.motion.body_pose).max() > 0.1
    notes = [note for report in records[2].reports for note in report.notes]
    assert "of a batch of 2 runs, which share its time" in notes
    assert not any("batch" in note for report in shown.reports for note in report.notes)


def test_one_run_that_fails_does_not_stop_the_others(composed, tmp_path, monkeypatch):
    options = ["human.gaussians=1000", "scene.frames=4", "scene.contact_frame=2", "ablation=no_mpm"]
    config = to_config(composed(*SMOKE, *options, "stage/motion=none", "stage/coordinate=default"))
    to_do = [
        jobs.Job(replace(config, seed=seed), tmp_path / f"{seed}" / "run.mcap", f"seed: {seed}\n", {"seed": str(seed)})
        for seed in range(3)
    ]
    looked = contact.find_contact

    def diverge(*given, **options):
        if len(list(tmp_path.glob("*/run.mcap"))) == 1:  # the second
            monkeypatch.setattr(contact, "find_contact", looked)
            raise RunError("diverged")
        return looked(*given, **options)

    monkeypatch.setattr(contact, "find_contact", diverge)
    for job in to_do:
        job.path.parent.mkdir()
    with pytest.raises(RunError, match="1 of 3 runs failed: seed 1: diverged"):
        jobs.run(to_do, make_plan(config))
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("*/*")) == [
        "0/run.mcap", "1/run.failed.mcap", "2/run.mcap",
    ]  # fmt: skip


def test_finished_run_is_not_computed_again(runs):
    _, out, _ = runs("full")
    before = (out / "run.mcap").stat().st_mtime_ns
    again = hoi(*SMOKE, "ablation=full", f"out={out}", cwd=out)
    assert again.returncode == 0
    assert "already computed" in again.stdout
    assert (out / "run.mcap").stat().st_mtime_ns == before
    other = hoi(*SMOKE, "seed=7", f"out={out}", cwd=out)
    assert other.returncode == 2
    assert "overwrite=true" in other.stderr


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """The folder and the output of a run with a tiny video, which takes the shortest way to a simulated object."""
    out = tmp_path_factory.mktemp("filmed")
    done = hoi(*SMOKE, "ablation=no_mdm", *TINY_VIDEO, f"out={out}", cwd=out)
    assert done.returncode == 0, done.stderr
    return out, done


def test_a_run_is_filmed_after_its_simulation(filmed):
    out, done = filmed
    run, footage = read(out / "run.mcap"), video(out / "run.mcap")
    assert "mpm" in run.state.trajectory.phase, "Taichi is to be used before it draws"
    assert sorted(file.name for file in out.iterdir()) == ["run.mcap", "run.mp4"]
    assert str(out / "run.mp4") in done.stdout.splitlines()[-2]
    assert len(footage) == run.scene.frames
    with av.open(str(out / "run.mp4")) as film:
        pictures = [picture.to_ndarray(format="rgb24") for picture in film.decode(video=0)]
    assert len(pictures) == run.scene.frames
    assert {picture.shape for picture in pictures} == {(64, 96, 3)}
    decoder = av.CodecContext.create("h264", "r")
    for unit, picture in zip(footage.units, pictures, strict=True):
        (shown,) = decoder.decode(av.Packet(unit))
        np.testing.assert_array_equal(shown.to_ndarray(format="rgb24"), picture)
    (report,) = (report for report in run.reports if report.stage == "render")
    assert report.numbers["frames_per_second"] == pytest.approx(run.scene.frames / report.seconds, rel=0.2)


def test_a_finished_run_names_its_video_too(filmed):
    out, _ = filmed
    again = hoi(*SMOKE, "ablation=no_mdm", *TINY_VIDEO, f"out={out}", cwd=out)
    assert again.returncode == 0 and "already computed" in again.stdout
    assert str(out / "run.mp4") in again.stdout.splitlines()[-2]


def test_the_video_shows_the_object_where_the_camera_says(filmed):
    out, _ = filmed
    run, footage = read(out / "run.mcap"), video(out / "run.mcap")
    pixel, depth = project(footage.cameras[0], run.state.trajectory.com[0])
    assert depth > 0
    x, y = pixel.astype(int)
    with av.open(str(out / "run.mp4")) as film:
        first = next(film.decode(video=0)).to_ndarray(format="rgb24").astype(float)
    assert np.abs(first[y, x] - first[y, 2]).max() > 20, "the ball stands out from the floor beside it"


def test_the_same_record_gives_the_same_pictures(filmed, composed):
    """What was drawn from memory is drawn again from the record, in another process: every bit is the run's alone."""
    out, _ = filmed
    run = read(out / "run.mcap")
    conf = to_config(composed(*SMOKE, *TINY_VIDEO)).render
    torch.set_num_threads(1)
    with Stages().stage("render", run.scene.frames) as stage:
        _, again = conf.draw(run, "cpu", stage)
    assert again.units == video(out / "run.mcap").units


def test_a_run_without_a_video_removes_the_old_one_and_imports_no_renderer(tmp_path):
    """Where the object needs no MPM, neither Taichi nor PyAV is imported."""
    (tmp_path / "run.mp4").write_bytes(b"of an older run")
    code = f"""
import sys
sys.argv = ["hoi.run", *{SMOKE}, "ablation=no_mpm", "stage/motion=none", "stage.coordinate.iterations=2"]
sys.argv += ["render=none", "out={tmp_path}"]
from hoi.run import main
try: main()
except SystemExit as end: assert not end.code, end.code
print(sorted({{"taichi", "av", "gsplat"}} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]
    with pytest.raises(InputError, match="has no video"):
        video(tmp_path / "run.mcap")


def test_a_video_that_cannot_be_drawn_keeps_the_run(composed, tmp_path, monkeypatch):
    """A fault of the renderer costs the video, not what was computed before it."""
    monkeypatch.setattr("hoi.render.replay.replay", refuse)
    options = ["human.gaussians=1000", "scene.frames=4", "scene.contact_frame=2", "ablation=no_mpm"]
    config = to_config(composed(*SMOKE, *TINY_VIDEO, *options, "stage/motion=none", "stage/contact=none"))
    with pytest.raises(RunError, match=r"render: splats are not finite; render=none runs without a video"):
        jobs.run([jobs.Job(config, tmp_path / "run.mcap", "seed: 0\n", {"seed": "0"})], make_plan(config))
    assert [file.name for file in tmp_path.iterdir()] == ["run.failed.mcap"]
    failed = read(tmp_path / "run.failed.mcap")
    assert failed.result["status"] == "failed" and len(failed.state.trajectory.positions) == 4


def refuse(*_, **__):
    raise InputError("splats are not finite")


def test_a_backend_that_is_not_there_is_refused_before_the_run(tmp_path):
    if torch.cuda.is_available():
        pytest.skip("gsplat may run here")
    done = hoi(*SMOKE, *TINY_VIDEO, "render.backend=gsplat", "out=here", cwd=tmp_path)
    assert done.returncode == 2
    assert "render.backend" in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_without_attraction_nothing_pulls_and_the_person_starts_where_they_did(runs):
    """One thing differs, L_attr: j*, t* and the placement are the full method's."""
    (run, *_), (full, *_) = runs("no_attraction"), runs("full")
    losses = [{name for row in each.history if row["stage"] == "coordinate" for name in row} for each in (run, full)]
    assert losses[1] - losses[0] == {"attraction"} and not losses[0] - losses[1]
    assert run.state.target == full.state.target
    np.testing.assert_allclose(run.state.motion.translation[0], full.state.motion.translation[0], atol=1e-6)


def test_without_contact_the_ball_ignores_the_hit(runs):
    run, *_ = runs("no_contact")
    full, *_ = runs("full")
    assert run.state.contact is None
    # Paired ablations: until the contact and its answer, but for stage 3 in its window, the persons move alike.
    first = min(push(full).frame, full.state.target.frame) - 2
    alike = [frame for frame in range(len(run.state.motion)) if frame < first]
    assert len(alike) > 10
    for name in ("translation", "orientation", "body_pose"):
        ours, theirs = (getattr(each.state.motion, name)[alike] for each in (run, full))
        np.testing.assert_array_equal(ours, theirs)
    com = run.state.trajectory.com
    np.testing.assert_allclose(com, np.tile(com[0], (len(com), 1)), atol=1e-6)


def test_without_mpm_it_moves_on_a_straight_line(runs):
    run, *_ = runs("no_mpm")
    contact = push(run)
    assert contact is not None
    after = run.state.trajectory.com[int(np.ceil(contact.frame)) :]
    steps = np.diff(after, axis=0)
    np.testing.assert_allclose(steps, np.tile(contact.v_post / run.scene.fps, (len(steps), 1)), atol=1e-6)
    assert run.state.trajectory.deformation_gradient is None


def test_without_mdm_it_moves_only_around_the_contact_frame(runs):
    run, *_ = runs("no_mdm")
    pose = run.state.motion.body_pose
    target = run.state.target
    assert target.chosen_by == "scene"
    moved = np.abs(pose - pose[0]).max(axis=(1, 2)) > 1e-6
    frames = np.arange(len(pose))
    near = (np.abs(frames - target.frame) <= 6) | (frames > push(run).frame)  # then the person answers
    assert moved[target.frame]
    assert not moved[~near].any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["ablation=no_fun"], ["ablation", "no_fun"]),
        (["object.size=-1"], ["object.size", "-1"]),
        (["object=from_file", "object.path=missing.ply", "object.size=0.3"], ["missing.ply"]),
        (["scene.approach=none", "scene.placement.position=[0,0.05,0.5]"], ["scene.placement", "inside the person"]),
        (["scene.placement.position=[0,2,0.01]"], ["ground"]),
        (["out=/dev/null/runs"], ["/dev/null"]),
        (["stage.object.dt=0.5"], ["stage.object.dt must be at most"]),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(arguments, words, tmp_path):
    done = hoi(*SMOKE, *([] if arguments[0].startswith("out=") else ["out=here"]), *arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("hoi:")]
    assert len(errors) == 1
    assert all(word in errors[0] for word in words), errors
    assert "Traceback" not in done.stderr
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_broken_object_file(tmp_path):
    (tmp_path / "cut.splat").write_bytes(b"\0" * 100)
    done = hoi(*SMOKE, "object=from_file", "object.path=cut.splat", "object.size=0.3", "out=here", cwd=tmp_path)
    assert done.returncode == 2
    assert "cut.splat" in done.stderr and "Traceback" not in done.stderr


def test_interrupt_leaves_nothing_that_looks_complete(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "hoi.run", "out=here"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job inherits it as ignored
    )
    deadline = time.monotonic() + 60
    while not (tmp_path / "here").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    # Where a library swallows the interrupt, the process is ended with its lock, which nobody holds any more.
    assert {file.name for file in (tmp_path / "here").iterdir()} <= {".lock"}


@pytest.mark.parametrize("then", ["time.sleep(60)", "raise ImportError('initialization failed')", "sys.exit(1)"])
def test_what_libraries_make_of_an_interrupt_does_not_matter(then):
    """Some swallow it while they are imported, some make an error of it."""
    code = f"""
import os, signal, sys, time
from hoi.terminal.interrupt import interruptible
signal.signal(signal.SIGINT, signal.default_int_handler)
with interruptible():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
    except BaseException:
        {then}
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=50)
    assert done.returncode == 130
    assert done.stderr == "hoi: interrupted; what was not finished is not recorded\n"


@pytest.mark.parametrize("name", ["plant.splat", "spot_10k.splat"])
def test_captured_object(name, shared_objects, tmp_path):
    size = "0.5" if name.startswith("plant") else "0.4"
    done = hoi(
        *SMOKE, "object=from_file", f"object.path={shared_objects / name}", f"object.size={size}", "out=here",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    run = read(tmp_path / "here" / "run.mcap")
    assert np.isfinite(run.state.trajectory.positions).all()
    assert run.state.trajectory.positions[..., 2].min() > -0.05


def test_runs_outside_the_checkout(tmp_path):
    assert hoi("plan_only=true", cwd=tmp_path).returncode == 0
