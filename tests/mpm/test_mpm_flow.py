"""Bodies that flow, in the whole solver: clay stays dented, sand stands in a heap, water lies level."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, block
from mpm_examples import EXAMPLES

from hoi.data import Plane
from hoi.mpm.materials import kirchhoff_stress
from hoi.mpm.solver import SimulationResult, simulate
from hoi.mpm.state import initial_state

UP = np.array([0.0, 0.0, 1.0])


def walls(low: tuple[float, float], high: tuple[float, float]) -> list[Plane]:
    """Four smooth walls around [low, high] in x and y."""
    sides = []
    for axis in range(2):
        normal = np.eye(3)[axis]
        sides += [Plane(low[axis] * normal, normal, "slip"), Plane(high[axis] * normal, -normal, "slip")]
    return sides


def dropped(model: str, **changes: float) -> SimulationResult:
    """A cube of 0.2 m thrown at the ground at 6 m/s; states at 0, 0.06 and 0.3 s."""
    material = replace(EXAMPLES[model], youngs_modulus=1e6, **changes)
    x, volumes = block((0.2, 0.2, 0.2), DX / 2, 0.02)
    start = initial_state(x, volumes, [0, 0, -6])
    return simulate(start, volumes, material, dx=DX, times=[0.0, 0.06, 0.3])


def heights(result: SimulationResult) -> np.ndarray:
    return np.array([np.ptp(state.positions[:, 2]) for state in result.states])


def test_clay_stays_dented_and_rubber_springs_back() -> None:
    """Clay loses a fifth of its height and most of its energy for good; rubber is 3 % from its shape and in the air."""
    clay, rubber = dropped("viscoplastic", yield_stress=2e4, viscosity=100.0), dropped("neo_hookean")
    before, after, later = heights(clay)
    assert after < 0.8 * before
    assert later == pytest.approx(after, rel=0.03)
    assert heights(rubber)[2] == pytest.approx(before, rel=0.03)
    assert rubber.com[2, 2] > clay.com[2, 2] + 0.2
    total, elastic, plastic = clay.final.deformation_gradient, clay.final.elastic, clay.final.hardening
    assert elastic is not None and plastic is not None
    assert np.linalg.det(total).mean() == pytest.approx(1, abs=0.02)
    # The elastic F has let go of what the total F remembers.
    strain = [np.abs(np.log(np.linalg.svd(f, compute_uv=False))).mean() for f in (elastic, total)]
    assert strain[0] < 0.03 < 0.1 < strain[1]
    assert plastic.max() > 0.2


def collapsed(friction_angle: float) -> SimulationResult:
    """A column of sand, 8 cm square and 12 cm high, let go in a trough of 8 x 32 cm with a rough floor."""
    material = replace(EXAMPLES["drucker_prager"], friction_angle=friction_angle)
    x, volumes = block((0.08, 0.08, 0.12), 0.01)
    planes = [Plane(np.zeros(3), UP, "stick"), *walls((0, 0), (0.32, 0.08))]
    start = initial_state(x, volumes, [0, 0, 0])
    return simulate(start, volumes, material, dx=0.02, times=[0.3, 0.5, 0.6], planes=planes)


def test_sand_comes_to_rest_in_a_heap_as_steep_as_its_friction() -> None:
    """It runs out further and lies flatter with less friction, its slope below that of the friction angle."""
    slopes, reach = [], []
    for angle in (0.3, 0.6):
        result = collapsed(angle)
        x, z = result.final.positions[:, 0], result.final.positions[:, 2]
        assert np.linalg.norm(result.com_velocity[-1]) < 0.02
        assert result.energy[-1, 0] < 2e-3 * result.energy[0, 0]
        starts = np.arange(0.0, np.quantile(x, 0.98), 0.02)
        surface = [np.quantile(z[(x >= left) & (x < left + 0.02)], 0.95) for left in starts]
        slopes.append(-np.polyfit(starts, surface, 1)[0])
        reach.append(np.quantile(x, 0.98))
    assert 0.4 * np.tan(0.3) < slopes[0] < np.tan(0.3)
    assert 0.4 * np.tan(0.6) < slopes[1] < np.tan(0.6)
    assert reach[0] > 1.1 * reach[1]


def test_water_comes_to_lie_level_and_bears_its_own_weight() -> None:
    """A column let go in a tank: level to half a cell, its volume kept, its pressure that of its depth."""
    material = replace(EXAMPLES["fluid"], poisson_ratio=0.45, viscosity=5.0)
    x, volumes = block((0.2, 0.2, 0.4), DX / 2)
    planes = [Plane(np.zeros(3), UP, "slip"), *walls((0, 0), (0.4, 0.2))]
    start = initial_state(x, volumes, [0, 0, 0])
    final = simulate(start, volumes, material, dx=DX, times=[3.0], planes=planes).final
    z, j = final.positions[:, 2], np.linalg.det(final.deformation_gradient)
    quarters = np.digitize(final.positions[:, 0], [0.1, 0.2, 0.3])
    surface = [np.quantile(z[quarters == quarter], 0.95) for quarter in range(4)]
    assert np.ptp(surface) < 0.5 * DX
    assert j.mean() == pytest.approx(1, abs=0.02)
    pressure = -kirchhoff_stress(material, final.deformation_gradient.astype(float))[:, 0, 0]
    depth = 2 * (z.mean() - z.min()) + DX / 2
    assert pressure.mean() == pytest.approx(0.5 * material.density * 9.81 * depth, rel=0.2)
