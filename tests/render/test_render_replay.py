"""A run back as Gaussians: skinning, deformation, how colours turn, what is not made twice, and gradients."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch
from demo_run import fk, make_run, posed_means

from hoi import gaussians, record
from hoi.body.skinning import pose_gaussians
from hoi.data import GaussianCloud, Run
from hoi.errors import InputError
from hoi.render.cameras import project, view
from hoi.render.replay import person_tensors, polar_rotation, posed, replay
from hoi.render.splats import shade


def lively(cloud: GaussianCloud, degree: int = 2) -> GaussianCloud:
    """The cloud with Gaussians of all shapes and directions, and colours that depend on the view."""
    rng = np.random.default_rng(4)
    quaternions = rng.normal(size=(len(cloud), 4))
    return replace(
        cloud,
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.002, 0.02, (len(cloud), 3)).astype(np.float32),
        sh=rng.normal(0, 0.2, (len(cloud), (degree + 1) ** 2, 3)).astype(np.float32),
    )


@pytest.fixture(scope="module")
def run() -> Run:
    run, _, _ = make_run(frames=8, points=300)
    scene = run.scene
    assert scene is not None
    body = replace(scene.body, cloud=lively(scene.body.cloud))
    thing = replace(scene.object, cloud=lively(scene.object.cloud))
    return replace(run, scene=replace(scene, body=body, object=thing))


def rotations_of(cloud: GaussianCloud) -> np.ndarray:
    return gaussians.rotation_matrices(cloud)


def test_the_person_is_where_skinning_puts_it(run: Run) -> None:
    body, motion = run.scene.body, run.state.motion
    means = posed_means(body, motion)
    turns, _ = fk(body, motion)
    turns = turns[:, body.skinning_weights.argmax(1)]  # each Gaussian of this body hangs on one joint
    root = turns @ (rotations_of(body.cloud) * body.cloud.scales[:, None, :])
    player = replay(run)
    assert player.frames == 8 and player.fps == run.scene.fps
    for frame in (0, 5, 2, 7):
        person, _ = player.parts(frame)
        np.testing.assert_allclose(person.means, means[frame], atol=1e-5)
        np.testing.assert_allclose(person.covariances, root[frame] @ root[frame].transpose(0, 2, 1), atol=1e-8)
        np.testing.assert_allclose(person.turns, turns[frame], atol=1e-5)
        assert not person.means.requires_grad


def test_the_object_is_deformed_by_its_gradient(run: Run) -> None:
    cloud, trajectory = run.scene.object.cloud, run.state.trajectory
    player = replay(run)
    for frame in (0, 2, 7):
        gradient = trajectory.deformation_gradient[frame, : len(cloud)]
        _, thing = player.parts(frame)
        np.testing.assert_allclose(thing.means, trajectory.positions[frame, : len(cloud)], atol=1e-7)
        expected = gradient @ gaussians.covariances(cloud) @ gradient.transpose(0, 2, 1)
        np.testing.assert_allclose(thing.covariances, expected, atol=1e-8)
        left, _, right = np.linalg.svd(gradient)
        np.testing.assert_allclose(thing.turns, left @ right, atol=1e-5)


def test_colours_turn_as_rotated_harmonics_do(run: Run) -> None:
    """`turns` against `gaussians.rotate_sh`, for the person and the object in the last frame."""
    eye = torch.tensor([2.0, 1.0, 1.5])
    for splats, cloud in zip(replay(run).parts(7), (run.scene.body.cloud, run.scene.object.cloud), strict=True):
        turned = replace(cloud, sh=gaussians.rotate_sh(cloud.sh, splats.turns.double().numpy()))
        directions = splats.means.double().numpy() - eye.numpy()
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        expected = gaussians.colours(turned, directions)
        np.testing.assert_allclose(shade(splats, eye), expected, atol=1e-4)
        still = shade(replace(splats, turns=None), eye)
        assert np.abs(still.numpy() - expected).max() > 0.1, "the test would notice"


def test_flat_colours_need_no_turns(run: Run) -> None:
    plain, _, _ = make_run(frames=3)
    assert [part.turns for part in replay(plain).parts(2)] == [None, None]


def test_without_a_gradient_the_object_only_moves(run: Run) -> None:
    trajectory = replace(run.state.trajectory, deformation_gradient=None)
    player = replay(replace(run, state=replace(run.state, trajectory=trajectory)))
    (_, first), (_, last) = player.parts(0), player.parts(7)
    assert first.covariances is last.covariances and last.turns is None
    np.testing.assert_allclose(last.covariances, gaussians.covariances(run.scene.object.cloud), atol=1e-8)
    np.testing.assert_allclose(last.means, trajectory.positions[7, : len(last)])


def test_what_stands_still_is_the_same_object(run: Run) -> None:
    player = replay(run)
    parts = [player.parts(frame) for frame in range(8)]
    # The ball rests until frame 1; the person always moves.
    assert [parts[t][1] is parts[t - 1][1] for t in range(1, 8)] == [True] + [False] * 6
    assert [parts[t][0] is parts[t - 1][0] for t in range(1, 8)] == [False] * 7
    assert player.parts(7)[0] is parts[7][0]

    motion = run.state.motion
    paused = replace(
        motion,
        **{
            name: np.concatenate([values[:3], np.repeat(values[3:4], 4, 0), values[7:]])
            for name, values in vars(motion).items()
            if name != "fps"
        },
    )
    player = replay(replace(run, state=replace(run.state, motion=paused)))
    people = [player.parts(frame)[0] for frame in range(8)]
    assert [people[t] is people[t - 1] for t in range(1, 8)] == [False] * 3 + [True] * 3 + [False]
    np.testing.assert_allclose(people[5].means, posed_means(run.scene.body, motion)[3], atol=1e-5)


def test_frames_in_any_order_are_the_differentiable_poses(run: Run) -> None:
    motion, cloud = run.state.motion, run.scene.body.cloud
    normals = np.random.default_rng(0).normal(size=(len(cloud), 2, 3)).astype(np.float32)
    body = replace(run.scene.body, cloud=replace(cloud, surface=normals))
    turned = replace(cloud, sh=np.concatenate([cloud.sh[:, :1], np.ones((len(cloud), 3, 3), np.float32)], 1))
    for shown in (body, replace(body, cloud=turned)):
        arrays = (motion.translation, motion.orientation, motion.body_pose)
        expected = posed(person_tensors(shown, torch.float64), *(torch.tensor(a, dtype=torch.float64) for a in arrays))
        player = replay(replace(run, scene=replace(run.scene, body=shown)))
        for frame in (7, 0, 1, 6, 5, 2):
            part, other = player.parts(frame)[0], expected[frame]
            np.testing.assert_allclose(part.means, other.means, atol=3e-6)
            np.testing.assert_allclose(part.covariances, other.covariances, atol=1e-8)
            if other.surface is not None:
                np.testing.assert_allclose(part.surface, other.surface, atol=2e-5)
            if other.turns is not None:
                np.testing.assert_allclose(part.turns, other.turns, atol=1e-5)


def test_a_record_shows_what_the_run_shows(run: Run, tmp_path) -> None:
    record.write(run, tmp_path / "run.mcap", plan_text="")
    fresh, read = replay(run), replay(record.read(tmp_path / "run.mcap"))
    assert read.frames == fresh.frames
    for part, other in zip(read.parts(6), fresh.parts(6), strict=True):
        assert torch.equal(part.means, other.means) and torch.equal(part.covariances, other.covariances)
        assert torch.equal(part.sh, other.sh) and torch.equal(part.turns, other.turns)


@pytest.mark.parametrize("absent", ["motion", "trajectory"])
def test_a_run_shows_what_it_has(run: Run, absent: str) -> None:
    half = replace(run, state=replace(run.state, **{absent: None}))
    player = replay(half)
    (part,) = player.parts(7)
    assert len(part) == len(run.scene.object.cloud if absent == "motion" else run.scene.body.cloud)
    assert player.frames == 8
    assert len(view("follow", player.action())) == 8


def test_refusals(run: Run) -> None:
    empty = replace(run, state=replace(run.state, motion=None, trajectory=None))
    with pytest.raises(InputError, match="neither a motion nor a trajectory"):
        replay(empty)
    with pytest.raises(InputError, match="neither"):
        replay(replace(run, scene=None))
    longer = make_run(frames=9)[0].state.trajectory
    with pytest.raises(InputError, match="8 frames of motion, 9 of the trajectory"):
        replay(replace(run, state=replace(run.state, trajectory=longer)))
    for frame in (-1, 8):
        with pytest.raises(IndexError, match="0 to 7"):
            replay(run).parts(frame)


def test_the_outline_frames_all_gaussians() -> None:
    """Few points stand for all: what they leave out is a small part of the margin."""
    run, people, _ = make_run(frames=12, points=4000, gaussians=800, particles=1000)
    action = replay(run).action()
    assert action.person.shape[1] < 1500 and action.thing.shape[1] < 300
    for name in ("side", "front", "top", "three_quarter"):
        camera = view(name, action)
        size = np.array([camera.width, camera.height])
        shares = project(camera, people)[0] / size
        assert shares.min() > 0.05 and shares.max() < 0.95


def test_gaussians_nobody_sees_do_not_count() -> None:
    run, _, _ = make_run(frames=4)
    cloud = run.scene.object.cloud
    means, opacities = cloud.means.copy(), cloud.opacities.copy()
    opacities[0] = 0.01
    positions = run.state.trajectory.positions.copy()
    positions[:, 0] += 50
    faint = replace(cloud, means=means, opacities=opacities)
    scene = replace(run.scene, object=replace(run.scene.object, cloud=faint))
    state = replace(run.state, trajectory=replace(run.state.trajectory, positions=positions))
    assert np.abs(replay(replace(run, scene=scene, state=state)).action().thing).max() < 10
    scene = replace(scene, object=replace(scene.object, cloud=replace(faint, opacities=opacities * 0.05)))
    assert np.abs(replay(replace(run, scene=scene, state=state)).action().thing).max() > 40


# --- polar decomposition ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_polar_rotation_is_the_nearest_rotation(dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    gradient = torch.eye(3, dtype=dtype) + 0.4 * torch.randn(2000, 3, 3, generator=generator, dtype=dtype)
    gradient[:1000] = roma.random_rotmat(1000, dtype=dtype, generator=generator) @ gradient[:1000]
    gradient[0] = 0  # any rotation will do
    gradient[1] = torch.diag(torch.tensor([1.0, 1.0, -1.0], dtype=dtype))
    gradient[2] = torch.diag(torch.tensor([1.0, 2.0, 0.0], dtype=dtype))
    gradient[3] = 1e-6 * torch.eye(3, dtype=dtype)
    before = gradient.clone()
    rotation = polar_rotation(gradient)
    assert torch.equal(gradient, before)
    np.testing.assert_allclose(rotation @ rotation.mT, np.broadcast_to(np.eye(3), (2000, 3, 3)), atol=2e-4)
    assert (torch.linalg.det(rotation) > 0).all()
    np.testing.assert_allclose(rotation[2:4], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-4)
    # Nearest in the Frobenius norm: of the largest trace(R^T F), which is the sum of singular values, signed.
    left, singular, right = torch.linalg.svd(gradient.double())
    singular[:, 2] *= torch.linalg.det(left @ right).sign()
    trace = (rotation.double() * gradient.double()).sum((1, 2))
    np.testing.assert_allclose(trace, singular.sum(1), rtol=1e-5, atol=1e-4)


# --- gradients --------------------------------------------------------------------------------------------------------


def blended(run: Run):
    """A person whose Gaussians hang on several joints, in float64."""
    rng = np.random.default_rng(5)
    weights = run.scene.body.skinning_weights[:80] + rng.dirichlet(np.full(24, 0.1), 80)
    cloud = gaussians.select(run.scene.body.cloud, np.arange(80))
    body = replace(run.scene.body, cloud=cloud, skinning_weights=weights / weights.sum(1, keepdims=True))
    motion = run.state.motion
    parameters = [
        torch.as_tensor(values[2:5], dtype=torch.float64) + 0.05 * torch.from_numpy(rng.normal(size=values[2:5].shape))
        for values in (motion.translation, motion.orientation, motion.body_pose)
    ]
    return person_tensors(body, dtype=torch.float64), parameters


def test_posed_is_the_skinning_of_the_body(run: Run) -> None:
    person, parameters = blended(run)
    means, rotations = pose_gaussians(person.body, *parameters)
    rest = torch.from_numpy(rotations_of(gaussians.select(run.scene.body.cloud, np.arange(80))))
    frames = posed(person, *parameters)
    assert len(frames) == 3
    for frame, splats in enumerate(frames):
        assert torch.equal(splats.means, means[frame])
        expected = rotations[frame] @ torch.diag_embed(person.scales**2) @ rotations[frame].mT
        torch.testing.assert_close(splats.covariances, expected)
        torch.testing.assert_close(splats.turns @ rest, rotations[frame], atol=1e-6, rtol=0)
        assert splats.sh is person.sh and splats.opacities is person.opacities


@pytest.mark.parametrize("which", [0, 1, 2], ids=["translation", "orientation", "body_pose"])
def test_gradients_of_poses_match_finite_differences(run: Run, which: int) -> None:
    """Through means, covariances and the colours that turn, along random directions of all frames' parameters."""
    person, parameters = blended(run)
    generator = torch.Generator().manual_seed(which)
    eye = torch.tensor([2.0, 1.0, 1.5], dtype=torch.float64)
    probes = [torch.randn(3, 80, *size, generator=generator, dtype=torch.float64) for size in ((3,), (3, 3), (3,))]

    def loss(parameter: torch.Tensor) -> torch.Tensor:
        frames = posed(person, *parameters[:which], parameter, *parameters[which + 1 :])
        total = torch.zeros((), dtype=torch.float64)
        for means, sigma, colour, splats in zip(*probes, frames, strict=True):
            total = total + (means * splats.means).sum() + 1e4 * (sigma * splats.covariances).sum()
            total = total + (colour * shade(splats, eye)).sum()
        return total

    leaf = parameters[which].clone().requires_grad_()
    (gradient,) = torch.autograd.grad(loss(leaf), leaf)
    for _ in range(4):
        direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64)
        step = 1e-6 * direction
        with torch.no_grad():
            difference = (loss(leaf + step) - loss(leaf - step)) / 2e-6
        assert (gradient * direction).sum().item() == pytest.approx(difference.item(), rel=1e-5)


def test_gradients_reach_shape_and_colour(run: Run) -> None:
    person, parameters = blended(run)
    person = replace(
        person,
        scales=person.scales.clone().requires_grad_(),
        opacities=person.opacities.clone().requires_grad_(),
        sh=person.sh.clone().requires_grad_(),
    )
    splats = posed(person, *parameters)[1]
    total = splats.covariances.sum() + splats.opacities.sum() + shade(splats, torch.ones(3).double()).sum()
    grads = torch.autograd.grad(total, (person.scales, person.opacities, person.sh))
    assert all(torch.isfinite(grad).all() and grad.abs().max() > 0 for grad in grads)
