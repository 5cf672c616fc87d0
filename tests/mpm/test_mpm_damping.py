"""Solids that lose energy: the hysteresis as a law, and the drops of balls that it is made for."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, block

from analysis.experiments import drop, roll, sand_column, slide
from hoi.data import Material
from hoi.mpm.damping import LEAST_REBOUND, Damping, damping, played, rebound_of, recoverable
from hoi.mpm.rigid import Flight, RigidMotion, air_drag
from hoi.mpm.solver import Simulation, simulate
from hoi.mpm.state import initial_state

FLOOR = 1e-10
STIFF = replace(RUBBER, youngs_modulus=5e6)


def loop(of: Damping, psi: np.ndarray, play: float = 0.0) -> tuple[float, float]:
    """The work of the stress along a path of psi, and where the play then is."""
    work = 0.0
    for before, after in itertools.pairwise(psi):
        s, kept = played(of, np.array([(before + after) / 2]), FLOOR, np.array([play]))
        play = float(kept[0])
        work += float(s[0]) * (after - before)
    return work, play


@pytest.mark.parametrize("restitution", [0.2, 0.4, 0.6, 0.8, 0.95])
def test_a_spring_gives_back_e_squared_of_its_energy(restitution: float) -> None:
    up = np.linspace(0, 1, 4001) ** 2
    of = damping(restitution)
    given, play = loop(of, up)
    back, _ = loop(of, up[::-1], play)
    assert given == pytest.approx(1, rel=1e-3)
    assert -back == pytest.approx(restitution**2, rel=0.02)
    assert float(recoverable(of, np.ones(1), FLOOR, np.array([play]))[0]) == pytest.approx(restitution**2, rel=0.02)


def test_no_loop_gains_energy_and_small_ones_lose_none() -> None:
    """Along random paths of psi the work covers what can be given back; within the bounds of s it is all of it."""
    of, rng = damping(0.6), np.random.default_rng(0)
    for _ in range(5):
        ends = np.concatenate([[0], rng.random(10)])
        path = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(ends)])
        work, play = loop(of, path)
        stored = float(recoverable(of, path[-1:], FLOOR, np.array([play]))[0] * path[-1])
        assert work > stored - 1e-3
    _, play = loop(of, np.linspace(0, 1, 2000))
    work, again = loop(of, np.concatenate([np.linspace(1, 0.8, 500), np.linspace(0.8, 1, 500)]), play)
    assert (work, again) == (pytest.approx(0, abs=1e-5), pytest.approx(play, abs=1e-3))


def test_without_loss_nothing_changes_and_with_loss_energy_only_falls() -> None:
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, 0.1)
    start = initial_state(x, volumes * STIFF.density, [0.3, 0, -2], [0, 3, 1])
    times = np.linspace(0.02, 0.4, 20)
    plain = simulate(start, volumes, STIFF, dx=DX, times=times)
    elastic = simulate(start, volumes, STIFF, dx=DX, times=times, rebound=[1.0])
    np.testing.assert_array_equal(plain.final.positions, elastic.final.positions)
    assert plain.final.play is None
    lossy = simulate(start, volumes, STIFF, dx=DX, times=times, rebound=[0.5])
    total = lossy.energy.sum(axis=1)
    assert np.diff(total).max() < 1e-2 * total[0]
    assert total[-1] < 0.8 * plain.energy[-1].sum()


def test_a_lossy_simulation_that_is_resumed_goes_on_bit_for_bit() -> None:
    x, volumes = block((0.15, 0.15, 0.15), DX / 2, 0.02)
    start = initial_state(x, volumes * RUBBER.density, [0, 0, -2])
    settings = {"dx": DX, "dt": 2e-4, "rebound": [0.6]}
    whole = simulate(start, volumes, RUBBER, times=[0.02, 0.04], **settings)
    resumed = simulate(whole.states[0], volumes, RUBBER, times=[0.04 - 0.02], **settings)
    np.testing.assert_array_equal(whole.final.positions, resumed.final.positions)
    np.testing.assert_array_equal(whole.final.play, resumed.final.play)


def test_rebound_is_set_from_restitution_for_what_springs_back() -> None:
    ball = replace(RUBBER, restitution=0.6)
    assert 0.6 < rebound_of(ball, 32) < rebound_of(ball, 16) < rebound_of(ball, 8) < 0.66
    assert rebound_of(replace(ball, restitution=1.0), 16) == 1.0
    assert rebound_of(replace(ball, restitution=0.0), 16) == LEAST_REBOUND
    sand = Material("sand", "drucker_prager", 1e6, 0.3, 1600.0, 0.0, 0.6, friction_angle=0.5)
    assert rebound_of(sand, 16) == 1.0
    with pytest.raises(ValueError, match="rebound"):
        x, volumes = block((0.1, 0.1, 0.1), DX / 2)
        Simulation(initial_state(x, volumes, [0, 0, 0]), volumes, ball, dx=DX, rebound=[0.0])


@pytest.mark.parametrize(
    ("restitution", "cells", "changes"),
    [
        (0.9, 16, {}), (0.7, 24, {}), (0.4, 12, {}), (0.8, 16, {"youngs_modulus": 7e6}), (0.6, 12, {"density": 20.0}),
    ],
)  # fmt: skip
def test_a_dropped_ball_rebounds_with_its_restitution(restitution, cells, changes) -> None:
    """From 1 m: soft and stiff, light and heavy, on coarse and fine grids, within 0.03."""
    _, measured = drop("soccer_ball", 1.0, cells=cells, restitution=restitution, **changes)
    assert measured == pytest.approx(restitution, abs=0.03)


def test_another_size_and_shape_rebound_alike() -> None:
    assert drop("beach_ball", 1.0, cells=16, restitution=0.7)[1] == pytest.approx(0.7, abs=0.05)


def test_balls_come_back_as_high_as_their_rules_ask() -> None:
    """FIFA Quality Programme: 1.25 to 1.55 m of 2.0; FIBA: 0.96 to 1.16 m of 1.8."""
    assert 1.25 < drop("soccer_ball", 2.0)[0] < 1.55
    assert 0.96 < drop("basketball", 1.8)[0] < 1.16


def test_balls_roll_and_blocks_slide_by_the_law() -> None:
    assert roll()[0] == pytest.approx(1, abs=0.015)
    assert roll(slope=np.radians(20))[1] == pytest.approx(1, abs=0.02)
    assert slide() == pytest.approx(1, abs=0.02)


def test_a_column_of_sand_runs_out_to_most_of_the_law() -> None:
    """Lube et al. 2004: 1.24. Ours falls short of it by a quarter to a third, see docs/physics.md."""
    assert 0.8 < sand_column(1.0, cells=8) < 1.24


def test_flight_through_air_follows_the_closed_form() -> None:
    """From rest v = v_t tanh(g t / v_t), z = v_t^2 / g log cosh(g t / v_t); v_t = sqrt(2 m g / (rho C_d A))."""
    g, points = 9.81, np.random.default_rng(0).normal(size=(4000, 3))
    points = 0.2 * points / np.linalg.norm(points, axis=1)[:, None]
    drag = air_drag(points, 0.1, 1.2, 0.5)
    terminal = np.sqrt(2 * 0.1 * g / (1.2 * 0.5 * np.pi * 0.04))
    assert np.sqrt(g / drag) == pytest.approx(terminal, rel=0.01)
    terminal = np.sqrt(g / drag)
    flight = Flight(RigidMotion(0.1, np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3)), [0, 0, -g], drag)
    for time in (0.1, 1.0, 5.0):
        assert -flight.velocity(time)[2] == pytest.approx(terminal * np.tanh(g * time / terminal), rel=1e-9)
        expected = terminal**2 / g * np.log(np.cosh(g * time / terminal))
        assert -flight.com(time)[2] == pytest.approx(expected, rel=1e-9)


def test_a_flat_thing_has_no_silhouette_that_a_hull_could_tell() -> None:
    assert air_drag(np.zeros((3, 3)), 1.0, 1.2, 0.5) == 0.0
