"""The map of stability: its verdicts on made-up outcomes, its cases, and the command."""

import csv
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest

from analysis.stability.__main__ import main
from analysis.stability.blow_trial import verdict_of
from analysis.stability.blows import BLOWS
from analysis.stability.cases import CASES, MODELS, Case, quick
from analysis.stability.outcome import Look, Outcome
from analysis.stability.trial import SHAPES, attempt
from analysis.stability.verdict import Verdict, crushing, judge

FREE = Case(planes="none", gravity=0.0, speed=1.0)
TINY = replace(FREE, particles=27, lasts=20, frames=4, spin=10.0)
NOWHERE = Look(0.0, np.array([1.0, 0.0, 0.0]), 0.0, np.array([2.0, 0, 0]), np.zeros(3), np.inf, 1.0, 2.0)


def outcome(case: Case, *changes: dict, **fields) -> Outcome:
    """One look a change, a tenth of a second apart; each change holds from then on."""
    looks = [NOWHERE]
    for number, change in enumerate(changes, start=1):
        looks.append(replace(looks[-1], time=0.1 * number, **change))
    return Outcome(case, tuple(looks), mass=2.0, steps=10, cfl=0.3, reached=1.0, **fields)


def energy(*parts: float) -> dict:
    return {"energy": np.array(parts)}


def test_a_quiet_case_holds() -> None:
    verdict = judge(outcome(FREE, energy(0.9, 0.05, 0), energy(0.8, 0.1, 0)))
    assert (verdict.verdict, verdict.energy_rise, verdict.momentum_drift) == ("held", 0.0, 0.0)
    assert np.isnan(verdict.penetration)


def test_energy_rise_is_found_also_after_a_loss() -> None:
    """From 1 J to 0.5 J to 0.6 J: a rise of 0.1 of the 1 J at stake, though never above the start."""
    verdict = judge(outcome(FREE, energy(0.5, 0, 0), energy(0.5, 0.1, 0)))
    assert verdict.energy_rise == pytest.approx(0.1)
    assert verdict.verdict == "failed" and "energy rose by 0.1" in verdict.reason


def test_work_done_on_the_body_is_no_rise() -> None:
    assert judge(outcome(FREE, energy(3, 0, 0) | {"work": 2.0}, energy(3, 0, 0))).verdict == "held"
    assert judge(outcome(FREE, energy(3, 0, 0) | {"work": 1.0})).verdict == "failed"


def test_momentum_drift_is_found() -> None:
    drifted = judge(outcome(FREE, {"momentum": np.array([2.0, 1e-3, 0])}))
    assert drifted.momentum_drift == pytest.approx(5e-4)
    assert "momentum drifted" in drifted.reason
    assert judge(outcome(FREE, {"momentum": np.array([2.0, 1e-5, 0])})).verdict == "held"
    assert (
        judge(outcome(replace(FREE, precision="float64"), {"momentum": np.array([2.0, 1e-5, 0])})).verdict == "failed"
    )
    assert "angular" in judge(outcome(FREE, {"spin": np.array([0, 1e-3, 0])})).reason


def test_gravity_and_contact_may_change_momentum() -> None:
    """Falling is no drift, nor is what comes after a plane has been in reach."""
    falling = replace(FREE, gravity=10.0, planes="plane")
    down = {"momentum": np.array([2.0, 0, -2.0]), "gap": 10.0, "energy": np.array([1.0, 1.0, -1.0])}
    bounced = {"momentum": np.array([2.0, 0, 5.0]), "gap": 0.1}
    assert judge(outcome(falling, down)).momentum_drift == pytest.approx(0, abs=1e-15)
    assert judge(outcome(falling, down, bounced)).verdict == "held"


def test_penetration_is_found() -> None:
    """Half a cell in at the start counts from there; three cells deeper is through the ground."""
    inside = [replace(NOWHERE, gap=-0.5 * FREE.dx), replace(NOWHERE, time=0.1, gap=-3.5 * FREE.dx)]
    verdict = judge(Outcome(replace(FREE, planes="plane"), tuple(inside), mass=2.0, cfl=0.3))
    assert verdict.penetration == pytest.approx(3.0)
    assert "3 cells deeper" in verdict.reason


def test_what_is_not_finite_fails() -> None:
    assert judge(outcome(FREE, energy(np.nan, 0, 0))).reason == "a state is not finite"


def test_refusals() -> None:
    must = replace(FREE, must="refuse")
    assert judge(Outcome(must, refusal="dt must be less")).verdict == "refused"
    assert judge(Outcome(must, refusal="two\nlines")).verdict == "failed"
    assert judge(Outcome(FREE, refusal="dt must be less")).verdict == "failed"
    assert judge(outcome(must)).reason == "ran where it should have been refused"


def test_only_what_is_crushed_beyond_its_law_may_diverge() -> None:
    """fixed_corotated: more than its own wave speed of 11.6 m/s."""
    said = "t = 1 s, step 3: 5 of 9 particles are not finite; the simulation has diverged"
    ground = Case(gravity=0.0)
    assert crushing(replace(ground, speed=11.0)) < 1 < crushing(replace(ground, speed=12.0))
    assert judge(Outcome(replace(ground, speed=12.0), stop=said)).verdict == "stopped"
    assert judge(Outcome(replace(ground, speed=11.0), stop=said)).verdict == "failed"
    assert (
        judge(Outcome(replace(ground, speed=100.0, model="drucker_prager", friction_angle=0.5), stop=said)).verdict
        == "failed"
    )
    assert judge(Outcome(replace(ground, speed=12.0), failure="KeyError: 1")).verdict == "failed"
    fell = "dt 1 s is above the limit, which has fallen to 0.5 s"
    assert judge(Outcome(replace(ground, dt_share=0.9), stop=fell)).verdict == "stopped"
    assert judge(Outcome(ground, stop=fell)).verdict == "failed"


