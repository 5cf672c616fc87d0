"""Fewer Gaussians: evenly over what is seen, with the look of all of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import cloud_of
from captures import ball, flat, join
from scipy.spatial import KDTree

import hoi
from hoi.body.people import load_person
from hoi.data import Array, GaussianCloud
from hoi.gaussians import areas, colours, fibonacci_sphere, load_clean, rotation_matrices, select, transform
from hoi.objects.load import UP
from hoi.objects.thinning import sample, thin
from hoi.render.cameras import VIEWS, frame_action


def likeness(cloud: GaussianCloud, other: GaussianCloud) -> float:
    """PSNR of the pictures of both, over what the first covers [dB]."""

    def picture(each: GaussianCloud) -> Array:
        return hoi.render(each, frame_action(cloud.means, VIEWS["three_quarter"], width=400, height=600))

    shown, there = picture(cloud), picture(other)
    return float(-10 * np.log10(((shown - there)[shown.min(2) < 0.97] ** 2).mean()))


def quartered(cloud: GaussianCloud) -> GaussianCloud:
    """The same picture of four times as many: each Gaussian as four of half the size."""
    turns, steps = rotation_matrices(cloud), np.sort(cloud.scales, axis=1)[:, 1:].mean(1) / 2
    order = np.argsort(-cloud.scales, axis=1)
    rows = np.arange(len(cloud))
    first, second = turns[rows, :, order[:, 0]], turns[rows, :, order[:, 1]]
    parts = [
        replace(cloud, means=(cloud.means + steps[:, None] * (a * first + b * second)).astype(np.float32),
                scales=(cloud.scales * np.array([0.6])).astype(np.float32))
        for a in (-1, 1) for b in (-1, 1)
    ]  # fmt: skip
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(cloud)}
    return GaussianCloud(**columns)


def test_a_figure_of_130000_stays_itself_at_20000() -> None:
    man = transform(load_person("man").cloud, UP["+y"])
    figure = quartered(man)
    thinned, notes = thin(figure, 20_000)
    assert 19_000 <= len(thinned) <= 20_000 and str(len(figure)) in notes[0]
    assert likeness(figure, thinned) > 28


def test_a_capture_stays_itself(shared_objects: Path) -> None:
    plant = load_clean(shared_objects / "plant.splat")[0]
    thinned, _ = thin(plant, 20_000)
    assert likeness(plant, thinned) > 23
    assert likeness(plant, thinned) > likeness(plant, sample(plant, 20_000)[0]) + 5


def test_no_long_axis_grows_beyond_the_gap() -> None:
    points = fibonacci_sphere(20_000)
    needles = flat(points, points, 0.002)
    needles.scales[:, 0] = 0.05
    thinned, _ = thin(needles, 2_000)
    gap = KDTree(thinned.means).query(thinned.means, 5)[0][:, 1:].mean(1)
    assert (thinned.scales.max(1) <= np.maximum(gap, 0.05) * 1.001).all()
    small, _ = thin(cloud_of(points, 1e-4), 2_000)
    gap = KDTree(small.means).query(small.means, 5)[0][:, 1:].mean(1)
    assert (small.scales.max(1) <= gap * 1.001).all()


def test_what_is_seen_decides_who_stays() -> None:
    coarse, fine = ball(0.5, [0, 0, 0], 0.05), ball(0.05, [0.6, 0, 0], 0.0008)
    faint = replace(ball(0.5, [0, 0, 2], 0.02), opacities=np.full(7853, 0.06, np.float32))
    thinned, _ = thin(join(coarse, fine, faint), 2_000)
    near = KDTree(thinned.means).query(coarse.means)[0]
    assert near.max() < 0.05  # each of the few that make up the large ball is still there, or its like
    there = (np.abs(thinned.means[:, 2]) > 1).sum()
    assert there < 0.4 * len(thinned)


def test_shown_area_colours_and_place_are_kept() -> None:
    thing = ball(0.5, [0, 0, 0], 0.01, rgb=[0.9, 0.2, 0.1])
    thinned, _ = thin(thing, 3_000)
    assert areas(thinned).sum() == pytest.approx(areas(thing).sum(), rel=0.2)
    np.testing.assert_allclose(colours(thinned), colours(thing)[: len(thinned)], atol=1e-3)
    assert np.linalg.norm(thinned.means, axis=1) == pytest.approx(0.5, rel=0.01)
    nearest = KDTree(thinned.means).query(thinned.means, 2)[0][:, 1]
    assert np.percentile(nearest, 5) > 0.3 * np.median(nearest)  # even, no clumps


def test_little_is_thinned_by_nothing_and_the_same_seed_gives_the_same() -> None:
    thing = ball(0.5, [0, 0, 0], 0.05)
    assert thin(thing, len(thing)) == (thing, [])
    first, again = thin(thing, 300)[0], thin(thing, 300)[0]
    np.testing.assert_array_equal(first.means, again.means)
    assert len(thin(select(thing, np.arange(50)), 1)[0]) == 1
