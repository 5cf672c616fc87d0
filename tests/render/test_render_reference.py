"""The judge of the rasterisers against numbers worked out by hand, and its gradients against finite differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from render_scenes import INPUTS, balls, camera, random_splats, straight, weighed

from hoi.gaussians import rotate_sh, sh_basis
from hoi.render.cameras import project
from hoi.render.reference import rasterise_reference
from hoi.render.splats import Splats, covariances, join, shade

WHITE = (1.0, 1.0, 1.0)
BLACK = (0.0, 0.0, 0.0)


def test_a_ball_on_the_axis():
    picture = rasterise_reference(balls([[0, 0, 2]], 0.1, 0.8, [[1, 0.5, 0]]), straight(), (0, 0, 1), depth=True)
    variance = (40 * 0.1 / 2) ** 2 + 0.3
    for row, column in ((12, 16), (11, 15), (9, 20), (17, 14)):
        squared = (column + 0.5 - 16) ** 2 + (row + 0.5 - 12) ** 2
        alpha = 0.8 * math.exp(-squared / (2 * variance))
        assert alpha > 1 / 255
        assert picture.colour[row, column].tolist() == pytest.approx([alpha, alpha / 2, 1 - alpha], abs=1e-12)
        assert picture.alpha[row, column].item() == pytest.approx(alpha, abs=1e-12)
        assert picture.depth is not None
        assert picture.depth[row, column].item() == pytest.approx(2 * alpha, abs=1e-12)


def test_it_ends_where_it_is_weaker_than_a_255th():
    picture = rasterise_reference(balls([[0, 0, 2]], 0.1, 0.8), straight(), WHITE)
    radius = math.sqrt(2 * 4.3 * math.log(0.8 * 255))
    rows, columns = np.mgrid[:24, :32]
    inside = np.hypot(columns + 0.5 - 16, rows + 0.5 - 12) < radius
    assert 20 < inside.sum() < inside.size
    assert np.array_equal(picture.alpha.numpy() > 0, inside)
    assert picture.alpha[picture.alpha > 0].min() >= 1 / 255


def test_an_ellipsoid_off_the_axis():
    """Its spread is the projection's derivative, here by finite differences, about its centre."""
    splats, view = replace_means(random_splats(4, 1, size=0.3), [[0.2, 0.1, -0.1]]), camera()
    mean, step = splats.means[0].numpy(), 1e-6
    jacobian = np.stack(
        [(project(view, mean + e)[0] - project(view, mean - e)[0]) / (2 * step) for e in np.eye(3) * step], 1
    )
    inverse = np.linalg.inv(jacobian @ splats.covariances[0].numpy() @ jacobian.T + 0.3 * np.eye(2))
    rows, columns = np.mgrid[: view.height, : view.width] + 0.5
    offsets = np.stack([columns, rows], -1) - project(view, mean)[0]
    alpha = splats.opacities.item() * np.exp(-0.5 * np.einsum("hwi,ij,hwj->hw", offsets, inverse, offsets))
    alpha[alpha < 1 / 255] = 0
    assert (alpha > 0).sum() > 100
    assert rasterise_reference(splats, view).alpha.numpy() == pytest.approx(alpha, abs=1e-7)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_of_two_covers_the_other(order: tuple[int, int]):
    both = balls([[0, 0, 2], [0.02, 0, 3]], [0.1, 0.3], [0.6, 0.7], [[1, 0, 0], [0, 1, 0]])
    splats = join([Splats(*(getattr(both, name)[i : i + 1] for name in INPUTS[:-1])) for i in order])
    picture = rasterise_reference(splats, straight(), (0, 0, 1), depth=True)
    near, far = (rasterise_reference(part, straight()).alpha for part in (select(both, 0), select(both, 1)))
    expected = torch.stack([near, (1 - near) * far, (1 - near) * (1 - far)], dim=-1)
    assert torch.allclose(picture.colour, expected, atol=1e-12)
    assert torch.allclose(picture.alpha, 1 - (1 - near) * (1 - far), atol=1e-12)
    assert picture.depth is not None
    assert torch.allclose(picture.depth, 2 * near + 3 * (1 - near) * far, atol=1e-12)


def test_of_two_as_near_the_first_is_in_front():
    splats = balls([[0, 0, 2], [0, 0, 2]], 0.2, 0.5, [[1, 0, 0], [0, 1, 0]])
    colour = rasterise_reference(splats, straight(width=1, height=1), BLACK).colour[0, 0]
    assert colour.tolist() == pytest.approx([0.5, 0.25, 0])


