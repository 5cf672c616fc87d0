"""The rasterisers' pictures against the reference's."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from render_scenes import balls, camera, random_splats, straight, to
from torch import Tensor

from hoi.errors import InputError
from hoi.gaussians import load_clean, select
from hoi.render.cameras import Camera, look_at
from hoi.render.rasterise import Backend, Settings, rasterise, render_frames
from hoi.render.reference import rasterise_reference
from hoi.render.splats import Picture, Splats, covariances, from_cloud, join

STEP = 1 / 255
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat wants a CUDA device")
BACKENDS = ["taichi", pytest.param("gsplat", marks=GPU)]
COLOURED = (0.2, 0.5, 0.9)


def compare(
    splats: Splats,
    view: Camera,
    background: Tensor | Sequence[float] = COLOURED,
    *,
    sh_degree: int | None = None,
    backend: Backend = "taichi",
) -> Picture:
    """Both pictures of the same float32 numbers; they may differ by less than a step of 8 bits. Returns the judge's."""
    given = to(splats, torch.float32)
    expected = rasterise_reference(given, view, background, depth=True, sh_degree=sh_degree)
    made = rasterise(given, view, background, depth=True, sh_degree=sh_degree, backend=backend)
    assert made.colour.shape == (view.height, view.width, 3)
    assert made.colour.dtype == torch.float32
    assert (made.colour - expected.colour).abs().max() < STEP
    assert (made.alpha - expected.alpha).abs().max() < STEP
    assert made.depth is not None
    assert expected.depth is not None
    assert (made.depth - expected.depth).abs().max() < STEP * max(1.0, expected.depth.max().item())
    # A cut-off may fall to the other side by rounding, but hardly ever.
    assert ((made.colour - expected.colour).abs() > 1e-3).double().mean() < 2e-3
    assert (made.colour - expected.colour).abs().mean() < 5e-5
    return expected


# --- clouds ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("seed", "degree"), [(0, 0), (1, 1), (2, 2), (3, 3)])
def test_random_clouds(seed: int, degree: int, backend: Backend):
    expected = compare(random_splats(seed, 800, degree, turned=seed % 2 == 1), camera(), backend=backend)
    assert expected.alpha.max() > 0.9
    assert expected.alpha.min() == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_dense_cloud_of_opaque_gaussians(backend: Backend):
    splats = random_splats(4, 2000, spread=0.3)
    expected = compare(replace(splats, opacities=0.5 + 0.5 * splats.opacities), camera(), backend=backend)
    assert (expected.alpha > 0.999).double().mean() > 0.1


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_harmonics_can_be_left_out(degree: int):
    splats = random_splats(5, 200, degree=3)
    compare(splats, camera(), sh_degree=degree)
    fewer, all_of_them = (rasterise(to(splats, torch.float32), camera(), sh_degree=d) for d in (degree, None))
    assert (fewer.colour - all_of_them.colour).abs().max() > STEP


def test_parts_of_different_harmonics_join():
    compare(join([random_splats(0, 100, 2, turned=True), random_splats(1, 100, 0)]), camera())


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (40, 1), (15, 17), (16, 16), (33, 31), (97, 50)])
def test_pictures_of_any_size(width: int, height: int):
    assert compare(random_splats(6, 400), camera(width, height)).alpha.max() > 0.1


def test_a_picture_as_background():
    view = camera(50, 35)
    compare(random_splats(7, 200), view, torch.rand(35, 50, 3, generator=torch.Generator().manual_seed(0)))


def test_colours_above_white_are_not_clipped():
    bright = balls([[0, 0, 1]], 0.2, 0.9, [[3.0, 1.5, 0.2]])
    assert compare(bright, straight()).colour.max() > 2


def test_the_same_numbers_give_the_same_picture():
    splats = to(random_splats(8, 500, 1), torch.float32)
    first, second = (rasterise(splats, camera(), COLOURED, depth=True) for _ in range(2))
    assert torch.equal(first.colour, second.colour)
    assert torch.equal(first.alpha, second.alpha)


