"""Free flight backwards against central differences, and the time of a landing by the event rule."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, block

from hoi.data import Material, ObjectState
from hoi.gradient.backwards import Cotangent, Recording
from hoi.gradient.flight import flight_backwards, landing_backwards, landing_time
from hoi.mpm import rigid
from hoi.mpm.solver import ground_plane, simulate
from hoi.mpm.state import initial_state

G = np.array([0.2, -0.1, -9.81])
D = DX**2 / 4
X, VOLUMES = block((0.1, 0.15, 0.2), 0.05)
MASSES = 1000 * VOLUMES
FIELDS = ("positions", "velocities", "affine", "deformation_gradient")


def start(spin: tuple[float, float, float] = (3.0, -8.0, 5.0), height: float = 0.0) -> ObjectState:
    rng = np.random.default_rng(0)
    state = initial_state(X + np.array([0, 0, height]), MASSES, (1.0, 2.0, -1.0), spin)
    shaken = {name: getattr(state, name) + 1e-3 * rng.normal(size=getattr(state, name).shape) for name in FIELDS}
    return replace(state, **shaken)


def weights(seed: int) -> Cotangent:
    rng = np.random.default_rng(seed)
    return Cotangent(*(rng.normal(size=(len(X), *shape)) for shape in ((3,), (3,), (3, 3), (3, 3))))


def product(a: Cotangent, b: ObjectState | Cotangent) -> float:
    return sum(float((getattr(a, name) * getattr(b, name)).sum()) for name in FIELDS)


def moved(state: ObjectState, by: Cotangent, h: float) -> ObjectState:
    return replace(state, **{name: getattr(state, name) + h * getattr(by, name) for name in FIELDS})


@pytest.mark.parametrize(("spin", "drag"), [((3.0, -8.0, 5.0), 0.0), ((0.0, 0.0, 0.0), 0.0), ((3.0, -8.0, 5.0), 0.05)])
def test_each_cause_against_central_differences(spin, drag) -> None:
    state, after, way, time = start(spin), weights(1), weights(2), 0.7

    def value(state: ObjectState, time: float = time, g: np.ndarray = G) -> float:
        return product(after, rigid.carry(rigid.Flight(rigid.fit(state, MASSES, D), g, drag), state, time))

    flight = rigid.Flight(rigid.fit(state, MASSES, D), G, drag)
    before, gravity, longer = flight_backwards(flight, state, MASSES, D, time, after)
    h = 1e-6
    for name in FIELDS:
        alone = Cotangent(**{n: getattr(way, n) * (n == name) for n in FIELDS})
        expected = (value(moved(state, alone, h)) - value(moved(state, alone, -h))) / (2 * h)
        assert product(before, alone) == pytest.approx(expected, rel=1e-6), name
    assert longer == pytest.approx((value(state, time + h) - value(state, time - h)) / (2 * h), rel=1e-7)
    step = np.array([h, 2 * h, -h])
    assert gravity @ step == pytest.approx((value(state, g=G + step) - value(state, g=G - step)) / 2, rel=1e-7)


def test_a_landing_is_differentiated_at_its_time() -> None:
    """Flight until a particle comes within reach of the ground, then the MPM until a fixed end: the whole of it, where
    the moment of the change follows the start, against central differences."""
    plane, reach, end = ground_plane(0.4), 0.03, 0.26
    material = Material("m", "neo_hookean", 1e5, 0.3, 1000.0, 0.6, 0.4)
    after, way, state = weights(3), weights(4), start(height=0.4)
    settings = {"dx": DX, "dt": 5e-4, "gravity": G, "planes": [plane], "precision": "float64"}

    def walk(state: ObjectState) -> tuple[rigid.Flight, float, int, ObjectState]:
        flight = rigid.Flight(rigid.fit(state, MASSES, D), G)
        time, lowest = landing_time(flight, state, plane, reach, 0.2)
        return flight, time, lowest, rigid.carry(flight, state, time)

    def value(state: ObjectState) -> float:
        _, time, _, landed = walk(state)
        return product(after, simulate(landed, VOLUMES, material, times=[end - time], **settings).final)

    flight, time, lowest, landed = walk(state)
    assert 0.05 < time < end - 0.02
    run = Recording(landed, VOLUMES, material, **settings)
    run.advance(end - time)
    assert run.state().positions[:, 2].min() < 0.0, "it touches the ground"
    later = run.backwards([(end - time, after)])
    before, _ = landing_backwards(
        flight, state, MASSES, D, time, later.cotangent, plane, lowest, later.duration
    )  # fmt: skip
    h = 1e-7
    for name in FIELDS:
        alone = Cotangent(**{n: getattr(way, n) * (n == name) for n in FIELDS})
        expected = (value(moved(state, alone, h)) - value(moved(state, alone, -h))) / (2 * h)
        assert product(before, alone) == pytest.approx(expected, rel=1e-5), name
