"""Light is what integrals say, its gradients are exact, shadows fall along it, and captures keep theirs."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch
from bodies import cloud_of, splats_of
from render_scenes import camera, weighed

from hoi.data import Body
from hoi.gaussians import SH_C0, fibonacci_sphere, transform, with_surface
from hoi.render import Ground
from hoi.render.light import DAY, Light, irradiance, lit, lit_cloud, relit, sky, to_linear, to_shown
from hoi.render.places import PLACES, pattern_at
from hoi.render.rasterise import Settings, rasterise
from hoi.render.replay import person_tensors, posed
from hoi.render.shadows import key_light_left


def surfaced(splats, share=1.0):
    normals = torch.nn.functional.normalize(splats.means, dim=1)
    return replace(splats, surface=torch.stack([normals, share * normals], 1))


def shown(splats):
    return 0.5 + SH_C0 * splats.sh[:, 0]


@pytest.mark.parametrize("light", [DAY, Light(zenith=2.0, horizon=0.1, ground=0.7)])
def test_the_sky_is_its_integral(light: Light):
    directions = torch.as_tensor(fibonacci_sphere(40_000))
    up = directions[:, 2:]
    radiance = torch.where(
        up > 0,
        (light.horizon + (light.zenith - light.horizon) * up) * torch.tensor(light.sky_tint),
        light.ground * torch.tensor(light.ground_tint),
    )
    normals = torch.as_tensor(fibonacci_sphere(50))
    cosines = (normals @ directions.T).clamp_min(0)
    expected = 4 * cosines @ radiance / len(directions)
    np.testing.assert_allclose(sky(light, normals), expected, atol=2e-4)


def test_an_even_light_shows_white_as_white():
    """In a furnace of radiance 1 an open white surface sends on 1, whichever way it faces."""
    light = Light(1.0, 1.0, 1.0, 0.0, sky_tint=(1, 1, 1), ground_tint=(1, 1, 1))
    ball = surfaced(splats_of(fibonacci_sphere(100), 0.05, sh=torch.full((100, 1, 3), 0.5 / SH_C0)))
    np.testing.assert_allclose(shown(lit(ball, light)), 1, atol=1e-4)


def test_creases_get_less_and_what_faces_the_key_light_most():
    grey = torch.full((500, 1, 3), -0.1)
    normals = torch.as_tensor(fibonacci_sphere(500), dtype=torch.float32)
    open_, closed = (shown(lit(surfaced(splats_of(normals.numpy(), 0.05, sh=grey), share))) for share in (1.0, 0.3))
    assert (closed < open_).all()
    assert normals[open_.mean(1).argmax()] @ torch.tensor(DAY.direction, dtype=torch.float32) > 0.7
    dark = shown(lit(surfaced(splats_of(normals.numpy(), 0.05, sh=grey)), DAY, torch.zeros(500)))
    assert (dark <= open_ + 1e-6).all() and dark.mean() < 0.85 * open_.mean()


def test_without_a_light_the_albedo_is_seen_and_captures_never_change():
    splats = splats_of(fibonacci_sphere(50), 0.05, sh=torch.rand(50, 1, 3))
    assert lit(splats) is splats
    bare = lit(surfaced(splats), None)
    assert torch.equal(bare.sh, splats.sh) and bare.surface is None


def test_srgb_there_and_back():
    values = torch.linspace(0, 1, 1001, dtype=torch.float64)
    np.testing.assert_allclose(to_shown(to_linear(values)), values, atol=1e-7)
    assert to_linear(torch.tensor(0.5)).item() == pytest.approx(0.2140, abs=1e-4)  # IEC 61966-2-1


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_gradients_of_normals_openness_and_albedo(share: float):
    generator = torch.Generator().manual_seed(0)
    normals = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator, dtype=torch.float64), dim=1)
    bent = torch.nn.functional.normalize(normals + 0.3 * torch.randn(40, 3, generator=generator).double(), dim=1)
    surface = torch.stack([normals, 0.98 * share * bent], 1).requires_grad_()
    albedo = torch.rand(40, 3, generator=generator, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda s, a: irradiance(DAY, s, a), (surface, albedo), eps=1e-7, atol=1e-5)


def test_a_lit_picture_against_finite_differences_of_the_pose():
    """From the picture's weighed sum through light, projection and skinning to the joints, in float64."""
    rng = np.random.default_rng(0)
    cloud = cloud_of(0.3 * rng.normal(size=(60, 3)), 0.05, rgb=rng.uniform(0.2, 0.8, (60, 3)), dtype=np.float64)
    cloud = replace(cloud, scales=cloud.scales * [1, 1, 0.3], surface=rng.normal(size=(60, 2, 3)))
    unit = cloud.surface / np.linalg.norm(cloud.surface, axis=2, keepdims=True) * [[[1.0], [0.7]]]
    weights = rng.dirichlet(np.full(24, 0.1), size=60)
    body = Body("ball", replace(cloud, surface=unit), weights, 0.2 * rng.normal(size=(24, 3)))
    person, settings = person_tensors(body, torch.float64), Settings(antialiased=True)

    def value(pose):
        still = torch.zeros(1, 3, dtype=torch.float64), torch.tensor([[1.0, 0, 0, 0, 1, 0]], dtype=torch.float64)
        (splats,) = posed(person, *still, pose)
        return weighed(rasterise(lit(splats), camera(48, 32), settings=settings))

    pose = torch.as_tensor(0.3 * rng.normal(size=(1, 23, 3))).requires_grad_()
    (gradient,) = torch.autograd.grad(value(pose), pose)
    along = torch.as_tensor(rng.normal(size=pose.shape))
    with torch.no_grad():
        after, before = (value(pose + sign * 1e-6 * along) for sign in (1, -1))
    assert (gradient * along).sum().item() == pytest.approx((after - before).item() / 2e-6, rel=1e-4)


