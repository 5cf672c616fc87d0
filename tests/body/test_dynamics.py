"""A person as a body with mass: what it weighs, how it follows its motion, and what a blow does to it."""

from dataclasses import replace

import numpy as np
import pytest

from hoi.body.dynamics import Person
from hoi.body.mass import masses_of
from hoi.body.people import load_person
from hoi.body.skeleton import CHAINS, JOINT_NAMES
from hoi.body.skinning import joint_frames, joint_paths, stand_motion
from hoi.data import Motion
from hoi.errors import RunError

FPS = 20.0
FOOT, HAND = JOINT_NAMES.index("right_foot"), JOINT_NAMES.index("left_hand")
DE_LEVA = {"head": 0.0694, "left arm": 0.0271 + 0.0162 + 0.0061, "left leg": 0.1416 + 0.0433 + 0.0137, "trunk": 0.4346}
"""Shares of the body's mass, men (de Leva 1996, Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters)."""


@pytest.fixture(scope="module", name="man")
def the_man():
    return load_person("man")


def swinging(body, frames: int = 24) -> Motion:
    """On its feet, one leg and one arm swinging, the trunk turning."""
    motion = stand_motion(body, frames, FPS)
    time = np.arange(frames) / FPS
    for joint, axis, size in (
        ("right_hip", 0, -0.8),
        ("right_knee", 0, 0.9),
        ("left_shoulder", 2, 0.7),
        ("spine2", 1, 0.4),
    ):
        motion.body_pose[:, JOINT_NAMES.index(joint) - 1, axis] += size * np.sin(4 * time)
    return motion


def person(body, motion, start=0.0, **settings) -> Person:
    return Person(body, motion, **({"start": start, "gravity": 9.81, "recovery": 0.5, "one_piece": 0.85} | settings))


def momentum(somebody: Person):
    return somebody.parts.momentum()


@pytest.mark.parametrize(("name", "weight"), [("man", 76.0), ("woman", 60.0), ("child", 31.0), ("heavy", 107.0)])
def test_people_weigh_what_people_of_their_build_weigh(name, weight):
    """The volumes of the meshes that they were made from, times 1060 kg/m^3; the skin is 5% too large."""
    assert masses_of(load_person(name)).mass.sum() == pytest.approx(weight, rel=0.06)


def test_each_part_has_its_share_of_the_weight(man):
    masses = masses_of(man)
    for chain, share in DE_LEVA.items():
        assert masses.mass[list(CHAINS[chain])].sum() / masses.mass.sum() == pytest.approx(share, rel=0.47)
    moving = masses.mass > 0
    assert (np.linalg.eigvalsh(masses.inertia[moving]) > 0).all()
    left, right = (masses.mass[list(CHAINS[f"{side} leg"])].sum() for side in ("left", "right"))
    assert left == pytest.approx(right, rel=0.05)


@pytest.mark.parametrize("frames", [8, 200])
def test_without_a_push_the_motion_is_the_one_that_was_given(man, frames):
    motion = swinging(man, frames)
    somebody = person(man, motion)
    for _ in range(frames - 1):
        somebody.advance(1 / FPS)
    made = somebody.motion_made()
    apart = np.linalg.norm(joint_paths(man, made) - joint_paths(man, motion), axis=-1)
    assert apart.max() < 1e-5  # asked for: 1 mm
    turns = [joint_frames(man, each)[0] for each in (made, motion)]
    assert np.degrees(np.linalg.norm(turns[0] - turns[1], axis=(-1, -2)).max()) < 0.01
    assert somebody.settled


@pytest.mark.parametrize("one_piece", [0.0, 0.5, 0.85, 1.0])
@pytest.mark.parametrize("joint", [FOOT, HAND, JOINT_NAMES.index("spine3"), JOINT_NAMES.index("left_hip")])
def test_a_person_takes_up_the_momentum_that_it_is_given(man, joint, one_piece):
    motion = swinging(man)
    somebody = person(man, motion, start=0.31, one_piece=one_piece)
    point = somebody.parts.data.xpos[somebody.parts.part[joint]] + np.array([0.02, 0.05, -0.03])
    given = np.array([3.0, -20.0, 5.0])
    linear, angular = momentum(somebody)
    somebody.push(joint, point, given)
    after_linear, after_angular = momentum(somebody)
    np.testing.assert_allclose(after_linear - linear, given, atol=1e-9)
    np.testing.assert_allclose(after_angular - angular, np.cross(point, given), atol=1e-9)


@pytest.mark.parametrize("one_piece", [0.0, 0.85, 1.0])
@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_a_blow_adds_no_energy(man, restitution, one_piece):
    """Person and a thing at rest: what the thing has after it is no more than what the person lost."""
    somebody = person(man, swinging(man), start=0.31, one_piece=one_piece)
    point = somebody.parts.data.xpos[somebody.parts.part[FOOT]].copy()
    velocity = somebody.velocity(FOOT, point)
    normal = velocity / np.linalg.norm(velocity)
    inverse = somebody.inverse_mass(FOOT, point, normal)
    before = somebody.kinetic_energy()
    for mass in (0.001, 0.43, 20.0, 10_000.0):
        struck = person(man, swinging(man), start=0.31, one_piece=one_piece)
        given = (1 + restitution) * float(velocity @ normal) / (inverse + 1 / mass)
        struck.push(FOOT, point, -given * normal)
        apart = given / mass - float(struck.velocity(FOOT, point) @ normal)
        assert apart == pytest.approx(restitution * float(velocity @ normal), abs=1e-9)
        lost = before - struck.kinetic_energy() - 0.5 * given**2 / mass
        assert lost > -1e-9
        if restitution == 1 and one_piece in (0.0, 1.0):
            # Free joints keep all of it; so does a limb in one piece, but for the joints' own turning.
            assert lost == pytest.approx(0, abs=1e-6 * before) or one_piece == 1.0


