"""Sweeps: what they list, what is left of runs that fail, and of sweeps that are killed, interrupted, resumed."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from analysis.variations import VARIATIONS
from hoi.config import CONF, register
from hoi.config.validate import to_config
from hoi.record import read
from hoi.runner.execute import alone, is_finished
from hoi.runner.sweep import Sweep, run_of_sweep
from tests.sweep_kills import RUN, at_work, command, joblib, kill_and_resume, records, start

SWEEPS = Path(__file__).parents[2] / "sweeps"
CELL = "runs/kick_soccer_ball/smoke/no_mpm"
needs_proc = pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="looks for processes in /proc")
needs_submitit = pytest.mark.skipif(find_spec("submitit") is None, reason="hoi[cluster] is not installed")
needs_ray = pytest.mark.skipif(
    find_spec("ray") is None, reason="hydra-ray-launcher is not installed; it is in no extra"
)
needs_joblib = pytest.mark.skipif(find_spec("joblib") is None, reason="hoi[cluster] is not installed")


def composed_sweep(name: str, *overrides: str):
    register()
    with initialize_config_dir(str(SWEEPS), version_base="1.3"):
        return compose(name, [f"hydra.searchpath=[file://{CONF}]", *overrides], return_hydra_config=True)


def choices(sweep: str) -> dict[str, list[str]]:
    """What a sweep lists of each key."""
    params = composed_sweep(sweep).hydra.sweeper.params
    overrides = OverridesParser.create().parse_overrides([f"{key}={value}" for key, value in params.items()])
    return {
        override.get_key_element(): list(override.sweep_string_iterator())
        for override in overrides
        if override.is_sweep_override()
    }


def in_conf(group: str) -> set[str]:
    return {file.stem for file in (CONF / group).glob("*.yaml")}


@pytest.mark.parametrize("name", ["ablations", "cluster_slurm"])
def test_the_benchmark_has_every_scene_of_one_sentence_and_every_ablation(name):
    if find_spec("submitit") is None and name == "cluster_slurm":
        pytest.skip("hoi[cluster] is not installed")
    listed = choices(name)
    in_time = {name for name in in_conf("scene") if "acts:" in (CONF / "scene" / f"{name}.yaml").read_text()}
    assert set(listed["scene"]) == in_conf("scene") - in_time and len(listed["scene"]) == 10
    assert set(listed["ablation"]) == in_conf("ablation") and len(listed["ablation"]) == 6


def test_the_smoke_sweep_is_small():
    assert len(choices("smoke")["scene"]) == 2
    assert composed_sweep("smoke").experiment == "smoke"


def test_variations_differ_in_more_than_their_names():
    listed = choices("variations")["variation"]
    assert set(listed) == {file.stem for file in (SWEEPS / "variation").glob("*.yaml")}
    made = {name: composed_sweep("variations", f"variation={name}") for name in listed}
    assert [config.experiment for config in made.values()] == listed
    assert len({config.out for config in made.values()}) == len(listed)
    assert made["object_low"].scene.placement != made["object_high"].scene.placement
    assert (made["step"].scene.approach, made["stand"].scene.approach) == ("step", "stand")
    assert made["object_fast"].scene.placement.velocity[1] < made["object_slow"].scene.placement.velocity[1] < 0
    assert made["gentle"].scene.motion_prompt == made["hard"].scene.motion_prompt  # it is the strike that differs
    assert made["hard"].scene.tempo / made["gentle"].scene.tempo >= 1.5
    assert set(listed) == set(VARIATIONS)


def sweep(folder: Path, *overrides: str, workers: int = 0) -> subprocess.CompletedProcess[str]:
    folder.mkdir(parents=True, exist_ok=True)
    return subprocess.run(command(*overrides, workers=workers), cwd=folder, capture_output=True, text=True)


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    """A sweep of two runs, by Hydra's basic launcher."""
    folder = tmp_path_factory.mktemp("swept").resolve()
    done = sweep(folder, "ablation=no_mpm", "seed=0,1")
    assert done.returncode == 0, done.stderr
    assert "all 2 runs of the sweep are done" in done.stdout
    return folder


def test_runs_are_where_those_of_single_commands_are(swept, composed):
    """Nothing but the records is written, in folders named by the names of the options."""
    alone = composed("experiment=smoke", "ablation=no_mpm", "seed=1")
    assert alone.out == to_config(alone).out == f"{CELL}/s1"
    assert sorted(records(swept)) == [f"{CELL}/s0/run.mcap", f"{CELL}/s1/run.mcap"]
    assert sum(path.is_file() for path in swept.rglob("*")) == 2


