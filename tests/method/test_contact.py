"""Detection and impulse on constructed cases."""

import numpy as np
import pytest
from bodies import HAND, carried, cloud_of, fist

from hoi.data import Body, Material, Motion, ObjectTrajectory, Scene, SceneObject
from hoi.gaussians import fibonacci_sphere
from hoi.method.contact import find_contact, impulse, touch

FPS, FRAMES = 20.0, 12
RADIUS, LIMB_RADIUS = 0.11, 0.05


@pytest.fixture(name="fist")
def fist_of_this_size() -> Body:
    return fist(400, LIMB_RADIUS)


def moving(start, velocity) -> Motion:
    return carried(start, velocity, FRAMES, FPS)


def ball(velocity=(0.0, 0.0, 0.0)) -> ObjectTrajectory:
    com = np.array([0.0, 0, 1]) + np.arange(FRAMES)[:, None] / FPS * np.asarray(velocity)
    return ObjectTrajectory(
        positions=com[:, None] + RADIUS * fibonacci_sphere(4000),
        com=com,
        com_velocity=np.tile(np.asarray(velocity, float), (FRAMES, 1)),
        energy=np.zeros((FRAMES, 3)),
    )


def search(body, motion, trajectory, between_frames=True, widened=True):
    means, zero = trajectory.positions[0], np.zeros(3)
    material = Material("ball", "neo_hookean", 1e5, 0.3, 1.0, 0.6, 0.5)
    volumes = np.full(len(means), 0.43 / len(means))  # 0.43 kg
    thing = SceneObject("ball", cloud_of(means, 0.005), means, volumes, material, zero, zero, 2 * RADIUS)
    scene = Scene("strike", body, thing, "", FRAMES, FPS, zero)
    how = {"between_frames": between_frames, "widened": widened}
    return find_contact(scene, motion, trajectory, tau=0.05, distance=0.01, **how)


def test_impulse_formula():
    normal = np.array([0.0, 0.6, 0.8])
    v_in, v_post = impulse(np.array([1.0, 5, 2]), np.array([0.0, -1, 0.5]), normal, 0.6)
    assert v_in == pytest.approx(0.6 * 6 + 0.8 * 1.5)
    np.testing.assert_allclose(v_post, [0, -1 + 1.6 * v_in * 0.6, 0.5 + 1.6 * v_in * 0.8])


def test_separating_bodies_exchange_nothing():
    v_in, v_post = impulse(np.array([0.0, 1, 0]), np.array([0.0, 3, 0]), np.array([0.0, 1, 0]), 0.6)
    assert v_in == -2
    np.testing.assert_array_equal(v_post, [0, 3, 0])


def test_head_on_strike(fist):
    found = search(fist, moving([0, -0.5, 1], [0, 3, 0]), ball())
    (contact,) = found.contacts
    distance = RADIUS + LIMB_RADIUS
    centre = -0.5 + 3 * contact.frame / FPS
    assert -distance - 0.01 < centre < -distance + 0.02
    np.testing.assert_allclose(contact.v_human, [0, 3, 0], atol=1e-4)
    np.testing.assert_allclose(contact.normal, [0, 1, 0], atol=0.05)
    assert contact.v_in == pytest.approx(3, rel=0.01)
    np.testing.assert_allclose(contact.v_formula, 1.6 * contact.v_in * contact.normal, atol=1e-9)
    assert contact.duration == 0


@pytest.mark.parametrize("speed", [10.0, 20.0])
def test_fast_fist_cannot_tunnel(fist, speed):
    """It crosses the ball between two frames: whole frames miss it, the search between them does not."""
    start = [0, -0.5 - speed / FPS * 3, 1]
    start[1] += 0.5 * (speed / FPS - 1.0)  # before and after the ball at neighbouring frames
    motion = moving(start, [0, speed, 0])
    gap_to_centre = np.abs(motion.translation[:, 1]).min()
    assert gap_to_centre > RADIUS + LIMB_RADIUS + 0.02
    assert search(fist, motion, ball(), between_frames=False).contacts == ()
    (contact,) = search(fist, motion, ball()).contacts
    assert contact.frame % 1 != 0
    assert contact.v_in == pytest.approx(speed, rel=0.02)


def test_graze_below_tau_is_no_contact(fist):
    beside = RADIUS + LIMB_RADIUS + 0.0085
    found = search(fist, moving([beside, -0.5, 1], [0, 3, 0]), ball())
    assert found.contacts == ()
    assert found.smallest_gap == pytest.approx(0.0085, abs=0.003)
    assert found.smallest_gap_joint == HAND


def test_graze_above_tau_pushes_aside(fist):
    beside = RADIUS + LIMB_RADIUS - 0.02
    contact = search(fist, moving([beside, -0.5, 1], [0, 3, 0]), ball()).contacts[-1]
    assert contact.normal[0] < -0.5
    assert 0 < contact.v_in < 3


def test_separating_contact_is_recorded_without_impulse(fist):
    """The ball rests against a fist that moves away."""
    found = search(fist, moving([0, -RADIUS - LIMB_RADIUS, 1], [0, -2, 0]), ball(velocity=(0, 0.5, 0)))
    (contact,) = found.contacts
    assert contact.frame < 1 and contact.v_in <= 0
    np.testing.assert_array_equal(contact.v_post, contact.v_object)
    np.testing.assert_array_equal(contact.impulse, 0)


def test_ball_that_flies_into_a_still_fist(fist):
    (contact,) = search(fist, moving([0, -0.4, 1], [0, 0, 0]), ball(velocity=(0, -4, 0))).contacts
    assert contact.v_in == pytest.approx(4, rel=0.01)
    assert contact.v_formula[1] == pytest.approx(0.6 * 4, rel=0.05)


def test_no_contact_is_a_result_with_the_smallest_gap(fist):
    found = search(fist, moving([0, -1, 1], [0, 0.5, 0]), ball())
    assert found.contacts == ()
    nearest = 1 - 0.5 * (FRAMES - 1) / FPS - RADIUS - LIMB_RADIUS
    assert found.smallest_gap == pytest.approx(nearest, abs=0.005)
    assert found.smallest_gap_frame == FRAMES - 1


def test_touch_counts_the_limb_and_averages_the_object():
    limb = np.array([[0.0, 0, 0], [0, 0, 0.5]])
    surface = np.array([[0.0, 0.005, 0], [0, -0.005, 0], [0, 0, 1]])
    found = touch(limb, surface, 0.01)
    assert found.fraction == 0.5
    assert found.gap == pytest.approx(0.005)
    np.testing.assert_allclose(found.point, [0, 0, 0])


def test_boxes_that_do_not_overlap_are_no_contact_in_the_papers_way(fist):
    """A fist 1 mm off a ball is within d_contact; its box meets the ball's only where both are wider by it."""
    start = [0, -(RADIUS + LIMB_RADIUS + 0.001), 1]
    assert search(fist, moving(start, [0, 0.0, 0]), ball(), between_frames=False).contacts
    assert not search(fist, moving(start, [0, 0.0, 0]), ball(), between_frames=False, widened=False).contacts
    inside = [0, -(RADIUS + LIMB_RADIUS - 0.005), 1]
    assert search(fist, moving(inside, [0, 0.0, 0]), ball(), between_frames=False, widened=False).contacts
