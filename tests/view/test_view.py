"""The viewer without a browser: frames, clock, switches, runs side by side, files that are none, large objects."""

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hoi import record
from hoi.data import Contact, ContactSearch, ObjectTrajectory, Plane, Run
from hoi.errors import InputError
from hoi.render.marks import bones, impulse_arrow, marks_of, normal_arrow, plane_axes, trail, trail_colours
from hoi.render.replay import replay
from hoi.view.__main__ import main
from hoi.view.clock import Clock, Player, common_clock
from hoi.view.moments import UNIT, Moments, faded, load, pack
from hoi.view.words import curves_of, facts_markdown, plain, plan_markdown
from tests.demo_run import make_run, posed_means

FRAMES, CONTACT = 8, 3.4
WALL = Plane(np.array([0.0, 3.0, 0.0]), np.array([0.0, -1.0, 0.0]))


def positions(packed):
    """Centres [m], (N, 3)."""
    return packed[:, :3].copy().view(np.float32) * np.float32(UNIT)


@pytest.fixture(scope="module")
def demo() -> tuple[Run, np.ndarray, np.ndarray]:
    run, points, colours = make_run(frames=FRAMES, points=200, gaussians=40, particles=60, contact_frame=CONTACT)
    assert run.scene is not None
    return replace(run, scene=replace(run.scene, planes=(*run.scene.planes, WALL))), points, colours


def save(demo: tuple[Run, np.ndarray, np.ndarray], path: Path, **changes: object) -> Path:
    run, points, colours = demo
    record.write(replace(run, **changes), path, points, colours, plan_text="")
    return path


@pytest.fixture(scope="module")
def files(demo, tmp_path_factory) -> tuple[Path, Path]:
    """Two variants."""
    folder = tmp_path_factory.mktemp("records")
    other = replace(demo[0].plan, variant="no_mpm")
    return save(demo, folder / "a.mcap"), save(demo, folder / "b.mcap", plan=other)


