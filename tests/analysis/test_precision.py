"""Precision against run time: the answers, the measures of error, the orders, the front and the command."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from analysis.precision import report
from analysis.precision.bodies import ball, block, preset
from analysis.precision.convergence import Order, by_grid
from analysis.precision.errors import (
    best_rotation,
    compare,
    observed_order,
    pareto_front,
    probe_weights,
    rotation_angle,
)
from analysis.precision.hertz import contact_time, hertz_path, hertz_share
from analysis.precision.problems import EXACT, bar, flight, hertz, spin, waves
from analysis.precision.run import STAND_INS, Variant, judge, run, variants
from analysis.precision.scenes import SCENES
from hoi.mpm.materials import kirchhoff_stress
from hoi.mpm.state import centre_of_mass

# --- errors ----------------------------------------------------------------------------------------------------------


def test_each_error_sees_its_own_kind_of_motion() -> None:
    """Truth shifted, turned and stretched by known amounts: com, orientation and shape each see one of them."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(3, 200, 3))
    truth -= truth.mean(axis=1, keepdims=True)
    com = np.zeros((3, 3))
    shift = np.array([0.3, 0, 0.4])
    moved = compare(truth + shift, truth, com + shift, com, size=2.0)
    assert moved.com == pytest.approx(0.25) and moved.position == pytest.approx(0.25)
    assert moved.orientation < 1e-14 and moved.shape < 1e-14

    turn = Rotation.from_rotvec([0.0, 0.003, 0.004]).as_matrix()
    turned = compare(truth @ turn.T, truth, com, com, size=2.0)
    assert turned.orientation == pytest.approx(0.005, rel=1e-10) and turned.shape < 1e-14 and turned.com == 0

    swollen = compare(1.01 * truth, truth, com, com, size=2.0)
    assert swollen.shape == pytest.approx(0.01 * np.sqrt((truth**2).sum(2).mean()) / 2, rel=1e-10)
    assert swollen.orientation < 1e-14


def test_best_rotation_is_no_reflection_and_tiny_angles_are_exact() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert np.linalg.det(best_rotation(points, points * [1, 1, -1])) == pytest.approx(1)
    angles = np.array([1e-12, 1e-6, 0.5, 3.1])
    turns = Rotation.from_rotvec(angles[:, None] * [0.6, 0, 0.8]).as_matrix()
    np.testing.assert_allclose(rotation_angle(turns), angles, rtol=1e-4)


def test_probes_follow_affine_motion_exactly_and_others_to_second_order() -> None:
    rng = np.random.default_rng(0)
    probes = 0.8 * rng.random((40, 3)) - 0.4
    errors = []
    for dx in (0.2, 0.1):
        particles, _ = block((1, 1, 1), dx)
        weights = probe_weights(particles, probes)
        affine = rng.normal(size=(3, 3))
        np.testing.assert_allclose(weights @ (particles @ affine + 1), probes @ affine + 1, atol=1e-12)
        errors.append(np.abs(weights @ np.sin(3 * particles) - np.sin(3 * probes)).max())
    assert errors[0] / errors[1] > 3


def test_order_of_synthetic_errors() -> None:
    steps = np.array([0.1, 0.05, 0.025])
    assert observed_order(steps, 3 * steps**2) == pytest.approx(2)
    assert observed_order(steps, 0.1 * steps) == pytest.approx(1)
    assert np.isnan(observed_order(steps, [0.1, 0.0, 0.1]))
    assert Order("", "", (8, 16), (0.04, 0.01), 2.0).verdict == "as expected"
    assert Order("", "", (8, 16), (0.04, 0.02), 2.0).verdict == "NOT as expected"


def test_pareto_front_of_synthetic_runs() -> None:
    seconds = [1.0, 2.0, 2.0, 3.0, 0.5, 4.0, 5.0]
    errors = [1.0, 0.5, 0.4, 0.6, np.nan, 0.4, 0.0]
    assert pareto_front(seconds, errors).tolist() == [True, False, True, False, False, False, True]
    assert pareto_front([1, 2, 3], [1, 0.99, 0.97], gain=0.02).tolist() == [True, False, True]


