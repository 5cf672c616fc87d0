"""Stage 1 with the embedded prior, on people of different size; and the random streams."""

from dataclasses import replace

import numpy as np
import pytest

from hoi.body.skinning import joint_paths, posed_means
from hoi.config.validate import to_config
from hoi.errors import RunError
from hoi.method.hmsd import sample_motions, synthesise
from hoi.reports import Stage
from hoi.runner.scene import build_scene
from hoi.stages.motion.hmsd import HMSD
from hoi.streams import stream_seed


@pytest.mark.parametrize("person", ["man", "child"])
def test_sampled_kick_fits_the_person(composed, person):
    """From the origin, towards +Y, on the ground, with the foot it is told; the child's steps are shorter."""
    config = to_config(composed(f"human={person}", "human.gaussians=2000"))
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", False)
    (motion,) = sample_motions(distillation, conf.sampling, scene.frames, scene.fps, [1])
    (again,) = sample_motions(distillation, conf.sampling, scene.frames, scene.fps, [1])
    np.testing.assert_array_equal(motion.body_pose, again.body_pose)
    joints = joint_paths(scene.body, motion)
    np.testing.assert_allclose(motion.translation[0, :2], 0, atol=1e-6)
    assert joints[20:, 0, 1].min() > 0.2  # the pelvis goes forward
    lowest = posed_means(scene.body, motion)[..., 2].min(axis=1)
    assert np.abs(lowest).max() < 0.12
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * scene.fps
    assert speed[:, 11].max() > 4 and speed[:, 11].max() > speed[:, 10].max()
    if person == "child":
        assert distillation.leg_ratio > 1.2


def test_streams_are_named_and_stable():
    assert stream_seed(0, "motion") == stream_seed(0, "motion")
    seeds = {stream_seed(seed, name) for seed in range(3) for name in ("sample", "motion", "coordinate")}
    assert len(seeds) == 9
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_sample_that_is_not_finite_fails_the_run(composed):
    config = to_config(composed("human.gaussians=2000", "stage.motion.sample_steps=2"))
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", False)
    with pytest.raises(RunError, match="not finite; lower"):
        sample_motions(distillation, replace(conf, sample_guidance=np.inf).sampling, scene.frames, scene.fps, [0])


@pytest.mark.parametrize(("fps", "frames"), [(60.0, 120), (30.0, 60), (30.0, 40), (60.0, 40)])
def test_a_scene_of_another_frame_rate_has_the_same_speeds(composed, fps, frames):
    """What the prior draws is resampled, not relabelled; a scene too short for all of it shows its strike."""
    config = to_config(composed("human.gaussians=2000", "scene.contact_frame=2"))
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", False)
    seeds = [0, 1, 2]
    own = sample_motions(distillation, conf.sampling, 40, 20.0, seeds)
    other = sample_motions(distillation, conf.sampling, frames, fps, seeds)
    stages = [Stage("motion", lambda units: None, [])] * len(seeds)
    other = synthesise(distillation, other, seeds, stages, iterations=10, learning_rate=0.005)

    def fastest(motions) -> np.ndarray:
        steps = [np.diff(joint_paths(scene.body, motion)[:, 11], axis=0) for motion in motions]
        return np.array([np.linalg.norm(step, axis=1).max() for step in steps]) * motions[0].fps

    assert all(len(motion) == frames and motion.fps == fps for motion in other)
    np.testing.assert_allclose(fastest(other), fastest(own), rtol=0.2)
