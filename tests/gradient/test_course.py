"""A trajectory of flight, bounce and flight backwards, against central differences of the walk itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpm_bodies import DX, block

from hoi.data import Material
from hoi.gradient.backwards import Cotangent
from hoi.gradient.course import Course
from hoi.mpm.phases import Surroundings, lowest_frequency, reach_of
from hoi.mpm.solver import ground_plane
from hoi.mpm.state import initial_state

X, VOLUMES = block((0.1, 0.1, 0.1), 0.025, lowest=0.3)
MATERIAL = Material("m", "neo_hookean", 1e5, 0.3, 1000.0, 0.6, 0.4)
TIMES = (0.1, 0.25, 0.4)
ALONG = np.random.default_rng(0).normal(size=(len(TIMES), 3))


def course(
    velocity: Any = (0.4, 0.1, -1.0), spin: Any = (0.3, 0.5, 0.2), material: Material = MATERIAL,
    tolerance: float | None = 0.05, rebound: float = 0.7, friction: float = 0.4,
) -> tuple[Course, float]:  # fmt: skip
    """And a number: a part of where its centre is at the times."""
    masses = VOLUMES * material.density
    plane = ground_plane(friction)
    walk = Course(
        initial_state(X, masses, velocity, spin), masses, VOLUMES, material, end=TIMES[-1],
        surroundings=Surroundings([plane], [reach_of(plane, DX)]), size=0.1, moment=DX**2 / 4,
        frequency=lowest_frequency(X, masses, [material]), tolerance=tolerance, dx=DX, dt=5e-4, rebound=[rebound],
        precision="float64", drag=0.05,
    )  # fmt: skip
    states = [walk.advance(t)[0] for t in TIMES]
    return walk, sum(float(way @ state.positions.mean(axis=0)) for way, state in zip(ALONG, states, strict=True))


def test_flight_bounce_flight() -> None:
    walk, _ = course()
    kinds = ["mpm" if p.run else "flight" if p.flight else "rest" for p in walk.passed]
    assert kinds == ["mpm", "flight", "mpm", "flight"]
    each = [np.tile(way / len(X), (len(X), 1)) for way in ALONG]
    g = walk.backwards([(t, Cotangent(positions=c)) for t, c in zip(TIMES, each, strict=True)])
    unit = np.eye(3)

    def central(h: float, **by: Any) -> float:
        ((name, change),) = by.items()
        return (course(**{name: change(h)})[1] - course(**{name: change(-h)})[1]) / (2 * h)

    for axis, h, share in ((0, 1e-5, 2e-3), (1, 1e-5, 2e-3), (2, 0.05, 5e-2)):  # z moves the landing among the steps
        expected = central(h, velocity=lambda h, axis=axis: np.array([0.4, 0.1, -1.0]) + h * unit[axis])
        assert g.velocity[axis] == pytest.approx(expected, rel=share), axis
    expected = central(1.0, material=lambda h: replace(MATERIAL, youngs_modulus=1e5 + h))
    assert g.materials[0].youngs_modulus == pytest.approx(expected, rel=1e-4)
    assert g.materials[0].rebound == pytest.approx(central(1e-4, rebound=lambda h: 0.7 + h), rel=1e-4)
    assert g.friction[0] == pytest.approx(central(1e-4, friction=lambda h: 0.4 + h), rel=1e-4)


def test_what_lies_still_keeps_its_place_alone() -> None:
    """Its place owes all to where it was when it came to rest, and its speed nothing."""
    walk, _ = course()
    state = walk.passed[1].departed
    walk.passed = [*walk.passed[:2], replace(walk.passed[1], flight=None, departed=state, began=0.2)]
    walk.time = 0.5
    g = walk.backwards([(0.5, Cotangent(positions=np.ones_like(X), velocities=np.ones_like(X)))])
    alone = walk.backwards([(0.2, Cotangent(positions=np.ones_like(X)))])
    np.testing.assert_allclose(g.positions, alone.positions, rtol=1e-12)
    np.testing.assert_allclose(g.velocities, alone.velocities, rtol=1e-12)
