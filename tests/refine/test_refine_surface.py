"""The signed distance against spheres, boxes, ellipsoids, sheets and captures; its gradient against differences."""

import numpy as np
import pytest

from hoi.gaussians import fibonacci_sphere
from hoi.objects.filling import fill_cloud
from hoi.objects.load import load_builtin, load_file
from hoi.refine.surface import Surface, surface_of
from tests.demo_run import make_run


def whole(particles: np.ndarray, gaussians: int, volumes: np.ndarray, size: float) -> Surface:
    return surface_of(particles, gaussians, volumes, size, (particles.min(axis=0), particles.max(axis=0)))


def around(low: np.ndarray, high: np.ndarray, count: int = 3000) -> np.ndarray:
    return np.random.default_rng(0).uniform(low, high, (count, 3))


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, int, np.ndarray]:
    loaded = load_builtin("soccer_ball", 0.22 / 25, 0.22)
    return loaded.particles.astype(np.float64), len(loaded.cloud), loaded.volumes


def test_a_ball(ball):
    points = around(np.full(3, -0.15), np.full(3, 0.15))
    radius = np.linalg.norm(points, axis=1)
    got, gradient = whole(*ball, 0.22).distance(points)
    near = np.abs(radius - 0.11) < 0.03
    assert np.abs(got - (radius - 0.11))[near].max() < 1e-3
    assert np.abs(got - (radius - 0.11))[radius > 0.03].max() < 2e-3
    outwards = (gradient * points).sum(axis=1) / radius
    assert outwards[near].min() > 0.95 and np.median(outwards[near]) > 0.999


def test_a_dented_ball_that_has_moved(ball):
    """Squeezed to an ellipsoid: the sign of every point, and the distance along the axes."""
    particles, gaussians, volumes = ball
    squeeze, place = np.array([0.7, 1.0, 1.2]), np.array([0.4, -2.0, 0.9])
    surface = whole(particles * squeeze + place, gaussians, volumes, 0.22)
    unit = around(np.full(3, -1.3), np.full(3, 1.3))
    level = np.linalg.norm(unit, axis=1)
    got, _ = surface.distance(unit * 0.11 * squeeze + place)
    clear = np.abs(level - 1) > 0.03
    np.testing.assert_array_equal(np.sign(got)[clear], np.sign(level - 1)[clear])
    tips = np.concatenate([np.diag(0.11 * squeeze), -np.diag(0.11 * squeeze)])
    for off in (-0.02, 0.015):
        ends = tips * (1 + off / np.linalg.norm(tips, axis=1, keepdims=True))
        np.testing.assert_allclose(surface.distance(ends + place)[0], off, atol=1.5e-3)


def test_a_box():
    loaded = load_builtin("cardboard_box", 0.4 / 25, 0.4)
    particles = loaded.particles.astype(np.float64)
    centre, half = (particles.max(0) + particles.min(0)) / 2, np.ptp(particles, axis=0) / 2
    points = centre + around(-1.3 * half, 1.3 * half)
    beyond = np.abs(points - centre) - half
    within = np.sort(beyond, axis=1)
    before_a_face = (within[:, 1] < -0.04) & (np.abs(within[:, 2]) < 0.03)  # away from the edges
    got, gradient = whole(particles, len(loaded.cloud), loaded.volumes, 0.4).distance(points)
    off = np.abs(got - beyond.max(axis=1))
    assert off[before_a_face].max() < 1e-3
    inside = (beyond.max(axis=1) < -0.01) & (beyond.max(axis=1) > -0.15)
    assert off[inside].max() < 5e-3
    assert (got[beyond.max(axis=1) > 0.01] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(gradient[before_a_face], axis=1), 1, atol=1e-3)


def test_its_gradient_is_its_slope(ball):
    surface = whole(*ball, 0.22)
    points = around(np.full(3, -0.12), np.full(3, 0.12), 300)
    _, gradient = surface.distance(points)
    slope = np.stack(
        [(surface.distance(points + d)[0] - surface.distance(points - d)[0]) / 2e-6 for d in 1e-6 * np.eye(3)], -1
    )
    # A few lie where another point of the surface becomes one of the nearest.
    assert np.percentile(np.abs(slope - gradient), 98) < 1e-6


def test_many_layers_of_a_capture_are_one_surface():
    """Means scattered by 4 mm about a sphere, as in a capture."""
    rng = np.random.default_rng(1)
    run, *_ = make_run(gaussians=200, particles=300)
    directions = fibonacci_sphere(8000)
    means = directions * (0.2 + 0.004 * rng.standard_normal(8000))[:, None]
    cloud = run.scene.object.cloud
    filled = type(cloud)(
        means.astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (8000, 1)),
        np.full((8000, 3), 0.004, np.float32),
        np.ones(8000, np.float32),
        np.zeros((8000, 1, 3), np.float32),
    )
    filling = fill_cloud(filled, 0.4 / 25)
    particles = np.concatenate([means, filling.interior])
    surface = whole(particles, 8000, filling.volumes, 0.4)
    points = around(np.full(3, -0.26), np.full(3, 0.26))
    radius = np.linalg.norm(points, axis=1)
    got, _ = surface.distance(points)
    clear = np.abs(radius - 0.2) > 0.015
    assert (np.sign(got) == np.sign(radius - 0.2))[clear].mean() > 0.999
    assert np.median(np.abs(got - (radius - 0.2))[clear & (radius > 0.15)]) < 0.01


def test_a_sheet_has_no_inside():
    grid = np.stack(np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60), indexing="ij"), -1).reshape(-1, 2)
    sheet = np.column_stack([grid, np.zeros(len(grid))])
    surface = whole(sheet, len(sheet), np.full(len(sheet), 0.002 / 3600), 1.0)
    for side in (-1, 1):
        got, _ = surface.distance(np.array([[0.5, 0.5, side * 0.03]]))
        assert got[0] == pytest.approx(0.03, abs=0.005)


def test_a_captured_object(shared_objects):
    """What the filling put inside is inside; what is far from all particles is outside."""
    loaded = load_file(shared_objects / "spot_10k.splat", 0.5, "+y", 0.5 / 25, 20000)
    particles, gaussians = loaded.particles.astype(np.float64), len(loaded.cloud)
    surface = whole(particles, gaussians, loaded.volumes, 0.5)
    assert (surface.distance(particles[gaussians:])[0] < 0).mean() > 0.99
    corners = particles.min(axis=0) - 0.03 + np.array([[0, 0, 0], [0, 1, 0]]) * (np.ptp(particles, axis=0) + 0.06)
    assert (surface.distance(corners)[0] > 0.03).all()