def test_a_limb_in_one_piece_is_heavier(man):
    masses = []
    for one_piece in (0.0, 0.5, 0.85, 1.0):
        somebody = person(man, swinging(man), start=0.31, one_piece=one_piece)
        point = somebody.parts.data.xpos[somebody.parts.part[FOOT]]
        masses.append(1 / somebody.inverse_mass(FOOT, point, np.array([0.0, 1, 0])))
    assert masses == sorted(masses) and 0.3 < masses[0] and masses[-1] < 12


def test_a_pushed_person_comes_back_within_the_time_that_muscles_need(man):
    motion = stand_motion(man, 60, FPS)
    somebody = person(man, motion, recovery=0.5)
    chest = JOINT_NAMES.index("spine3")
    somebody.push(chest, somebody.parts.data.xpos[somebody.parts.part[chest]], np.array([0.0, -15.0, 0.0]))
    for _ in range(len(motion) - 1):
        somebody.advance(1 / FPS)
    apart = np.linalg.norm(joint_paths(man, somebody.motion_made()) - joint_paths(man, motion), axis=-1).max(axis=1)
    assert 0.005 < apart.max() < 0.2 and apart.argmax() <= 8
    assert apart[-1] < 0.05 * apart.max()


def test_the_ground_cannot_hold_a_person_beyond_friction(man):
    """Shoved hard it slides: the ground gives mu m g and no more."""
    motion = stand_motion(man, 60, FPS)
    somebody = person(man, motion, recovery=0.1)
    chest = JOINT_NAMES.index("spine3")
    somebody.push(chest, somebody.parts.data.xpos[somebody.parts.part[chest]], np.array([0.0, -200.0, 0.0]))
    somebody.advance(0.1)
    assert np.linalg.norm(somebody.ground_impulse[:2]) == pytest.approx(0.8 * somebody.parts.mass * 9.81 * 0.1, rel=0.1)
    assert np.isfinite(somebody.q).all()


def test_nobody_pushes_off_from_the_air(man):
    """Away from the ground nothing but gravity changes the momentum beyond what the motion itself does."""
    motion = stand_motion(man, 30, FPS)
    motion.translation[:, 2] += 2.0
    told, struck = person(man, motion), person(man, motion)
    chest = JOINT_NAMES.index("spine3")
    given = np.array([0.0, -30.0, 0.0])
    struck.push(chest, struck.parts.data.xpos[struck.parts.part[chest]], given)
    for somebody in (told, struck):
        somebody.advance(0.5)
    np.testing.assert_allclose(momentum(struck)[0] - momentum(told)[0], given, atol=0.02 * 30)


@pytest.mark.parametrize("recovery", [0.05, 0.5, 100.0])
@pytest.mark.parametrize("size", [1e-3, 10.0, 100.0])
def test_any_stiffness_and_any_blow_stay_finite(man, recovery, size):
    motion = swinging(man, 8)
    somebody = person(man, motion, recovery=recovery)
    somebody.push(FOOT, somebody.parts.data.xpos[somebody.parts.part[FOOT]], np.array([0.0, -size, 0.0]))
    somebody.advance(7 / FPS)
    assert np.isfinite(somebody.q).all() and np.isfinite(somebody.rates).all()


def test_a_blow_that_nobody_survives_is_refused(man):
    somebody = person(man, swinging(man, 8))
    somebody.push(FOOT, somebody.parts.data.xpos[somebody.parts.part[FOOT]], np.array([0.0, -1e5, 0.0]))
    with pytest.raises(
        RunError, match=r"thrown about at \S+ rad/s, 0.000 s into the motion, where 1000 can be followed"
    ):
        somebody.advance(1 / FPS)


def test_the_work_of_the_muscles_is_the_energy_that_the_motion_gains(man):
    """From rest to speed without a push: kinetic and potential energy."""
    motion = swinging(man)
    somebody = person(man, motion)
    body = somebody.parts

    def energy() -> float:
        return somebody.kinetic_energy() + body.mass * 9.81 * float(body.data.subtree_com[1][2])

    before = energy()
    somebody.advance(0.37)
    assert somebody.work == pytest.approx(energy() - before, abs=0.02 * abs(energy() - before) + 0.05)


def test_a_ghost_has_no_weight():
    body = load_person("man", 800)
    sparse = replace(
        body,
        cloud=type(body.cloud)(
            *(getattr(body.cloud, n)[::200] for n in ("means", "quaternions", "scales", "opacities", "sh"))
        ),
        skinning_weights=body.skinning_weights[::200],
    )
    with pytest.raises(RunError, match=r"has no volume: the surface of 4 Gaussians does not close"):
        masses_of(sparse)
