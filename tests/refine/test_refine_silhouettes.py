"""Silhouettes: what covers a pixel, whatever is before it; their gradient; a clip of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bodies import splats_of
from refine_scenes import FRAMES, HIT, refine, struck

from hoi.body.interpolate import interpolate_motion
from hoi.config.validate import to_config
from hoi.data import Motion
from hoi.refine.clip import chosen, moved_by
from hoi.refine.contact_clip import ContactClip
from hoi.refine.fidelity import surfaces_near
from hoi.refine.silhouettes import coverage, section, silhouettes
from hoi.refine.stage import contact_window
from hoi.refine.views import Framing, viewpoint
from hoi.refine.window import window_around
from hoi.render.rasterise import rasterise
from hoi.render.replay import person_tensors, posed
from hoi.render.splats import Splats
from hoi.reports import Stages


def ball(centre: tuple[float, float, float], radius: float, count: int = 3000) -> Splats:
    points = np.random.default_rng(0).normal(size=(count, 3))
    points = radius * points / np.linalg.norm(points, axis=1, keepdims=True) + centre
    return splats_of(points, 0.004, torch.rand(count, 4, 3))


CAMERA = viewpoint(Framing(np.zeros(3), 0.28), 0.0, width=64, height=48)


def test_coverage_is_alpha_of_all_gaussians_seen_or_not() -> None:
    splats = ball((0, 0.2, 0), 0.15)  # partly out of the picture
    torch.testing.assert_close(coverage(splats, CAMERA), rasterise(splats, CAMERA).alpha, rtol=0, atol=1e-5)
    assert float(coverage(ball((0, 5.0, 0), 0.1), CAMERA).max()) == 0


def test_a_ball_inside_another_is_as_visible_as_alone() -> None:
    inner, outer, nothing = ball((0, 0, 0), 0.05), ball((0, 0, 0), 0.15), ball((0, 5.0, 0), 0.1)
    shown = silhouettes(inner, nothing, outer, CAMERA)
    torch.testing.assert_close(shown[0], coverage(inner, CAMERA), rtol=0, atol=0)
    assert float(shown[1].max()) == 0
    area = (0.28 / 24) ** 2 * float(shown[2].sum())  # of a pixel [m^2], 48 of which are 0.56 m
    assert np.pi * 0.15**2 < area < np.pi * 0.175**2  # a Gaussian's edge is soft, a pixel wider than the ball
    assert bool((shown[2] >= shown[0] - 0.05).all())


def test_gradient_agrees_with_central_differences() -> None:
    splats, weights = ball((0, 0.03, 0), 0.1, 400), torch.rand(48, 64, generator=torch.Generator().manual_seed(1))

    def total(shift: torch.Tensor) -> torch.Tensor:
        moved = Splats(splats.means + shift, splats.covariances, splats.opacities, splats.sh)
        return (weights * coverage(moved, CAMERA)).sum()

    shift = torch.zeros(3, requires_grad=True)
    total(shift).backward()
    steps = 1e-3 * torch.eye(3)
    central = torch.stack([total(step) - total(-step) for step in steps]) / 2e-3
    assert shift.grad is not None
    assert float((shift.grad - central).norm()) < 0.1 * float(central.norm())  # the rasteriser's cut-offs are steps


def test_a_section_is_the_ball_cut_through() -> None:
    scene, state = struck()
    centre, radius = state.trajectory.com[HIT], scene.thing.size / 2
    near = (centre - 0.3, centre + 0.3)
    (surface,) = surfaces_near(scene.thing, state.trajectory, None, scene.fps, [HIT], near)
    for aside in (0.0, 0.6):  # of the radius, towards the camera
        camera = viewpoint(Framing(centre, 0.28), 0.0, 0.0, width=64, height=64)
        through = centre - aside * radius * camera.forward
        shown = section(surface, through, camera)
        pixel = float((through - camera.position) @ camera.forward) / camera.fx
        area = np.pi * radius**2 * (1 - aside**2)
        assert pixel**2 * float(shown.sum()) == pytest.approx(area, rel=0.03)
        assert 0 <= float(shown.min()) and float(shown.max()) <= 1


def test_a_clip_shows_the_contact_between_frames_and_follows_theta() -> None:
    scene, state = struck()
    window = window_around(HIT + 0.3, 11, 1.0, FRAMES)
    centre = state.trajectory.com[HIT]
    contact = Framing(centre, 0.28)
    clip = ContactClip(scene, state.motion, state.trajectory, window, 5, contact, tempo=0.5)
    assert np.allclose(clip.instants, HIT + 0.3 + np.array([-0.5, -0.25, 0, 0.25, 0.5]))
    camera = viewpoint(contact, 0.0, width=32, height=32)
    theta = torch.tensor(state.motion.body_pose[np.array(window.frames)], dtype=torch.float32, requires_grad=True)
    video = clip.render(camera, theta)
    assert video.shape == (5, 3, 32, 32)
    # Limb and rest are those of the whole person at that instant, the object is cut through its middle.
    limb = torch.from_numpy(moved_by(scene.body, window.moving))
    moved = interpolate_motion(state.motion, clip.instants)
    parts = (
        torch.tensor(array, dtype=torch.float32) for array in (moved.translation, moved.orientation, moved.body_pose)
    )
    for place, person in enumerate(posed(person_tensors(scene.body), *parts)):
        expected = torch.stack([coverage(chosen(person, rows), camera) for rows in (limb, ~limb)])
        torch.testing.assert_close(video[place, :2].detach(), expected.clamp(0, 1), rtol=0, atol=2e-3)
    (others,) = torch.autograd.grad(video[:, 1:].sum(), theta, retain_graph=True)
    assert float(others.abs().max()) == 0
    (video[:, 0] * torch.rand(5, 32, 32)).sum().backward()
    assert theta.grad is not None
    followed = [float(frame.abs().max()) > 0 for frame in theta.grad]
    assert followed[1] and followed[2] and torch.equal(clip.render(camera, theta), video)


def test_the_prior_in_the_package_takes_a_foot_out_of_a_ball(composed) -> None:
    """In its default settings, and ends as soon as that is so."""
    scene, state = struck(depth=0.03)
    config = to_config(composed("scene=kick_soccer_ball"))
    stages = Stages()
    with stages.stage("refine", 1) as stage:
        refined = refine(scene, state, config, "cpu", stage)
    numbers, conf = stages.reports[0].numbers, config.stage.refine
    assert numbers["penetration_before"] > 0.025
    assert numbers["penetration_after"] <= conf.tolerance
    assert numbers["gap_after"] < 0.01
    assert 3 < stages.reports[0].iterations < conf.iterations
    window = contact_window(state, conf.half_width, FRAMES)
    outside = [frame for frame in range(FRAMES) if frame not in window.frames]
    assert refined.body_pose[outside].tobytes() == state.motion.body_pose[outside].tobytes()


def test_the_motion_nearest_to_touch_is_kept(composed, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limb that is out, but farther off than it was deep, is no better."""
    scene, state = struck(depth=0.03)

    def shifted(by: float) -> Motion:
        return replace(state.motion, translation=state.motion.translation + np.array([0, by, 0]))

    tried = [shifted(0.01), shifted(-0.012), shifted(-0.005)]

    def pushing(*_, enough, **__) -> Motion:
        assert not any(enough(motion) for motion in tried)
        return tried[-1]

    monkeypatch.setattr("hoi.method.video_sds.video_sds", pushing)
    stages, config = Stages(), to_config(composed("scene=kick_soccer_ball"))
    with stages.stage("refine", 1) as stage:
        assert refine(scene, state, config, "cpu", stage) is tried[1]
        assert "the nearest to it is kept" in stage.notes[-1]
        tried[1] = shifted(0.02)
        tried[2] = shifted(0.01)
        assert refine(scene, state, config, "cpu", stage) is state.motion

        def leaving(*_, enough, **__) -> Motion:
            assert not enough(near) and not enough(far)
            return far

        monkeypatch.setattr("hoi.method.video_sds.video_sds", leaving)
        near, far = shifted(-0.012), shifted(-0.1)
        assert refine(scene, state, config, "cpu", stage) is near
        near = shifted(0.01)
        assert refine(scene, state, config, "cpu", stage) is state.motion

        def touching(*_, enough, **__) -> Motion:
            assert not enough(near) and enough(far)
            return far

        monkeypatch.setattr("hoi.method.video_sds.video_sds", touching)
        near, far = (
            shifted(-0.026),
            shifted(-0.038),
        )  # a few mm deep; out, and farther off than that but within d_contact
        assert refine(scene, state, config, "cpu", stage) is far
        near = far = state.motion
        monkeypatch.setattr("hoi.method.video_sds.video_sds", lambda *_, **__: far)
        assert refine(scene, state, config, "cpu", stage) is state.motion
    numbers = stages.reports[0].numbers
    assert numbers["penetration_after"] == numbers["penetration_before"] > 0.02
