"""What a motion takes against cases whose forces are known, and against MuJoCo's inverse dynamics."""

# MuJoCo brings no types.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from analysis.metrics import METRICS
from analysis.metrics.inverse import acting, cone, from_ground, nearest, needed
from analysis.records import Record
from hoi.body.articulated import Articulated
from hoi.body.mass import masses_of
from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import stand_motion
from hoi.data import Body, Motion, Push, Run, fields_of
from tests.demo_run import make_run

G = np.array([0.0, 0.0, -9.81])
FPS, FRAMES = 20.0, 12
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module", name="man")
def the_man() -> Body:
    return load_person("man")


@pytest.fixture(scope="module", name="weight")
def the_weight(man) -> float:
    return float(masses_of(man).mass.sum() * 9.81)


@pytest.fixture(scope="module", name="run")
def a_run() -> Run:
    """An object that is kicked at frame 5.4, out of the person's reach and the ground's."""
    run, *_ = make_run(frames=FRAMES, gaussians=300, particles=400, contact_frame=5.4)
    return run


def standing(man: Body, frames: int = FRAMES, fps: float = FPS) -> Motion:
    motion = stand_motion(man, frames, fps)
    return replace(motion, translation=motion.translation.astype(np.float64))


def record(run: Run, man: Body, motion: Motion, **parts) -> Record:
    """The run's record with another person in it, and no contact unless it is given."""
    assert run.scene is not None
    scene = replace(run.scene, body=man, gravity=G)
    return Record(Path("run.mcap"), replace(run, scene=scene, state=replace(run.state, motion=motion, **parts)))


def still(run: Run, man: Body, motion: Motion) -> Record:
    return record(run, man, motion, contact=None)


def lifted(motion: Motion, path: np.ndarray) -> Motion:
    return replace(motion, translation=motion.translation + path)


def swinging(man: Body, frames: int, fps: float) -> Motion:
    """Arms, a leg and the trunk swing, and the whole person turns and drifts."""
    motion, time = standing(man, frames, fps), np.arange(frames) / fps
    pose, turn = motion.body_pose.astype(np.float64), np.sin(2 * time)
    for joint, axis, size in (("right_hip", 0, -0.8), ("right_knee", 0, 0.9), ("left_shoulder", 2, 0.7),
                              ("left_elbow", 1, -0.6), ("spine2", 1, 0.4), ("neck", 0, 0.3)):  # fmt: skip
        pose[:, JOINT_NAMES.index(joint) - 1, axis] += size * np.sin(4 * time + axis)
    cos, sin, none = np.cos(turn), np.sin(turn), 0 * turn
    rows = np.stack([cos, -sin, none, sin, cos, none], axis=1)
    drift = np.stack([0.3 * np.sin(3 * time), 0.2 * time, 0.1 * np.cos(5 * time)], axis=1)
    return replace(lifted(motion, drift), body_pose=pose, orientation=rows)


def test_who_stands_is_carried_by_the_ground(run, man, weight):
    made = still(run, man, standing(man))
    assert METRICS["root_force_95"](made) < 1e-3 and METRICS["root_torque_95"](made) < 1e-3
    assert METRICS["beyond_strength"](made) == 0
    assert 0.01 < METRICS["strain"](made) < 0.7
    need = needed(man, masses_of(man), standing(man), G)
    left = need.force.sum(axis=1)
    turn = need.moment.sum(axis=1) - np.cross(need.joints[:, 0], left)
    force, moment = from_ground(need, np.concatenate([left, turn], axis=1))
    np.testing.assert_allclose(force.sum(axis=1), np.tile(weight * UP, (FRAMES - 2, 1)), atol=1e-3)
    feet = [JOINT_NAMES.index(f"{side}_ankle") for side in ("left", "right")]
    np.testing.assert_allclose(force[:, feet, 2].sum(axis=1), weight, rtol=1e-6)
    assert (force[:, feet, 2] > 0.35 * weight).all()  # on both
    torque = np.linalg.norm(need.torques(force, moment), axis=-1)
    assert torque[:, JOINT_NAMES.index("head")].max() < 4


