"""Stages 1 and 2 with the embedded prior: the strike reaches the object, feet stay, extremes end well or are
refused.
"""

from dataclasses import replace

import numpy as np
import pytest

from hoi.body.skinning import joint_paths, stand_motion
from hoi.config.compose import config_of
from hoi.config.validate import to_config
from hoi.data import Motion, StageReport, State, Target
from hoi.errors import InputError, RunError
from hoi.method.approach import BACK_STEP, approach, shifted
from hoi.method.attraction import REACHED, Batch, coordinate
from hoi.method.hmsd import sample_motions
from hoi.method.object_motion import at_rest, free_motion
from hoi.method.optimization import Walk
from hoi.method.scene_representation import is_apart
from hoi.plan import make_plan
from hoi.reports import Stages, quiet
from hoi.runner.jobs import outcome
from hoi.runner.scene import build_scene
from hoi.stages.motion.hmsd import HMSD

SMALL = ("human.gaussians=2000", "object.max_gaussians=1500", "stage/object=mpm_coarse", "render=none")


def stage_1(config):
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", config.scene.approach == "stand")
    return scene, distillation, conf.motions(scene, distillation, [config.seed], [quiet()])[0]


def walk_of(config, seeds, distillation, motions) -> Walk:
    """As far as stage 1, the object at rest."""
    scene, plan = build_scene(config), make_plan(config)
    trajectory, _ = free_motion(scene, at_rest, quiet())
    states = [State(motion, trajectory) for motion in motions]
    batch = Batch([scene] * len(seeds), seeds, "cpu")
    return Walk(config, plan, batch, at_rest, [Stages() for _ in seeds], states, (), distillation)


def stage_2(config, distillation, motion, target=None):
    walk, stage = walk_of(config, [config.seed], distillation, [motion]), quiet("coordinate")
    (state,), (scene,), options = walk.states, walk.batch.scenes, config.stage
    state = walk.aimed(scene, state) if target is None else replace(state, target=target)
    attraction = options.attraction.term(walk.batch, [state]) if "attraction" in walk.plan.uses else None
    (after,) = coordinate(walk.batch, [state], distillation, attraction, [stage], **vars(options.coordinate))
    return after, state.target, stage


def find_target(scene, motion, config) -> Target:
    return config.stage.motion.target(scene, motion, config.scene)


@pytest.fixture(scope="module")
def kick():
    """Prior and motion of the default scene's sentence, drawn only: distilling costs time and changes little here."""
    config = config_of(*SMALL, "stage.motion.iterations=0", "stage.motion.sample_steps=10")
    _, distillation, motion = stage_1(config)
    return distillation, motion


@pytest.mark.parametrize(
    ("position", "approach"), [("[-1.0,-1.0,null]", "step"), ("[0.3,1.0,0.5]", "step"), ("[0.2,1.1,null]", "none")]
)
def test_the_strike_reaches_and_feet_stay(composed, kick, position, approach):
    config = to_config(
        composed(*SMALL, f"scene.placement.position={position}", f"scene.approach={approach}",
                 "stage.coordinate.iterations=60", "stage.coordinate.learning_rate=0.01",
                 "stage.attraction.growth=1.05")
    )  # fmt: skip
    _, _, stage = stage_2(config, *kick)
    assert stage.numbers["reach_gap"] <= REACHED
    assert stage.numbers["slide_after"] < 0.5 * stage.numbers["slide_before"]


def test_out_of_reach_is_said_with_the_gap(composed, kick):
    config = to_config(composed(*SMALL, "scene.placement.position=[0,1.2,4.0]", "stage.coordinate.iterations=3"))
    after, target, stage = stage_2(config, *kick)
    gap = stage.numbers["reach_gap"]
    assert gap > 1
    report = type("Report", (), {"numbers": stage.numbers})()
    said = outcome(config, make_plan(config), State(motion=after, target=target), [report])  # pyright: ignore[reportArgumentType]
    assert said.endswith(f"could not reach the object: {gap:.3f} m short at frame {target.frame}")


def test_feet_slide_more_without_their_term(composed, kick):
    slides = []
    for weight in (0, 10):
        few = ("stage.coordinate.iterations=25", f"stage.coordinate.lambda_feet={weight}")
        _, _, stage = stage_2(to_config(composed(*SMALL, *few)), *kick)
        slides.append(stage.numbers["slide_after"])
    assert slides[1] < 0.5 * slides[0]


def test_who_stands_does_not_travel(composed):
    conf = (
        "scene.approach=stand",
        "stage.motion.iterations=0",
        "stage.motion.sample_steps=5",
        "scene.motion_prompt=a person stands and kicks",
    )
    scene, _, motion = stage_1(to_config(composed(*SMALL, *conf)))
    np.testing.assert_allclose(motion.translation[:, :2], 0, atol=1e-4)
    assert np.ptp(joint_paths(scene.body, motion)[:, 11], axis=0).max() > 0.1  # but moves


THOUSAND_WORDS = " ".join(["a person kicks, and then"] * 200)


@pytest.mark.parametrize(
    "extreme",
    [
        ["stage.motion.guidance=0", "stage.motion.sample_guidance=0"],
        ["stage.motion.guidance=50", "stage.motion.guidance_rescale=0"],
        ["stage.motion.guidance=50", "stage.motion.sample_guidance=50"],
        ["stage.motion.learning_rate=1", "stage.coordinate.learning_rate=1"],
        ["scene.motion_prompt=''"],
        [f"scene.motion_prompt='{THOUSAND_WORDS}'"],
        ["scene.frames=8", "scene.contact_frame=4"],
        ["scene.frames=200"],
        ["stage.motion.sample_steps=1"],
        ["stage.motion.init=stand"],
    ],
    ids=lambda extreme: extreme[0][:40],
)
def test_extremes_give_a_finite_motion(composed, extreme):
    config = to_config(
        composed(*SMALL, "stage.motion.iterations=2", "stage.coordinate.iterations=2",
                 "stage.motion.sample_steps=2", *extreme)
    )  # fmt: skip
    scene, distillation, free = stage_1(config)
    after, *_ = stage_2(config, distillation, free)
    assert len(after) == scene.frames
    assert all(np.isfinite(part).all() for part in (after.translation, after.orientation, after.body_pose))