# --- answers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [waves, spin, lambda: waves(phase=1.0)], ids=["waves", "spin", "waves under strain"])
def test_exact_motion_obeys_the_equations(make) -> None:
    """rho x_tt = div P by finite differences of the motion along the axes, F at the start, and no traction at the ends.

    With P = tau F^-T from the material's own stress, at material points X of the unstrained body.
    """
    problem = make()
    material, motion = problem.material, problem.motion
    assert motion is not None
    state, _ = problem.body(problem.size / 16)
    start = motion(state.positions, np.array([0.0]))[0]
    np.testing.assert_allclose(start, state.positions, atol=1e-12)
    h = 1e-5 * problem.times[-1]
    velocity = (motion(state.positions, np.array([h])) - motion(state.positions, np.array([-h])))[0] / (2 * h)
    np.testing.assert_allclose(velocity, state.velocities, atol=1e-6 * np.abs(state.velocities).max())

    time = 0.4 * problem.times[-1]
    dt = 1e-3 * problem.times[-1]
    now = motion(state.positions, np.array([time - dt, time, time + dt]))
    acceleration = (now[0] - 2 * now[1] + now[2]) / dt**2
    rest, shape = _rest(problem), _lattice(problem)
    points = now[1].reshape(*shape, 3)
    axes = [np.unique(np.round(rest[:, a], 12)) for a in range(3)]
    gradient = np.stack([np.gradient(points, axes[a], axis=a, edge_order=2) for a in range(3)], axis=-1)
    stress = kirchhoff_stress(material, gradient) @ np.swapaxes(np.linalg.inv(gradient), -1, -2)
    divergence = sum(np.gradient(stress[..., a], axes[a], axis=a, edge_order=2) for a in range(3))
    inner = tuple(slice(2, -2) if n > 6 else slice(None) for n in shape)
    wanted = material.density * acceleration.reshape(*shape, 3)[inner]
    assert np.abs(divergence[inner] - wanted).max() < 0.03 * np.abs(wanted).max()
    traction = np.abs(stress[0, :, :, :, 0]).max()
    assert traction < 0.2 * np.abs(stress).max()  # half a spacing inside the face, where it is 0


def _lattice(problem) -> tuple[int, int, int]:
    rest = _rest(problem)
    counts = [len(np.unique(np.round(rest[:, a], 12))) for a in range(3)]
    return counts[0], counts[1], counts[2]


def _rest(problem) -> np.ndarray:
    """The lattice that the body was before it was strained."""
    dx = problem.size / 16
    extent = (1.0, 0.5, 2 * dx) if problem.name == "waves" else (0.4, 0.1, 0.1)
    return block(extent, dx)[0]


def test_spin_that_starts_unstretched_lags_as_predicted() -> None:
    """The lag that the setup states is twice the mean stretch, weighed by x^2, times the angle turned."""
    problem = spin()
    rest, _ = block((0.4, 0.1, 0.1), 0.4 / 64)
    stretched = problem.body(0.4 / 64)[0].positions
    inertia = [(points[:, 0] ** 2).sum() for points in (rest, stretched)]
    angle = 16.0 * problem.times[-1]
    lag = angle * (inertia[1] / inertia[0] - 1)
    assert lag == pytest.approx(problem.notes["lag if it started unstretched [rad]"], rel=0.01)


def test_hertz_contact_from_the_equation_of_motion() -> None:
    """m x'' = -4/3 E* sqrt(R) x^(3/2), integrated here step by step: how long, how deep, and between which speeds."""
    mass, radius, effective, v = 2.0, 0.3, 5e4, 0.7
    x, speed, steps, speeds, deepest = 0.0, v, 0, [v], 0.0
    dt = contact_time(mass, radius, effective, v) / 20000
    while x >= 0:
        speed -= dt * 4 / 3 * effective * np.sqrt(radius) * x**1.5 / mass
        x += dt * speed
        deepest, steps = max(deepest, x), steps + 1
        speeds.append(speed)
    duration = steps * dt
    assert duration == pytest.approx(contact_time(mass, radius, effective, v), rel=0.002)
    assert deepest == pytest.approx((15 * mass * v**2 / (16 * effective * np.sqrt(radius))) ** 0.4, rel=1e-3)
    within = np.abs(speeds) < 0.9 * v
    assert hertz_share(0.9) == pytest.approx(within.mean(), rel=1e-3)
    path = hertz_path(np.array([-1.0, 0.0, duration / 2, duration, duration + 1]), duration, deepest, v)
    np.testing.assert_allclose(path, [v, 0, -deepest, 0, v], atol=1e-6)


def test_hertz_setup_is_within_the_theory() -> None:
    notes = hertz().notes
    assert notes["delta / R"] == pytest.approx((5 * np.pi / 4 * 0.02**2) ** 0.4)
    assert notes["a / R"] < 0.3


def test_bar_rings_below_the_thin_bar_by_lateral_inertia() -> None:
    notes = bar().notes
    assert notes["c / 2L [Hz]"] == pytest.approx(5.0)
    assert 0.998 < notes["frequency [Hz]"] / notes["c / 2L [Hz]"] < 0.9995


def test_flight_follows_the_parabola() -> None:
    problem = flight()
    state, volumes = problem.body(0.05)
    assert problem.motion is not None
    com = np.array([centre_of_mass(x, volumes) for x in problem.motion(state.positions, problem.times)])
    t = problem.times[:, None]
    np.testing.assert_allclose(com, [0, 0, 1] + t * [1, 2, 3] - t**2 * [0, 0, 9.81 / 2], atol=1e-12)


