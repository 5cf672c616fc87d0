"""What of a capture is solid: the volume is that of the thing, whatever the capture and the grid."""

from collections.abc import Callable

import numpy as np
import pytest
from bodies import cloud_of
from captures import ball, box, flat, join, stool, tube

from hoi.data import Array, GaussianCloud
from hoi.gaussians import fibonacci_sphere, select, transform
from hoi.objects.filling import fill_cloud
from hoi.objects.solidity import OPENING, THICKNESS, solid_of

SPHERE = np.pi / 6
RANDOM = np.random.default_rng(0)


def scattered(count: int, noise: float = 0.0) -> Array:
    """Points on a ball of diameter 1, at random."""
    points = RANDOM.normal(size=(count, 3))
    points /= 2 * np.linalg.norm(points, axis=1, keepdims=True)
    return points + noise * RANDOM.normal(size=points.shape)


def disc(radius: float, height: float, spacing: float) -> GaussianCloud:
    points = np.stack(np.meshgrid(*[np.arange(-radius, radius, spacing)] * 2), -1).reshape(-1, 2)
    points = points[(points**2).sum(1) < radius**2]
    return flat(
        np.pad(points, ((0, 0), (0, 1)), constant_values=height), np.tile([0, 0, 1.0], (len(points), 1)), 0.6 * spacing
    )


def cylinder(radius: float, spacing: float) -> GaussianCloud:
    ends = [disc(radius, height, spacing) for height in (-0.5, 0.5)]
    return join(tube([0, 0, -0.5], [0, 0, 0.5], radius, spacing), *ends)


def torus(wide: float, thick: float) -> GaussianCloud:
    u, v = RANDOM.uniform(0, 2 * np.pi, (2, 8000))
    kept = RANDOM.uniform(size=8000) < (wide + thick * np.cos(v)) / (wide + thick)
    u, v = u[kept], v[kept]
    out = np.column_stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)])
    return flat(wide * np.column_stack([np.cos(u), np.sin(u), 0 * u]) + thick * out, out, 0.01)


def punctured(width: float) -> GaussianCloud:
    whole = ball(0.5, [0, 0, 0], 0.02)
    return select(whole, np.linalg.norm(whole.means - [0.5, 0, 0], axis=1) > width / 2)


CLOSED: dict[str, tuple[Callable[[], GaussianCloud], float]] = {
    "evenly sampled ball": (lambda: cloud_of(fibonacci_sphere(4000) / 2, 0.0056), SPHERE),
    "randomly sampled ball": (lambda: cloud_of(scattered(4000), 0.0056), SPHERE),
    "ball of flat Gaussians": (lambda: ball(0.5, [0, 0, 0], 0.02), SPHERE),
    "noisy ball": (lambda: cloud_of(scattered(6000, 0.015), 0.0056), SPHERE),
    "ball with thick walls": (lambda: cloud_of(fibonacci_sphere(4000) / 2, 0.05), SPHERE),
    "ball of few Gaussians": (lambda: cloud_of(fibonacci_sphere(700) / 2, 0.013), SPHERE),
    "ball with a hole in the capture": (lambda: punctured(0.9 * OPENING), SPHERE),
    "box": (lambda: box([1, 0.6, 0.4], [0, 0, 0], 0.02), 0.24),
    "box of 216": (lambda: box([1, 1, 1], [0, 0, 0], 1 / 6, jitter=0), 1.0),
    "torus": (lambda: torus(0.35, 0.15), 2 * np.pi**2 * 0.35 * 0.15**2),
    "cylinder": (lambda: cylinder(0.2, 0.015), np.pi * 0.2**2),
    "slim cylinder": (lambda: cylinder(0.05, 0.01), np.pi * 0.05**2),
    "stool with thin legs": (lambda: stool().thing, 0.01 + 4 * np.pi * 0.012**2 * 0.67),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_closed_body_has_its_volume_at_every_grid(name: str) -> None:
    make, truth = CLOSED[name]
    cloud = make()
    extent = np.ptp(cloud.means, axis=0).max()
    volumes = []
    for cells in (16, 32, 48):
        filling = fill_cloud(cloud, extent / cells)
        volumes.append(filling.volumes.sum())
        assert (filling.volumes > 0).all() and filling.enclosed > 0.95
        assert len(filling.volumes) == len(cloud) + len(filling.interior)
    np.testing.assert_allclose(volumes, truth, rtol=0.05)
    np.testing.assert_allclose(volumes, volumes[-1], rtol=1e-6)  # the grid has no say in it


def test_volume_knows_neither_units_nor_direction() -> None:
    cloud, truth = CLOSED["torus"][0](), CLOSED["torus"][1]
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    assert solid_of(transform(cloud, turn, 200.0, [5, 6, 7])).volume == pytest.approx(truth * 200**3, rel=0.05)


def test_a_larger_hole_than_stated_makes_it_a_bowl() -> None:
    open_ = solid_of(punctured(0.5))
    assert open_.enclosed < 0.05 and open_.volume == pytest.approx(THICKNESS * np.pi, rel=0.2)


@pytest.mark.parametrize("cells", [16, 32, 48])
def test_what_encloses_nothing_has_the_stated_thickness(cells: int) -> None:
    points = np.stack(np.meshgrid(*[np.arange(-0.5, 0.51, 0.02)] * 2), -1).reshape(-1, 2)
    plate = flat(np.pad(points, ((0, 0), (0, 1))), np.tile([0, 0, 1.0], (len(points), 1)), 0.012)
    filling = fill_cloud(plate, 1 / cells)
    assert filling.volumes.sum() == pytest.approx(THICKNESS, rel=0.15)
    assert filling.enclosed < 0.05
    assert len(filling.interior) < 0.5 * cells**2  # one layer, held by the surface's own particles


def test_interior_lies_inside_and_balances() -> None:
    filling = fill_cloud(ball(0.5, [0, 0, 0], 0.02), 1 / 32)
    assert (np.linalg.norm(filling.interior, axis=1) < 0.5 + 0.5 / 32).all()
    particles = np.concatenate([ball(0.5, [0, 0, 0], 0.02).means, filling.interior])
    np.testing.assert_allclose(np.average(particles, axis=0, weights=filling.volumes), 0, atol=2e-3)
    arms = (particles**2).sum(1) - particles[:, 0] ** 2
    assert (arms * filling.volumes).sum() == pytest.approx(0.4 * SPHERE * 0.25, rel=0.06)