def test_two_frames_are_refused(composed):
    with pytest.raises(InputError, match=r"scene.frames must be 3 or more"):
        to_config(composed("scene.frames=2", "scene.contact_frame=1"))


def half_turns(motion: Motion) -> Motion:
    """Every joint turned by pi, the pelvis upside down and facing back."""
    pose = np.zeros_like(motion.body_pose)
    pose[..., 0] = np.pi
    orientation = np.tile(np.array([-1.0, 0, 0, 0, 1, 0], dtype=np.float32), (len(motion), 1))
    return Motion(motion.translation, orientation, pose, motion.fps)


def test_half_turns_are_followed(composed, kick):
    config = to_config(composed(*SMALL, "stage.coordinate.iterations=2"))
    start = half_turns(kick[1])
    after, *_ = stage_2(config, kick[0], start)
    assert all(np.isfinite(part).all() for part in (after.translation, after.orientation, after.body_pose))


@pytest.mark.parametrize("rows", [(0, 0, 0, 0, 0, 0), (1, 0, 0, 1, 0, 0), (1, 0, 0, 2, 0, 0)])
def test_degenerate_orientation_is_refused(composed, kick, rows):
    """Two rows that span no plane are no rotation."""
    config = to_config(composed(*SMALL, "stage.coordinate.iterations=2", "scene.approach=none"))
    orientation = kick[1].orientation.copy()
    orientation[3] = rows
    broken = Motion(kick[1].translation, orientation, kick[1].body_pose, kick[1].fps)
    target = find_target(build_scene(config), kick[1], config)
    with pytest.raises(RunError, match="not finite"):
        stage_2(config, kick[0], broken, target)


@pytest.mark.parametrize("arms_out", [False, True])
def test_whoever_would_start_inside_the_object_stands_back(composed, arms_out):
    """The hip is to touch a ball at the right: with a hanging arm between, or one too long to step back from."""
    config = to_config(composed(*SMALL, f"scene.placement.position=[1.2,0,{1.45 if arms_out else 0.9}]"))
    scene = build_scene(config)
    trajectory, _ = free_motion(scene, at_rest, quiet())
    still, hip = stand_motion(scene.body, scene.frames, scene.fps), Target(0, 10, "scene")
    sway = 1e-4 * np.arange(scene.frames)[:, None] * np.array([0.0, 1.0, 0.0])  # who stands quite still is turned first
    still = replace(still, translation=(still.translation + sway).astype(np.float32))
    if arms_out:
        t_pose = replace(still, body_pose=np.zeros_like(still.body_pose))
        with pytest.raises(InputError, match="inside the person at t = 0"):
            approach(scene, t_pose, trajectory, hip)
        return
    placed, same = approach(scene, still, trajectory, hip)
    assert same == hip
    assert is_apart(scene, placed)
    assert not is_apart(scene, shifted(placed, np.array([BACK_STEP, 0.0, 0.0])))
    np.testing.assert_allclose(placed.translation[:, 2], still.translation[:, 2])


def test_without_iterations_nothing_moves(composed):
    config = to_config(composed(*SMALL, "stage.coordinate.iterations=0", "scene.approach=none"))
    scene = build_scene(config)
    still = stand_motion(scene.body, scene.frames, scene.fps)
    after, *_ = stage_2(config, None, still, find_target(scene, still, config))
    np.testing.assert_allclose(after.translation, still.translation, atol=1e-6)


def test_seeds_differ_and_repeat(composed):
    config = to_config(composed(*SMALL))
    scene, conf = build_scene(config), config.stage.motion
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", False)
    first, again, other = (
        sample_motions(distillation, conf.sampling, scene.frames, scene.fps, [seed])[0].body_pose for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_runs_of_a_batch_are_the_runs_of_their_seeds(composed):
    """Stages 1 and 2: what a run draws, wants and is told does not depend on the others beside it."""
    short = ("stage.motion.iterations=3", "stage.motion.sample_steps=4", "stage.coordinate.iterations=3")
    config = to_config(composed(*SMALL, *short))
    scene, conf, seeds = build_scene(config), config.stage.motion, (3, 1, 4)
    assert isinstance(conf, HMSD)
    distillation = conf.prior(scene, "cpu", False)

    def both(seeds) -> tuple[list[Motion], list[StageReport]]:
        motions = conf.motions(scene, distillation, seeds, [quiet() for _ in seeds])
        walk = walk_of(config, seeds, distillation, motions)
        walk.coordinate()
        return [state.motion for state in walk.states], [stages.reports[0] for stages in walk.stages]

    together, told = both(seeds)
    for seed, motion, stage in zip(seeds, together, told, strict=True):
        (alone,), (said,) = both([seed])
        for part in ("translation", "orientation", "body_pose"):
            apart = np.abs(getattr(motion, part) - getattr(alone, part))
            # Adam steps by its rate whichever way a gradient of next to nothing points, and rounding decides that.
            assert np.quantile(apart, 0.99) < 2e-3 and apart.max() < 6 * 2 * 0.005
        assert stage.numbers == pytest.approx(said.numbers, abs=5e-3)
    assert np.abs(together[0].body_pose - together[1].body_pose).max() > 0.1
