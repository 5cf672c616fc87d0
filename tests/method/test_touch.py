"""Touch of coarse and large Gaussians, the touched surface's normal, and what people call the limb."""

import numpy as np
import pytest
from bodies import carried, cloud_of, fist

from hoi.data import GaussianCloud, Material, ObjectTrajectory, Scene, SceneObject
from hoi.gaussians import fibonacci_sphere
from hoi.method.contact import find_contact
from hoi.method.touch import contact_normal, plates_of, slack_of, spacing, surface_normal, touch

FPS, FRAMES, D = 20.0, 12, 0.01
STEEL = Material("steel", "neo_hookean", 1e5, 0.3, 1000.0, 0.6, 0.5)


def box(size, gap, fill=None) -> tuple[np.ndarray, np.ndarray]:
    """Points on the faces of a box around the origin, `gap` apart, and points that fill it."""
    half, points = np.asarray(size) / 2, []
    for axis in range(3):
        across = [np.linspace(-h, h, round(2 * h / gap) + 1) for k, h in enumerate(half) if k != axis]
        face = np.stack(np.meshgrid(*across), -1).reshape(-1, 2)
        points += [np.insert(face, axis, side * half[axis], axis=1) for side in (-1, 1)]
    count = [max(round(2 * h / (fill or gap)), 2) for h in half]
    inner = [np.linspace(-h, h, n + 1)[:-1] + h / n for h, n in zip(half, count, strict=True)]
    return np.unique(np.concatenate(points).round(6), axis=0), np.stack(np.meshgrid(*inner), -1).reshape(-1, 3)


def ball(radius=0.15) -> tuple[np.ndarray, np.ndarray]:
    inner = np.stack(np.meshgrid(*[np.arange(-radius, radius, radius / 6)] * 3), -1).reshape(-1, 3)
    return radius * fibonacci_sphere(4000), inner[np.linalg.norm(inner, axis=1) < 0.95 * radius]


def thing_of(skin, inside=(), scales=None) -> SceneObject:
    particles = np.concatenate([skin, np.reshape(inside, (-1, 3))])
    cloud = cloud_of(skin, 0.005, dtype=np.float64)
    if scales is not None:
        cloud = GaussianCloud(cloud.means, cloud.quaternions, np.asarray(scales, float), cloud.opacities, cloud.sh)
    volumes, zero = np.full(len(particles), np.ptp(skin, axis=0).prod() / len(particles)), np.zeros(3)
    return SceneObject("thing", cloud, particles, volumes, STEEL, zero, zero, float(np.ptp(skin, axis=0).max()))


def still(thing: SceneObject) -> ObjectTrajectory:
    com = thing.particles.mean(axis=0)
    repeat = [np.tile(each, (FRAMES, *[1] * np.ndim(each))) for each in (thing.particles, com, np.zeros(3))]
    return ObjectTrajectory(*repeat, energy=np.zeros((FRAMES, 3)))


def strike(thing: SceneObject, start, velocity, count=600, to_com=False):
    motion, body = carried(start, velocity, FRAMES, FPS), fist(count, 0.04)
    scene = Scene("strike", body, thing, "", FRAMES, FPS, np.zeros(3))
    return find_contact(scene, motion, still(thing), tau=0.05, distance=D, between_frames=True, to_com=to_com)


def touched(thing: SceneObject, centre):
    limb = np.asarray(centre) + 0.04 * fibonacci_sphere(600)
    found = touch(limb, thing.cloud.means, D)
    assert found.point is not None
    return found


def off(first, second) -> float:
    """Angle between [deg]."""
    return float(np.degrees(np.arccos(np.clip(np.dot(first, second), -1, 1))))


@pytest.mark.parametrize("direction", fibonacci_sphere(7))
def test_ball_is_pushed_through_its_centre(direction):
    thing = thing_of(*ball())
    found = touched(thing, direction * 0.19)
    com = np.zeros(3)
    assert off(surface_normal(found, thing.particles, thing), -direction) < 5
    given = contact_normal(found, thing.particles, thing, com, np.zeros(3), to_com=False)
    np.testing.assert_array_equal(given, contact_normal(found, thing.particles, thing, com, np.zeros(3), to_com=True))


@pytest.mark.parametrize("aside", [(0, 0), (0.05, 0.02), (0.16, 0.1), (0.17, 0.17), (-0.17, 0.0)])
def test_face_of_a_box_is_pushed_square_up_to_its_edge(aside):
    thing = thing_of(*box((0.4, 0.4, 0.4), 0.01, 0.02))
    found = touched(thing, [aside[0], -0.239, aside[1]])
    assert off(surface_normal(found, thing.particles, thing), [0, 1, 0]) < 2
    if aside == (0, 0):
        assert off(contact_normal(found, thing.particles, thing, np.zeros(3), np.zeros(3), to_com=True), [0, 1, 0]) < 2


def test_row_of_touched_gaussians_has_the_normal_of_its_neighbours():
    """As under the side of a hand; the filling is coarse, as that of large objects is."""
    thing = thing_of(*box((0.6, 0.6, 1.2), 0.02, 0.05))
    for tilt in (0.0, 0.5, 1.0, 1.5):
        along = np.linspace(-0.05, 0.05, 60)[:, None] * [np.cos(tilt), 0, np.sin(tilt)]
        found = touch(along + np.array([-0.12, -0.303, 0.36]), thing.cloud.means, D)
        assert len(found.points) >= 3
        assert off(surface_normal(found, thing.particles, thing), [0, 1, 0]) < 2