def covariances(packed: np.ndarray) -> np.ndarray:
    """[m^2], (N, 3, 3)."""
    six = packed[:, 4:7].copy().view(np.float16).astype(np.float64) * UNIT**2
    return six[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


def trajectory_of(run: Run) -> ObjectTrajectory:
    assert run.state.trajectory is not None
    return run.state.trajectory


# --- frames ----------------------------------------------------------------------------------------------------------


def test_frames_hold_the_gaussians_of_the_record(demo):
    run = demo[0]
    moments, shown = Moments(run), replay(run)
    assert run.scene is not None and run.state.motion is not None
    person = posed_means(run.scene.body, run.state.motion)
    for frame in (0, 4, 2, FRAMES - 1):
        moment, parts = moments.at(frame), shown.parts(frame)
        assert list(moment) == ["person", "object"]
        np.testing.assert_allclose(positions(moment["person"]), person[frame], atol=2e-5)
        np.testing.assert_allclose(positions(moment["object"]), trajectory_of(run).positions[frame, :40], atol=1e-6)
        for packed, splats in zip(moment.values(), parts, strict=True):
            np.testing.assert_allclose(covariances(packed), splats.covariances.numpy(), atol=1e-7)
            rgba = packed[:, 7].copy().view(np.uint8).reshape(-1, 4) / 255
            np.testing.assert_allclose(rgba[:, 3], 0.9, atol=1 / 255)
            np.testing.assert_allclose(rgba[:, :3], 0.5 + 0.28209479 * splats.sh[:, 0].numpy(), atol=1 / 255)


def test_a_part_that_rests_is_packed_once_and_room_is_kept_to(demo):
    moments = Moments(demo[0])
    assert moments.at(0)["object"] is moments.at(1)["object"]  # at rest before the contact
    assert moments.at(5)["object"] is not moments.at(6)["object"]
    assert moments.prepare(0) and moments.at(2) is moments.at(2)
    tight = Moments(demo[0], kept_bytes=2 * 240 * 32)
    assert [tight.prepare(frame) for frame in range(4)] == [True, True, False, False]
    moment = tight.at(6)
    assert np.array_equal(moment["person"], Moments(demo[0]).at(6)["person"])


def test_thin_gaussians_keep_their_width(demo):
    splats = replay(demo[0]).parts(0)[0]
    thin = replace(splats, covariances=splats.covariances * 1e-4)  # 0.1 mm
    ratio = covariances(pack(thin))[:, 0, 0] / thin.covariances.numpy()[:, 0, 0]
    assert abs(ratio - 1).max() < 1e-3


def test_what_is_not_finite_is_not_seen(demo):
    splats = replay(demo[0]).parts(0)[0]
    splats.means[3, 1], splats.covariances[5, 0, 0] = float("nan"), float("inf")
    splats.opacities[7], splats.sh[9, 0, 2] = float("nan"), float("inf")
    packed = pack(splats)
    alpha = packed[:, 7] >> 24
    assert np.flatnonzero(alpha == 0).tolist() == [3, 5, 7, 9]
    assert np.isfinite(positions(packed)).all() and np.isfinite(covariances(packed)).all()


def test_fading_leaves_all_but_the_opacity(demo):
    packed = Moments(demo[0]).at(0)["person"]
    assert packed is not None and faded(packed, 1.0) is packed
    half = faded(packed, 0.5)
    assert np.array_equal(half[:, :7], packed[:, :7]) and np.array_equal(half[:, 7] << 8, packed[:, 7] << 8)
    np.testing.assert_allclose(half[:, 7] >> 24, (packed[:, 7] >> 24) / 2, atol=0.5)


# --- clock -----------------------------------------------------------------------------------------------------------


def test_runs_of_different_rates_share_a_clock(demo):
    run = demo[0]
    slow = replay(replace(run, scene=replace(run.scene, fps=10.0)))
    fast = replay(run)
    clock = common_clock([slow, fast])
    assert clock == Clock(frames=16, fps=20.0)
    assert [clock.frame_of(slow, frame) for frame in (0, 2, 14, 15)] == [0, 1, 7, 7]
    assert [clock.frame_of(fast, frame) for frame in (0, 7, 8, 15)] == [0, 7, 7, 7]


@pytest.fixture
def played() -> Iterator[tuple[Player, list[tuple[int, float]]]]:
    """A player of 10 frames at 50 a second, and what it has shown when."""
    shown: list[tuple[int, float]] = []
    player = Player(Clock(10, 50.0), lambda frame: shown.append((frame, time.perf_counter())))
    player.start()
    yield player, shown
    player.stop()


def until(found) -> None:
    end = time.monotonic() + 20
    while not found():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def test_frames_follow_the_time_and_begin_again(played):
    player, shown = played
    player.play()
    until(lambda: len(shown) > 25)
    player.pause()
    first, start = shown[0]
    for frame, when in shown:  # a frame is shown in its own time, or late on a busy machine, never early
        due = round(((when - start) * 50 + first - frame) / 10) * 10 + frame - first
        assert -1 < (when - start) * 50 - due < 8
    assert {frame for frame, _ in shown} <= set(range(10)) and any(a[0] > b[0] for a, b in pairwise(shown))


def test_pause_seek_and_speed(played):
    player, shown = played
    player.play()
    until(lambda: shown)
    player.pause()
    time.sleep(0.05)
    count = len(shown)
    time.sleep(0.1)
    assert len(shown) == count and not player.playing
    player.set_speed(0.1)  # 5 frames a second
    player.seek(4)
    player.play()
    until(lambda: len(shown) >= count + 2)
    assert [frame for frame, _ in shown[count:]][:2] in ([4, 5], [5, 6])
    assert shown[count + 1][1] - shown[count][1] > 0.1


def test_a_slow_picture_costs_frames_not_time():
    shown = []

    def show(frame: int) -> None:
        shown.append((frame, time.perf_counter()))
        time.sleep(0.1)

    player = Player(Clock(1000, 50.0), show)
    player.start()
    player.play()
    until(lambda: len(shown) >= 6)
    player.stop()
    (first, start), (last, end) = shown[0], shown[5]
    assert last - first == pytest.approx((end - start) * 50, abs=1.5) and last - first >= 20


# --- marks -----------------------------------------------------------------------------------------------------------


def test_marks(demo):
    run = demo[0]
    marks = marks_of(run)
    assert marks.joints is not None and marks.com is not None and marks.speed is not None
    ends = bones(marks.joints[2])
    assert ends.shape == (23, 2, 3) and np.array_equal(ends[4], marks.joints[2, [2, 5]])  # right hip, right knee
    path = trail(marks.com, 4)
    assert path.shape == (FRAMES - 1, 2, 3)
    np.testing.assert_array_equal(path[:4, 1], marks.com[1:5])
    np.testing.assert_array_equal(path[4:], np.broadcast_to(marks.com[4], (FRAMES - 5, 2, 3)))
    assert trail_colours(marks.speed).shape == path.shape and len(np.unique(trail_colours(np.zeros(4)))) == 3
    contact: Contact = marks.contacts[0]
    start, end = normal_arrow(contact)
    np.testing.assert_allclose(end - start, 0.3 * contact.normal, atol=1e-12)
    start, end = impulse_arrow(contact, 2 * float(np.linalg.norm(contact.impulse)))
    assert np.linalg.norm(end - start) == pytest.approx(0.3)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, -1, 0), (1, 0, 0), (0, 0, -1), (0.3, -0.2, 0.9)])
