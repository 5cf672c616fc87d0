"""Stage 1 with the embedded prior, on people of different size; and the random streams."""

from dataclasses import replace

import numpy as np
import pytest

from hoi.body.skinning import joint_paths, posed_means
from hoi.config.validate import to_config
from hoi.errors import RunError
from hoi.method.hmsd import load_distillation, sample_motions
from hoi.runner.scene import build_scene
from hoi.stages.motion.hmsd import HMSD
from hoi.streams import stream_seed


@pytest.mark.parametrize("person", ["man", "child"])
def test_sampled_kick_fits_the_person(composed, person):
    """From the origin, towards +Y, on the ground, with the foot it is told; the child's steps are shorter."""
    config = to_config(composed(f"human={person}", "human.gaussians=2000"))
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = load_distillation(scene, conf, "cpu")
    (motion,) = sample_motions(scene, distillation, conf, [1])
    (again,) = sample_motions(scene, distillation, conf, [1])
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
    with pytest.raises(RunError, match="not finite; lower"):
        sample_motions(scene, load_distillation(scene, conf, "cpu"), replace(conf, sample_guidance=np.inf), [0])
