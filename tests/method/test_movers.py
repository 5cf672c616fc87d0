"""Free motion, the impulse and re-simulation, and a run that fails on the way."""

from dataclasses import replace

import numpy as np
import pytest

from hoi.config.validate import to_config
from hoi.data import Contact
from hoi.errors import InputError, RunError
from hoi.method.object_motion import World, at_rest, free_motion, joint_motion
from hoi.method.resimulation import resimulate
from hoi.plan import make_plan
from hoi.record import read
from hoi.reports import Stages
from hoi.runner import jobs
from hoi.runner.scene import build_scene
from hoi.stages.object.mpm import MPM

SMALL = ["human.gaussians=1000", "scene.frames=8", "scene.contact_frame=4"]
COARSE = "stage.object.cells_across=6"
VACUUM = "stage.object.air_density=0"


@pytest.fixture
def scene_of(composed):
    def make(*overrides):
        config = to_config(composed(*SMALL, *overrides))
        return config, build_scene(config)

    return make


def mover_of(config):
    return config.stage.object.mover(config.object.size, 1, "cpu")


def contact_at(frame: float, delta_v, thing) -> Contact:
    """After which a limb that nothing stops has given a thing at rest that velocity."""
    zero, v = np.zeros(3), np.asarray(delta_v, float)
    normal, middle = v / np.linalg.norm(v), thing.masses @ thing.particles / thing.masses.sum()
    v_human = v / (1 + thing.material.restitution)
    return Contact(frame, 11, 1.0, middle - 0.1 * normal, normal, v_human, zero, 1.0, zero, zero, 0.0)


def run_stage(function):
    with Stages().stage("test", 1) as stage:
        return function(stage)


@pytest.mark.parametrize("spline", ["quadratic", "cubic"])
def test_free_fall_by_mpm(scene_of, spline):
    config, scene = scene_of(
        VACUUM,
        COARSE,
        f"stage.object.spline={spline}",
        "scene.placement.position=[0,2,3]",
        "scene.placement.velocity=[1,0,2]",
    )
    move = mover_of(config)
    trajectory, states = run_stage(lambda stage: free_motion(scene, move, stage))
    time = np.arange(scene.frames)[:, None] / scene.fps
    expected = trajectory.com[0] + time * [1, 0, 2] + 0.5 * time**2 * [0, 0, -9.81]
    np.testing.assert_allclose(trajectory.com, expected, atol=1e-4)
    assert len(states) == scene.frames and trajectory.phase[2:] == ("flight",) * (scene.frames - 2)
    assert trajectory.deformation_gradient is not None


def test_objects_that_move_together(scene_of):
    """One of two is thrown at the other, which lies still until it is hit; their momentum is that of the first."""
    config, scene = scene_of(COARSE, VACUUM, "scene.placement.position=[0,2,3]", "scene.placement.velocity=[4,0,0]")
    thing, still = scene.object, np.zeros(3)
    target = replace(thing, particles=thing.particles + np.array([2.5 * thing.size, 0, 0]), velocity=still)
    worlds = [World(each, scene.frames, scene.fps, still) for each in (thing, target)]
    move = config.stage.object.joint_mover(thing.size, 1, "cpu")
    (first, _), (second, _) = run_stage(lambda stage: joint_motion(worlds, move, stage, held=[False, True]))
    assert first.phase[1] == "flight" and second.phase[1] == "rest" and "mpm" in second.phase
    assert second.com_velocity[-1, 0] > 2 > first.com_velocity[-1, 0]
    np.testing.assert_allclose(first.com_velocity + second.com_velocity, [[4, 0, 0]] * scene.frames, atol=1e-3)
    assert second.energy.shape == (scene.frames, 3)
    with pytest.raises(InputError, match="must have one fps"):
        run_stage(lambda stage: joint_motion([worlds[0], replace(worlds[1], fps=7.0)], move, stage))


def test_what_a_walk_left_out_is_reported(scene_of):
    """Steps done and left out make up the whole, and every second has its phase."""
    turning = "scene.placement.angular_velocity=[0,0,2]"
    config, scene = scene_of(COARSE, VACUUM, "scene.placement.position=[0,2,3]", turning)
    with Stages().stage("test", 1) as stage:
        free_motion(scene, mover_of(config), stage)
    numbers = stage.numbers
    seconds = [numbers[f"seconds_{phase}"] for phase in ("mpm", "flight", "rest")]
    assert sum(seconds) == pytest.approx((scene.frames - 1) / scene.fps)
    assert 0 < numbers["steps"] < 0.2 * numbers["steps_left_out"]
    assert numbers["phase_changes"] == 1
    assert 0 < numbers["dt_least"] <= numbers["dt_most"]


