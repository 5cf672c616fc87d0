"""The MPM against closed forms and conservation laws."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, RUBBER, block

from hoi.data import ObjectState
from hoi.mpm.solver import SimulationResult, simulate
from hoi.mpm.stability import choose_time_step
from hoi.mpm.state import angular_momentum, centre_of_mass, energies, initial_state, kick, linear_momentum

G = 9.81
DT = choose_time_step(RUBBER, DX, 5.0, fraction=0.5)


def run(state: ObjectState, volumes: np.ndarray, times, material=RUBBER, **options) -> SimulationResult:
    return simulate(state, volumes, material, dx=DX, dt=DT, times=times, **options)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-12)])
def test_spinning_body_flies_the_parabola(precision: str, tolerance: float) -> None:
    """Centre of mass v t - g t^2/2; momentum, angular momentum about it and energy as they were, off the ground."""
    x, volumes = block((0.2, 0.15, 0.1), DX / 2, lowest=5.0)
    masses = volumes * RUBBER.density
    start = initial_state(x, masses, [1, 2, 3], [3, -4, 2])
    times = np.array([0.013, 0.2, 0.5])
    result = run(start, volumes, times, precision=precision)
    t = times[:, None]
    flight = t * [1, 2, 3] - t**2 * [0, 0, G / 2]
    moved = result.com - centre_of_mass(x, masses)
    assert np.abs(moved - flight).max() < tolerance * np.linalg.norm(flight, axis=1).max()
    np.testing.assert_allclose(result.com_velocity, [1, 2, 3] - t * [0, 0, G], atol=10 * tolerance)

    def spin(state: ObjectState) -> np.ndarray:
        com = centre_of_mass(state.positions, masses)
        return angular_momentum(state, masses, DX) - np.cross(com, linear_momentum(state, masses))

    for state in result.states:
        assert np.linalg.norm(spin(state) - spin(start)) < max(10 * tolerance, 1e-10) * np.linalg.norm(spin(start))
    before = energies(start, volumes, RUBBER, DX, np.array([0, 0, -G]))
    spin_energy = before[0] - 0.5 * masses.sum() * 14
    assert np.abs(result.energy.sum(axis=1) - before.sum()).max() < 0.05 * spin_energy


def test_momentum_is_conserved_while_vibrating() -> None:
    """Random velocities, no gravity: linear and angular momentum stay to round-off, total energy never grows."""
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, lowest=1.0)
    masses = volumes * RUBBER.density
    rest = initial_state(x, masses, [0, 0, 0])
    start = replace(rest, velocities=0.3 * np.random.default_rng(0).normal(size=x.shape))
    result = run(start, volumes, [0.05, 0.1], gravity=(0, 0, 0), precision="float64")
    scale = np.abs(masses @ np.abs(start.velocities)).max()
    for state in result.states:
        assert np.abs(linear_momentum(state, masses) - linear_momentum(start, masses)).max() < 1e-13 * scale
        drift = angular_momentum(state, masses, DX) - angular_momentum(start, masses, DX)
        assert np.abs(drift).max() < 1e-12 * scale
    total = [energies(start, volumes, RUBBER, DX, np.zeros(3)).sum(), *result.energy.sum(axis=1)]
    assert total[0] > total[1] > total[2] > 0


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-4), ("float64", 1e-11)])
def test_momentum_over_ten_thousand_steps(precision: str, tolerance: float) -> None:
    """A spinning, vibrating body in empty space keeps both momenta to float precision."""
    x, volumes = block((0.1, 0.1, 0.15), DX / 2, lowest=1.0)
    masses = volumes * RUBBER.density
    rest = initial_state(x, masses, [0.5, -0.2, 0.1], [2, 5, -3])
    noise = 0.2 * np.random.default_rng(0).normal(size=x.shape)
    start = replace(rest, velocities=rest.velocities + noise)
    result = run(start, volumes, [10_000 * DT], gravity=(0, 0, 0), precision=precision, planes=())
    assert result.steps == 10_000
    momentum, spin = linear_momentum(start, masses), angular_momentum(start, masses, DX)
    assert np.linalg.norm(linear_momentum(result.final, masses) - momentum) < tolerance * np.linalg.norm(momentum)
    assert np.linalg.norm(angular_momentum(result.final, masses, DX) - spin) < tolerance * np.linalg.norm(spin)


def test_bar_rings_at_its_frequency() -> None:
    """A free bar of length L with nu = 0: first longitudinal period 2 L / sqrt(E/rho) within 1%, little damping."""
    material = replace(RUBBER, poisson_ratio=0.0)
    length, wave_speed = 20 * DX, np.sqrt(material.youngs_modulus / material.density)
    x, volumes = block((length, 2 * DX, 2 * DX), DX / 2, lowest=1.0)
    mode = np.cos(np.pi * x[:, 0] / length)
    rest = initial_state(x, volumes, [0, 0, 0])
    affine = np.zeros((len(x), 3, 3))
    affine[:, 0, 0] = -0.01 * wave_speed * np.pi / length * np.sin(np.pi * x[:, 0] / length)
    start = replace(rest, velocities=0.01 * wave_speed * mode[:, None] * [1, 0, 0], affine=affine)
    period = 2 * length / wave_speed
    times = np.linspace(0, 2 * period, 81)
    result = run(start, volumes, times, material, gravity=(0, 0, 0), precision="float64")
    amplitude = np.array([mode @ state.velocities[:, 0] for state in result.states])
    crossings = np.flatnonzero(np.diff(np.sign(amplitude)))
    exact = [times[i] - amplitude[i] * (times[i + 1] - times[i]) / (amplitude[i + 1] - amplitude[i]) for i in crossings]
    assert len(exact) == 4
    assert 2 * np.diff(exact).mean() == pytest.approx(period, rel=0.01)
    kept = result.energy[-1].sum() / result.energy[0].sum()
    assert 0.97 < kept <= 1.0


def test_bounce_turns_the_momentum_and_does_not_sink_in() -> None:
    """Dropped from 0.3 m: comes back up with less energy, never more than half a cell under the ground."""
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, lowest=0.3)
    result = run(initial_state(x, volumes, [0, 0, 0]), volumes, np.arange(1, 41) * 0.01)
    speed = result.com_velocity[:, 2]
    impact = np.sqrt(2 * G * 0.3)
    assert speed.min() == pytest.approx(-impact, rel=0.1)
    assert 0.3 * impact < speed.max() < impact
    assert min(state.positions[:, 2].min() for state in result.states) > -0.5 * DX
    total = result.energy.sum(axis=1)
    assert (np.diff(total) < 0.02 * total[0]).all()  # what a damped solid can give back is known to 2%


def test_body_at_rest_stays_at_rest() -> None:
    """Put down with its bottom at z = 0 it stays there within 0.15 cells, and ends still."""
    x, volumes = block((0.2, 0.2, 0.1), DX / 2)
    stiff = replace(RUBBER, youngs_modulus=1e6)
    result = simulate(initial_state(x, volumes, [0, 0, 0]), volumes, stiff, dx=DX, dt=2e-4, times=[0.5, 0.6, 1.0])
    assert abs(result.states[-1].positions[:, 2].min() - DX / 4) < 0.15 * DX
    assert np.abs(result.com[-1] - result.com[0])[:2].max() < 1e-4 * DX
    assert np.abs(result.com_velocity[-1]).max() < 0.02


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4])
def test_sliding_block_slows_by_coulomb_friction(friction: float) -> None:
    """Deceleration mu g within 6% of g; without friction none."""
    x, volumes = block((0.3, 0.3, 0.1), DX / 2)
    stiff = replace(RUBBER, youngs_modulus=1e6, ground_friction=friction)
    times = np.array([0.1, 0.4])
    start = initial_state(x, volumes, [2, 0, 0])
    result = simulate(start, volumes, stiff, dx=DX, dt=2e-4, times=times)
    deceleration = (result.com_velocity[0, 0] - result.com_velocity[1, 0]) / (times[1] - times[0])
    assert deceleration == pytest.approx(friction * G, abs=0.06 * G if friction else 1e-4)
    assert abs(result.com_velocity[1, 1]) < 1e-3


def test_friction_stops_a_body_and_holds_it() -> None:
    x, volumes = block((0.3, 0.3, 0.1), DX / 2)
    stiff = replace(RUBBER, youngs_modulus=1e6, ground_friction=0.8)
    result = simulate(initial_state(x, volumes, [0.5, 0, 0]), volumes, stiff, dx=DX, dt=2e-4, times=[0.3, 0.5])
    assert abs(result.com[1, 0] - result.com[0, 0]) < 0.02 * DX


def test_ground_does_not_hold_what_leaves() -> None:
    """A body kicked up from the ground follows the parabola, unlike on a sticky ground."""
    x, volumes = block((0.2, 0.2, 0.1), DX / 2)
    start = kick(initial_state(x, volumes, [0, 0, 0]), [0.5, 0, 2.0])
    result = run(start, volumes, [0.1, 0.2])
    expected = result.com[0] + 0.1 * result.com_velocity[0] - [0, 0, G * 0.1**2 / 2]
    np.testing.assert_allclose(result.com_velocity[0], [0.5, 0, 2 - G * 0.1], atol=0.05)
    np.testing.assert_allclose(result.com[1], expected, atol=1e-3 * DX)
