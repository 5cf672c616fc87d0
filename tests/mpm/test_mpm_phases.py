"""Phases against the MPM of every step, and the conditions under which steps are left out."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import ground
from mpm_bodies import DX, RUBBER, block
from mpm_examples import EXAMPLES
from scipy.spatial.transform import Rotation

from hoi.data import Material, ObjectState, Plane
from hoi.mpm import rigid
from hoi.mpm.collider import Collider
from hoi.mpm.phases import Surroundings, Walk, first_contact, lowest_frequency, reach_of, unstrained
from hoi.mpm.rigid import Flight, RigidMotion
from hoi.mpm.solver import Simulation, simulate
from hoi.mpm.state import angular_momentum, centre_of_mass, initial_state, linear_momentum

STIFF = replace(RUBBER, youngs_modulus=1e6)
GROUND = ground(STIFF.ground_friction)
WALL = Plane(np.array([0.6, 0, 0]), np.array([-0.8, 0, 0.6]), "slip")
GRAVITY = np.array([0, 0, -9.81])
TOLERANCE = 0.003
DT = 4e-4  # a third of the limit
D = DX**2 / 4


def walk(
    state, volumes, material=STIFF, *, end, tolerance=TOLERANCE, planes=(GROUND,), size=0.2, dt=DT, **options
) -> Walk:
    masses = volumes * material.density

    def start(state: ObjectState, _: float) -> Simulation:
        return Simulation(state, volumes, material, dx=DX, dt=dt, planes=planes, **options)

    return Walk(
        state,
        masses,
        start,
        end=end,
        gravity=GRAVITY,
        surroundings=Surroundings(planes, [reach_of(plane, DX) for plane in planes]),
        size=size,
        moment=D,
        frequency=lowest_frequency(state.positions, masses, [material]),
        tolerance=tolerance,
    )


def ball(radius: float, lowest: float) -> tuple[np.ndarray, np.ndarray]:
    x, volumes = block((2 * radius,) * 3, DX / 2, lowest)
    inside = np.linalg.norm(x - x.mean(axis=0), axis=1) <= radius
    return x[inside], volumes[inside]


def orientation(state: ObjectState, rest: np.ndarray) -> Rotation:
    return Rotation.align_vectors(state.positions - state.positions.mean(axis=0), rest - rest.mean(axis=0))[0]


def along(walked: Walk, times) -> tuple[list[ObjectState], list[str]]:
    states, phases = zip(*(walked.advance(float(t)) for t in times), strict=True)
    return list(states), list(phases)


def test_thrown_box_flies_as_it_does_in_the_mpm() -> None:
    """Up, down and off the ground again, turning: centre of mass within 1% of the size, orientation within 2 deg."""
    x, volumes = block((0.2, 0.15, 0.1), DX / 2, lowest=0.3)
    masses = volumes * STIFF.density
    start = initial_state(x, masses, [1, 0.5, 1.5], [1, 3, 0.5])
    times = np.arange(1, 13) * 0.05
    (on, phases), (off, _) = (
        along(walk(start, volumes, end=0.6, tolerance=t, precision="float64"), times) for t in (TOLERANCE, None)
    )
    assert phases[2:5] == ["flight"] * 3 and "mpm" in phases[5:]
    for a, b in zip(on, off, strict=True):
        assert np.linalg.norm(centre_of_mass(a.positions - b.positions, masses)) < 0.01 * 0.2
        assert np.degrees((orientation(a, x) * orientation(b, x).inv()).magnitude()) < 2


def test_bouncing_ball_bounces_as_it_does_in_the_mpm() -> None:
    x, volumes = ball(0.1, lowest=0.3)
    start = initial_state(x, volumes, [0.5, 0, 0])
    times = np.arange(1, 19) * 0.05
    walked = walk(start, volumes, end=0.9)
    (on, phases), (off, _) = along(walked, times), along(walk(start, volumes, end=0.9, tolerance=None), times)
    for a, b in zip(on, off, strict=True):
        assert np.linalg.norm(centre_of_mass(a.positions - b.positions, volumes)) < 0.01 * 0.2
    assert {"mpm", "flight"} == set(phases)
    assert walked.tally.changes >= 4


def test_flight_only_where_nothing_can_be_touched() -> None:
    """A tumbling block thrown at a slanting wall: whenever it flies, every particle is out of reach of every plane."""
    x, volumes = block((0.2, 0.1, 0.1), DX / 2, lowest=0.4)
    start = initial_state(x, volumes, [1.5, 0, 0], [0, 9, 4])
    walked = walk(start, volumes, end=0.9, planes=(GROUND, WALL))
    flown, touched = 0, 0
    for t in np.arange(1, 181) * 0.005:
        state, phase = walked.advance(float(t))
        gaps = [((state.positions - p.point) @ p.normal).min() - reach_of(p, DX) for p in (GROUND, WALL)]
        touched += min(gaps) < 0
        if phase == "flight":
            flown += 1
            assert min(gaps) > 0
    assert flown > 40 and touched > 20


def test_momentum_is_kept_when_the_phase_changes() -> None:
    """P - M g t and L about the centre of mass, from the MPM into flight, to round-off."""
    x, volumes = block((0.2, 0.15, 0.1), DX / 2, lowest=1.0)
    masses = volumes * STIFF.density
    start = initial_state(x, masses, [1, 0.5, 1.5], [1, 3, 0.5])
    walked = walk(start, volumes, end=0.3, precision="float64")
    seen = set()
    for t in np.arange(0, 31) * 0.01:
        state, phase = walked.advance(float(t))
        seen.add(phase)
        momentum = linear_momentum(state, masses)
        np.testing.assert_allclose(momentum, masses.sum() * (np.array([1, 0.5, 1.5]) + t * GRAVITY), rtol=1e-11)
        spin = angular_momentum(state, masses, DX) - np.cross(centre_of_mass(state.positions, masses), momentum)
        np.testing.assert_allclose(spin, rigid.fit(start, masses, D).angular_momentum, rtol=1e-9)
    assert seen == {"mpm", "flight"}


@pytest.mark.parametrize("material", EXAMPLES.values(), ids=EXAMPLES)
def test_unstrained_bodies_fly_at_once(material: Material) -> None:
    """What is thrown in one piece stays in one piece until it touches, whatever it is made of; so has it the MPM."""
    x, volumes = block((0.1, 0.1, 0.1), DX / 2, lowest=0.3)
    masses = volumes * material.density
    start = initial_state(x, masses, [1, 0.5, 0.5])
    (on, phases), (off, _) = (
        along(walk(start, volumes, material, end=0.2, tolerance=t, dt=None, precision="float64"), (0.1, 0.2))
        for t in (TOLERANCE, None)
    )
    assert phases == ["flight", "flight"]
    for a, b in zip(on, off, strict=True):
        for name in ("positions", "velocities", "deformation_gradient"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-9)
        assert unstrained(a)
    low = initial_state(x - [0, 0, 0.3], masses, [1, 0, 0])
    assert walk(low, volumes, material, end=0.1, dt=None).phase == "mpm"
    assert not unstrained(replace(start, velocities=start.velocities + 0.1 * x))
    assert not unstrained(replace(start, deformation_gradient=1.001 * start.deformation_gradient))
    assert not unstrained(initial_state(x, masses, [1, 0, 0], [0, 0.1, 0]))


@pytest.mark.parametrize("spin", [0.0, 2.0])
def test_what_is_left_out_is_counted(spin: float) -> None:
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, lowest=0.5)
    start = initial_state(x, volumes, [0, 0, 1], [0, 0, spin])
    walked = walk(start, volumes, end=0.4)
    walked.advance(0.4)
    tally = walked.finish()
    every = walk(start, volumes, end=0.4, tolerance=None)
    every.advance(0.4)
    assert tally.changes == 1 and tally.seconds["rest"] == 0
    assert tally.seconds["mpm"] + tally.seconds["flight"] == pytest.approx(0.4)
    assert tally.steps + tally.steps_left_out == pytest.approx(every.finish().steps, rel=0.1)
    assert (tally.steps > 0) == (spin > 0) and tally.steps < 0.1 * tally.steps_left_out
    assert tally.vibration < 1e-3 and 0 <= tally.energy < 1e-3


def test_vibration_delays_the_flight() -> None:
    """A body that rings flies only once it rings less than the tolerance, and never where there is none."""
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, lowest=1.0)
    rest = initial_state(x, volumes, [0, 0, 0])
    stretch = (x - x.mean(axis=0)) * [1, 0, 0]
    begun = {}
    for speed, tolerances in ((0.0, [1e-3]), (4.0, [0.0, 2e-4, 1e-3])):
        ringing = replace(
            rest, velocities=speed * stretch, affine=np.tile(speed * np.diag([1.0, 0, 0]), (len(x), 1, 1))
        )
        for tolerance in tolerances:
            walked = walk(ringing, volumes, end=0.3, tolerance=tolerance, precision="float64")
            walked.advance(0.3)
            begun[speed, tolerance] = walked.tally.seconds["mpm"]
            assert walked.tally.vibration <= tolerance
    assert begun[0, 1e-3] < begun[4, 1e-3] < begun[4, 2e-4] < begun[4, 0] == pytest.approx(0.3)


def test_rest_is_found_and_held() -> None:
    """A box set down on the ground comes to rest and stays exactly where it is, which is where the MPM has it."""
    x, volumes = block((0.2, 0.2, 0.1), DX / 2, lowest=0.002)
    start = initial_state(x, volumes, [0.02, 0, 0])
    walked = walk(start, volumes, end=1.0)
    times = np.arange(1, 21) * 0.05
    states, phases = along(walked, times)
    assert phases[0] == "mpm" and phases[-1] == "rest"
    held = phases.index("rest")
    for state in states[held:]:
        np.testing.assert_array_equal(state.positions, states[held].positions)
        assert not state.velocities.any()
    every, _ = along(walk(start, volumes, end=1.0, tolerance=None), times)
    assert np.linalg.norm(states[-1].positions - every[-1].positions, axis=1).max() < TOLERANCE * 0.2


def test_no_tolerance_is_the_plain_solver() -> None:
    x, volumes = block((0.2, 0.2, 0.1), DX / 2, lowest=0.02)
    start, times = initial_state(x, volumes, [1, 0, 0]), [0.02, 0.05, 0.11]
    states, phases = along(walk(start, volumes, end=0.11, tolerance=None), times)
    plain = simulate(start, volumes, STIFF, times=times, dx=DX, dt=DT, planes=(GROUND,))
    assert phases == ["mpm"] * 3
    for a, b in zip(states, plain.states, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        np.testing.assert_array_equal(a.deformation_gradient, b.deformation_gradient)


@pytest.mark.parametrize("seed", range(3))
def test_first_contact_is_neither_late_nor_early(seed: int) -> None:
    """Against samples every 0.1 ms: no sooner than 1 ms before the first particle is in reach."""
    rng = np.random.default_rng(seed)
    body = rng.normal(size=(40, 3)) * [0.2, 0.1, 0.05]
    body -= body.mean(axis=0)
    inertia = np.trace(body.T @ body) * np.eye(3) - body.T @ body
    motion = RigidMotion(1.0, np.array([0, 0, 1.0]), rng.normal(size=3), inertia @ (8 * rng.normal(size=3)), inertia)
    flight = Flight(motion, GRAVITY)
    around = Surroundings((GROUND, WALL), (0.03, 0.05))
    found = first_contact(flight, rigid.hull(body), around, 0.0, 2.0)
    for t in np.arange(0, 2, 1e-4):
        x = flight.com(t) + body @ flight.rotation(t).T
        if around.touched(x):
            break
    assert t - 1e-3 < found <= t


def test_flight_ends_before_the_collider_comes() -> None:
    """A capsule comes towards a ball at rest in empty space: the flight ends when their reach meets."""
    times = np.array([0.5, 1.0, 3.0])
    path = np.array([[[0, 3.0, -1]], [[0, 2.5, -1]], [[0, -1.5, -1]]])
    collider = Collider(times, path, path + np.array([0, 0, 2.0]), np.array([0.1]), 0.5)
    motion = RigidMotion(1.0, np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3))
    flight = Flight(motion, np.zeros(3))
    around = Surroundings((), (), collider, 0.05)
    hull = 0.25 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    meets = 1.0 + (2.5 - 0.1 - 0.25 - 0.05) / 2  # at 2 m/s
    assert meets - 1e-3 < first_contact(flight, hull, around, 0.0, 5.0) <= meets
    assert meets - 1.2 - 1e-3 < first_contact(flight, hull, around, 1.2, 5.0) <= meets - 1.2 + 1e-12
    assert first_contact(flight, hull, around, 3.1, 5.0) == 5.0


@pytest.mark.parametrize("plane", [GROUND, WALL, replace(GROUND, point=np.array([0, 0, 0.3 * DX]))])
def test_beyond_reach_no_held_node_is_touched(plane: Plane) -> None:
    """The ground at a node's height holds nothing above a cell below it: half a cell of reach is all."""
    rng = np.random.default_rng(0)
    x = plane.point + rng.uniform(-2, 2, (20000, 3)) * DX
    nodes = (np.floor(x / DX - 0.5)[:, None] + np.array(list(np.ndindex(3, 3, 3)))) * DX
    touching = (((nodes - plane.point) @ plane.normal) < -0.5 * DX - 1e-12).any(axis=1)
    height = (x - plane.point) @ plane.normal
    assert height[touching].max() <= reach_of(plane, DX)
    assert height[touching].max() > 0.7 * reach_of(plane, DX)
    assert reach_of(GROUND, DX) == pytest.approx(0.5 * DX)


def test_lowest_frequency_is_a_lower_bound() -> None:
    """Of a ball 5.0 c_s / l and of a bending bar 22.4 h c / (sqrt(12) l^2), whatever the direction."""
    shear = np.sqrt(STIFF.youngs_modulus / 2.6 / STIFF.density)
    x, volumes = ball(0.1, 0)
    assert 0.7 * 5.0 * shear / 0.2 < lowest_frequency(x, volumes, [STIFF]) < 5.0 * shear / 0.2
    x, volumes = block((0.5, 0.1, 0.1), DX / 4)
    bending = 22.4 * 0.1 / 12**0.5 * np.sqrt(STIFF.youngs_modulus / STIFF.density) / 0.25
    turned = x @ Rotation.from_rotvec([1, 2, 3]).as_matrix().T
    for points in (x, turned):
        assert 0.25 * bending < lowest_frequency(points, volumes, [STIFF]) < bending
    assert lowest_frequency(x, volumes, [STIFF, RUBBER]) < lowest_frequency(x, volumes, [STIFF])