def test_the_grid_covers_what_it_should() -> None:
    cases = list(CASES.values())
    assert len(cases) >= 300 and all(case.id == name for name, case in CASES.items())
    assert len({replace(case, id="", family="") for case in cases}) > 0.9 * len(cases)  # few say the same twice
    assert {case.model for case in cases} == set(MODELS)
    assert {case.shape for case in cases} == set(SHAPES)
    combinations = Counter(case.compile_key for case in cases if case.must == "run")
    assert {(p, "fixed_corotated", s) for p in ("float32", "float64") for s in ("quadratic", "cubic")} <= set(
        combinations
    )
    shares = Counter((case.dt_share, case.must) for case in cases)
    assert shares[1.1, "refuse"] >= 14 and shares[10.0, "refuse"] >= 14 and shares[1.1, "run"] == 0
    assert not {field.name for field in fields(Case)} & {field.name for field in fields(Verdict)}  # one row holds both
    assert 20 <= len(quick()) <= 80 and {case.id for case in quick()} <= set(CASES)


def test_the_person_is_tried_at_its_extremes() -> None:
    blows = list(BLOWS.values())
    assert len(blows) >= 200 and all(blow.id == name for name, blow in BLOWS.items())
    ends = {name: {getattr(blow, name) for blow in blows} for name in ("mass", "speed", "youngs_modulus", "frames")}
    assert ends["mass"] >= {1e-3, 1e4} and ends["speed"] >= {0.0, 50.0}
    assert ends["youngs_modulus"] >= {1e3, 1e9} and ends["frames"] >= {8, 400}


@pytest.mark.parametrize("blow", [
    "person_impulse/rigid/m1e4/v50", "person_impulse/limp/m0.001/v2", "person_collider/joints/E1e6 m0.1/v10",
    "person_collider/rigid/E1e9 m1e4/v2",
])  # fmt: skip
def test_blows_hold(blow: str) -> None:
    verdict = verdict_of(BLOWS[blow])
    assert verdict.verdict == "held", verdict.reason
    assert verdict.momentum_drift < 1e-4 and verdict.energy_rise < 0.02


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_have_the_size_they_should(shape: str) -> None:
    case = Case(shape=shape)
    positions, volumes = SHAPES[shape](case)
    assert positions.shape == (len(volumes), 3) and (volumes > 0).all()
    assert np.ptp(positions, axis=0).max() <= case.size


@pytest.mark.parametrize("planes", ["plane", "wedge", "corner"])
@pytest.mark.parametrize("tilt", [0.0, 45.0, 90.0])
def test_bodies_start_as_far_from_the_planes_as_they_should(planes, tilt) -> None:
    if planes == "wedge" and tilt == 90.0:
        pytest.skip("two walls face to face leave no room")
    case = replace(TINY, planes=planes, tilt=tilt, gap=2.0)
    spacing = case.size / 3
    assert attempt(case).looks[0].gap == pytest.approx(2 * case.dx + spacing / 2)


def test_a_tiny_case_runs_end_to_end() -> None:
    verdict = judge(attempt(TINY))
    assert verdict.verdict == "held", verdict.reason
    assert verdict.steps >= 20 and verdict.reached == 1.0 and verdict.spin_drift < 1e-5


def test_a_kick_is_counted_as_work() -> None:
    result = attempt(replace(TINY, speed=0.0, spin=0.0, kick=0.01, kick_restitution=1.0))
    speed = 2 * 0.01 * np.sqrt(1e5 * 0.7 / (1.3 * 0.4) / 1000)
    assert result.looks[-1].work == pytest.approx(0.5 * result.mass * speed**2, rel=1e-5)
    assert judge(result).verdict == "held"


@pytest.mark.parametrize("share", [1.1, 10.0])
def test_a_step_above_the_limit_is_refused(share: float) -> None:
    verdict = judge(attempt(replace(TINY, dt_share=share, must="refuse")))
    assert verdict.verdict == "refused" and "must be at most" in verdict.reason


def test_one_case_by_its_id(capsys) -> None:
    assert main(["--case", "step/neo_hookean/quadratic/dt10"]) == 0
    assert "refused" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"), [(["--case", "nonsense"], "--case"), (["--family", "nonsense"], "--family")]
)
def test_bad_arguments_are_one_line(arguments, message, capsys) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and "nonsense" in error and error.count("\n") == 1


def test_bad_jobs() -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--jobs", "0"])
    assert ended.value.code == 2


def test_the_command_writes_table_and_map(tmp_path, capsys) -> None:
    assert main(["--family", "impossible", "--jobs", "1", "-o", str(tmp_path)]) == 0
    with (tmp_path / "stability.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 10 and {row["verdict"] for row in rows} == {"refused"}
    assert CASES[rows[0]["id"]].youngs_modulus == float(rows[0]["youngs_modulus"])
    assert (tmp_path / "stability.png").stat().st_size > 5000
    assert f"{len(rows)} cases: 0 held, {len(rows)} refused" in capsys.readouterr().out


def test_interrupted_it_ends_at_once_and_marks_what_is_left(tmp_path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "analysis.stability", "--family", "drop_of_100m", "--jobs", "1", "-o", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job inherits it as ignored
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    assert process.stderr is not None and process.stderr.read(1) == "0"  # it has begun
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=15)
    assert process.returncode == 130, errors
    assert "2 not run: interrupted" in out
    assert (tmp_path / "stability.csv").read_text().count("not run") == 2