def pixel(opacities: list[float], colours: list) -> list[float]:
    """One pixel with large Gaussians right behind each other on it, over black."""
    splats = balls([[0, 0, 1 + 0.1 * i] for i in range(len(opacities))], 100.0, opacities, colours)
    return rasterise_reference(splats, straight(width=1, height=1), BLACK).colour[0, 0].tolist()


def test_an_opaque_gaussian_lets_a_thousandth_through():
    assert pixel([1.0], [[1, 0, 0]]) == pytest.approx([0.999, 0, 0], abs=1e-9)
    assert pixel([1.0, 0.5], [[1, 0, 0], [0, 1, 0]]) == pytest.approx([0.999, 0.0005, 0], abs=1e-9)


def test_a_pixel_ends_before_what_would_fill_it():
    """The transmittances would be 1e-1, 1e-2, 5e-5 and 4e-5: the third is left out, and all behind it."""
    colours = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]]
    assert pixel([0.9, 0.9, 0.995, 0.2], colours) == pytest.approx([0.9, 0.09, 0], abs=1e-6)
    assert pixel([0.9, 0.9, 0.98, 0.2], colours) == pytest.approx([0.9, 0.09, 0.01 * 0.98 + 0.0002 * 0.2], abs=1e-6)


def test_what_is_nearer_than_the_near_plane_is_not_drawn():
    view = straight()
    for z, drawn in ((0.0099, False), (0.0101, True), (0.0, False), (-1.0, False)):
        picture = rasterise_reference(balls([[0, 0, z]], 1e-3, 0.9), view, WHITE)
        assert bool((picture.alpha > 0).any()) == drawn
    assert rasterise_reference(balls([[0, 0, 1]], 0.1, 0.9), replace(view, near=1.5)).alpha.max() == 0


@pytest.mark.parametrize(("axis", "sign"), [(0, -1), (0, 1), (1, -1), (1, 1)])
def test_beside_the_picture_the_jacobian_is_held(axis: int, sign: int):
    """Far out at x / z = 3, it is that of the picture's edge and 0.3 of half the picture."""
    view = replace(straight(), cx=14.0, cy=15.0)
    size, principal = ((32, 14.0), (24, 15.0))[axis]
    edge = (size - principal if sign > 0 else principal) / 40
    slope = sign * (edge + 0.3 * size / 2 / 40)
    mean = [0.0, 0.0, 1.0]
    mean[axis] = sign * 3.0
    picture = rasterise_reference(balls([mean], 1.0, 0.9), view)
    variance = 40**2 * (1 + slope**2) + 0.3
    nearest = [15, 14]  # row and column of a pixel at the edge
    nearest[1 - axis] = size - 1 if sign > 0 else 0
    row, column = nearest
    offset = np.array([column + 0.5 - 14, row + 0.5 - 15]) - 40 * np.array(mean[:2])
    across = offset[1 - axis] ** 2 / (40**2 + 0.3)
    expected = 0.9 * math.exp(-0.5 * (offset[axis] ** 2 / variance + across))
    assert expected > 1 / 255
    assert picture.alpha[row, column].item() == pytest.approx(expected, abs=1e-12)


def test_no_gaussian_is_the_background():
    background = torch.rand(24, 32, 3, generator=torch.Generator().manual_seed(0))
    picture = rasterise_reference(balls([], 0.1, 0.5), straight(), background)
    assert torch.equal(picture.colour, background.double())
    assert picture.alpha.max() == 0
    assert picture.depth is None