def test_in_float64_only_rounding_is_left():
    splats = random_splats(9, 300, 2, turned=True)
    made = rasterise(splats, camera(), COLOURED)
    expected = rasterise_reference(splats, camera(), COLOURED)
    assert made.colour.dtype == torch.float64
    assert made.depth is None
    assert (made.colour - expected.colour).abs().max() < 1e-11
    assert (made.alpha - expected.alpha).abs().max() < 1e-11


@pytest.mark.parametrize(
    "settings",
    [Settings(by_pixel=True), Settings(by_pixel=False), Settings(tile=8), Settings(tile=32), Settings(exact=True)],
    ids=["by pixel", "by row", "small tiles", "large tiles", "exact"],
)
def test_the_ways_to_blend_agree(settings: Settings):
    splats = random_splats(9, 600, 1)
    dense = to(replace(splats, opacities=0.5 + 0.5 * splats.opacities), torch.float32)
    usual, other = rasterise(dense, camera(), depth=True), rasterise(dense, camera(), depth=True, settings=settings)
    assert (usual.colour - other.colour).abs().mean() < 1e-5
    assert (usual.colour - other.colour).abs().max() < STEP
    assert (usual.alpha - other.alpha).abs().max() < STEP
    assert usual.depth is not None
    assert other.depth is not None
    assert (usual.depth - other.depth).abs().max() < 2 * STEP


def test_threads_change_nothing():
    splats, threads = to(random_splats(9, 600, 1), torch.float32), torch.get_num_threads()
    try:
        pictures = [(torch.set_num_threads(count), rasterise(splats, camera()))[1] for count in (1, 3)]
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(pictures[0].colour, pictures[1].colour)


def test_the_order_of_the_rows_does_not_matter():
    splats = to(random_splats(10, 500), torch.float32)
    order = torch.randperm(500, generator=torch.Generator().manual_seed(0))
    other = Splats(splats.means[order], splats.covariances[order], splats.opacities[order], splats.sh[order])
    one, two = rasterise(splats, camera()), rasterise(other, camera())
    assert (one.colour - two.colour).abs().max() < 1e-5


def test_of_two_as_near_the_first_is_in_front():
    rgb = np.random.default_rng(0).random((40, 3)).tolist()
    compare(balls([[0.01 * i, 0, 2.0] for i in range(40)], 0.2, 0.5, rgb), straight())


@pytest.mark.parametrize("size", [0.002, 0.02, 0.2])
def test_antialiased_as_the_reference(size: float):
    splats = random_splats(12, 800, 1, size=size, turned=True)
    made = rasterise(splats, camera(), COLOURED, settings=Settings(antialiased=True))
    expected = rasterise_reference(splats, camera(), COLOURED, antialiased=True)
    assert (made.colour - expected.colour).abs().max() < 1e-9


@pytest.mark.parametrize("pixels", [0.3, 0.6, 1.5, 2.5])
def test_antialiased_gaussians_cover_as_much_as_they_are_large(pixels: float):
    """The integral of o exp(-d^2 / 2) is 2 pi s^2 o, however small s is; without the filter it is too much by far."""
    view, faint = straight(), 0.2
    settings = Settings(antialiased=True, least_alpha=1e-9)
    area = 2 * np.pi * pixels**2 * faint

    def seen(right: float, down: float, settings: Settings) -> float:
        ball = balls([[right / view.fx, down / view.fx, 1.0]], pixels / view.fx, faint)
        return rasterise(ball, view, settings=settings).alpha.sum().item()

    quarters = np.arange(4) / 4  # of a pixel: wherever it lies between the pixels' middles
    assert np.mean([seen(x, y, settings) for x in quarters for y in quarters]) == pytest.approx(area, rel=2e-3)
    assert seen(0.0, 0.0, settings) == pytest.approx(area, rel=0.11 if pixels < 0.5 else 0.01)
    if pixels < 1:
        assert seen(0.0, 0.0, replace(settings, antialiased=False)) > 1.6 * area