def test_a_run_after_others_in_one_process_is_that_of_a_single_command(swept, tmp_path):
    alone = [each for each in command("ablation=no_mpm", "seed=1", workers=0) if each != "--multirun"]
    subprocess.run(alone, cwd=tmp_path, check=True, capture_output=True)
    assert list(records(tmp_path).items()) == list(records(swept).items())[1:]


def test_what_acts_late_varies_fastest():
    from hydra_plugins.hoi_sweeper import _is_late, _length

    given = OverridesParser.create().parse_overrides(["ablation=a,b,c", "stage/refine=c,d", "seed=0,1", "scene=x"])
    given.sort(key=_is_late)
    assert [override.get_key_element() for override in given] == ["seed", "scene", "ablation", "stage/refine"]
    assert [_length(override) for override in given] == [2, 1, 3, 2]


@needs_joblib
@pytest.mark.parametrize(
    ("runs", "alike", "asked", "together"),
    [(12, 6, "auto", 6), (6, 6, "auto", 3), (3, 6, "auto", 2), (20, 1, "auto", 1), (12, 6, 1, 1)],
)
def test_runs_with_a_beginning_in_common_go_to_one_worker(runs, alike, asked, together):
    from hydra_plugins.hoi_sweeper import HoiSweeper

    sweeper = HoiSweeper(max_batch_size=None)
    sweeper.launcher = SimpleNamespace(joblib={"n_jobs": 2, "batch_size": asked})  # pyright: ignore
    sweeper._keep_together(runs, alike)
    assert sweeper.launcher.joblib["batch_size"] == together  # pyright: ignore


@pytest.fixture(scope="module")
def ray_cluster():
    """Of two nodes, which are processes here."""
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    yield [
        "--config-dir", str(SWEEPS), "--config-name", "cluster_ray", "scene=kick_soccer_ball",
        f"hydra.launcher.ray.init.address={cluster.address}",
    ]  # fmt: skip
    cluster.shutdown()


@pytest.fixture(params=["joblib", pytest.param("submitit", marks=needs_submitit), pytest.param("ray", marks=needs_ray)])
def launcher(request) -> list[str]:
    if request.param == "ray":
        return request.getfixturevalue("ray_cluster")
    return {"joblib": joblib(1), "submitit": ["hydra/launcher=submitit_local"]}[request.param]


@needs_joblib
def test_a_failed_run_stops_no_other_and_finished_ones_are_kept(swept, tmp_path, launcher):
    folder = tmp_path / "again"
    shutil.copytree(swept, folder)
    shutil.rmtree(folder / CELL / "s1")
    before = (folder / CELL / "s0" / "run.mcap").stat().st_mtime_ns
    done = sweep(folder, *launcher, "ablation=no_mpm", "seed=-1,0,1")
    assert done.returncode == 3, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("hoi:")]
    assert errors == [
        f"hoi: {CELL}/s-1: seed must be 0 or more, got -1",
        "hoi: 1 of 3 runs failed; the same command tries them again, and no others",
    ]
    assert records(folder) == records(swept)
    assert (folder / CELL / "s0" / "run.mcap").stat().st_mtime_ns == before
    failed = read(folder / CELL / "s-1" / "run.failed.mcap")
    assert failed.result["status"] == "failed"
    assert failed.result["outcome"] == "seed must be 0 or more, got -1"
    facts = failed.provenance | failed.result
    assert [facts[key] for key in ("scene", "experiment", "variant", "seed")] == [
        "kick_soccer_ball", "smoke", "no_mpm", "-1",
    ]  # fmt: skip


def test_a_run_that_is_killed_has_failed_until_it_is_done(composed, tmp_path, monkeypatch):
    config = composed(*RUN, "ablation=no_mpm", f"out={tmp_path}/run")
    dying = tmp_path / "python"
    dying.write_text("#!/bin/sh\nkill -9 $$\n")
    dying.chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(dying))
        ended = run_of_sweep(config, [], Sweep())
    assert ended.failure == "the process of the run was ended by SIGKILL; the system does so when memory runs out"
    assert read(tmp_path / "run" / "run.failed.mcap").result["outcome"] == ended.failure
    assert not is_finished(config)
    assert not run_of_sweep(config, [], Sweep()).failure
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run.mcap"]
    assert is_finished(config)


