"""The rasterisers' gradients against autograd's through the reference in float64, input by input."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch
from render_scenes import balls, camera, leaves, random_splats, straight, to, weighed
from torch import Tensor

from hoi.body.kinematics import rotation_to_6d
from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import BodyTensors, pose_gaussians
from hoi.render.cameras import Camera, look_at
from hoi.render.rasterise import Backend, Settings, rasterise
from hoi.render.reference import rasterise_reference
from hoi.render.splats import Splats, covariances

GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="gsplat wants a CUDA device")
BACKENDS = ["taichi", pytest.param("gsplat", marks=GPU)]
TOLERANCE = 1e-3


def agree(made: Tensor | None, expected: Tensor | None, name: str) -> None:
    """To a thousandth of the largest entry, and in the mean."""
    assert made is not None, f"{name} has no gradient"
    assert expected is not None
    assert made.shape == expected.shape
    assert expected.abs().max() > 0
    error = made.double() - expected.double()
    assert error.abs().max() < TOLERANCE * expected.abs().max(), name
    assert error.norm() < TOLERANCE * expected.norm(), name


def compare(splats: Splats, view: Camera, *, depth: bool = True, backend: Backend = "taichi") -> None:
    """Gradients of a picture's weighed sum; of a covariance's, the symmetric part, as it has no other."""
    background = torch.tensor([0.2, 0.5, 0.9])
    single, double = to(splats, torch.float32), to(to(splats, torch.float32), torch.float64)
    made, expected = leaves(single), leaves(double)
    behind, judged_behind = background.clone().requires_grad_(), background.double().requires_grad_()
    weighed(rasterise(single, view, behind, depth=depth, backend=backend)).backward()
    weighed(rasterise_reference(double, view, judged_behind, depth=depth)).backward()
    for name, tensor in made.items():
        gradient, judge = tensor.grad, expected[name].grad
        if name == "covariances":
            assert gradient is not None
            gradient = (gradient + gradient.mT) / 2
        agree(gradient, judge, name)
    agree(behind.grad, judged_behind.grad, "background")


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("seed", "degree"), [(0, 0), (1, 1), (2, 2), (3, 3)])
def test_random_clouds(seed: int, degree: int, backend: Backend):
    compare(random_splats(seed, 300, degree, turned=degree > 0), camera(), backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_opaque_clouds(backend: Backend):
    """Pixels that are full, and Gaussians behind them."""
    splats = random_splats(4, 600, 1, spread=0.25)
    dense = replace(splats, opacities=0.6 + 0.4 * splats.opacities)
    assert rasterise_reference(dense, camera()).alpha.max() > 0.9995
    compare(dense, camera(), backend=backend)


def test_without_depth():
    compare(random_splats(5, 200), camera(), depth=False)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (17, 15), (40, 1)])
def test_pictures_of_any_size(width: int, height: int):
    compare(random_splats(6, 200, spread=0.2, size=0.2), camera(width, height))


def test_inside_the_cloud():
    """The near plane, and the held Jacobian beside the picture."""
    view = look_at((0.03, 0.02, 0.01), (1.0, 0.5, 0.1), width=48, height=32, fov_y=1.2)
    compare(random_splats(7, 200, 1, size=0.05), view)


def test_large_gaussians():
    compare(random_splats(8, 30, 1, size=1.0), camera())


def test_needles():
    generator = torch.Generator().manual_seed(15)
    thin = torch.tensor([0.5, 1e-4, 1e-4], dtype=torch.float64).expand(60, 3)
    needles = covariances(torch.randn(60, 4, generator=generator, dtype=torch.float64), thin)
    compare(replace(random_splats(15, 60, 1), covariances=needles), camera())


def test_tiny_gaussians():
    compare(random_splats(9, 200, 1, size=1e-3), camera())


@pytest.mark.parametrize("view", [camera(), camera(40, 30)], ids=["near", "small"])
@pytest.mark.parametrize("size", [0.004, 0.05])
def test_with_antialiasing(size: float, view: Camera):
    """In float64 against autograd, of Gaussians below a pixel and above."""
    splats = random_splats(11, 200, 1, size=size, turned=True)
    made, expected = leaves(splats), leaves(splats)
    weighed(rasterise(splats, view, (0.2, 0.5, 0.9), depth=True, settings=Settings(antialiased=True))).backward()
    ours = {name: tensor.grad for name, tensor in made.items()}
    for tensor in made.values():
        tensor.grad = None
    weighed(rasterise_reference(splats, view, (0.2, 0.5, 0.9), depth=True, antialiased=True)).backward()
    for name, gradient in ours.items():
        judge = expected[name].grad
        assert gradient is not None
        gradient = (gradient + gradient.mT) / 2 if name == "covariances" else gradient
        agree(gradient, judge, name)


def test_in_float64_only_rounding_is_left():
    made, expected = leaves(random_splats(14, 200, 2, turned=True)), leaves(random_splats(14, 200, 2, turned=True))
    weighed(rasterise(Splats(**made), camera(), depth=True)).backward()
    weighed(rasterise_reference(Splats(**expected), camera(), depth=True)).backward()
    for name, tensor in made.items():
        gradient, judge = tensor.grad, expected[name].grad
        assert gradient is not None
        assert judge is not None
        error = (gradient + gradient.mT) / 2 - judge if name == "covariances" else gradient - judge
        assert error.abs().max() < 1e-9 * judge.abs().max(), name


@pytest.mark.parametrize("settings", [Settings(by_pixel=True), Settings(by_pixel=False)], ids=["by pixel", "by row"])
def test_the_ways_to_blend_agree(settings: Settings):
    """What GPUs run, on whatever there is."""
    splats = random_splats(16, 300, 1, spread=0.3, turned=True)
    single, double = to(splats, torch.float32), to(to(splats, torch.float32), torch.float64)
    made, expected = leaves(single), leaves(double)
    weighed(rasterise(single, camera(), depth=True, settings=settings)).backward()
    weighed(rasterise_reference(double, camera(), depth=True)).backward()
    for name, tensor in made.items():
        agree(tensor.grad, expected[name].grad, name)


def test_a_picture_as_background():
    splats, view = to(random_splats(10, 60), torch.float32), camera(30, 20)
    background = torch.rand(20, 30, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    weighed(rasterise(splats, view, background)).backward()
    made = background.grad
    background.grad = None
    weighed(rasterise_reference(splats, view, background)).backward()
    agree(made, background.grad, "background")


def test_what_is_not_seen_has_no_gradient():
    splats = to(balls([[0, 0, 2], [0, 0, -2], [9, 0, 2], [0.1, 0, 2]], 0.1, [0.5, 0.5, 0.5, 0.001]), torch.float32)
    inputs = leaves(splats)
    weighed(rasterise(splats, straight(), depth=True)).backward()
    for name, tensor in inputs.items():
        assert tensor.grad is not None
        assert tensor.grad[0].abs().max() > 0, name
        assert tensor.grad[1:].abs().max() == 0, name


def test_only_what_asks_gets_a_gradient():
    splats = to(random_splats(11, 50), torch.float32)
    splats.opacities.requires_grad_()
    weighed(rasterise(splats, camera())).backward()
    assert splats.opacities.grad is not None
    assert splats.means.grad is None
    assert not rasterise(to(splats, torch.float32), camera()).colour.requires_grad


def test_gradients_add_up_over_views():
    splats = to(random_splats(12, 80), torch.float32)
    splats.means.requires_grad_()
    views = [camera(30, 20), replace(camera(30, 20), cx=10.0)]

    def gradient(used: list[Camera]) -> Tensor:
        total = torch.stack([weighed(rasterise(splats, view)) for view in used]).sum()
        return torch.autograd.grad(total, splats.means)[0]

    assert torch.allclose(gradient(views), gradient(views[:1]) + gradient(views[1:]), rtol=1e-4, atol=1e-5)


# --- through the body ------------------------------------------------------------------------------------------------


def posed(pose: list[Tensor]) -> Splats:
    """A ball of Gaussians on 24 joints at `pose`: translation (1, 3), orientation (1, 6), body pose (1, 23, 3)."""
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.full(JOINT_COUNT, 0.1), size=40)
    rest = random_splats(13, 40, 1, spread=0.3)
    quaternions = torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(40, 4))), dim=-1)
    arrays = (rest.means, quaternions, torch.from_numpy(weights), torch.from_numpy(0.2 * rng.normal(size=(24, 3))))
    body = BodyTensors(*(array.to(pose[0].dtype) for array in arrays))
    means, rotations = (part[0] for part in pose_gaussians(body, *pose))
    root = rotations * torch.from_numpy(0.02 + 0.06 * rng.random((40, 1, 3))).to(means)
    unturned = roma.unitquat_to_rotmat(body.quaternions[:, [1, 2, 3, 0]])
    return Splats(means, root @ root.mT, rest.opacities.to(means), rest.sh.to(means), rotations @ unturned.mT)


def pose(dtype: torch.dtype) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    parts = [
        0.1 * torch.randn(1, 3, generator=generator, dtype=torch.float64),
        rotation_to_6d(roma.rotvec_to_rotmat(torch.randn(1, 3, generator=generator, dtype=torch.float64))),
        0.3 * torch.randn(1, 23, 3, generator=generator, dtype=torch.float64),
    ]
    return [part.float().to(dtype).requires_grad_() for part in parts]


@pytest.mark.parametrize("backend", BACKENDS)
def test_from_the_picture_to_the_pose(backend: Backend):
    single, double = pose(torch.float32), pose(torch.float64)
    weighed(rasterise(posed(single), camera(48, 32), depth=True, backend=backend)).backward()
    weighed(rasterise_reference(posed(double), camera(48, 32), depth=True)).backward()
    for name, made, expected in zip(("translation", "orientation", "body_pose"), single, double, strict=True):
        agree(made.grad, expected.grad, name)


def test_the_pose_against_finite_differences():
    """The judge itself, along a random direction: central differences of the picture's weighed sum."""
    at = pose(torch.float64)
    value = weighed(rasterise_reference(posed(at), camera(48, 32), depth=True))
    gradients = torch.autograd.grad(value, at)
    generator = torch.Generator().manual_seed(2)
    along = [torch.randn(part.shape, generator=generator, dtype=torch.float64) for part in at]
    step = 1e-7
    with torch.no_grad():
        after, before = (
            weighed(
                rasterise_reference(
                    posed([p + sign * step * d for p, d in zip(at, along, strict=True)]), camera(48, 32), depth=True
                )
            )
            for sign in (1, -1)
        )
    slope = sum((g * d).sum() for g, d in zip(gradients, along, strict=True))
    assert slope == pytest.approx(((after - before) / (2 * step)).item(), rel=1e-4)
