"""The person answers: one impulse shared between limb and object, and a push that both sides feel."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import cloud_of

from hoi.body.capsules import fit_capsules
from hoi.body.dynamics import Person
from hoi.body.people import load_person
from hoi.body.pushing import Pushing
from hoi.body.skeleton import CHAINS, JOINT_NAMES
from hoi.body.skinning import stand_motion
from hoi.data import Contact, Material, SceneObject
from hoi.errors import RunError
from hoi.method.contact import exchange, impulse
from hoi.method.reaction import react
from hoi.mpm.solver import Simulation
from hoi.mpm.state import angular_momentum, initial_state, kick, linear_momentum
from hoi.reports import Stages

FPS, FOOT = 20.0, JOINT_NAMES.index("right_foot")


@pytest.fixture(scope="module", name="man")
def the_man():
    return load_person("man", 8000)


def plate(size=(0.4, 0.4, 0.04), mass: float = 1.0, restitution: float = 0.5) -> SceneObject:
    axes = [np.linspace(-0.5, 0.5, n) * s for n, s in zip((9, 9, 3), size, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    material = Material("wood", "neo_hookean", 1e6, 0.3, 1000.0, restitution, 0.5)
    volumes = np.full(len(points), mass / 1000 / len(points))
    return SceneObject("plate", cloud_of(points, 0.01), points, volumes, material, np.zeros(3), np.zeros(3), max(size))


def blow(point, normal, velocity) -> Contact:
    zero = np.zeros(3)
    v_in, formula = impulse(np.asarray(velocity, float), zero, np.asarray(normal, float), 0.5)
    return Contact(
        5.0, FOOT, 0.5, np.asarray(point, float), np.asarray(normal, float), np.asarray(velocity, float), zero, v_in,
        zero, zero, 0.0, v_formula=formula,
    )  # fmt: skip


def test_a_limb_that_nothing_stops_gives_the_papers_velocity():
    thing = plate()
    state = initial_state(thing.particles, thing.masses, thing.velocity)
    made = exchange(blow([0, 0, -0.02], [0, 0, 1], [0.3, 0.1, 4.0]), thing, state, 0.0)
    np.testing.assert_allclose(made.v_post, made.v_formula, atol=1e-12)
    np.testing.assert_allclose(made.spin, 0, atol=1e-12)
    assert made.limb_mass == np.inf


@pytest.mark.parametrize("limb", [0.0, 0.5, 10.0])
def test_off_centre_the_point_and_not_the_centre_bounces(limb):
    """Conserved: momentum, angular momentum about the point; the touched points part at e times what they came with."""
    thing = plate()
    spinning = initial_state(thing.particles, thing.masses, [0, 0.2, 0], [0.5, 0, 0.2])
    contact = blow([0.15, 0.05, -0.02], [0, 0, 1], [0, 0, 4.0])
    made = exchange(contact, thing, spinning, limb)
    after = kick(spinning, made.v_post - made.v_object, made.spin)
    gained = linear_momentum(after, thing.masses) - linear_momentum(spinning, thing.masses)
    np.testing.assert_allclose(gained, made.impulse, atol=1e-12)
    turned = angular_momentum(after, thing.masses, 0.0) - angular_momentum(spinning, thing.masses, 0.0)
    np.testing.assert_allclose(turned, np.cross(contact.point, made.impulse), atol=1e-12)

    def approach(state, v_limb: float) -> float:
        at_point = state.velocities[0] + state.affine[0] @ (contact.point - state.positions[0])
        return v_limb - float(at_point @ contact.normal)

    after_limb = 4.0 - limb * float(made.impulse @ contact.normal)
    assert approach(after, after_limb) == pytest.approx(-0.5 * approach(spinning, 4.0), rel=1e-9)
    assert np.linalg.norm(made.v_post - made.v_object) < np.linalg.norm(contact.v_formula)


@pytest.mark.parametrize("mass", [0.001, 0.43, 19.0, 10_000.0])
@pytest.mark.parametrize("speed", [0.1, 8.0, 50.0])
def test_object_and_person_share_a_blow_or_it_is_refused(man, mass, speed):
    person = Person(man, stand_motion(man, 12, FPS), start=0.25, gravity=9.81, recovery=0.3, one_piece=0.85)
    point = person.parts.data.xpos[person.parts.part[FOOT]] + np.array([0, 0.1, -0.03])
    thing = plate(mass=mass)
    limb = person.inverse_mass(FOOT, point, np.array([0.0, 1, 0]))
    state = initial_state(thing.particles + point, thing.masses, thing.velocity)
    made = exchange(blow(point, [0, 1, 0], [0, speed, 0]), thing, state, limb)
    with Stages().stage("test", 1) as stage:
        try:
            motion = react(person, [replace(made)], stage)
        except RunError as error:
            assert speed == 50.0 and "thrown about at" in str(error)
            return
    assert np.isfinite(motion.body_pose).all() and np.isfinite(motion.translation).all()
    assert np.linalg.norm(made.v_post) <= np.linalg.norm(made.v_formula) + 1e-12
    assert made.limb_mass == pytest.approx(1 / limb)


def test_an_answer_too_small_to_see_is_left_out(man):
    motion = stand_motion(man, 12, FPS)
    person = Person(man, motion, start=0.25, gravity=9.81, recovery=0.3, one_piece=0.85)
    point = person.parts.data.xpos[person.parts.part[FOOT]].copy()
    contact = replace(blow(point, [0, 1, 0], [0, 1, 0]), impulse=np.array([0, 1e-3, 0]))
    with Stages().stage("test", 1) as stage:
        assert react(person, [contact], stage) is motion
    assert "left out: it would move by 0.0" in stage.notes[0]


def thrown_at(man, friction: float, precision: str):
    """A ball of 2 kg flies at the chest of a person who floats without weight, all of it limp."""
    motion = stand_motion(man, 10, FPS)
    motion.translation[:, 2] += 5.0
    person = Person(man, motion, start=0.0, gravity=0.0, recovery=1e4, one_piece=0.85)
    capsules = fit_capsules(man, [joint for joints in CHAINS.values() for joint in joints])
    pushing = Pushing(person, capsules, capsules.radii, friction)
    chest = person.parts.data.xpos[person.parts.part[JOINT_NAMES.index("spine3")]]
    dx, radius = 0.02, 0.08
    axis = np.arange(-radius + dx / 4, radius, dx / 2)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[np.linalg.norm(points, axis=1) < radius] + chest + np.array([0.03, 0.3, 0.04])
    volumes = np.full(len(points), (dx / 2) ** 3)
    material = Material("ball", "neo_hookean", 1e5, 0.3, 2.0 / volumes.sum(), 0.5, 0.5)
    run = Simulation(
        initial_state(points, volumes, [0, -5.0, 0]), volumes, material, dx=dx, gravity=(0, 0, 0), planes=(),
        collider=pushing, precision=precision,
    )  # fmt: skip
    return person, pushing, run


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-9), ("float32", 1e-4)])
def test_person_and_ball_in_free_space_keep_their_momentum(man, precision, tolerance):
    person, pushing, run = thrown_at(man, 0.5, precision)
    masses = run.masses
    linear, angular = (a + b for a, b in zip(person.parts.momentum(), momenta(run), strict=True))
    kinetic = person.kinetic_energy() + run.energies(run.state()).sum()
    lost, take = np.zeros(3), pushing.take

    def counted(parts, wrenches) -> None:
        before = pushing.rates
        take(parts, wrenches)
        lost[:] += (person.parts.inertia() @ (before - pushing.rates))[:3]

    pushing.take = counted
    run.advance(0.09)
    given = run.collider_impulse
    assert given[1] > 8.0
    np.testing.assert_allclose(lost, given, rtol=0, atol=tolerance * np.linalg.norm(given))
    after_linear, after_angular = (a + b for a, b in zip(person.parts.momentum(), momenta(run), strict=True))
    np.testing.assert_allclose(after_linear, linear, atol=0.01 * np.linalg.norm(given))
    np.testing.assert_allclose(after_angular, angular, atol=0.01 * np.linalg.norm(angular))
    assert person.kinetic_energy() + run.energies(run.state()).sum() <= 1.01 * kinetic
    assert masses.sum() == pytest.approx(2.0)


def momenta(run) -> tuple[np.ndarray, np.ndarray]:
    state = run.state()
    return linear_momentum(state, run.masses), angular_momentum(state, run.masses, run.dx)