def test_a_machine_that_does_not_see_the_folder_says_so(composed):
    ended = run_of_sweep(composed(*RUN), [], Sweep(folder="/not/here"))
    assert ended.failure.endswith("does not see /not/here: No such file or directory")


def test_another_config_in_the_folder_is_a_failure_that_leaves_the_record(composed, swept):
    ended = run_of_sweep(composed(*RUN, "ablation=no_mpm", "seed=7", f"out={swept}/{CELL}/s0"), [], Sweep())
    assert "holds a run of another config" in ended.failure
    assert [file.name for file in (swept / CELL / "s0").iterdir()] == ["run.mcap"]


def test_two_processes_never_compute_into_one_folder(tmp_path, capfd):
    entered = threading.Event()

    def enter() -> None:
        with alone(tmp_path / "run"):
            entered.set()

    other = threading.Thread(target=enter)
    with alone(tmp_path / "run"):
        (tmp_path / "run" / "run.mcap").touch()
        other.start()
        assert not entered.wait(0.3)
    other.join(timeout=10)
    assert entered.is_set()
    assert "another process computes this run" in capfd.readouterr().out
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run.mcap"]


def test_what_a_killed_process_left_is_cleared(tmp_path):
    for name in (".lock", "run.mcap.part", "run.mp4.part"):
        (tmp_path / name).write_bytes(b"unfinished")
    with alone(tmp_path):
        assert [file.name for file in tmp_path.iterdir()] == [".lock"]
    assert not list(tmp_path.iterdir())


@needs_proc
@needs_joblib
def test_a_sweep_that_is_killed_again_and_again_ends_as_if_it_were_not(swept, tmp_path):
    done = kill_and_resume(swept, tmp_path / "killed", ["ablation=no_mpm", "seed=0,1"], kills=2, run=4.0, seed=3)
    assert len(done) == 2


def at_a_run(folder: Path) -> subprocess.Popen[bytes]:
    """A sweep on two workers of which a run has begun."""
    process = start(folder, "ablation=no_mpm", "seed=0,1,2")
    while process.poll() is None and not list(folder.rglob(".lock")):
        time.sleep(0.1)
    return process


def nobody_is_left(folder: Path) -> bool:
    deadline = time.monotonic() + 30
    while at_work(folder) and time.monotonic() < deadline:
        time.sleep(0.2)
    return not at_work(folder)


@needs_proc
@needs_joblib
def test_interrupt_ends_a_sweep(tmp_path):
    process = at_a_run(tmp_path)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    log = (tmp_path / "sweep.log").read_text()
    assert "hoi: interrupted; what was not finished is not recorded" in log
    assert "Traceback" not in log
    assert nobody_is_left(tmp_path)
    assert not list(tmp_path.rglob("run.failed.mcap"))


@needs_proc
@needs_joblib
def test_a_worker_that_is_killed_is_said(tmp_path):
    process = at_a_run(tmp_path)
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process.pid and "LokyProcess" in (entry / "cmdline").read_text():
                os.kill(int(entry.name), signal.SIGKILL)
                break
        except OSError:
            continue
    assert process.wait(timeout=120) == 3
    log = (tmp_path / "sweep.log").read_text()
    assert "hoi: the launcher stopped: TerminatedWorkerError" in log
    assert "Traceback" not in log
    assert nobody_is_left(tmp_path)


@needs_proc
@needs_ray
def test_a_worker_of_ray_that_is_killed_is_said_and_its_run_done_again(swept, tmp_path, ray_cluster):
    overrides = [*ray_cluster, "ablation=no_mpm", "seed=0,1"]
    process = start(tmp_path, *overrides, workers=0)
    while process.poll() is None and not list(tmp_path.rglob(".lock")):
        time.sleep(0.1)
    for entry in Path("/proc").glob("[0-9]*"):
        if b"ray::_run_job" in (entry / "cmdline").read_bytes():
            os.kill(int(entry.name), signal.SIGKILL)
    assert process.wait(timeout=300) == 3
    log = (tmp_path / "sweep.log").read_text()
    assert "hoi: the launcher stopped: " in log and "Traceback" not in log
    assert nobody_is_left(tmp_path)
    assert sweep(tmp_path, *overrides).returncode == 0
    assert records(tmp_path) == records(swept)