# --- where the camera stands -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_inside_the_cloud(seed: int):
    """Gaussians ahead, beside, behind, and at the camera, within the near plane or just beyond it."""
    splats = random_splats(seed, 600, 1, spread=0.4, size=0.05)
    view = look_at((0.03, 0.02, 0.01), (1.0, 0.5, 0.1), width=64, height=48, fov_y=1.2)
    assert compare(splats, view).alpha.mean() > 0.3


def test_around_the_near_plane():
    """A row of Gaussians through the camera, a tenth of a millimetre apart."""
    means = [[0.002 * np.sin(i), 0.002 * np.cos(i), 0.0097 + 0.0001 * i] for i in range(40)]
    rgb = np.random.default_rng(1).random((40, 3)).tolist()
    assert compare(balls(means, 0.0005, 0.3, rgb), straight()).alpha.max() > 0.3


def test_a_near_plane_of_its_own():
    view = replace(straight(), near=2.0)
    expected = compare(balls([[0, 0, 1.9], [0.2, 0, 2.1]], 0.1, 0.9, [[1, 0, 0], [0, 1, 0]]), view)
    assert expected.colour[12, 20, 1] > 0.8
    assert expected.colour[12, 20, 0] < 0.1


def test_nothing_in_sight():
    behind = balls([[0, 0, -1], [0, 0, -2]], 0.3, 0.9)
    beside = balls([[5, 0, 1], [-5, 0, 1], [0, 5, 1], [0, -5, 1]], 0.05, 0.9)
    for splats in (behind, beside, balls([], 0.1, 0.5)):
        expected = compare(splats, straight())
        assert expected.alpha.max() == 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_gaussians(backend: Backend):
    background = torch.rand(24, 32, 3, generator=torch.Generator().manual_seed(0))
    empty = to(balls([], 0.1, 0.5), torch.float32)
    made = rasterise(empty, straight(), background, depth=True, backend=backend)
    assert torch.equal(made.colour, background)
    assert made.alpha.abs().max() == 0
    assert made.depth is not None
    assert made.depth.abs().max() == 0


def test_beside_the_picture_but_reaching_into_it():
    generator = torch.Generator().manual_seed(0)
    angle = 2 * np.pi * torch.rand(60, generator=generator, dtype=torch.float64)
    radius = 0.6 + 1.5 * torch.rand(60, generator=generator, dtype=torch.float64)
    depth = 0.6 + torch.rand(60, generator=generator, dtype=torch.float64)
    means = torch.stack([radius * angle.cos(), radius * angle.sin(), depth], dim=1)
    splats = replace(random_splats(11, 60, size=0.8), means=means)
    assert compare(splats, straight()).alpha.max() > 0.3


@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9, 1e15, 1e30])
def test_out_of_all_bounds(distance: float):
    """Finite numbers, however large, do no harm: one Gaussian in sight, others far to the sides and ahead."""
    sides = [[distance, 0, 0.011], [-distance, 0, 0.011], [0, distance, 0.011], [0, -distance, 0.011], [0, 0, distance]]
    expected = compare(balls([[0, 0, 1.0], *sides], 0.1, 0.9), straight())
    assert 0 < (expected.alpha > 0).double().mean() < 1


def test_far_from_the_origin():
    """The camera and the Gaussians 50 m out, where float32 keeps microns."""
    splats = random_splats(12, 300)
    shift = np.array([40.0, -30.0, 2.0])
    view = look_at(np.array([2.0, -2.0, 1.0]) + shift, shift, width=64, height=48)
    compare(replace(splats, means=splats.means + torch.from_numpy(shift)), view)