def test_edge_of_a_box_is_pushed_between_its_faces():
    thing = thing_of(*box((0.4, 0.4, 0.4), 0.01, 0.02))
    found = touched(thing, [-0.225, -0.225, 0.1])
    assert off(surface_normal(found, thing.particles, thing), np.array([1, 1, 0]) / np.sqrt(2)) < 15


@pytest.mark.parametrize("filled", [True, False])
@pytest.mark.parametrize("thickness", [0.005, 0.02])
@pytest.mark.parametrize("side", [-1, 1])
def test_plate_that_is_hit_square_leaves_along_the_strike(filled, thickness, side):
    skin, inside = box((0.4, thickness, 0.4), 0.01, 0.004)
    thing = thing_of(skin, inside if filled else ())
    contact = strike(thing, [0.15, side * 0.4, 0.1], [0, -side * 10, 0]).contacts[-1]
    assert off(contact.normal, [0, -side, 0]) < 3
    assert contact.v_in == pytest.approx(10, rel=0.01)
    assert off(contact.v_formula / np.linalg.norm(contact.v_formula), [0, -side, 0]) < 3
    centre = strike(thing, [0.15, side * 0.4, 0.1], [0, -side * 10, 0], to_com=True).contacts[-1]
    assert off(centre.normal, [0, -side, 0]) > 60


def test_neck_of_a_guitar_is_pushed_along_the_strike():
    """A beam far from the body that holds the mass: n to the centre of mass leads along the neck."""
    body, neck = box((0.36, 0.1, 0.44), 0.01, 0.02), box((0.05, 0.025, 0.6), 0.01, 0.0125)
    up = np.array([0, 0, 0.52])
    thing = thing_of(np.concatenate([body[0], neck[0] + up]), np.concatenate([body[1], neck[1] + up]))
    contact = strike(thing, [0.0, -0.4, 0.7], [0, 5, 0]).contacts[-1]
    assert off(contact.normal, [0, 1, 0]) < 10
    assert off(strike(thing, [0.0, -0.4, 0.7], [0, 5, 0], to_com=True).contacts[-1].normal, [0, 1, 0]) > 60


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("at", [(0.1, 0.1), (0.0, 0.1), (0.02, 0.03), (0.3, -0.1)])
def test_coarse_cloud_is_touched_between_its_gaussians(flat, at):
    """Gaussians 0.2 m apart; the fist of 4 cm comes down in between, where none is within d_contact."""
    skin, inside = box((0.8, 0.8, 0.8), 0.2, 0.1)
    scales = np.full((len(skin), 3), 0.1)
    if flat:
        scales[np.arange(len(skin)), np.abs(skin).argmax(axis=1)] = 0.005
    contact = strike(thing_of(skin, inside, scales), [at[0], -1.0, at[1]], [0, 6, 0]).contacts[-1]
    front = -1.0 + 6 * contact.frame / FPS + 0.04
    assert contact.v_in > 0
    assert -0.43 < front < -0.37 if flat else -0.55 < front < -0.37
    assert off(contact.normal, [0, 1, 0]) < 20
    assert np.linalg.norm(contact.point[[0, 2]] - at) < 0.12


def test_six_gaussians_are_a_cube():
    skin = np.concatenate([0.4 * np.eye(3), -0.4 * np.eye(3)])
    thing = thing_of(skin, box((0.8, 0.8, 0.8), 0.2, 0.1)[1], np.where(np.abs(skin) > 0.1, 0.01, 0.3))
    contact = strike(thing, [0.25, -1.0, -0.2], [0, 6, 0]).contacts[-1]
    assert -0.43 < -1.0 + 6 * contact.frame / FPS + 0.04 < -0.37


def test_plates_turn_with_the_object():
    skin, _ = box((0.8, 0.8, 0.8), 0.2)
    plates = plates_of(thing_of(skin, scales=np.full((len(skin), 3), (0.1, 0.1, 0.001))).cloud, D)
    assert plates is not None
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(plates.at(skin @ turn.T + 3).axes[5], turn, atol=1e-9)


def test_coarse_limb_reaches_half_its_spacing():
    limb, surface = 0.1 * np.stack(np.meshgrid(*[np.arange(3.0)] * 2, [0.0]), -1).reshape(-1, 3), np.zeros((400, 3))
    surface[:, 0], surface[:, 1] = 0.05, np.linspace(0, 0.2, 400)
    assert touch(limb, surface, D).fraction == 0
    assert touch(limb, surface, D, slack=slack_of(limb, D)).fraction > 0.5


def test_fine_clouds_are_points():
    fine = ball()[0]
    assert spacing(fine).max() < 2.5 * D
    assert plates_of(cloud_of(fine, 0.005), D) is None
    assert not slack_of(fine, D).any()
    assert plates_of(cloud_of(fine[:1], 0.005), D) is None
    assert plates_of(cloud_of(fine[:1], 0.2), D) is not None
