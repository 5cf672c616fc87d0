"""Capsules that take the opposite of what they give: momentum is kept, and no energy comes from nowhere."""

import numpy as np
import pytest

from hoi.data import Material
from hoi.mpm.collider import Collider
from hoi.mpm.solver import Simulation
from hoi.mpm.state import initial_state, linear_momentum

RADIUS, DX = 0.1, 0.025


class Stone:
    """A ball of some mass that does not turn, as a partner."""

    def __init__(self, centre, velocity, mass: float, radius: float = 0.05, friction: float = 0.0) -> None:
        self.radii, self.friction, self.mass, self.parts = np.array([radius]), friction, mass, np.array([0])
        self.centre, self.velocity = np.asarray(centre, float), np.asarray(velocity, float)
        self._place()

    def _place(self) -> None:
        self.ends = np.tile(self.centre, (1, 2, 1))
        self.twists = np.concatenate([self.velocity, np.zeros(3)])[None]

    def ease(self, parts):
        return np.diag(np.repeat([1 / self.mass, 0], 3))

    def take(self, parts, wrenches) -> None:
        self.velocity = self.velocity - wrenches[:, :3].sum(axis=0) / self.mass
        self._place()

    def advance(self, seconds: float) -> None:
        self.centre = self.centre + seconds * self.velocity
        self._place()

    def foreseen(self) -> Collider:
        times = np.array([0.0, 10.0])
        path = (self.centre + times[:, None] * self.velocity)[:, None]
        return Collider(times, path, path, self.radii, self.friction)

    @property
    def energy(self) -> float:
        return 0.5 * self.mass * float(self.velocity @ self.velocity)


def ball_of(mass: float, stiffness: float = 1e5) -> tuple[np.ndarray, np.ndarray, Material]:
    axis = np.arange(-RADIUS + DX / 4, RADIUS, DX / 2)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[np.linalg.norm(points, axis=1) < RADIUS]
    volumes = np.full(len(points), 4 / 3 * np.pi * RADIUS**3 / len(points))
    return points, volumes, Material("ball", "neo_hookean", stiffness, 0.3, mass / volumes.sum(), 0.9, 0.5)


def struck(stone: Stone, mass: float = 0.4, stiffness: float = 1e5, seconds: float = 0.06, **settings):
    points, volumes, material = ball_of(mass, stiffness)
    run = Simulation(
        initial_state(points, volumes * material.density, [0, 0, 0]), volumes, material, dx=DX, gravity=(0, 0, 0),
        planes=(), collider=stone, **settings,
    )  # fmt: skip
    run.advance(seconds)
    return run


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-12), ("float32", 1e-5)])
@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_what_the_object_gets_the_partner_loses(precision, tolerance, friction):
    stone = Stone([0.02, -0.2, 0.01], [0.5, 4.0, 0.0], 0.8, friction=friction)
    before = stone.mass * stone.velocity
    run = struck(stone, precision=precision)
    given = run.collider_impulse
    assert np.linalg.norm(given) > 0.5
    np.testing.assert_allclose(
        before - stone.mass * stone.velocity, given, rtol=0, atol=tolerance * np.linalg.norm(given)
    )
    np.testing.assert_allclose(
        linear_momentum(run.state(), run.masses), given, rtol=0, atol=1e-4 * np.linalg.norm(given)
    )


def test_equal_masses_all_but_exchange_their_velocities():
    """As two balls on a table; with 8 cells across, meeting node by node costs 15% of it."""
    stone = Stone([0, -0.2, 0], [0, 3.0, 0], 0.4)
    run = struck(stone, mass=0.4)
    assert 2.5 < run.collider_impulse[1] / 0.4 < 3.0
    assert 0.0 < stone.velocity[1] < 0.5


@pytest.mark.parametrize("mass", [1e-3, 0.4, 30.0, 1e4])
@pytest.mark.parametrize("heft", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize("stiffness", [1e4, 1e7])
def test_no_energy_comes_from_nowhere_however_unequal_they_are(mass, heft, stiffness):
    stone = Stone([0, -0.146, 0], [0, 5.0, 0], heft)
    before = stone.energy
    points, volumes, material = ball_of(mass, stiffness)
    masses = volumes * material.density
    run = Simulation(
        initial_state(points, masses, [0, 0, 0]), volumes, material, dx=DX, gravity=(0, 0, 0), planes=(),
        collider=stone,
    )  # fmt: skip
    for _ in range(6):
        run.advance(run.time + max(60 * run.time_step(), 2e-4))
        kinetic, elastic, _ = run.energies(run.state())
        assert np.isfinite(stone.velocity).all()
        assert kinetic + elastic + stone.energy <= before * 1.02
    assert run.collider_impulse[1] > 0


def test_a_partner_that_is_far_costs_no_coupling_and_moves_on():
    stone = Stone([0, -5.0, 0], [0, 1.0, 0], 1.0)
    run = struck(stone, seconds=0.05)
    assert stone.centre[1] == pytest.approx(-4.95)
    np.testing.assert_array_equal(run.collider_impulse, 0)


def test_a_heavy_partner_pushes_as_one_that_nothing_stops():
    """The limit of a great mass is the obstacle on a given path."""
    stone = Stone([0, -0.2, 0], [0, 3.0, 0], 1e6)
    times = np.linspace(0, 0.06, 13)
    path = np.array([0, -0.2, 0]) + times[:, None, None] * np.array([0, 3.0, 0])
    wall = Collider(times, path, path, stone.radii, 0.0)
    given = [struck(one, precision="float64").collider_impulse for one in (stone, wall)]
    np.testing.assert_allclose(*given, rtol=0.02, atol=1e-3)


def test_threads_change_nothing_but_round_off():
    given = [
        struck(Stone([0, -0.2, 0], [0, 3.0, 0], 1.0), threads=n, precision="float64").collider_impulse for n in (1, 2)
    ]
    np.testing.assert_allclose(*given, rtol=1e-6, atol=1e-9)