# --- shapes and opacities --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "scales",
    [
        pytest.param((0.0, 0.0, 0.0), id="points"),
        pytest.param((1e-6, 1e-6, 1e-6), id="tiny"),
        pytest.param((0.5, 0.0, 0.0), id="needles"),
        pytest.param((0.5, 0.5, 0.0), id="discs"),
        pytest.param((3.0, 1e-4, 1e-4), id="long needles"),
        pytest.param((20.0, 20.0, 20.0), id="huge"),
        pytest.param((1e3, 1e-3, 1e3), id="walls"),
    ],
)
def test_shapes(scales: tuple[float, float, float]):
    splats = random_splats(13, 60)
    generator = torch.Generator().manual_seed(13)
    quaternions = torch.randn(60, 4, generator=generator, dtype=torch.float64)
    shaped = covariances(quaternions, torch.tensor(scales, dtype=torch.float64).expand(60, 3))
    assert compare(replace(splats, covariances=shaped, opacities=0.3 * splats.opacities), camera()).alpha.max() > 0.05


def test_needles_seen_from_within():
    """Half a metre long, up to the near plane: thousands of pixels long and less than one wide."""
    splats = random_splats(14, 60, spread=0.2)
    generator = torch.Generator().manual_seed(14)
    needles = covariances(
        torch.randn(60, 4, generator=generator, dtype=torch.float64),
        torch.tensor([0.5, 1e-4, 1e-4], dtype=torch.float64).expand(60, 3),
    )
    view = look_at((0.0, 0.0, 0.0), (1.0, 0.2, 0.1), width=64, height=48, fov_y=1.2)
    compare(replace(splats, covariances=needles), view)


@pytest.mark.parametrize("distance", [100, 500, 2000, 10000])
def test_needles_across_the_picture(distance: int):
    """Half a pixel thick and as long as `distance` pixels, which their centres are away from the picture's."""
    generator = torch.Generator().manual_seed(distance)
    angle = 2 * np.pi * torch.rand(12, generator=generator, dtype=torch.float64)
    along = torch.stack([angle.cos(), angle.sin(), torch.zeros(12)], dim=1)
    across = torch.stack([-angle.sin(), angle.cos(), torch.zeros(12)], dim=1)
    length = distance / 600.0
    aside = 10 / 600 * torch.randn(12, 1, generator=generator, dtype=torch.float64)
    means = length * along + aside * across + torch.tensor([0.0, 0.0, 1.0])
    needles = length**2 * along[:, :, None] * along[:, None, :] + 1e-8 * torch.eye(3)
    splats = replace(random_splats(22, 12), means=means, covariances=needles)
    assert compare(splats, straight(64, 48, focal=600.0)).alpha.max() > 0.4


@pytest.mark.parametrize("scales", [(1.0, -1.0, 1.0), (-1.0, -1.0, -1.0), (-0.01, 0.01, 0.01)])
def test_what_is_no_covariance_is_not_drawn(scales: tuple[float, float, float]):
    indefinite = torch.diag(torch.tensor(scales, dtype=torch.float64))[None]
    assert compare(replace(balls([[0, 0, 2]], 0.1, 0.9), covariances=indefinite), straight()).alpha.max() == 0


@pytest.mark.parametrize("opacity", [0.0, 1e-12, 0.99 / 255, 1.01 / 255, 0.999, 1.0])
def test_opacities(opacity: float):
    splats = replace(random_splats(15, 150), opacities=torch.full((150,), opacity, dtype=torch.float64))
    expected = compare(splats, camera())
    assert (expected.alpha.max() > 0) == (opacity > STEP)


def test_a_thousand_faint_gaussians_on_each_other():
    rgb = np.random.default_rng(2).random((1000, 3)).tolist()
    stack = balls([[0, 0, 1 + 0.001 * i] for i in range(1000)], 0.1, 0.008, rgb)
    assert compare(stack, straight()).alpha.max() > 0.99


# --- frames ----------------------------------------------------------------------------------------------------------