def test_axes_of_a_plane(normal):
    axes = plane_axes(np.array(normal, float))
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes[:, 2], np.array(normal) / np.linalg.norm(normal), atol=1e-12)


# --- words -----------------------------------------------------------------------------------------------------------

EVIL = "<img src=x onerror=alert(1)> ![a](/etc/passwd) **b** `c` | d\n# e"


def test_no_markup_of_a_record(demo):
    assert plain(EVIL).count("\\") == sum(not (c.isalnum() or c.isspace()) for c in EVIL) and "\n" not in plain(EVIL)
    run = demo[0]
    evil = replace(run, plan=replace(run.plan, variant=EVIL), result={"status": EVIL}, provenance={"scene": EVIL})
    for text in (plan_markdown(evil), facts_markdown(evil)):
        assert not re.search(r"(?<!\\)<|(?<!\\)!|(?<!\\)`", text) and "\n# e" not in text
    assert len(plain("x" * 10_000)) == 400


def test_plan_and_facts(demo):
    plan, facts = plan_markdown(demo[0]), facts_markdown(demo[0])
    assert "**full**" in plan and "**motion**, hmsd: a prompt is given" in plan and "saves the video prior" in plan
    assert "a person kicks" in facts and "| outcome | contact |" in facts and "| motion | 1.0 |" in facts


def test_losses_by_stage_and_run(demo):
    run = replace(
        demo[0],
        history=(
            {"stage": "motion", "iteration": 0.0, "hmsd": 0.5},
            {"stage": "motion", "iteration": 1.0, "hmsd": 0.25, "feet": 0.0},
            {"stage": "refine", "iteration": 0.0, "sds": 2.0},
        ),
    )
    motion, refine = curves_of([run], ["full"])
    assert (motion.title, refine.title) == ("motion", "refine") and list(motion.losses) == ["hmsd", "feet"]
    np.testing.assert_array_equal(motion.losses["feet"], [np.nan, 0.0])
    assert not motion.logarithmic and refine.logarithmic
    both = curves_of([run, run], ["full", "no_mpm"])[1]
    assert list(both.losses) == ["full · sds", "no_mpm · sds"]
    assert curves_of([replace(run, history=())], ["full"]) == []


