"""Cleaning: what belongs to the thing stays, what floats around it goes."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import cloud_of
from captures import CAPTURES, ball, box, dome, flat, haze, join

from hoi import gaussians
from hoi.data import GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import areas, fibonacci_sphere, select
from hoi.objects import cleaning


def shell(radius: float = 0.5, count: int = 4000) -> GaussianCloud:
    spacing = radius * (4 * np.pi / count) ** 0.5
    return cloud_of(radius * fibonacci_sphere(count), 0.4 * spacing)


def kept(cleaned: GaussianCloud, cloud: GaussianCloud) -> np.ndarray:
    """Which Gaussians of a cloud are among the cleaned ones."""
    there = {tuple(mean) for mean in cleaned.means.tolist()}
    return np.array([tuple(mean) in there for mean in cloud.means.tolist()])


@pytest.mark.parametrize("name", CAPTURES)
def test_a_capture_keeps_its_surface_and_loses_what_is_around_it(name: str) -> None:
    capture = CAPTURES[name]()
    cleaned, notes = cleaning.clean(capture.cloud)
    area = areas(capture.thing)
    assert area[kept(cleaned, capture.thing)].sum() >= 0.99 * area.sum()
    assert kept(cleaned, capture.around).mean() <= 0.05
    assert any("of the area" in note for note in notes)


@pytest.mark.parametrize("name", CAPTURES)
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_cleaning_knows_no_units(name: str, scale: float) -> None:
    cloud = CAPTURES[name]().cloud
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    moved = gaussians.transform(cloud, turn, scale, scale * np.array([3.0, -2, 1]))
    assert len(cleaning.clean(moved)[0]) == pytest.approx(len(cleaning.clean(cloud)[0]), rel=2e-3)


def test_haze_floaters_and_giants_go() -> None:
    ball_ = shell()
    rng = np.random.default_rng(0)
    faint = replace(gaussians.select(ball_, np.arange(300)), opacities=np.full(300, 0.01, np.float32))
    dust = gaussians.select(ball_, np.arange(40))
    dust = replace(dust, means=rng.uniform(-20, 20, (40, 3)).astype(np.float32))
    clump = gaussians.transform(gaussians.select(ball_, np.arange(60)), np.eye(3), 0.1, [2, 0, 0])
    giant = replace(ball_, scales=np.where(np.arange(len(ball_))[:, None] < 7, np.float32(3), ball_.scales))
    cloud, notes = cleaning.clean(join(giant, faint, dust, clump))
    np.testing.assert_array_equal(cloud.means, ball_.means)
    assert cloud.scales.max() <= 0.25
    assert [note.split(" Gaussians")[0] for note in notes] == ["removed 300", "removed 100 floating", "shrank 7"]


def test_a_clean_cloud_stays_as_it_is() -> None:
    for cloud in (shell(), cloud_of(fibonacci_sphere(3000), 1e-4), box([1, 2, 3], [0, 0, 0], 0.5)):
        cleaned, notes = cleaning.clean(cloud)
        np.testing.assert_array_equal(cleaned.means, cloud.means)
        np.testing.assert_array_equal(cleaned.scales, cloud.scales)
        assert notes == []


def test_large_flat_gaussians_keep_their_size() -> None:
    crate = box([1, 1, 1], [0, 0, 0], 1 / 6, jitter=0)
    np.testing.assert_array_equal(cleaning.clean(crate)[0].scales, crate.scales)


def test_a_translucent_thing_stays_and_its_haze_goes() -> None:
    thing = flat(fibonacci_sphere(4000), fibonacci_sphere(4000), 0.04, opacity=0.15)
    cleaned, _ = cleaning.clean(join(thing, dome(), replace(haze(2, 300), opacities=np.full(300, 0.08, np.float32))))
    assert kept(cleaned, thing).all() and len(cleaned) < len(thing) + 15


def test_padding_is_dropped_and_counted_and_clones_are_merged() -> None:
    thing = ball(1.0, [5, 4, 5], 0.05)
    padding = select(cloud_of(np.zeros((1, 3)), 1.0), np.zeros(3500, int))
    cleaned, notes = cleaning.clean(join(padding, thing))
    np.testing.assert_array_equal(cleaned.means, thing.means)
    assert notes == ["dropped 3500 Gaussians that repeat 1: padding"]
    cleaned, notes = cleaning.clean(join(thing, thing, thing))
    np.testing.assert_array_equal(cleaned.means, thing.means)
    np.testing.assert_allclose(cleaned.opacities, 1 - 0.1**3, rtol=1e-6)
    assert "clones" in notes[0]
    with pytest.raises(InputError, match="3500 Gaussians repeat 1"):
        cleaning.clean(padding)


def test_many_clones_do_not_make_the_rest_float() -> None:
    thing = ball(1.0, [0, 0, 0], 0.05)
    cloned = gaussians.select(thing, np.arange(len(thing) * 3 // 5))
    cleaned, _ = cleaning.clean(join(thing, cloned))
    np.testing.assert_array_equal(cleaned.means, thing.means)


def test_all_in_one_place_is_refused_for_that() -> None:
    ball_ = shell()
    with pytest.raises(InputError, match="in one place"):
        cleaning.clean(
            replace(ball_, means=np.zeros_like(ball_.means), opacities=np.linspace(0.2, 1, 4000, dtype="f4"))
        )


def test_a_thing_smoothed_until_it_is_see_through_keeps_its_fainter_half() -> None:
    """As Mip-Splatting's filter leaves thin Gaussians: all of one surface, some at 0.25 and some at 0.3."""
    points = fibonacci_sphere(3000)
    thing = flat(points, points, 0.03)
    upper = np.where(points[:, 2] > 0.4, 0.25, 0.3036).astype(np.float32)
    cleaned, notes = cleaning.clean(replace(thing, opacities=upper))
    assert len(cleaned) == 3000 and notes == []