def test_frames_are_the_pictures_of_their_parts():
    """A still part in front of and behind a moving one; a part that comes and goes; a view that moves."""
    still, moving = to(random_splats(16, 150, 1), torch.float32), to(random_splats(17, 150), torch.float32)
    moved = replace(moving, means=moving.means + 0.1)
    frames = [(still, moving), (still, moved), (still,), (moved, still), (still, moving), (still, moving)]
    for views in (camera(40, 30), [camera(40, 30)] * 3 + [replace(camera(40, 30), cx=15.0)] * 3):
        backdrop = torch.rand(30, 40, 3, generator=torch.Generator().manual_seed(0))
        made = list(render_frames(frames, views, backdrop))
        assert len(made) == len(frames)
        for i, (parts, picture) in enumerate(zip(frames, made, strict=True)):
            view = views if isinstance(views, Camera) else views[i]
            alone = rasterise(join(parts), view, backdrop)
            assert (picture.colour - alone.colour).abs().max() < 1e-5


def test_frames_over_their_own_backgrounds():
    splats = to(random_splats(18, 100), torch.float32)
    backdrops = torch.rand(3, 30, 40, 3, generator=torch.Generator().manual_seed(0))
    made = list(render_frames([(splats,)] * 3, camera(40, 30), iter(backdrops)))
    for backdrop, picture in zip(backdrops, made, strict=True):
        assert (picture.colour - rasterise(splats, camera(40, 30), backdrop).colour).abs().max() < 1e-5


def test_pictures_of_different_sizes_after_each_other():
    splats = to(random_splats(19, 200), torch.float32)
    sizes = [(64, 48), (16, 16), (90, 20), (64, 48)]
    made = [rasterise(splats, camera(*size), COLOURED).colour for size in sizes]
    assert torch.equal(made[0], made[3])
    compare(random_splats(19, 200), camera(90, 20))


# --- what is not allowed ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["means", "covariances", "opacities", "sh", "turns"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_none(name: str, value: float):
    splats = to(random_splats(20, 10, 1, turned=True), torch.float32)
    broken = getattr(splats, name).clone()
    broken.view(-1)[-1] = value
    with pytest.raises(InputError, match=name) as caught:
        rasterise(replace(splats, **{name: broken}), camera())
    assert "\n" not in str(caught.value)


def test_shapes_that_do_not_fit():
    splats = to(random_splats(21, 10, 1), torch.float32)
    for wrong in (
        replace(splats, means=splats.means[:9]),
        replace(splats, covariances=splats.covariances[:, :2]),
        replace(splats, opacities=splats.opacities[:, None]),
        replace(splats, sh=splats.sh[:, :3]),
    ):
        with pytest.raises(InputError) as caught:
            rasterise(wrong, camera())
        assert "\n" not in str(caught.value)
    for background in ((1.0, 1.0), torch.zeros(3, 3, 3), torch.full((3,), float("nan"))):
        with pytest.raises(InputError, match="background"):
            rasterise(splats, camera(), background)


def test_an_unknown_backend():
    with pytest.raises(InputError, match=r"opengl.*taichi"):
        rasterise(to(random_splats(0, 3), torch.float32), camera(), backend="opengl")  # pyright: ignore


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_gsplat_without_a_gpu():
    with pytest.raises(InputError, match=r"gsplat.*CUDA"):
        rasterise(to(random_splats(0, 3), torch.float32), camera(), backend="gsplat")


# --- a captured object -----------------------------------------------------------------------------------------------


def test_a_captured_object(shared_objects: Path):
    """Every thirtieth Gaussian of a plant, from outside and from among its leaves."""
    cloud, _ = load_clean(shared_objects / "plant.splat")
    rows = np.random.default_rng(0).permutation(len(cloud))[: len(cloud) // 30]
    splats = from_cloud(select(cloud, rows))
    centre = cloud.means.mean(0)
    for eye, opening in (((0.9, -0.3, -0.7), 0.8), ((0.05, 0.1, 0.0), 1.5)):
        view = look_at(centre + eye, centre, width=96, height=64, fov_y=opening, up=(0, -1, 0))
        assert compare(splats, view).alpha.max() > 0.9