def test_without_phases_every_step_is_taken(scene_of):
    """The same bits as the solver alone."""
    from hoi.mpm.solver import simulate
    from hoi.mpm.state import initial_state

    config, scene = scene_of(
        COARSE, "stage.object.phases=false", "stage.object.damping=false", "scene.placement.velocity=[1,0,2]"
    )
    scene = replace(scene, frames=3)
    move = mover_of(config)
    trajectory, states = run_stage(lambda stage: free_motion(scene, move, stage))
    thing, mpm = scene.object, config.stage.object
    plain = simulate(
        initial_state(thing.particles, thing.masses, thing.velocity),
        thing.volumes,
        thing.material,
        times=np.arange(3) / scene.fps,
        dx=mpm.cell(config.object.size),
        fraction=mpm.limit_fraction,
        planes=scene.planes,
    )
    assert set(trajectory.phase) == {"mpm"}
    for ours, theirs in zip(states, plain.states, strict=True):
        np.testing.assert_array_equal(ours.positions, theirs.positions)
        np.testing.assert_array_equal(ours.deformation_gradient, theirs.deformation_gradient)


def test_velocity_after_the_impulse_is_measured_on_the_way(scene_of):
    """A ball in the air leaves with V_post; the look 1 ms later is no frame and costs no walk of its own."""
    config, scene = scene_of(COARSE, VACUUM, "scene.placement.position=[0,2,3]", "scene.gravity=[0,0,0]")
    move = mover_of(config)
    free, states = run_stage(lambda stage: free_motion(scene, move, stage))
    with Stages().stage("test", 1) as stage:
        struck, _, _ = resimulate(scene, free, states, contact_at(3.0, [0, 5, 1], scene.object), 0.0, 1.0, move, stage)
    assert len(struck.com) == len(struck.phase) == scene.frames
    assert stage.numbers["v_post_error"] < 1e-4
    assert stage.numbers["seconds_mpm"] + stage.numbers["seconds_flight"] == pytest.approx(4 / scene.fps)


@pytest.mark.parametrize("t_c", [3.0, 3.4])
def test_resimulation_starts_at_the_moment_of_contact(scene_of, t_c):
    """A ball at rest in the air without gravity: straight on from t_c with V_post, untouched before."""
    config, scene = scene_of(COARSE, VACUUM, "scene.placement.position=[0,2,3]", "scene.gravity=[0,0,0]")
    move = mover_of(config)
    free, states = run_stage(lambda stage: free_motion(scene, move, stage))
    contact = contact_at(t_c, [0, 5, 1], scene.object)
    struck, _, _ = run_stage(lambda stage: resimulate(scene, free, states, contact, 0.0, 1.0, move, stage))
    time = np.maximum(np.arange(scene.frames) - t_c, 0)[:, None] / scene.fps
    np.testing.assert_allclose(struck.com, free.com[0] + time * [0, 5, 1], atol=1e-4)
    np.testing.assert_array_equal(struck.positions[:3], free.positions[:3])
    np.testing.assert_allclose(
        struck.com_velocity[int(np.ceil(t_c)) :], np.tile([0, 5, 1], (8 - int(np.ceil(t_c)), 1)), atol=1e-3
    )


def test_constant_velocity_is_a_straight_line_without_deformation(scene_of):
    config, scene = scene_of("stage/object=constant_velocity", "scene.placement.velocity=[1,2,3]")
    move = mover_of(config)
    trajectory, _ = run_stage(lambda stage: free_motion(scene, move, stage))
    time = np.arange(scene.frames)[:, None] / scene.fps
    np.testing.assert_allclose(trajectory.com, trajectory.com[0] + time * [1, 2, 3], atol=1e-9)
    assert trajectory.deformation_gradient is None
    mass = scene.object.masses.sum()
    np.testing.assert_allclose(trajectory.energy[:, 0], 0.5 * mass * 14, rtol=1e-6)


def test_at_rest_stays(scene_of):
    _, scene = scene_of()
    trajectory, _ = run_stage(lambda stage: free_motion(scene, at_rest, stage))
    assert np.ptp(trajectory.positions, axis=0).max() == 0
    assert set(trajectory.phase) == {"rest"}


def test_a_failed_run_is_recorded_as_failed(composed, tmp_path, monkeypatch):
    config = to_config(composed(*SMALL, COARSE, "ablation=no_mdm", "stage.coordinate.iterations=2", f"out={tmp_path}"))
    config = replace(
        config, scene=replace(config.scene, placement=replace(config.scene.placement, position=[0, 2, 1.0]))
    )

    def diverge(*_):
        raise RunError("diverged at frame 3; lower stage.object.dt")

    monkeypatch.setattr(MPM, "mover", lambda *_: diverge)
    with pytest.raises(RunError, match="diverged"):
        jobs.run([jobs.Job(config, tmp_path / "run.mcap", "seed: 0\n", {"seed": "0"})], make_plan(config))
    assert [file.name for file in tmp_path.iterdir()] == ["run.failed.mcap"]
    failed = read(tmp_path / "run.failed.mcap")
    assert failed.result["status"] == "failed" and "diverged" in failed.result["outcome"]