def test_who_falls_needs_nothing_and_who_hovers_its_weight(run, man, weight):
    time = np.arange(FRAMES)[:, None] / FPS
    falling = still(run, man, lifted(standing(man), 4 * UP + [1.0, 2.0, 3.0] * time + 0.5 * G * time**2))
    for key in ("root_force", "root_force_95", "root_torque_95", "strain"):
        assert METRICS[key](falling) == pytest.approx(0, abs=1e-6)
    hovering = still(run, man, lifted(standing(man), 4 * UP))
    assert METRICS["root_force"](hovering) == pytest.approx(weight)
    assert METRICS["root_force_95"](hovering) == pytest.approx(weight)


def test_who_leans_too_far_is_held_by_a_torque_from_nowhere(run, man, weight):
    """Half a metre in front of the feet: from 40 cm or so in front of where the ground can push."""
    motion = standing(man)
    lean = np.radians(45.0)
    turned = replace(
        motion,
        orientation=np.tile([-1.0, 0, 0, 0, np.sin(lean), np.cos(lean)], (FRAMES, 1)),
        translation=motion.translation * [1, 1, 0.73],
    )
    lost = still(run, man, turned)
    assert METRICS["root_torque"](lost) > 0.1 * weight


def test_what_a_slide_takes_beyond_friction(run, man, weight):
    """Accelerated along the ground at 12 m/s^2, of which soles give mu N; the nearest that they give presses harder."""
    time = np.arange(FRAMES)[:, None] / FPS
    made = still(run, man, lifted(standing(man), 0.5 * np.array([0.0, 12.0, 0.0]) * time**2))
    beyond = weight * (12 / 9.81 - 0.8) / np.hypot(1, 0.8)
    assert METRICS["root_force"](made) >= 0.99 * beyond
    given = nearest(cone(UP, 0.8).T, np.array([0.0, 12.0, 9.81])) @ cone(UP, 0.8)
    assert np.linalg.norm(given - [0, 12, 9.81]) == pytest.approx((12 - 0.8 * 9.81) / np.hypot(1, 0.8), rel=0.03)


def test_inverse_dynamics_are_those_of_mujoco(man):
    """Of order 2 in the time between frames."""
    masses, parts = masses_of(man), Articulated(man)
    parts.model.opt.gravity[:] = G
    errors = []
    for fps in (100.0, 200.0):
        motion = swinging(man, 5, fps)
        need = needed(man, masses, motion, G)
        q = parts.coordinates(motion, np.arange(5.0))
        before, after = (parts.difference(q[k], q[k + 1]) * fps for k in (1, 2))
        data = mujoco.MjData(parts.model)
        data.qpos[:], data.qvel[:], data.qacc[:] = q[2], 0.5 * (before + after), (after - before) * fps
        mujoco.mj_inverse(parts.model, data)
        ours = need.torques(np.zeros_like(need.force), np.zeros_like(need.force))[1]
        total, pelvis = need.force[1].sum(axis=0), data.xmat[1].reshape(3, 3)
        wrong = [abs(total - data.qfrc_inverse[:3]).max(), abs(ours[0] - pelvis @ data.qfrc_inverse[3:6]).max()]
        for joint, rate in list(parts.rate.items())[1:]:
            turn = data.xmat[parts.part[joint]].reshape(3, 3)
            wrong.append(abs(ours[joint] - turn @ data.qfrc_inverse[rate : rate + 3]).max())
        errors.append(max(wrong))
    assert np.linalg.norm(total) > 500 and np.linalg.norm(ours[JOINT_NAMES.index("right_hip")]) > 10
    assert errors[1] < 0.02 and errors[0] / errors[1] == pytest.approx(4, rel=0.3)


