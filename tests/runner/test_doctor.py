"""What `hoi doctor` says of machines that have all, or lack something."""

import sys

import pytest

from hoi.config.compose import config_of
from hoi.data import Check, Plan
from hoi.gpu import GPU
from hoi.plan import make_plan
from hoi.runner import doctor


@pytest.fixture(autouse=True)
def bare(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("hoi.plan.gpus", lambda: [])
    monkeypatch.setattr("hoi.runner.doctor.gpus", lambda: [])


def test_what_is_here_and_what_each_experiment_lacks(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "experiments", lambda: ["laptop", "paper"])
    monkeypatch.setattr(sys, "argv", ["doctor"])
    assert doctor.main() == 0
    lines = capsys.readouterr().out.splitlines()
    said = {line.split("  ")[0].strip(): line for line in lines}
    assert {"Python", "cores", "memory", "free space here", "GPU", "torch", "gsplat"} <= set(said)
    assert said["experiment=laptop"].endswith("ready") and said["experiment=paper"].endswith("not yet")
    lacks = lines[lines.index(said["experiment=paper"]) + 1 :]
    assert len(lacks) == 5 and all(line.startswith("  - ") for line in lacks)


def test_the_default_comes_first_and_all_are_told():
    names = doctor.experiments()
    assert names[0] == "laptop" and {"live", "paper", "paper_smoke", "smoke", "unplaced"} == set(names[1:])


def test_a_gpu_that_is_too_small_is_said():
    plan = Plan("full", (), (), (Check("gpu_memory", "32 GB", ""),))
    assert doctor.verdict(plan, [GPU("big", 80_000_000_000)]) == ["ready"]
    first, line = doctor.verdict(plan, [GPU("small", 24_000_000_000)])
    assert first == "not yet" and "32.0 GB" in line and "24.0 GB" in line and "offload" in line
    assert doctor.verdict(make_plan(config_of()), []) == ["ready"]


def test_bad_overrides_are_one_line(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["doctor", "seed=-1"])
    assert doctor.main() == 2
    assert capsys.readouterr().err == "doctor: seed must be 0 or more, got -1\n"
