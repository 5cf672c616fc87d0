"""The method from Python: light to import, in memory, the same as the command line, nothing global touched."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

import hoi
from hoi.data import Material
from hoi.gaussians import fibonacci_sphere, select, sh_from_colours, transform
from hoi.objects.shapes import SHAPES, build
from hoi.record import message_digest
from tests.conftest import ROOT

QUICK = (
    "scene=punch_blue_ball",
    "experiment=smoke",
    "stage.motion.iterations=2",
    "stage.coordinate.iterations=4",
    "human.gaussians=1000",
    "object.max_gaussians=500",
    "human_points=200",
)
STILL = (
    "experiment=smoke",
    "stage/motion=none",
    "stage/attraction=none",
    "stage/refine=none",
    "human.gaussians=1000",
    "object.max_gaussians=500",
    "scene.frames=22",
)
"""Nobody moves: for what hangs on the object alone."""


def ball(radius: float = 0.1, count: int = 2000, colour: tuple[float, float, float] = (0.8, 0.2, 0.1)):
    """An opaque ball of Gaussians around the origin."""
    same = np.ones((count, 1))
    rgb = sh_from_colours(same * colour)
    scales = np.full((count, 3), 0.06 * radius)
    return hoi.GaussianCloud(radius * fibonacci_sphere(count), same * [1, 0, 0, 0], scales, same[:, 0], rgb)


def at(cloud: hoi.GaussianCloud, place) -> hoi.GaussianCloud:
    return transform(cloud, np.eye(3), 1.0, place)


def python(*arguments: str, cwd) -> str:
    """What a Python of its own prints; it must end well."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def assert_same(one: hoi.Run, other: hoi.Run) -> None:
    """To the bit, in what a record keeps."""
    assert one.state.trajectory is not None and other.state.trajectory is not None
    assert one.state.motion is not None and other.state.motion is not None
    for name in ("positions", "com", "energy", "deformation_gradient"):
        np.testing.assert_array_equal(getattr(one.state.trajectory, name), getattr(other.state.trajectory, name))
    for name in ("translation", "orientation", "body_pose"):
        np.testing.assert_array_equal(getattr(one.state.motion, name), getattr(other.state.motion, name))
    assert one.result["outcome"] == other.result["outcome"] and one.result["variant"] == other.result["variant"]


def one_line(error: BaseException) -> str:
    assert "\n" not in str(error), str(error)
    return str(error)


# --- what is imported ------------------------------------------------------------------------------------------------


def test_import_is_light_and_says_what_there_is(tmp_path):
    says = """
import json, sys
import hoi
heavy = [name for name in ("torch", "hydra", "numpy", "omegaconf", "taichi", "quadrants") if name in sys.modules]
try:
    hoi.simulation
except AttributeError as error:
    said = str(error)
print(json.dumps([heavy, dir(hoi), said]))
"""
    heavy, names, said = json.loads(python("-c", says, cwd=tmp_path))
    assert not heavy
    assert set(names) == set(hoi.__all__) >= {"compose", "run", "simulate", "sample_motion", "render", "read", "write"}
    assert "'simulation'" in said and all(name in said for name in hoi.__all__)
    assert all(getattr(hoi, name) is not None for name in hoi.__all__)


@pytest.mark.parametrize("first", ["hoi.run", "import hoi.run", "import hoi.render.cameras", "from hoi import render"])
def test_rooms_of_the_same_name_can_be_called(first, tmp_path):
    """`hoi.run` and `hoi.render` are modules as well; which comes first makes no difference."""
    says = f"""
import hoi
{first}
import hoi.run
import hoi.render.cameras
from hoi import run
assert callable(hoi.run) and callable(run) and callable(hoi.render)
assert hoi.render.cameras.WIDTH == 720
for call in (hoi.run, hoi.render):
    try:
        call()
    except TypeError as error:
        print(error)
"""
    said = python("-c", says, cwd=tmp_path)
    assert "run() missing 1 required positional argument: 'config'" in said
    assert "render() missing 1 required positional argument: 'cloud'" in said