def test_the_background_shows_by_what_is_left():
    splats, view = random_splats(0, 40), camera(20, 10)
    over = torch.rand(10, 20, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    bare, full = rasterise_reference(splats, view, BLACK), rasterise_reference(splats, view, over)
    assert torch.allclose(full.colour, bare.colour + (1 - bare.alpha[..., None]) * over, atol=1e-12)
    assert torch.equal(full.alpha, bare.alpha)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colours_are_the_clouds_harmonics(degree: int):
    splats, eye = random_splats(degree, 50, degree=3), torch.tensor([0.4, -2.0, 1.0], dtype=torch.float64)
    directions = torch.nn.functional.normalize(splats.means - eye, dim=-1).numpy()
    used = splats.sh[:, : (degree + 1) ** 2].numpy()
    expected = np.maximum(0.5 + np.einsum("nk,nkc->nc", sh_basis(directions, degree), used), 0)
    assert shade(splats, eye, degree).numpy() == pytest.approx(expected, abs=1e-12)


def test_colours_turn_with_their_gaussians():
    splats, eye = random_splats(1, 50, degree=3, turned=True), torch.zeros(3, dtype=torch.float64)
    assert splats.turns is not None
    rotated = torch.from_numpy(rotate_sh(splats.sh.numpy(), splats.turns.numpy()))
    still = replace(splats, sh=rotated, turns=None)
    assert torch.allclose(shade(splats, eye), shade(still, eye), atol=1e-9)
    assert not torch.allclose(shade(splats, eye), shade(replace(splats, turns=None), eye), atol=1e-2)


def test_colours_are_not_below_black():
    dark = replace(balls([[0, 0, 1]], 0.1, 0.5), sh=torch.full((1, 1, 3), -4.0, dtype=torch.float64))
    assert shade(dark, torch.zeros(3, dtype=torch.float64)).tolist() == [[0.0, 0.0, 0.0]]


def test_covariances_of_quaternions_of_any_length():
    """A quarter turn about z, wxyz, takes the first axis to the second."""
    quaternion, scales = torch.tensor([[3.0, 0.0, 0.0, 3.0]]), torch.tensor([[1.0, 2.0, 4.0]])
    assert torch.allclose(covariances(quaternion, scales)[0], torch.diag(torch.tensor([4.0, 1.0, 16.0])), atol=1e-5)


def select(splats: Splats, row: int) -> Splats:
    return Splats(*(getattr(splats, name)[row : row + 1] for name in INPUTS[:-1]))


def replace_means(splats: Splats, means: list) -> Splats:
    return replace(splats, means=torch.tensor(means, dtype=torch.float64))


# --- gradients -------------------------------------------------------------------------------------------------------
# Cut-offs, and changes of order in depth, are steps: no gradient flows through them, but a finite difference across one
# sees the whole step.


def differentiable(splats: Splats, view, background: torch.Tensor) -> None:
    """Autograd against central differences of 1e-6, entry by entry, of all inputs."""

    def loss(*inputs: torch.Tensor) -> torch.Tensor:
        *parts, behind = inputs
        return weighed(rasterise_reference(Splats(*parts), view, behind, depth=True))

    inputs = [getattr(splats, name) for name in INPUTS if getattr(splats, name) is not None] + [background]
    assert torch.autograd.gradcheck(loss, [x.clone().requires_grad_() for x in inputs], eps=1e-6, atol=1e-6, rtol=1e-4)


def test_gradients_without_any_cut_off():
    """Gaussians so large and faint that each shows in every pixel and none fills one: the picture is smooth."""
    splats, view = random_splats(3, 5, degree=2, spread=0.2, size=0.1, turned=True), camera(10, 7)
    scaled = replace(
        splats, covariances=splats.covariances + 0.6 * torch.eye(3), opacities=0.2 + 0.5 * splats.opacities
    )
    alone = torch.stack([rasterise_reference(select(scaled, i), view).alpha for i in range(5)])
    assert alone.min() > 1.5 / 255
    assert alone.max() < 0.9
    assert rasterise_reference(scaled, view).alpha.max() < 1 - 1e-3
    differentiable(scaled, view, torch.rand(3, generator=torch.Generator().manual_seed(0), dtype=torch.float64))


def test_gradients_beside_cut_offs():
    """Small and opaque Gaussians, ends and full pixels among them. A difference of 1e-6 seldom crosses a cut-off; one
    that does is off by 1 / 255 / 2e-6, so that a passing seed has none."""
    splats, view = random_splats(5, 12, degree=1, spread=0.25, size=0.15), camera(12, 9)
    opaque = replace(splats, opacities=0.9 + 0.1 * splats.opacities)
    full = rasterise_reference(opaque, view).alpha
    assert full.min() == 0
    assert full.max() > 0.995
    behind = torch.rand(9, 12, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    differentiable(opaque, view, behind)


def test_gradients_of_the_held_jacobian():
    splats = replace_means(random_splats(6, 3, size=0.5), [[1.6, 0.1, 1.0], [0.1, -1.5, 1.1], [-1.5, 1.4, 1.2]])
    wide = replace(splats, covariances=splats.covariances * 4)
    assert rasterise_reference(wide, straight(8, 6, focal=8)).alpha.max() > 0.05
    differentiable(wide, straight(8, 6, focal=8), torch.zeros(3, dtype=torch.float64))


def test_what_a_cut_off_hides_has_no_gradient():
    means = torch.tensor([[0, 0, 0.005], [0, 0, 2.0], [50.0, 0, 2.0]], dtype=torch.float64).requires_grad_()
    splats = replace(balls([[0, 0, 1]] * 3, 0.01, 0.9), means=means)
    weighed(rasterise_reference(splats, straight())).backward()
    assert means.grad is not None
    assert means.grad[0].abs().max() == 0
    assert means.grad[1].abs().max() > 0
    assert means.grad[2].abs().max() == 0
