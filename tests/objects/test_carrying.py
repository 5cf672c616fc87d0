"""Drawn Gaussians hang on the particles: with a moving object they move, turn and stretch as it does."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from captures import ball
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.data import Array, Material, SceneObject
from hoi.objects.carrying import carried_by
from hoi.objects.load import load_file, place

WOOD = Material("wood", "neo_hookean", 1e6, 0.3, 400.0, 0.5, 0.5)


@pytest.fixture(scope="module")
def thing(tmp_path_factory: pytest.TempPathFactory) -> SceneObject:
    path = tmp_path_factory.mktemp("object") / "ball.ply"
    gaussians.write_ply(ball(0.5, [0, 0, 0], 0.01, rgb=[0.9, 0.5, 0.1]), path)
    loaded = load_file(path, 0.4, "+z", 0.03, 2000, max_drawn=20_000)
    assert len(loaded.cloud) <= 2000 < 15_000 < len(loaded.drawn or ()) <= 20_000
    assert any("drawn" in note for note in loaded.notes)
    return place(loaded, WOOD, (0.2, 1.0, None), yaw=0.3)


def motion(thing: SceneObject, gradient: Array, shift: Array) -> tuple[Array, Array]:
    positions = thing.particles[: len(thing.cloud)] @ gradient.T + shift
    return positions, np.broadcast_to(gradient, (len(thing.cloud), 3, 3))


@pytest.mark.parametrize("kind", ["rigid", "sheared"])
def test_an_even_motion_is_followed_exactly(thing: SceneObject, kind: str) -> None:
    rng = np.random.default_rng(0)
    gradient = Rotation.random(rng=rng).as_matrix()
    gradient = gradient if kind == "rigid" else gradient @ (np.eye(3) + 0.3 * rng.normal(size=(3, 3)))
    carried = carried_by(thing)
    assert carried is not None and thing.drawn is not None
    means, turned = carried.moved(*motion(thing, gradient, np.array([1.0, 2, 3])))
    np.testing.assert_allclose(means, thing.drawn.means @ gradient.T + [1, 2, 3], atol=2e-6)
    np.testing.assert_allclose(turned, np.broadcast_to(gradient, (len(thing.drawn), 3, 3)), atol=1e-6)


def test_without_a_gradient_they_are_shifted(thing: SceneObject) -> None:
    carried = carried_by(thing)
    assert carried is not None and thing.drawn is not None
    means, gradients = carried.moved(thing.particles[: len(thing.cloud)] + np.float32(2), None)
    np.testing.assert_allclose(means, thing.drawn.means + 2, atol=1e-6)
    assert gradients is None


def test_what_is_simulated_is_drawn_where_nothing_else_is(thing: SceneObject) -> None:
    assert carried_by(replace(thing, drawn=None)) is None


def test_placing_moves_both_alike(thing: SceneObject) -> None:
    assert thing.drawn is not None
    for cloud in (thing.cloud, thing.drawn):
        middle = (cloud.means.min(0) + cloud.means.max(0)) / 2
        np.testing.assert_allclose(middle, [0.2, 1.0, 0.2], atol=4e-3)


def test_few_are_all_drawn_as_they_are_simulated(tmp_path: Path) -> None:
    gaussians.write_ply(ball(0.5, [0, 0, 0], 0.05), tmp_path / "ball.ply")
    assert load_file(tmp_path / "ball.ply", 0.4, "+z", 0.03, 2000, max_drawn=20_000).drawn is None
