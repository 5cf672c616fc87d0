"""What a GPU does otherwise, run on a CPU; and films made of parts."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from hoi.render import rasterise as rasteriser
from hoi.render.rasterise import Settings, rasterise, render_frames
from hoi.render.splats import Splats, join
from tests.render_scenes import camera, random_splats, to


def leaves(splats: Splats) -> Splats:
    parts = (splats.means, splats.covariances, splats.opacities, splats.sh)
    return Splats(*(part.clone().requires_grad_() for part in parts), splats.turns)


@pytest.mark.parametrize("tile", [8, 16, 32])
def test_pixel_by_pixel_is_row_by_row(tile: int):
    """The same sums in the same order: pictures differ by rounding, gradients by the order of adding pixels."""
    pictures, gradients = [], []
    for by_pixel in (False, True):
        splats = leaves(to(random_splats(3, 400, 2), torch.float32))
        settings = Settings(by_pixel=by_pixel, tile=tile)
        picture = rasterise(splats, camera(50, 37), (0.1, 0.2, 0.3), depth=True, settings=settings)
        assert picture.depth is not None
        ramp = torch.linspace(-1, 1, 50)[None, :, None]
        ((picture.colour * ramp).sum() + picture.alpha.sum() + picture.depth.sum()).backward()
        pictures.append(picture)
        gradients.append([leaf.grad for leaf in (splats.means, splats.covariances, splats.opacities, splats.sh)])
    for name in ("colour", "alpha", "depth"):
        rows, pixels = (getattr(picture, name) for picture in pictures)
        assert torch.allclose(rows, pixels, atol=2e-6), name
    for by_row, by_pixel in zip(*gradients, strict=True):
        assert (by_row - by_pixel).norm() < 1e-5 * by_row.norm()


def test_both_sorts_fill_tiles_alike():
    flat = rasteriser._flat(to(random_splats(4, 500), torch.float32), camera(100, 70), None)
    tiles = rasteriser._sort(flat, camera(100, 70), Settings())
    order = torch.argsort(flat.splats[:, 10], stable=True)
    order = order[tiles.counts[order] > 0]
    other = rasteriser._tiles_by_sorting(flat.boxes, order, tiles.counts, tiles.first, 7, 5, 16)
    assert len(tiles.members) > 1000
    for name in ("columns", "ends", "members", "entries"):
        ours, theirs = getattr(tiles, name), getattr(other, name)
        assert np.array_equal(ours, theirs), name


def test_equal_depths_keep_their_order():
    depths = np.array([2.0, 1.0, 2.0, 1.0, 0.5], np.float32)
    assert rasteriser._front_to_back(depths).tolist() == [4, 1, 3, 0, 2]
    assert rasteriser._front_to_back(depths.astype(np.float64)).tolist() == [4, 1, 3, 0, 2]


def test_threads_do_not_change_a_picture():
    splats = to(random_splats(5, 300), torch.float32)
    threads = torch.get_num_threads()
    try:
        pictures = []
        for count in (1, 2):
            torch.set_num_threads(count)
            pictures.append(rasterise(splats, camera(64, 48)).colour)
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(*pictures)


def test_what_stands_still_is_projected_once(monkeypatch: pytest.MonkeyPatch):
    person = [to(random_splats(seed, 50), torch.float32) for seed in (1, 2, 3)]
    thing = to(random_splats(9, 40), torch.float32)
    projected = []
    flat = rasteriser._flat
    monkeypatch.setattr(rasteriser, "_flat", lambda part, *rest: projected.append(part) or flat(part, *rest))
    first, second = camera(40, 30), camera(40, 30)

    film = list(render_frames([(part, thing) for part in person], first))
    assert [part is thing for part in projected] == [False, True, False, False]
    for picture, part in zip(film, person, strict=True):
        assert torch.equal(picture.colour, rasterise(join([part, thing]), first).colour)

    projected.clear()
    list(render_frames([(thing,), (thing,)], [first, second]))
    assert len(projected) == 2  # another camera sees another picture


def test_each_frame_may_have_its_own_camera_and_background():
    thing = to(random_splats(9, 40), torch.float32)

    def backgrounds() -> Iterator[torch.Tensor]:
        for shade in (0.1, 0.9):
            yield torch.full((30, 40, 3), shade)

    film = list(render_frames([(thing,), (thing,)], [camera(40, 30), camera(40, 30)], backgrounds()))
    for picture, shade in zip(film, (0.1, 0.9), strict=True):
        assert torch.equal(picture.colour, rasterise(thing, camera(40, 30), (shade,) * 3).colour)
