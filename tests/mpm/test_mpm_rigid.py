"""Free flight against closed forms, and what a rigid fit keeps of a state."""

from dataclasses import replace

import numpy as np
import pytest
from mpm_bodies import DX, shaken
from scipy.linalg import expm

from hoi.mpm import rigid
from hoi.mpm.rigid import Flight, RigidMotion
from hoi.mpm.state import angular_momentum, centre_of_mass, initial_state, linear_momentum

G = np.array([0.3, -0.2, -9.81])
D = DX**2 / 4


def body(inertia, angular_velocity, velocity=(1.0, 2, 3)) -> RigidMotion:
    inertia = np.asarray(inertia, float)
    return RigidMotion(2.0, np.array([0.1, 0.2, 5]), np.array(velocity), inertia @ angular_velocity, inertia)


def test_centre_of_mass_flies_its_parabola() -> None:
    flight = Flight(body(np.diag([1.0, 2, 3]), [5, 1, 2]), G)
    for t in (0.0, 0.3, 1.7):
        np.testing.assert_allclose(flight.com(t), [0.1, 0.2, 5] + t * np.array([1, 2, 3]) + t**2 / 2 * G, atol=1e-14)
        np.testing.assert_allclose(flight.velocity(t), np.array([1, 2, 3]) + t * G, atol=1e-14)


def test_equal_inertia_turns_by_omega_t() -> None:
    w = np.array([3.0, -40, 20])
    flight = Flight(body(0.7 * np.eye(3), w), G)
    for t in (0.1, 20.0):
        np.testing.assert_allclose(flight.rotation(t), expm(rigid.cross_matrix(w * t)), atol=1e-11)
        np.testing.assert_allclose(flight.angular_velocity(t), w, rtol=1e-12)


def test_symmetric_top_precesses() -> None:
    """R = exp([L] t / I) exp([e3] L3 (1/I3 - 1/I) t), in a turned frame, to 1e-9."""
    turn = expm(rigid.cross_matrix(np.array([0.4, -1, 0.2])))
    inertia, w = np.array([2.0, 2, 3]), np.array([3.0, 1, 6])
    flight = Flight(body(turn @ np.diag(inertia) @ turn.T, turn @ w), G)
    for t in np.linspace(0, 5, 23):
        own = expm(rigid.cross_matrix(np.array([0, 0, inertia[2] * w[2] * (1 / 3 - 1 / 2)]) * t))
        exact = turn @ expm(rigid.cross_matrix(inertia * w / 2 * t)) @ own @ turn.T
        np.testing.assert_allclose(flight.rotation(t), exact, atol=1e-9)


def test_lopsided_body_keeps_energy_and_angular_momentum_and_flips() -> None:
    """A thousand turns about the middle axis: energy and |L| to 1e-9, and the axis turns over again and again."""
    inertia, w = np.diag([1.0, 2, 3]), np.array([0.1, 2 * np.pi, 0.05])
    motion = body(inertia, w)
    flight = Flight(motion, G)
    sides = []
    for t in np.linspace(0, 1000, 201):
        r, now = flight.rotation(t), flight.angular_velocity(t)
        np.testing.assert_allclose(r @ inertia @ r.T @ now, motion.angular_momentum, atol=1e-9)
        assert 0.5 * now @ motion.angular_momentum == pytest.approx(0.5 * w @ motion.angular_momentum, rel=1e-9)
        assert np.linalg.norm(now) <= flight.fastest
        sides.append(r[:, 1] @ motion.angular_momentum > 0)
    assert 100 < np.count_nonzero(np.diff(sides)) < 300


def test_rigid_fit_keeps_the_momentum_and_splits_the_energy() -> None:
    state, volumes = shaken()
    masses = volumes * 1000
    motion = rigid.fit(state, masses, D)
    np.testing.assert_allclose(motion.mass * motion.velocity, linear_momentum(state, masses), rtol=1e-12)
    about_com = angular_momentum(state, masses, DX) - motion.mass * np.cross(motion.com, motion.velocity)
    np.testing.assert_allclose(motion.angular_momentum, about_com, rtol=1e-11)
    kinetic = 0.5 * masses @ ((state.velocities**2).sum(-1) + D * (state.affine**2).sum((-2, -1)))
    of_rigid = 0.5 * motion.mass * motion.velocity @ motion.velocity
    of_rigid += 0.5 * motion.angular_velocity @ motion.angular_momentum
    assert rigid.vibration_energy(state, masses, D, motion) == pytest.approx(kinetic - of_rigid, rel=1e-12)


def test_flight_carries_the_whole_state() -> None:
    """P grows by M g t, L about the centre of mass stays, F turns with the body, nothing vibrates."""
    state, volumes = shaken()
    state = replace(state, elastic=1.1 * state.deformation_gradient, hardening=np.arange(len(volumes)))
    masses = volumes * 1000
    motion = rigid.fit(state, masses, D)
    flight = Flight(motion, G)
    for t in (0.0, 0.37):
        carried, r = rigid.carry(flight, state, t), flight.rotation(t)
        momentum = linear_momentum(state, masses) + motion.mass * t * G
        np.testing.assert_allclose(linear_momentum(carried, masses), momentum, rtol=1e-12)
        now = rigid.fit(carried, masses, D)
        np.testing.assert_allclose(now.angular_momentum, motion.angular_momentum, rtol=1e-10)
        np.testing.assert_allclose(centre_of_mass(carried.positions, masses), flight.com(t), atol=1e-12)
        assert rigid.vibration_energy(carried, masses, D, now) < 1e-20
        np.testing.assert_allclose(carried.deformation_gradient, r @ state.deformation_gradient)
        np.testing.assert_allclose(carried.elastic, 1.1 * carried.deformation_gradient)
        np.testing.assert_array_equal(carried.hardening, state.hardening)
    np.testing.assert_allclose(rigid.carry(flight, state, 0).positions, state.positions, atol=1e-13)


def test_a_rigid_state_does_not_vibrate() -> None:
    state, volumes = shaken()
    masses = volumes * 1000
    moving = initial_state(state.positions, masses, [1, 2, 3], [4, 5, 6])
    motion = rigid.fit(moving, masses, D)
    np.testing.assert_allclose(motion.angular_velocity, [4, 5, 6], rtol=1e-10)
    assert rigid.vibration_energy(moving, masses, D, motion) < 1e-20


def test_hull_of_bodies_with_and_without_volume() -> None:
    cube = np.array(np.meshgrid([0, 1, 2], [0, 1, 2], [0, 1, 2]), float).reshape(3, -1).T
    assert len(rigid.hull(cube)) == 8
    for points in (cube[cube[:, 2] == 0], cube[:2]):
        assert len(rigid.hull(points)) == len(points)