# --- the viewer ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def viewer(files) -> Iterator:
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.view.viewer import of_records

    made = of_records(files, port=0, playing=False)
    yield made
    made.stop()


def shown_nodes(viewer) -> set[str]:
    """Names of what can be seen of the first run."""
    handles = viewer.server.scene._handle_from_node_name
    return {name for name, handle in handles.items() if name.startswith("/run0/") and handle.visible}


def test_drawing_sends_the_frame(viewer, demo):
    moments = Moments(demo[0])
    for frame in (5, 1):
        viewer.draw(frame)
        assert viewer.nodes
        for nodes in viewer.nodes:
            assert np.array_equal(nodes._splats["person"].buffer, moments.at(frame)["person"])
            assert np.array_equal(nodes._splats["object"].buffer, moments.at(frame)["object"])
        assert viewer.panel.frame == frame


def test_runs_stand_side_by_side(viewer):
    first, second = (viewer.server.scene._handle_from_node_name[f"/run{k}"].position for k in (0, 1))
    assert first[0] - second[0] >= 2 and np.array_equal(first[1:], second[1:])
    labels = [viewer.server.scene._handle_from_node_name[f"/run{k}/label"].text for k in (0, 1)]
    assert labels == ["full", "no_mpm"]


def test_people_who_go_towards_each_other_do_not_meet(demo):
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.view.viewer import MARGIN, _offsets

    motion = demo[0].state.motion
    path = np.linspace(0, 3, FRAMES)[:, None] * (1.0, 0.0, 0.0)
    runs = []
    for way in (-1, 1):
        moved = replace(motion, translation=(motion.translation + way * path).astype(np.float32))
        runs.append(Moments(replace(demo[0], state=replace(demo[0].state, motion=moved))))
    left, right = (
        run.replay.action().person[..., 0] + offset[0] for run, offset in zip(runs, _offsets(runs), strict=True)
    )
    assert left.min() - right.max() >= MARGIN


def test_contact_shows_from_its_moment_on(viewer):
    contact = {"/run0/contact/0/normal", "/run0/contact/0/impulse", "/run0/contact/0/strength"}
    viewer.draw(3)
    assert not contact & shown_nodes(viewer)
    viewer.draw(4)
    assert contact <= shown_nodes(viewer)
    viewer.panel.switches["contact"].value = False
    assert not contact & shown_nodes(viewer)
    viewer.panel.switches["contact"].value = True


@pytest.mark.parametrize(
    ("switch", "node"),
    [
        *((name, name) for name in ("person", "object", "skeleton", "trail", "particles")),
        ("ground", "ground/0"),
        ("ground", "ground/1"),
    ],
)
def test_switches(viewer, switch, node):
    box = viewer.panel.switches[switch]
    before = box.value
    for on in (not before, before):
        box.value = on
        assert (f"/run0/{node}" in shown_nodes(viewer)) == on


def test_marks_move_while_they_are_shown(viewer, demo):
    marks = marks_of(demo[0])
    assert marks.joints is not None and marks.particles is not None
    for name in ("skeleton", "particles"):
        viewer.panel.switches[name].value = True
    viewer.draw(6)
    nodes = viewer.nodes[0]
    np.testing.assert_allclose(nodes._skeleton.points, bones(marks.joints[6]), atol=1e-6)
    np.testing.assert_allclose(nodes._particles.points, marks.particles[6], atol=1e-6)
    for name in ("skeleton", "particles"):
        viewer.panel.switches[name].value = False


def test_playing_goes_through_the_frames(viewer):
    seen, draw = set(), viewer.player._show
    viewer.player._show = lambda frame: (draw(frame), seen.add(viewer.panel.frame))
    viewer.panel.toggle()
    assert viewer.player.playing
    until(lambda: len(seen) >= 5)
    viewer.panel.toggle()
    viewer.player._show = draw
    assert not viewer.player.playing


