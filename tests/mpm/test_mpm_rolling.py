"""A ball on the ground: the rigid sphere against its equations of motion, and the phase against every step."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from bodies import ground
from scipy.integrate import solve_ivp

import hoi
from hoi.data import Plane
from hoi.gaussians import transform
from hoi.mpm import phases
from hoi.mpm.rigid import RigidMotion, carry, fit, turning
from hoi.mpm.rolling import Rolling, bears, is_ball
from hoi.mpm.state import initial_state
from hoi.objects.shapes import SHAPES, build

G = np.array([0, 0, -9.81])
RADIUS, MASS = 0.11, 0.43
FLOOR = ground(0.5)
MOTIONS = [([3, 1, 0], [10, 5, 20]), ([0, 0, 0], [0, 40, 3]), ([1, 0, 0], [0, 0, 9])]


def thrown(velocity, spin, inertia: float = 0.4 * MASS * RADIUS**2) -> RigidMotion:
    com = np.array([0.3, -0.2, RADIUS])
    return RigidMotion(MASS, com, np.array(velocity, float), inertia * np.array(spin, float), inertia * np.eye(3))


@pytest.mark.parametrize("drag", [0.0, 0.05])
@pytest.mark.parametrize(("velocity", "spin"), MOTIONS)
def test_it_slides_and_rolls_by_newton_s_laws(velocity: list[float], spin: list[float], drag: float) -> None:
    """Against an integration of M v' = F - k M |v| v, I w' = r x F with Coulomb's F opposite to the slip."""
    motion = thrown(velocity, spin)
    inertia, arm = motion.inertia[0, 0], np.array([0, 0, -RADIUS])

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        slip = y[3:6] + np.cross(y[6:], arm)
        speed = np.linalg.norm(slip)
        force = -FLOOR.friction * MASS * 9.81 * slip / max(speed, 1e-4)  # smooth where it rolls
        air = -drag * np.linalg.norm(y[3:6]) * y[3:6]
        return np.concatenate([y[3:6], force / MASS + air, np.cross(arm, force) / inertia])

    start = np.concatenate([motion.com, motion.velocity, spin])
    times = np.linspace(0, 1, 21)
    true = solve_ivp(rate, (0, 1), start, "LSODA", times, rtol=1e-10, atol=1e-10).y.T
    path = Rolling(motion, FLOOR, G, drag)
    for time, y in zip(times, true, strict=True):
        np.testing.assert_allclose(path.com(time), y[:3], atol=2e-5)
        np.testing.assert_allclose(path.velocity(time), y[3:6], atol=1e-4)
        np.testing.assert_allclose(path.angular_velocity(time), y[6:], atol=1e-3)
    assert np.linalg.norm(path.velocity(1.0) + np.cross(path.angular_velocity(1.0), arm)) < 1e-12, "it rolls"
    assert path.fastest >= max(np.linalg.norm(path.angular_velocity(t)) for t in times) - 1e-12


@pytest.mark.parametrize(("share", "kept"), [(2 / 5, 5 / 7), (2 / 3, 3 / 5)], ids=["solid", "hollow"])
def test_a_ball_kicked_without_spin_keeps_the_share_of_textbooks(share: float, kept: float) -> None:
    motion = thrown([7, 0, 0], [0, 0, 0], share * MASS * RADIUS**2)
    slides_for = (1 - kept) * 7 / (0.5 * 9.81)
    path = Rolling(motion, FLOOR, G)
    assert path.velocity(slides_for + 1e-9)[0] == pytest.approx(7 * kept)
    assert path.velocity(0.99 * slides_for)[0] > 7 * kept + 1e-3
    assert path.com(5.0)[0] - path.com(4.0)[0] == pytest.approx(7 * kept)
    sticking = Rolling(motion, replace(FLOOR, contact="stick"), G)
    assert sticking.velocity(0)[0] == pytest.approx(7 * kept), "at once"
    on_ice = Rolling(thrown([7, 0, 0], [0, 3, 0]), replace(FLOOR, contact="slip"), G, drag=0.1)
    assert on_ice.velocity(2.0)[0] == pytest.approx(7 / (1 + 0.1 * 7 * 2)) and on_ice.angular_velocity(9.0)[1] == 3


def test_turning_follows_the_angular_velocity() -> None:
    w = np.array([0.3, -2.0, 1.1])
    rotation = turning(lambda t: w * (1 + 3 * t))
    from scipy.spatial.transform import Rotation

    np.testing.assert_allclose(rotation(1.3), Rotation.from_rotvec(w * (1.3 + 1.5 * 1.3**2)).as_matrix(), atol=1e-8)
    np.testing.assert_array_equal(rotation(0.0), np.eye(3))


