"""Two fields on one grid against what collisions, friction and conservation say."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, block
from mpm_meetings import STIFF, Meeting, ball
from scipy.spatial.transform import Rotation

from hoi.data import Plane
from hoi.errors import InputError
from hoi.mpm.solver import simulate
from hoi.mpm.state import angular_momentum, initial_state, linear_momentum

R = 0.2  # 8 cells across
FLOOR = Plane(np.zeros(3), np.array([0, 0, 1.0]), "stick")


def own_rebound(speed: float) -> float:
    """With which share of its speed a ball leaves a wall."""
    x, volumes = ball(R, [0, 0, R + 0.01])
    start = initial_state(x, volumes, [0, 0, -speed])
    wall = Plane(np.zeros(3), np.array([0, 0, 1.0]), "slip")
    found = simulate(start, volumes, STIFF, times=[0.12], dx=DX, planes=[wall], gravity=(0, 0, 0), precision="float64")
    return float(found.com_velocity[-1, 2]) / speed


@pytest.mark.parametrize("place", [0.0, 0.25, 0.5])
def test_equal_balls_swap_their_velocities(place: float) -> None:
    """They lose what one loses at a wall, within 10% of its speed at 8 cells across, wherever in a cell they meet."""
    (a, volumes), (b, _) = ball(R, [place * DX, 0, 0]), ball(R, [2 * R + 0.02 + place * DX, 0, 0])
    meeting = Meeting((a, volumes, [2.0, 0, 0], STIFF), (b, volumes, [0.0, 0, 0], STIFF), precision="float64")
    meeting.advance(0.12)
    first, second = meeting.velocities()
    rebound = (second - first)[0] / 2
    own = own_rebound(1.0)
    assert own - 0.10 < rebound < own + 0.01
    np.testing.assert_allclose(first + second, [2, 0, 0], atol=1e-12)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_glancing_hit_keeps_both_momenta(precision) -> None:
    (a, volumes), (b, heavy) = ball(R, [0, 0, 0]), ball(R, [2 * R + 0.01, 0.7 * R, 0.3 * R])
    dense = replace(STIFF, density=3000.0)
    meeting = Meeting((a, volumes, [3.0, 0, 0], STIFF), (b, heavy, [-1.0, 0.5, 0], dense), precision=precision)
    before = sums(meeting)
    meeting.advance(0.12)
    after = sums(meeting)
    sizes = [3.0 * meeting.masses[0].sum(), 3.0 * meeting.masses[0].sum() * R]
    for was, now, size, allowed in zip(before, after, sizes, (1e-5, 1e-3), strict=True):
        assert np.abs(now - was).max() < (allowed if precision == "float32" else 1e-12) * size
    assert np.linalg.norm(meeting.velocities()[0] - [3, 0, 0]) > 0.5


def energy(meeting: Meeting) -> float:
    """Kinetic and elastic, of all."""
    return sum(float(each.energies(each.state())[:2].sum()) for each in meeting.simulations)


def sums(meeting: Meeting) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular momentum of all."""
    parts = list(zip(meeting.states(), meeting.masses, strict=True))
    return (sum(linear_momentum(state, mass) for state, mass in parts),  # pyright: ignore[reportReturnType]
            sum(angular_momentum(state, mass, meeting.dx) for state, mass in parts))  # fmt: skip


@pytest.mark.parametrize("turn", [0.0, 0.5])
@pytest.mark.parametrize("place", [0.0, 0.3, 0.6])
def test_nothing_is_felt_before_surfaces_meet(place: float, turn: float) -> None:
    """Two blocks, flat on and turned against the grid: free until 0.35 cells apart, and stopped before 0.25 inside."""
    about = Rotation.from_rotvec([0, 0, turn])
    gap, speed = 1.5 * DX, 1.0
    x, volumes = block((0.2, 0.3, 0.3), DX / 2)
    other = x + np.array([0.2 + gap, 0, 0])
    a, b = (about.apply(each) + np.array([place * DX, 0, 0]) for each in (x, other))
    ahead = about.apply([1.0, 0, 0])
    meeting = Meeting((a, volumes, speed * ahead, STIFF), (b, volumes, 0 * ahead, STIFF), precision="float64")
    apart, felt = gap, None
    while meeting.time < 0.12:
        meeting.fields.step_towards(meeting.simulations, 0.12 - meeting.time, meeting.friction, span=1e-9)
        states = meeting.states()
        apart = min(apart, ((states[1].positions @ ahead).min() - (states[0].positions @ ahead).max() - DX / 2))
        if felt is None and abs(states[1].velocities).max() > 1e-9:
            felt = apart
    assert felt is not None
    assert felt / DX < 0.35 and -0.25 < apart / DX