def test_people_or_objects_alone(demo, tmp_path):
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.view.viewer import of_records

    state = demo[0].state
    alone = save(demo, tmp_path / "person.mcap", state=replace(state, trajectory=None, contact=None))
    thing = tmp_path / "object.mcap"
    record.write(replace(demo[0], state=replace(state, motion=None)), thing, None, None, plan_text="")
    made = of_records([alone, thing], port=0, playing=False)
    made.draw(FRAMES - 1)
    assert [list(nodes._splats) for nodes in made.nodes] == [["person"], ["object"]]
    made.stop()


def test_one_frame_and_no_contact(demo, tmp_path):
    pytest.importorskip("viser", reason="needs hoi[view]")
    from hoi.view.viewer import of_records

    run, points, colours = make_run(frames=1, points=100, gaussians=20, particles=30)
    still = replace(run.state, contact=ContactSearch((), 0.2, 0.0, 3))
    record.write(replace(run, state=still), tmp_path / "one.mcap", points, colours, plan_text="")
    made = of_records([tmp_path / "one.mcap"], port=0)
    assert made.clock.frames == 1 and not made.player.playing
    made.stop()


def test_a_hundred_thousand_gaussians():
    run = make_run(frames=3, points=100, gaussians=100_000, particles=100_001, contact_frame=0.5)[0]
    moments = Moments(run)
    started = time.process_time()
    moment = moments.at(2)
    assert time.process_time() - started < 2
    assert moment["object"].nbytes == 3_200_000
    marks = marks_of(run)
    assert marks.particles is not None and 20_000 < marks.particles.shape[1] <= 40_000


# --- the command -----------------------------------------------------------------------------------------------------


def spoilt(files, folder: Path, kind: str) -> Path:
    path = folder / "bad.mcap"
    whole = files[0].read_bytes()
    if kind == "cut short":
        path.write_bytes(whole[: len(whole) // 2])
    elif kind == "damaged":
        path.write_bytes(whole[:9000] + bytes(400) + whole[9400:])
    elif kind == "no MCAP":
        path.write_text("hello")
    elif kind == "another's":
        from mcap.writer import Writer

        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            writer.finish()
    return path


@pytest.mark.parametrize("kind", ["missing", "cut short", "damaged", "no MCAP", "another's"])
def test_bad_records_take_one_line(files, tmp_path, capsys, kind):
    bad = spoilt(files, tmp_path, kind)
    assert main([str(files[0]), str(bad), "--port", "0"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(f"view: {bad}")


def test_a_run_with_nothing_to_show_takes_one_line(demo, tmp_path, capsys):
    empty = save(demo, tmp_path / "failed.mcap", scene=None, state=type(demo[0].state)(), result={"status": "failed"})
    assert main([str(empty), "--port", "0"]) == 2
    assert "neither a motion nor a trajectory" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"failed\.mcap"):
        load([empty])


def test_a_taken_port_takes_one_line(files, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main([str(files[0]), "--port", str(taken.getsockname()[1])]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "cannot listen" in err


def test_without_viser(files, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main([str(files[0])]) == 2
    assert capsys.readouterr().err == "view: needs hoi[view]: pip install 'hoi[view]'\n"


@pytest.mark.parametrize("port", ["-1", "70000", "x"])
def test_no_such_port(files, capsys, port):
    with pytest.raises(SystemExit) as ended:
        main([str(files[0]), f"--port={port}"])
    assert ended.value.code == 2 and "0 to 65535" in capsys.readouterr().err


def test_ctrl_c_ends_it_quietly(files):
    pytest.importorskip("viser", reason="needs hoi[view]")
    command = [sys.executable, "-m", "hoi.view", str(files[0]), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    guard = threading.Timer(60, process.kill)
    guard.start()
    assert process.stdout is not None
    line = process.stdout.readline()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    guard.cancel()
    assert line.startswith("http://localhost:") and (process.returncode, out, err) == (0, "", "")