def test_what_rolls_is_a_ball_on_level_ground() -> None:
    octant = abs(np.random.default_rng(0).normal(size=(150, 3)))
    signs = np.array(list(product((-1, 1), repeat=3)))
    points = np.concatenate([sign * np.roll(octant, shift, axis=1) for sign in signs for shift in range(3)])
    sphere = points / np.linalg.norm(points, axis=1, keepdims=True)
    cube = points / abs(points).max(axis=1, keepdims=True)
    equal = np.ones(len(points))
    assert is_ball(sphere, equal)
    assert not is_ball(cube, equal) and not is_ball(sphere * [1, 1, 0.97], equal)
    assert not is_ball(sphere, 1.0 + (sphere[:, 0] > 0)), "heavier on one side"
    assert not is_ball(sphere[:3], equal[:3]) and not is_ball(sphere * [1, 1, 0], equal)
    assert bears(FLOOR, G) and not bears(FLOOR, np.zeros(3)) and not bears(FLOOR, -G)
    assert not bears(Plane(np.zeros(3), np.array([0, -0.01, 1]) / np.linalg.norm([0, -0.01, 1])), G)


@pytest.fixture(scope="module")
def football():
    return transform(build(SHAPES["soccer_ball"], size=0.22).cloud, np.eye(3), 1, [0, 0, 0.11])


def both(football, monkeypatch, **options):
    """The same motion with phases and with every step simulated, without air, which only slows what is rigid."""
    walked = []
    init, finish = phases.Walk.__init__, phases.Walk.finish

    def kept(self):
        walked.append(finish(self))
        return walked[-1]

    monkeypatch.setattr(phases.Walk, "finish", kept)
    moved = []
    for changes in ({"drag": 0.0}, {"drag": 0.0, "tolerance": None}):
        monkeypatch.setattr(phases.Walk, "__init__", lambda self, *a, new=changes, **k: init(self, *a, **{**k, **new}))
        moved.append(hoi.simulate(football, "soccer_ball", cells_across=8, **options))
    return *moved, *walked


def test_a_ball_kicked_flat_rolls_as_it_does_in_the_mpm(football, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within 1% of the way, with a ninth of the steps; sideways spin and all."""
    on, off, tally, every = both(football, monkeypatch, seconds=0.6, velocity=[0.5, 8, 0], angular_velocity=[3, 20, 9])
    assert on.phase[1:] == ("mpm",) + ("rolling",) * 11 and set(off.phase[1:]) == {"mpm"}
    way = np.linalg.norm(off.com - off.com[0], axis=1)
    assert (np.linalg.norm(on.com - off.com, axis=1) <= 0.01 * way + 0.02 * 0.22).all()
    assert tally.steps < 0.15 * every.steps and tally.vibration < 0.003
    assert on.deformation_gradient is not None
    surface = np.linalg.norm(on.positions - on.com[:, None].astype(np.float32), axis=2)
    assert np.ptp(surface, axis=0).max() < 1e-3, "in one piece"


def test_a_ball_that_hops_high_or_meets_a_wall_is_simulated_there(football) -> None:
    wall = Plane(np.array([0, 1.5, 0]), np.array([0, -1.0, 0]), "coulomb", 0.3)
    moved = hoi.simulate(football, "soccer_ball", 0.8, velocity=[0, 6, 0], planes=(FLOOR, wall), cells_across=8)
    back = int(np.argmax(moved.com_velocity[:, 1] < 0))
    assert "rolling" in moved.phase[:back] and (moved.com_velocity[:back, 1] > 4).all()
    assert moved.com[:, 1].max() < 1.5 - 0.1 and moved.com_velocity[-1, 1] < -2, "it came back"
    hopping = hoi.simulate(football, "soccer_ball", 0.3, velocity=[0, 4, 1], cells_across=8)
    assert "rolling" not in hopping.phase


def test_a_soft_ball_sags_and_is_simulated(football) -> None:
    moved = hoi.simulate(football, "jelly", 0.2, velocity=[0, 1, 0], cells_across=8)
    assert set(moved.phase[1:]) == {"mpm"}


def test_carried_states_are_rigid() -> None:
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(50, 3)) * 0.05 + [0, 0, RADIUS]
    masses = np.full(50, MASS / 50)
    state = initial_state(positions, masses, [2.0, 0, 0], [0, 0, 0])
    path = Rolling(fit(state, masses, 0.0), FLOOR, G)
    moved = carry(path, state, 0.7)
    np.testing.assert_allclose(fit(moved, masses, 0.0).velocity, path.velocity(0.7), atol=1e-12)
    np.testing.assert_allclose(fit(moved, masses, 0.0).angular_velocity, path.angular_velocity(0.7), atol=1e-9)