def test_ball_and_block_have_their_volume_and_inertia() -> None:
    points, volumes = ball(0.5, 1 / 16)
    assert volumes.sum() == pytest.approx(4 / 3 * np.pi * 0.125)
    inertia = (volumes[:, None] * points).T @ points
    np.testing.assert_allclose(inertia, volumes.sum() * 0.05 * np.eye(3), atol=0.003 * volumes.sum() * 0.05)
    points, volumes = block((1.0, 0.5, 0.25), 0.125)
    assert len(points) == 16 * 8 * 4 and volumes.sum() == pytest.approx(0.125)


# --- runs ------------------------------------------------------------------------------------------------------------


def test_stand_ins_are_right_where_nothing_touches_and_wrong_where_something_does() -> None:
    errors = {}
    for problem in (flight(), hertz()):
        for name in STAND_INS:
            done = run(problem, Variant(name, 8))
            errors[problem.name, name] = judge(problem, done.seen, None)["com"]
    assert errors["flight", "ballistic rigid body"] < 1e-12 < errors["flight", "constant velocity"]
    assert errors["hertz", "ballistic rigid body"] > 0.1


def test_variants_change_one_thing_at_a_time() -> None:
    for make in (*EXACT, *SCENES):
        problem = make()
        base, *others = variants(problem)
        assert base.cells in problem.cells
        for other in others:
            same = replace(other, kind="base", cells=base.cells if other.kind in ("grid", "spline") else other.cells)
            changed = [name for name in vars(base) if getattr(same, name) != getattr(base, name)]
            assert len(changed) <= 1, other
        assert len({v.label for v in variants(problem)}) == len(variants(problem))
        assert set(variants(problem, quick=True)) < set(variants(problem))
        assert {v.kind for v in variants(problem)} == set(report.KINDS)


def test_scenes_keep_their_mass_at_every_resolution() -> None:
    for make in SCENES:
        problem = make()
        coarse, fine = (problem.body(problem.size / cells)[1].sum() for cells in (6, 12))
        assert coarse == pytest.approx(fine)
        assert problem.planes[0].friction == problem.material.ground_friction
        assert problem.body(problem.size / 8)[0].positions[:, 2].min() > 0


def test_preset_is_the_material_of_the_configuration(composed) -> None:
    conf, material = composed("object=soccer_ball").material, preset("soccer_ball")
    assert (material.youngs_modulus, material.density, material.model) == (
        conf.youngs_modulus,
        conf.density,
        conf.model,
    )


def test_orders_by_grid_come_from_base_and_grid_alone() -> None:
    rows = [("base", 16, 0.04), ("grid", 8, 0.16), ("dt", 16, 0.5), ("grid", 32, 0.01)]
    table = pd.DataFrame(rows, columns=["kind", "cells", "error"]).assign(problem="bar", headline="frequency")
    (order,) = by_grid(table)
    assert order.cells == (8, 16, 32) and order.observed == pytest.approx(2) and order.verdict == "as expected"


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "analysis.precision", *arguments], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--problems", "waves,nonsense"), "--problems must be of"),
        (("--repeats", "0"), "--repeats must be 1 or more, got 0"),
        (("--repeats", "few"), "--repeats"),
        (("--threads", "-1"), "--threads must be from 1"),
        (("--no-such-thing",), "--no-such-thing"),
        (("-o", "pyproject.toml", "--quick", "--problems", "flight"), "pyproject.toml"),
    ],
)
def test_bad_arguments_exit_2_with_one_line(arguments: tuple[str, ...], says: str) -> None:
    done = command(*arguments)
    assert done.returncode == 2
    assert says in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_quick_run_writes_table_report_and_picture(tmp_path: Path) -> None:
    done = command("--quick", "--problems", "waves", "--repeats", "1", "-o", str(tmp_path / "a" / "b"))
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "a" / "b"
    table = pd.read_csv(folder / "precision.csv")
    assert list(table.columns[: len(report.FIRST)]) == report.FIRST
    assert {"machine", "threads", "taichi", "commit"} <= set(table.columns)
    assert (table["problem"] == "waves").all() and table["front"].any()
    assert set(table["kind"]) == set(report.KINDS) - {"spline", "material"}
    mpm = table[~table["kind"].isin(list(STAND_INS))]
    assert (mpm["error"] < 0.02).all() and (mpm["seconds"] > 0).all() and (mpm["steps"] > 0).all()
    assert (table[table["kind"] == "constant velocity"]["error"] > 0.02).all()
    words = (folder / "precision.md").read_text()
    assert "## Observed orders" in words and "as expected" in words and "NOT as expected" not in words
    assert (folder / "precision.png").read_bytes()[:4] == b"\x89PNG"
    assert "as expected" in done.stdout
