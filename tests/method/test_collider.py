"""The striking limb as capsules: their fit, their way through the scene, and what they do to a body in the MPM."""

from dataclasses import fields, replace

import numpy as np
import pytest
from bodies import HAND, carried, cloud_of, fist

from hoi.body.capsules import Capsules, carry, fit_capsule, fit_capsules, fit_union, surface_distance
from hoi.body.limb_collider import limb_collider, outside, spacing
from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_frames, posed_means, stand_motion
from hoi.config.validate import to_config
from hoi.data import ContactSearch, Material, Motion, Plane, Scene, SceneObject, State
from hoi.errors import RunError
from hoi.gaussians import fibonacci_sphere
from hoi.method.contact import find_contact
from hoi.method.object_motion import at_rest, free_motion
from hoi.method.resimulation import push_by
from hoi.mpm.collider import Collider
from hoi.mpm.solver import Simulation, ground_plane
from hoi.mpm.state import initial_state
from hoi.plan import make_plan
from hoi.reports import Stages
from hoi.stages.contact.impulse import Impulse

SOFT = Material("soft", "neo_hookean", 1e5, 0.3, 100.0, 0.6, 0.5)
BALL_RADIUS, DX = 0.1, 0.025


# --- fit -------------------------------------------------------------------------------------------------------------


def capsule_surface(start, end, radius, count, rng) -> np.ndarray:
    """Random points of a capsule's surface."""
    axis = end - start
    length, unit = np.linalg.norm(axis), axis / np.linalg.norm(axis)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = (out @ unit > 0).astype(float)
    side = rng.random(count) < length / (length + 2 * radius)
    ring = out - np.outer(out @ unit, unit)
    out[side] = (ring / np.linalg.norm(ring, axis=1, keepdims=True))[side]
    along[side] = rng.random(side.sum())
    return start + along[:, None] * axis + radius * out


def test_fit_finds_a_capsule_in_spite_of_outliers():
    rng = np.random.default_rng(0)
    start, end, radius = np.array([0.3, 0.1, -0.2]), np.array([0.45, 0.3, -0.1]), 0.05
    points = capsule_surface(start, end, radius, 400, rng) + rng.normal(0, 0.001, (400, 3))
    points[:40] = start + rng.uniform(-0.3, 0.3, (40, 3))
    found_start, found_end, found_radius = fit_capsule(points)
    if (found_end - found_start) @ (end - start) < 0:
        found_start, found_end = found_end, found_start
    assert found_radius == pytest.approx(radius, abs=0.002)
    np.testing.assert_allclose([found_start, found_end], [start, end], atol=0.006)


@pytest.mark.parametrize("limb", ["knee", "ankle", "foot", "elbow", "hand"])
def test_limbs_of_the_default_person_are_covered(limb):
    """At least 88% of the limb's Gaussians lie within 1.5 cm of its capsules' surface."""
    body = load_person("man", 8000, seed=0)
    joint = JOINT_NAMES.index(f"right_{limb}")
    capsules = fit_capsules(body, [joint])
    assert set(capsules.joints) == {joint}
    points = body.cloud.means[body.skinning_weights.argmax(axis=1) == joint]
    apart = surface_distance(points, capsules.starts, capsules.ends, capsules.radii)
    assert (np.abs(apart) <= 0.015).mean() >= 0.88
    assert capsules.radii.min() > 0.008


def test_capsules_are_carried_as_the_gaussians_are():
    """Where one joint alone moves the skin, skin and capsules stay together."""
    body = load_person("man", 4000, seed=0)
    motion = stand_motion(body, 3, 20.0)
    turned = motion.body_pose + np.random.default_rng(0).normal(0, 0.3, motion.body_pose.shape)
    motion = replace(motion, body_pose=turned.astype(np.float32))
    joint = JOINT_NAMES.index("left_elbow")
    rigid = np.flatnonzero(body.skinning_weights[:, joint] > 0.999)
    capsules = fit_capsules(body, [joint])
    before = surface_distance(body.cloud.means[rigid], capsules.starts, capsules.ends, capsules.radii)
    frames = [0.0, 0.7, 2.0]
    starts, ends = carry(capsules, body.rest_joints, *joint_frames(body, motion, frames))
    assert len(rigid) > 10
    for points, start, end in zip(posed_means(body, motion, frames, rigid), starts, ends, strict=True):
        np.testing.assert_allclose(surface_distance(points, start, end, capsules.radii), before, atol=2e-4)