def test_surfaces_turn_with_what_they_lie_on():
    ball = cloud_of(fibonacci_sphere(60), 0.05, rgb=0.6)
    ball = replace(ball, surface=np.stack([ball.means, 0.8 * ball.means], 1))
    turn = roma.rotvec_to_rotmat(torch.tensor([0.3, -1.0, 0.5])).numpy()
    turned = transform(ball, turn)
    np.testing.assert_allclose(turned.surface[:, 0], turned.means, atol=1e-6)
    np.testing.assert_allclose(lit_cloud(turned).sh[:, 0].mean(0), lit_cloud(ball).sh[:, 0].mean(0), atol=0.02)


def test_relighting_a_capture_keeps_its_mean():
    rng = np.random.default_rng(1)
    cloud = cloud_of(fibonacci_sphere(800), 0.03, rgb=rng.uniform(0.3, 0.6, (800, 3)))
    flat = replace(cloud, scales=cloud.scales * np.float32([1, 1, 1]))
    with_normals = with_surface(
        replace(flat, quaternions=_facing(flat.means), scales=flat.scales * np.float32([1, 1, 0.1]))
    )
    np.testing.assert_allclose(with_normals.surface[:, 0], flat.means, atol=2e-3)
    splats = splats_of(flat.means, 0.03, sh=torch.as_tensor(flat.sh))
    again = relit(splats, DAY, torch.as_tensor(with_normals.surface[:, 0]).float())
    np.testing.assert_allclose(shown(again).mean(0), shown(splats).mean(0), rtol=0.03)
    assert shown(again).std() > 1.3 * shown(splats).std()


def _facing(normals):
    from hoi.body.people import tilt_quaternions

    return tilt_quaternions(normals.astype(np.float64)).astype(np.float32)


def test_a_plate_takes_the_key_light_from_what_lies_behind_it():
    towards = np.array(DAY.direction)
    x, y = np.meshgrid(np.arange(-0.3, 0.3, 0.008), np.arange(-0.3, 0.3, 0.008))
    aside = np.linalg.svd(towards[None])[2][1:]
    plate = (x.reshape(-1, 1) * aside[0] + y.reshape(-1, 1) * aside[1]) + 1.0 * towards
    behind, beside, before = np.zeros((1, 3)), 0.6 * aside[:1], 1.5 * towards[None]
    parts = [splats_of(plate, 0.005), splats_of(np.concatenate([behind, beside, before]), 0.005)]
    own, others = key_light_left(parts, DAY.direction)
    assert (own < 0.9).float().mean() < 0.01  # where the point before it shades it
    np.testing.assert_allclose(others, [0, 1, 1], atol=1e-6)


def test_shadow_edges_are_soft_and_nothing_breaks_it():
    towards = (0.0, 0.0, 1.0)
    x, y = np.meshgrid(np.arange(-0.3, 0, 0.008), np.arange(-0.3, 0.3, 0.008))
    plate = splats_of(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]), 0.005)
    line = splats_of(np.column_stack([np.linspace(-0.1, 0.1, 81), np.zeros(81), np.zeros(81)]), 0.005)
    left = key_light_left([plate, line], towards)[1]
    assert left[0] < 1e-6 and left[-1] == 1 and (left.diff() >= -1e-6).all() and ((left > 0) & (left < 1)).sum() >= 2
    line.means[3] = torch.nan
    assert key_light_left([line, plate], towards)[0][4:].isfinite().all()
    assert key_light_left([splats_of(np.zeros((3, 3)), 0.1, opacity=0.0)], towards)[0].tolist() == [1, 1, 1]


@pytest.mark.parametrize("ground", [Ground.grass, Ground.court, Ground.gym])
def test_a_ground_repeats_and_does_not_shimmer(ground: Ground):
    size = PLACES[ground].size
    places = torch.as_tensor(np.random.default_rng(0).uniform(-5, 5, (2, 20, 30)), dtype=torch.float32)
    near = torch.full((20, 30), 0.004)
    np.testing.assert_allclose(
        pattern_at(ground, places, near),
        pattern_at(ground, places + size * torch.tensor([2.0, -1.0])[:, None, None], near),
        atol=5e-3,
    )
    assert pattern_at(ground, places, near).std() > 0.05
    far = pattern_at(ground, places, torch.full((20, 30), 20 * size))
    assert far.std() < 3e-4 and far.mean() == pytest.approx(PLACES[ground].pattern().mean(), abs=1e-4)