@pytest.mark.parametrize("seconds", [0.0, 0.03, 0.2])
def test_momentum_closes_when_the_person_takes_what_it_gives(run, man, weight, seconds):
    """Both in free fall, their centres of mass pushed apart; an infinite limb does not budge."""
    search, mass = run.state.contact, weight / 9.81
    time, given = np.arange(FRAMES) / FPS, np.array([2.0, 30.0, 8.0])
    begin = 5.4 / FPS
    pushed = np.maximum(time - begin, 0) if seconds == 0 else ramp(time - begin, seconds)
    fall = 9 * UP + 0.5 * G * time[:, None] ** 2
    thing = float(run.scene.object.masses.sum())
    path = fall + [0.0, 0.7, 0.0] + pushed[:, None] * given / thing
    shape = run.scene.object.particles - run.scene.object.particles.mean(axis=0)
    trajectory = replace(run.state.trajectory, com=path, positions=(path[:, None] + shape).astype(np.float32))
    push = replace(search.push, frame=5.4, duration=seconds, impulse=given)
    search = replace(search, contacts=(push,))
    answers = lifted(standing(man), fall - pushed[:, None] * given / mass)
    made = record(run, man, answers, contact=search, trajectory=trajectory, target=None)
    assert METRICS["momentum_gap"](made) < 1e-5
    assert METRICS["momentum_gap_share"](made) < 1e-4
    infinite = record(run, man, lifted(standing(man), fall), contact=search, trajectory=trajectory, target=None)
    assert METRICS["momentum_gap"](infinite) == pytest.approx(np.linalg.norm(given), rel=1e-6)
    assert METRICS["momentum_gap_share"](infinite) == pytest.approx(100, rel=1e-6)
    late = replace(search, contacts=(replace(push, frame=FRAMES - 1.5),))
    assert np.isnan(METRICS["momentum_gap"](record(run, man, answers, contact=late, trajectory=trajectory)))


def test_a_second_push_is_given_by_the_person_too(run, man, weight):
    search, thing, mass = run.state.contact, float(run.scene.object.masses.sum()), weight / 9.81
    time = np.arange(FRAMES) / FPS
    pushes = (Push(3.2 / FPS, 4.1 / FPS, np.array([0.0, 20.0, 5.0])), Push(7.3 / FPS, 8.0 / FPS, np.array([3.0, 6, 0])))
    moved = sum(ramp(time - push.start, push.end - push.start)[:, None] * push.impulse for push in pushes)
    fall = 9 * UP + 0.5 * G * time[:, None] ** 2
    path = fall + [0.0, 0.7, 0.0] + moved / thing
    shape = run.scene.object.particles - run.scene.object.particles.mean(axis=0)
    trajectory = replace(run.state.trajectory, com=path, positions=(path[:, None] + shape).astype(np.float32))
    first = replace(search.push, frame=3.2, duration=0.9 / FPS, impulse=pushes[0].impulse)
    answers, changed = lifted(standing(man), fall - moved / mass), {"trajectory": trajectory, "target": None}
    both = replace(search, contacts=(first,), pushes=pushes)
    assert METRICS["momentum_gap"](record(run, man, answers, contact=both, **changed)) < 1e-5
    still_there = lifted(standing(man), fall)
    infinite = record(run, man, still_there, contact=both, **changed)
    assert METRICS["momentum_gap"](infinite) == pytest.approx(np.linalg.norm([3, 26, 5]), rel=1e-6)
    assert METRICS["momentum_gap_share"](infinite) == pytest.approx(100, rel=1e-6)


def ramp(time: np.ndarray, seconds: float) -> np.ndarray:
    """How far 1 m/s, reached evenly within some time, leads."""
    inside = time.clip(0, seconds)
    return 0.5 * inside**2 / seconds + np.maximum(time - seconds, 0)


@pytest.mark.parametrize(("first", "last"), [(3.0, 3.0), (4.3, 4.3), (2.1, 2.4), (2.5, 7.25)])
def test_a_push_spreads_over_the_frames_that_it_reaches(first, last):
    shares = acting(first, last, 12)
    assert shares.sum() == pytest.approx(1) and (shares >= 0).all()
    assert shares @ np.arange(1, 11) == pytest.approx((first + last) / 2)
    assert np.count_nonzero(shares) <= last - first + 3


def test_who_has_no_volume_or_no_ground_has_empty_cells(run, man):
    cloud, few = man.cloud, slice(None, None, 2000)
    thin = replace(cloud, **{name: value[few] for name, value in fields_of(cloud).items()})
    bare = still(run, replace(man, cloud=thin, skinning_weights=man.skinning_weights[few]), standing(man))
    floating = still(replace(run, scene=replace(run.scene, planes=())), man, standing(man))
    for made in (bare, floating):
        for key, metric in METRICS.items():
            if metric.group == "Dynamics":
                assert np.isnan(metric(made)), key