def test_bodies_part_as_they_like() -> None:
    """Two blocks face to face, one leaving: neither feels the other."""
    x, volumes = block((0.2, 0.2, 0.2), DX / 2)
    meeting = Meeting((x, volumes, [-1.0, 0, 0], STIFF), (x + np.array([0.2, 0, 0]), volumes, [0.5, 0, 0], STIFF))
    meeting.advance(0.1)
    for state, velocity in zip(meeting.states(), ([-1.0, 0, 0], [0.5, 0, 0]), strict=True):
        np.testing.assert_allclose(state.velocities, np.tile(velocity, (len(x), 1)), atol=1e-6)


@pytest.mark.parametrize(("friction", "within"), [(0.0, 0.03), (0.3, 0.05)])
def test_a_block_slides_on_another_as_coulomb_says(friction: float, within: float) -> None:
    """It slows by friction times g, and what it slides on gets the opposite; 4 cells across."""
    slab, of_slab = block((0.8, 0.3, 0.15), DX / 2)
    top, of_top = block((0.2, 0.2, 0.1), DX / 2, lowest=0.15)
    heavy = replace(STIFF, density=4000.0)
    meeting = Meeting(
        (slab, of_slab, [0, 0, 0], heavy), (top + np.array([0.1, 0.05, 0]), of_top, [1.0, 0, 0], STIFF),
        friction=friction, gravity=(0, 0, -9.81), planes=[FLOOR], rebound=[0.3],
    )  # fmt: skip
    meeting.advance(0.12)
    early = meeting.velocities()[1, 0]
    meeting.advance(0.24)
    slowing = (early - meeting.velocities()[1, 0]) / 0.12
    assert slowing == pytest.approx(friction * 9.81, abs=within * 9.81)


@pytest.mark.parametrize(
    ("light", "heavy", "speed"),
    [
        (STIFF, replace(STIFF, density=1e6), 2.0),
        (replace(STIFF, youngs_modulus=1e4), replace(STIFF, youngs_modulus=1e8), 2.0),
        (STIFF, STIFF, 30.0),
    ],
    ids=["a thousand times the mass", "stiff on soft", "at the speed of its waves"],
)
def test_extremes_stay_finite_and_make_no_energy(light, heavy, speed) -> None:
    (a, of_a), (b, of_b) = ball(0.1, [0, 0, 0]), ball(0.1, [0.22, 0.03, 0])
    meeting = Meeting((a, of_a, [speed, 0, 0], light), (b, of_b, [0, 0, 0], heavy))
    at_stake = energy(meeting)
    momentum = sums(meeting)[0]
    meeting.advance(0.04 / speed + 0.02)
    assert energy(meeting) < 1.02 * at_stake
    assert np.abs(sums(meeting)[0] - momentum).max() < 1e-4 * speed * max(mass.sum() for mass in meeting.masses)


def test_bodies_of_two_grids_are_refused() -> None:
    x, volumes = block((0.1, 0.1, 0.1), DX / 2)
    meeting = Meeting((x, volumes, [0, 0, 0], STIFF), (x + 1, volumes, [0, 0, 0], STIFF))
    other = Meeting((x, volumes, [0, 0, 0], STIFF), dx=2 * DX)
    with pytest.raises(InputError, match=r"must have the same dx, got 0\.1 beside 0\.05"):
        meeting.fields.step_towards([*meeting.simulations, *other.simulations], 0.1, np.zeros((3, 3)))