# --- what a capsule does ---------------------------------------------------------------------------------------------


def ball(centre=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    axis = np.arange(-BALL_RADIUS + DX / 4, BALL_RADIUS, DX / 2)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[np.linalg.norm(points, axis=1) < BALL_RADIUS]
    return points + centre, np.full(len(points), 4 / 3 * np.pi * BALL_RADIUS**3 / len(points))


def block(lowest: float = -0.075) -> tuple[np.ndarray, np.ndarray]:
    """A cube of 0.15 m around x = y = 0."""
    axis = np.arange(0, 0.15, DX / 2) + DX / 4 - 0.075
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return points + np.array([0, 0, lowest + 0.075]), np.full(len(points), (DX / 2) ** 3)


def moving_capsule(start, velocity, duration, radius=0.04, axis=(0.06, 0, 0), friction=0.5) -> Collider:
    times = np.linspace(0, duration, 9)
    centres = (np.asarray(start, float) + times[:, None] * np.asarray(velocity, float))[:, None]
    return Collider(times, centres - np.asarray(axis), centres + np.asarray(axis), np.array([radius]), friction)


def strike(collider: Collider, duration: float, points, volumes, gravity=(0.0, 0, 0), planes=()):
    """The simulation after `duration`, its state and the masses."""
    masses = volumes * SOFT.density
    state = initial_state(points, masses, [0, 0, 0])
    run = Simulation(state, volumes, SOFT, dx=DX, gravity=gravity, planes=planes, collider=collider,
                     precision="float64")  # fmt: skip
    run.advance(duration)
    return run, run.state(), masses


def momentum(state, masses) -> np.ndarray:
    return masses @ state.velocities


def spin(state, masses, centre) -> np.ndarray:
    """Angular momentum about `centre`: that of the particles and of their affine motion."""
    c = state.affine
    own = np.stack([c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], axis=-1)
    return (masses[:, None] * (np.cross(state.positions - centre, state.velocities) + DX**2 / 4 * own)).sum(axis=0)


@pytest.mark.parametrize("radius", [0.06, 0.04, 0.01])
def test_a_capsule_of_any_thickness_drives_the_ball_away(radius):
    """It meets the surface, not a place before it, and does not go through; the momentum is all accounted for."""
    reach = BALL_RADIUS + radius
    collider = moving_capsule([0, -reach - 0.01, 0], [0, 5, 0], 0.05, radius)
    points, volumes = ball()
    run, state, masses = strike(collider, 0.0019, points, volumes)  # 0.1 mm before it arrives
    assert np.abs(state.velocities).max() == 0 and run.pushes == []
    run.advance(0.05)
    state = run.state()
    np.testing.assert_allclose(momentum(state, masses), run.collider_impulse, rtol=0.01, atol=1e-6)
    velocity = momentum(state, masses) / masses.sum()
    assert 1.6 * 5 < velocity[1] < 2.0 * 5  # a heavy limb, an elastic ball: twice its speed, less what vibrates
    assert np.abs(velocity[[0, 2]]).max() < 0.01 * velocity[1]
    (push,) = run.pushes
    assert 0.001 < push.start + 0.001 < push.end < 0.03
    np.testing.assert_allclose(push.impulse, run.collider_impulse)
    starts, ends = collider.starts[-1], collider.ends[-1]
    assert outside(state.positions, starts, ends, collider.radii)


def test_penetration_stays_within_a_tenth_of_a_cell():
    collider = moving_capsule([0, -0.145, 0], [0, 5, 0], 0.03, 0.04)
    points, volumes = ball()
    run, _, _ = strike(collider, 1e-5, points, volumes)
    for time in np.linspace(0.001, 0.03, 30):
        run.advance(time)
        at = np.array([[0, -0.145 + 5 * time, 0]])
        offset = np.array([[0.06, 0, 0]])
        apart = surface_distance(run.state().positions, at - offset, at + offset, collider.radii)
        assert apart.min() > -0.1 * DX


def test_an_off_centre_kick_spins_the_block():
    """Struck on a flat face below its centre and driven along +y it turns about +x, by the angular impulse r x J."""
    points, volumes = block()
    below = np.array([0, -0.075 - 0.02 - 0.002, -0.045])
    collider = moving_capsule(below, [0, 3, 0], 0.03, radius=0.02, friction=0.0)
    run, state, masses = strike(collider, 0.03, points, volumes)
    impulse = run.collider_impulse
    np.testing.assert_allclose(impulse, momentum(state, masses), rtol=0.01, atol=1e-6)
    turned = spin(state, masses, masses @ state.positions / masses.sum())
    assert turned[0] > 0
    expected = np.cross(below + np.array([0, 0.02, 0]), impulse)
    np.testing.assert_allclose(turned, expected, atol=0.1 * float(np.linalg.norm(expected)))


def test_a_soft_ball_dents():
    """Pressed against a wall it is flatter where the limb is, and it comes back when the limb has gone."""
    wall = Plane(np.array([0, BALL_RADIUS, 0.0]), np.array([0, -1.0, 0]), "slip")
    times = np.array([0, 0.05, 0.1, 0.15])
    y = np.array([-0.145, -0.1, -0.1, -0.16])
    centres = np.stack([0 * y, y, 0 * y], axis=-1)[:, None]
    offset = np.array([0.06, 0, 0])
    collider = Collider(times, centres - offset, centres + offset, np.array([0.04]), 0.0)
    points, volumes = ball()
    run, pressed, _ = strike(collider, 0.1, points, volumes, planes=(wall,))
    near = np.abs(points[:, 2]) < 0.01
    rest = np.ptp(points[near, 1])
    assert np.ptp(pressed.positions[near, 1]) < rest - 0.01
    assert np.linalg.det(pressed.deformation_gradient).min() < 0.97
    run.advance(0.4)
    assert np.ptp(run.state().positions[near, 1]) > rest - 0.004


def test_a_slow_push_carries_the_object_along_for_as_long_as_it_lasts():
    """A hand that sets a block going from rest over the ground takes it along at its own speed."""
    points, volumes = block(lowest=0.0)
    times = np.linspace(0, 0.6, 61)
    y = -0.075 - 0.04 - 0.0005 + 0.3 * np.where(times < 0.2, times**2 / 0.4, times - 0.1)
    centres = np.stack([0 * y, y, 0 * y + 0.06], axis=-1)[:, None]
    offset = np.array([0.06, 0, 0])
    collider = Collider(times, centres - offset, centres + offset, np.array([0.04]), 0.3)
    run, state, masses = strike(collider, 0.3, points, volumes, gravity=(0, 0, -9.81), planes=(ground_plane(0.2),))
    before, given = masses @ state.positions / masses.sum(), run.collider_impulse
    run.advance(0.59)
    state = run.state()
    moved = masses @ state.positions / masses.sum() - before
    assert moved[1] / 0.29 == pytest.approx(0.3, rel=0.03)
    assert momentum(state, masses)[1] / masses.sum() == pytest.approx(0.3, rel=0.15)
    assert run.pushes[0].start < 0.1 and run.pushes[-1].end > 0.55
    # At a steady speed what the hand gives is what friction with the ground takes.
    braked = (run.collider_impulse - given)[1]
    assert braked == pytest.approx(0.2 * masses.sum() * 9.81 * 0.29, rel=0.15)


def test_without_friction_a_sliding_capsule_gives_no_tangential_momentum():
    """It slides along its axis over a flat face while it is pressed on: what it gives is along the normal."""
    points, volumes = block()
    given = {}
    for friction in (0.0, 0.5):
        collider = moving_capsule([-0.05, 0, 0.12], [2, 0, -0.5], 0.03, axis=(0.5, 0, 0), friction=friction)
        run, state, masses = strike(collider, 0.03, points, volumes)
        np.testing.assert_allclose(run.collider_impulse, momentum(state, masses), rtol=0.01, atol=1e-7)
        given[friction] = run.collider_impulse
    assert given[0.0][2] < 0 and abs(given[0.0][0]) < 1e-6 * abs(given[0.0][2])
    # It slips all the time; round as it is it also presses sideways, and friction counts that too.
    assert 0.5 <= given[0.5][0] / -given[0.5][2] < 0.6


def test_the_push_does_not_depend_on_the_frame_of_reference():
    """A ball that flies into a still capsule leaves as one that a capsule strikes."""
    points, volumes = ball()
    masses = volumes * SOFT.density
    run, struck, _ = strike(moving_capsule([0, -0.15, 0], [0, 4, 0], 0.04), 0.04, points, volumes)
    moving = initial_state(points, masses, [0, -4, 0])
    still = Simulation(moving, volumes, SOFT, dx=DX, gravity=(0, 0, 0), planes=(), precision="float64",
                       collider=moving_capsule([0, -0.15, 0], [0, 0, 0], 0.04))  # fmt: skip
    still.advance(0.04)
    struck_at = momentum(struck, masses)
    back = momentum(still.state(), masses) + masses.sum() * np.array([0, 4, 0])
    np.testing.assert_allclose(back, struck_at, atol=0.02 * float(np.linalg.norm(struck_at)))
    np.testing.assert_allclose(
        still.collider_impulse, run.collider_impulse, atol=0.02 * float(np.linalg.norm(struck_at))
    )


# --- from the scene --------------------------------------------------------------------------------------------------


def punch(start, velocity, frames: int = 8, fps: float = 20.0) -> tuple[Scene, Motion]:
    """A ball that lies still in empty space without gravity, and a fist on its way."""
    points, volumes = ball(centre=(0, 0, 1))
    surface = BALL_RADIUS * fibonacci_sphere(1500) + [0, 0, 1]
    count = len(surface)
    cloud = cloud_of(surface, 0.005, opacity=1, dtype=np.float64)
    total = volumes.sum()
    share = 1e-3 * total / count
    thing = SceneObject("ball", cloud, np.concatenate([surface, points]),
                        np.concatenate([np.full(count, share), 0.999 * volumes]), SOFT, np.zeros(3), np.zeros(3),
                        2 * BALL_RADIUS)  # fmt: skip
    scene = Scene("punch", fist(), thing, "a person punches a ball", frames, fps, np.zeros(3))
    return scene, carried(start, velocity, frames, fps)


def search(scene: Scene, motion: Motion):
    with Stages().stage("free", 1) as stage:
        free, states = free_motion(scene, at_rest, stage)
    found = find_contact(scene, motion, free, tau=0.05, distance=0.01, between_frames=True)
    assert found.push is not None
    return free, states, found.push


@pytest.fixture
def conf(composed):
    return to_config(composed("stage/contact=collider", "stage.object.cells_across=8"))


def pushing(conf) -> dict:
    return {"samples": conf.stage.contact.samples, "friction": conf.stage.contact.friction}


def mover_of(conf):
    return conf.stage.object.mover(conf.object.size, 1, "cpu")


def test_the_collider_starts_at_the_last_moment_clear_of_the_object(conf):
    scene, motion = punch([0, -0.6, 1], [0, 3, 0])
    free, _, contact = search(scene, motion)
    collider, notes = limb_collider(scene, motion, free, contact, **pushing(conf))
    assert notes == ()
    start = collider.times[0] * scene.fps
    assert contact.frame - 3 / conf.stage.contact.samples < start <= contact.frame
    assert outside(scene.object.particles, collider.starts[0], collider.ends[0], collider.radii)
    np.testing.assert_allclose(np.diff(collider.times), 1 / (scene.fps * conf.stage.contact.samples))
    assert collider.times[-1] == pytest.approx((scene.frames - 1) / scene.fps)
    centres = 0.5 * (collider.starts + collider.ends)[:, 0]
    expected = np.array([0, -0.6, 1]) + collider.times[:, None] * [0, 3, 0]
    np.testing.assert_allclose(centres, expected, atol=0.002)
    assert collider.radii[0] == pytest.approx(0.05, abs=0.003)


def test_a_limb_that_begins_inside_the_object_is_refused(conf):
    scene, motion = punch([0, -0.12, 1], [0, 3, 0])
    free, _, contact = search(scene, motion)
    with pytest.raises(RunError, match=r"left arm is in the object from the first frame") as caught:
        limb_collider(scene, motion, free, contact, **pushing(conf))
    assert "\n" not in str(caught.value)


def test_a_punch_moves_the_ball_and_is_recorded_in_its_contact(conf):
    """Nothing is simulated before the limb comes; then the ball has the momentum that the contact says."""
    scene, motion = punch([0, -0.6, 1], [0, 3, 0])
    free, states, contact = search(scene, motion)
    collider, _ = limb_collider(scene, motion, free, contact, **pushing(conf))
    with Stages().stage("push", 1) as stage:
        start = float(collider.times[0]) * scene.fps
        trajectory, pushed, _, _ = push_by(scene, free, states, contact, start, collider, mover_of(conf), stage)
    before = int(collider.times[0] * scene.fps) + 1
    assert set(trajectory.phase[:before]) == {"rest"}
    np.testing.assert_array_equal(trajectory.positions[:before], free.positions[:before])
    mass = scene.object.masses.sum()
    np.testing.assert_allclose(mass * trajectory.com_velocity[-1], pushed.impulse, rtol=0.02, atol=1e-3 * mass)
    assert 4.2 < trajectory.com_velocity[-1][1] < 4.8  # 3 (1 + e), e of 0.6 less what the limb's capsules lose
    assert 0.002 < pushed.duration < 0.05
    np.testing.assert_allclose(pushed.v_post, pushed.impulse / mass, rtol=0.02)
    np.testing.assert_array_equal(pushed.v_formula, contact.v_formula)
    assert abs(stage.numbers["pushed_from"] - contact.frame) < 0.3


def test_a_finger_does_not_slip_between_the_particles_of_a_coarse_object(conf):
    scene, motion = punch([0, -0.6, 1], [0, 3, 0])
    free, _, contact = search(scene, motion)
    fine = limb_collider(scene, motion, free, contact, **pushing(conf))[0]
    coarse = replace(scene.object, cloud=replace(scene.object.cloud, means=scene.object.cloud.means * 12))
    collider, (note,) = limb_collider(replace(scene, object=coarse), motion, free, contact, **pushing(conf))
    assert spacing(scene.object.cloud.means) < fine.radii.min() < spacing(coarse.cloud.means)
    np.testing.assert_allclose(collider.radii, spacing(coarse.cloud.means))
    assert "thinner" in note


def test_the_plan_says_which_model_pushes(composed):
    steps = {step.name: step for step in make_plan(to_config(composed("stage/contact=collider"))).steps}
    assert steps["contact"].implementation == "collider" and "moving obstacle" in steps["resimulate"].reason
    steps = {step.name: step for step in make_plan(to_config(composed())).steps}
    assert steps["contact"].implementation == "impulse" and "from t_c" in steps["resimulate"].reason


def test_without_matter_to_press_a_collider_gives_the_impulse(composed):
    """w/o MPM: the same contact in all its settings, and the plan says what acts and why."""
    config = to_config(composed("stage/contact=collider", "stage/object=constant_velocity", "stage.contact.tau=0.07"))
    contact = config.stage.contact
    acts = contact.beside(config.stage.object)
    assert isinstance(acts, Impulse) and acts.tau == 0.07
    assert {each.name: getattr(acts, each.name) for each in fields(acts)}.items() <= vars(contact).items()
    assert contact.beside(to_config(composed()).stage.object) is contact
    plan = make_plan(config)
    assert plan.implementation("contact") == "impulse"
    assert any("constant_velocity has no matter" in each.because for each in plan.omissions)


def test_carry_follows_a_joint():
    capsules = Capsules(np.array([HAND]), np.array([[0.1, 0, 0]]), np.array([[0.2, 0, 0]]), np.array([0.05]))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    rotations = np.tile(turn, (2, 24, 1, 1))
    positions = np.tile([[1.0, 2, 3]], (2, 24, 1))
    starts, ends = carry(capsules, np.full((24, 3), 0.05), rotations, positions)
    np.testing.assert_allclose(starts[1, 0], [1.05, 2.05, 2.95])
    np.testing.assert_allclose(ends[0, 0], [1.05, 2.15, 2.95])


def test_a_limb_of_few_gaussians_is_one_capsule():
    """Shared out among several it would leave each too few."""
    points = np.random.default_rng(0).normal(0, 1, (14, 3)) * [0.2, 0.2, 0.2]
    starts, ends, radii = fit_union(points)
    assert len(radii) == 1 and np.isfinite([*starts[0], *ends[0], radii[0]]).all()


def test_a_person_without_volume_is_told_as_such_and_not_as_one_in_the_object(conf):
    """A fist has skin and no trunk; only a limb that starts in the object is told to stay away from it."""
    with Stages().stage("push", 1) as stage:
        for start, said in (
            (-0.6, r"^the person .* has no volume"),
            (-0.12, r"in the object .*; move scene.placement"),
        ):
            scene, motion = punch([0, start, 1], [0, 3, 0])
            free, states, contact = search(scene, motion)
            state = State(motion, free, None, ContactSearch((contact,), 0.0, contact.frame, contact.joint))
            with pytest.raises(RunError, match=said):
                conf.stage.contact.answer(scene, state, states, mover_of(conf), stage)
