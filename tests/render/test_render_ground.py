"""The floor tells metres and fades, shadows lie below what casts them, soften with the height and never jump."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from bodies import splats_of

from hoi.gaussians import fibonacci_sphere
from hoi.render import ground
from hoi.render.cameras import look_at, project
from hoi.render.ground import FLOOR, HORIZON, LINE, Backdrop, cast
from hoi.render.splats import Splats

BALL = 0.11


def ball(centre, radius=BALL, count=600, opacity=0.9, scale=0.008):
    return splats_of(fibonacci_sphere(count) * radius + np.array(centre), scale, opacity=opacity)


@pytest.fixture(scope="module")
def above():
    """Straight down, 100 pixels a metre, the origin in the middle."""
    return look_at((0, 0, 4), (0, 0, 0), width=300, height=200, fov_y=2 * math.atan(0.25), up=(0, 1, 0))


def darkness(camera, *parts):
    backdrop = Backdrop(camera)
    return (backdrop([]) - backdrop([shadow for part in parts for shadow in cast(part)]))[..., 0]


def centre_of(image):
    rows, columns = torch.meshgrid(*(torch.arange(n) + 0.5 for n in image.shape), indexing="ij")
    return float((image * columns).sum() / image.sum()), float((image * rows).sum() / image.sum())


def width_of(image):
    """Standard deviation across the columns [pixel]."""
    columns, weight = torch.arange(image.shape[1]) + 0.5, image.sum(0)
    mean = (weight * columns).sum() / weight.sum()
    return float(((weight * (columns - mean) ** 2).sum() / weight.sum()).sqrt())


def test_lines_lie_at_whole_metres(above):
    grey = Backdrop(above)([])[..., 0]
    row = grey[150]  # y = -0.5 m: between lines
    for metre in (-1, 0, 1):
        column, _ = project(above, np.array([metre, -0.5, 0.0]))[0]
        assert float(row[round(column) - 1 : round(column) + 1].mean()) == pytest.approx(LINE, abs=0.02)
    assert float(row[175:225].min()) == pytest.approx(FLOOR, abs=1e-3)
    # What the lines take away is their share of the area, whatever the footprint of a pixel.
    coarse = look_at((0, 0, 4), (0, 0, 0), width=30, height=20, fov_y=2 * math.atan(0.25), up=(0, 1, 0))
    assert float(Backdrop(coarse)([]).mean()) == pytest.approx(float(grey.mean()), abs=3e-4)


def test_the_floor_fades_into_the_horizon():
    camera = look_at((0, -6, 1.5), (0, 0, 1.5), width=64, height=240)
    column = Backdrop(camera)([])[:, 20, 0]
    assert float(column[:120].min()) >= HORIZON - 1e-3 and (column[:120].diff() <= 1e-6).all()  # lighter upwards
    assert float(column[121:140].min()) > FLOOR + 0.01 and float(column[-1]) == pytest.approx(FLOOR, abs=0.01)
    assert float(column.diff().abs().max()) < 0.03  # no edge at the horizon


def test_far_lines_do_not_flicker():
    """Seen from afar the grid is an even tone: moving the camera by half a cell changes next to nothing."""
    grey = [Backdrop(look_at((x, -40, 8), (x, 0, 0), width=96, height=64))([])[:24] for x in (0.0, 0.5)]
    assert float((grey[0] - grey[1]).abs().max()) < 0.005


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.73, -0.31), (-0.6, 0.12)])
@pytest.mark.parametrize("height", [0.11, 0.6, 1.7])
def test_a_shadow_lies_straight_below(above, place, height):
    image = darkness(above, ball((*place, height)))
    wanted, _ = project(above, np.array([*place, 0.0]))
    np.testing.assert_allclose(centre_of(image), wanted, atol=1.0)


def test_shadows_tell_heights(above):
    heights = [BALL, 0.25, 0.6, 1.0, 1.5, 2.2]
    images = [darkness(above, ball((0, 0, height))) for height in heights]
    peaks, widths = [float(image.max()) for image in images], [width_of(image) for image in images]
    assert all(a > b for a, b in pairwise(peaks[1:])) and peaks[-1] > 0.05
    assert peaks[0] > 0.85 * peaks[1] > 0.35
    assert all(a < b for a, b in pairwise(widths))
    # At 1 m the edge is as soft as the light is large: the disc's own spread is radius / 2.
    assert widths[3] / 100 == pytest.approx(math.hypot(BALL / 2, ground.SOFTNESS), rel=0.2)


def test_a_rising_ball_casts_no_jump(above):
    """From layer to layer the shadow changes as steadily as the height does."""
    images = [darkness(above, ball((0.004 * step, 0, BALL + 0.02 * step))) for step in range(60)]
    steps = [float((a - b).abs().max()) for a, b in pairwise(images)]
    assert max(steps) < 0.05 and max(steps[10:]) < 0.035


def test_the_amount_does_not_hang_on_the_number_of_gaussians(above, monkeypatch):
    few, many = darkness(above, ball((0.2, 0, 0.3))), darkness(above, ball((0.2, 0, 0.3), count=5000))
    assert float((few - many).abs().max()) < 0.06
    monkeypatch.setattr(ground, "_CASTERS", 1250)
    fourth = darkness(above, ball((0.2, 0, 0.3), count=5000, scale=0.004))
    monkeypatch.undo()
    every = darkness(above, ball((0.2, 0, 0.3), count=5000, scale=0.004))
    assert 0 < float((fourth - every).abs().max()) < 0.06


def test_what_casts_no_shadow(above):
    assert cast(ball((0, 0, -1))) == ()
    assert cast(ball((0, 0, 1), opacity=0.0)) == ()
    assert cast(Splats(torch.zeros(0, 3), torch.zeros(0, 3, 3), torch.zeros(0), torch.zeros(0, 1, 3))) == ()
    sky = Backdrop(above, floor=False)
    assert torch.equal(sky([]), sky(cast(ball((0, 0, 0.2)))))
    assert float((Backdrop(above)([]) - sky([])).abs().max()) > 0.02


def test_strange_gaussians_leave_a_picture(above):
    part = ball((0, 0, 0.3))
    part.means[0], part.means[1], part.means[2, 0] = math.nan, math.inf, 1e30
    part.means[3, 0] = 300.0
    sigma = part.covariances.clone()
    sigma[4], sigma[5], sigma[6] = 0.0, math.inf, 1e12 * torch.eye(3)
    image = darkness(above, Splats(part.means, sigma, part.opacities, part.sh))
    assert image.isfinite().all() and float((image - darkness(above, ball((0, 0, 0.3)))).abs().max()) < 0.1


@pytest.mark.parametrize(
    "eye, target",
    [((0, -2, 0), (0, 0, 0.5)), ((0, -2, -1), (0, 0, 0)), ((0.1, 0, 0.3), (0, 0, 0)), ((0, 0, 5), (0, 0, 9))],
)
def test_any_camera_has_a_background(eye, target):
    backdrop = Backdrop(look_at(eye, target, width=33, height=17))
    picture = backdrop(cast(ball((0, 0, 0.2))))
    assert picture.shape == (17, 33, 3) and picture.isfinite().all() and 0 <= picture.min() and picture.max() <= 1


def test_a_shadow_is_not_left_behind(above):
    backdrop = Backdrop(above)
    before = backdrop([]).clone()
    backdrop(cast(ball((0, 0, 0.11))))
    assert torch.equal(backdrop([]), before)