# --- run -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def config():
    return hoi.compose(*QUICK, seed=1)


@pytest.fixture(scope="module")
def in_memory(config):
    return hoi.run(config)


@pytest.fixture(scope="module")
def of_the_command_line(tmp_path_factory):
    """The record of `python -m hoi.run` with the same settings."""
    folder = tmp_path_factory.mktemp("command")
    python("-m", "hoi.run", *QUICK, "seed=1", "out=here", cwd=folder)
    return folder / "here" / "run.mcap"


def test_in_memory_nothing_else_is_touched(config, in_memory, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    threads, environment, state = torch.get_num_threads(), dict(os.environ), torch.get_rng_state()
    numbers = np.random.get_state(legacy=False)["state"]["key"].copy()  # noqa: NPY002
    again = hoi.run(config)
    assert torch.get_num_threads() == threads and os.getcwd() == str(tmp_path) and dict(os.environ) == environment
    assert torch.equal(torch.get_rng_state(), state), "torch's own random numbers"
    assert (np.random.get_state(legacy=False)["state"]["key"] == numbers).all(), "NumPy's own"  # noqa: NPY002
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")
    assert_same(again, in_memory)


@pytest.mark.slow
def test_it_is_what_the_command_line_does(in_memory, of_the_command_line, tmp_path):
    assert_same(in_memory, hoi.read(of_the_command_line))
    hoi.write(in_memory, tmp_path / "run.mcap", human_points=200)
    assert message_digest(tmp_path / "run.mcap") == message_digest(of_the_command_line)


@pytest.mark.slow
def test_what_is_read_can_be_written_again(of_the_command_line, tmp_path):
    hoi.write(hoi.read(of_the_command_line), tmp_path / "again.mcap", human_points=200)
    assert message_digest(tmp_path / "again.mcap") == message_digest(of_the_command_line)


@pytest.mark.slow
def test_runs_in_one_process_do_not_disturb_each_other(config, in_memory):
    other = hoi.compose(*QUICK, "stage.object.precision=float64", "stage.motion.sample_guidance=2", seed=2)
    assert hoi.run(other).result["outcome"] != in_memory.result["outcome"]
    assert_same(hoi.run(config), in_memory)


def test_out_records_and_is_read_back(config, in_memory, tmp_path, monkeypatch, capfd):
    first = hoi.run(config, out=tmp_path / "here")
    assert sorted(file.name for file in (tmp_path / "here").iterdir()) == ["run.mcap"]
    assert_same(first, in_memory)
    written = (tmp_path / "here" / "run.mcap").stat().st_mtime_ns
    monkeypatch.setattr("hoi.runner.jobs.run", lambda *_: pytest.fail("computed again"))
    again = hoi.run(config, out=tmp_path / "here")
    assert (tmp_path / "here" / "run.mcap").stat().st_mtime_ns == written
    assert_same(again, in_memory)
    assert capfd.readouterr() == ("", "")
    with pytest.raises(hoi.InputError, match="holds a run of another config") as raised:
        hoi.run(hoi.compose(*QUICK, seed=2), out=tmp_path / "here")
    one_line(raised.value)


@pytest.mark.slow
def test_a_record_of_the_command_line_is_found_again(config, in_memory, of_the_command_line, monkeypatch):
    monkeypatch.setattr("hoi.runner.jobs.run", lambda *_: pytest.fail("computed again"))
    assert_same(hoi.run(config, out=of_the_command_line.parent), in_memory)


def test_progress_is_shown_when_asked_for(tmp_path, capfd):
    hoi.run(hoi.compose(*STILL, "scene=punch_blue_ball"), out=tmp_path / "here", progress=True)
    out, shown = capfd.readouterr()
    assert out == "" and "free motion" in shown
    assert shown.splitlines()[-1].startswith("no_attraction+no_mdm+no_video_sds: ")


def test_an_object_in_memory_stands_where_the_scene_says():
    config = hoi.compose(*STILL, "scene.placement.position=[0.3,0.9,null]", "material=foam", "scene.approach=none")
    cloud = at(ball(radius=0.15, count=500), [3, -2, 7])
    run = hoi.run(config, object=cloud)
    thing = run.scene.thing
    assert len(thing.cloud) == len(cloud) and thing.size == pytest.approx(0.3, rel=0.01)
    low, high = thing.cloud.means.min(0), thing.cloud.means.max(0)
    np.testing.assert_allclose((low + high)[:2] / 2, [0.3, 0.9], atol=1e-4)
    assert thing.particles[:, 2].min() == pytest.approx(0, abs=1e-4)
    assert thing.material == hoi.run(config).scene.thing.material and thing.material.name == "foam"
    np.testing.assert_allclose(np.linalg.norm(thing.cloud.means - thing.cloud.means.mean(0), axis=1), 0.15, rtol=0.02)
    assert "sha256.object" in run.provenance


# --- the object alone ------------------------------------------------------------------------------------------------


def test_a_ball_in_free_fall_is_on_a_parabola():
    cloud = at(ball(), [0, 0, 3])
    moved = hoi.simulate(cloud, "basketball", 0.5, velocity=[1, 0, 2], cells_across=6)
    time = np.arange(11) / 20
    path = moved.com[0] + np.outer(time, [1, 0, 2]) + np.outer(time**2, [0, 0, -9.81 / 2])
    assert moved.phase == ("flight",) * 11
    np.testing.assert_allclose(moved.com, path, atol=0.006)
    assert 0.001 < path[-1, 0] - moved.com[-1, 0]  # less what the air takes
    np.testing.assert_allclose(moved.positions[0, : len(cloud)], cloud.means, atol=1e-6)
    assert moved.positions.shape[0] == len(moved.com) == 11


def test_it_comes_to_rest_on_the_ground():
    moved = hoi.simulate(at(ball(count=500), [0, 0, 0.5]), "metal", 1.6, fps=10, cells_across=6)
    assert list(dict.fromkeys(moved.phase)) == ["flight", "mpm", "rest"], "the phases of a run"
    assert np.linalg.norm(moved.com_velocity[-1]) == 0 and moved.positions[-1, :, 2].min() > -0.03
    assert 0.03 < moved.com[-1, 2] < 0.1


def test_it_takes_a_material_a_spin_and_other_planes():
    spinning = {"planes": (), "gravity": [0, 0, 0], "angular_velocity": [0, 0, 5]}
    soft = Material("soft", "neo_hookean", 1e5, 0.3, 300.0, restitution=0.5, ground_friction=0.5)
    moved = hoi.simulate(at(ball(), [0, 0, 0.2]), soft, 0.2, **spinning, cells_across=6)
    np.testing.assert_allclose(moved.com, moved.com[:1].repeat(len(moved.com), 0), atol=1e-6)
    turned = moved.positions[-1] - moved.com[-1]
    start = moved.positions[0] - moved.com[0]
    cos, sin = np.cos(5 * 0.2), np.sin(5 * 0.2)
    np.testing.assert_allclose(turned, start @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]), atol=1e-3)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "granite"), "granite"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", seconds=0), "seconds"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", fps=-1), "fps"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", seconds=np.inf), "seconds"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", cells_across=0), "cells_across"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", velocity=[1, 2]), "velocity"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", threads=0), "threads"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", device="tpu"), "device"),
        (lambda: hoi.simulate(at(ball(), [0, 0, 1]), "jelly", gravity=[0, -9.81]), "gravity"),
        (lambda: hoi.simulate(ball(), "jelly"), "the ground"),
        (
            lambda: hoi.simulate(select(ball(), np.arange(0)), "jelly"),
            "no Gaussian",
        ),
        (lambda: hoi.sample_motion("a person kicks", frames=2), "frames"),
        (lambda: hoi.sample_motion("a person kicks", "giant"), "giant"),
        (lambda: hoi.sample_motion("a person kicks", checkpoint="nowhere.pt"), "nowhere.pt"),
        (lambda: hoi.compose("scene=kick_a_ball"), "kick_a_ball"),
        (lambda: hoi.compose("sede=1"), "sede"),
        (lambda: hoi.compose(seed=-1), "seed"),
        (lambda: hoi.compose(sede=1), "sede"),
        (lambda: hoi.run(hoi.compose(seeds=2)), "seeds"),
        (lambda: hoi.render(ball(), backend="crayon"), "backend"),
        (lambda: hoi.render(ball(), background=[0.5, 0.5]), "background"),
        (lambda: hoi.render(ball(), device="tpu"), "device"),
        (lambda: hoi.render([]), "no Gaussian"),
        (lambda: hoi.render(ball(), sh_degree=-1), "sh_degree"),
        (lambda: hoi.render(replace(ball(), scales=np.ones((2000, 1)))), "cloud.scales: shape (2000, 1)"),
        (lambda: hoi.simulate(replace(ball(), means=np.full((2000, 3), np.nan)), "jelly"), "cloud.means"),
        (lambda: hoi.run(hoi.compose(), object=replace(ball(), sh=np.ones((2000, 3)))), "cloud.sh"),
        (lambda: hoi.read("nowhere.mcap"), "nowhere.mcap"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(call, says):
    with pytest.raises(hoi.InputError) as raised:
        call()
    assert says in one_line(raised.value)


# --- the person alone ------------------------------------------------------------------------------------------------


def test_a_motion_is_what_stage_1_starts_from(tmp_path):
    prompt = "a person kicks with the right foot"
    config = hoi.compose(
        *QUICK, "human=woman", "human.gaussians=26000", f"scene.motion_prompt={prompt}", "stage.motion.iterations=0",
        "stage.coordinate.iterations=0", "scene.approach=none", "stage/refine=none", "stage/contact=none", seed=5,
    )  # fmt: skip
    expected = hoi.run(config).state.motion
    drawn = hoi.sample_motion(prompt, "woman", 5)
    assert expected is not None and len(drawn) == 40 and drawn.fps == expected.fps
    for name in ("translation", "orientation", "body_pose"):
        np.testing.assert_allclose(getattr(drawn, name), getattr(expected, name), atol=1e-6)
    python("-m", "hoi.runner.sample", prompt, "-o", "kick.mcap", "--person", "woman", "--seed", "5", cwd=tmp_path)
    told = hoi.read(tmp_path / "kick.mcap").state.motion
    assert told is not None
    for name in ("translation", "orientation", "body_pose"):
        np.testing.assert_array_equal(getattr(told, name), getattr(drawn, name))


# --- pictures --------------------------------------------------------------------------------------------------------


def test_a_picture_of_a_ball():
    colour, behind = (0.8, 0.2, 0.1), (0.1, 0.3, 0.6)
    picture = hoi.render(ball(colour=colour), background=behind)
    assert picture.shape == (480, 720, 3) and picture.min() >= 0 and picture.max() <= 1
    np.testing.assert_allclose(picture[240, 360], colour, atol=0.01)
    for corner in (picture[0, 0], picture[0, -1], picture[-1, 0], picture[-1, -1]):
        np.testing.assert_allclose(corner, behind, atol=1e-6)
    grey = hoi.render([ball(colour=colour), at(ball(colour=colour), [5, 0, 0])], background=0.25)
    np.testing.assert_allclose(grey[0, 0], 0.25, atol=1e-6)


def test_a_camera_of_ones_own():
    from hoi.render.cameras import look_at

    camera = look_at([0, -2, 0], [0, 0, 0], width=64, height=48)
    cloud = build(SHAPES["soccer_ball"], 0.22).cloud
    assert hoi.render(cloud, camera).shape == (48, 64, 3)
    reference = hoi.render(cloud, camera, backend="reference")
    np.testing.assert_allclose(hoi.render(cloud, camera), reference, atol=0.02)
