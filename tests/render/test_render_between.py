"""Between the frames: flight is exact, a blow comes when it came, rigid turns stay rigid, and the frames themselves
stay."""

import numpy as np
import pytest
from bodies import cloud_of
from scipy.spatial.transform import Rotation

from hoi.body.people import load_person
from hoi.data import Contact, ContactSearch, Material, Motion, ObjectTrajectory, Scene, SceneObject, State
from hoi.gaussians import fibonacci_sphere
from hoi.render.between import at_frames, frames_at

FPS, FRAMES, G = 20.0, 12, np.array([0, 0, -9.81])
STUFF = Material("x", "fixed_corotated", 1e5, 0.3, 100.0, 0.8, 0.5)


def scene_of(com, velocity, turns=None, stretch=None) -> tuple[Scene, ObjectTrajectory]:
    """A ball whose centre, turn and stretch are given frame by frame."""
    ball = 0.1 * fibonacci_sphere(80)
    turns = np.tile(np.eye(3), (len(com), 1, 1)) if turns is None else turns
    gradient = turns if stretch is None else turns @ stretch
    positions = (com[:, None] + ball @ gradient.transpose(0, 2, 1)).astype(np.float32)
    thing = SceneObject("ball", cloud_of(positions[0].astype(float), 0.01), positions[0], np.ones(80),
                        STUFF, np.zeros(3),
                        np.zeros(3), 0.2)  # fmt: skip
    fields = np.repeat(gradient[:, None], 80, 1).astype(np.float32)
    trajectory = ObjectTrajectory(positions, com, velocity, np.zeros((len(com), 3)), fields, ("mpm",) * len(com))
    return Scene("s", None, thing, "", len(com), FPS, G), trajectory  # pyright: ignore[reportArgumentType]


def flight(times):
    return np.array([0, 0, 1]) + times[:, None] * [3, 1, 4] + 0.5 * G * times[:, None] ** 2


def test_flight_with_a_spin_is_exact():
    times, fine = np.arange(FRAMES) / FPS, np.arange(3 * FRAMES - 2) / 60
    spin = np.array([5.0, -9.0, 12.0])
    turns = Rotation.from_rotvec(times[:, None] * spin).as_matrix()
    scene, trajectory = scene_of(flight(times), [3, 1, 4] + times[:, None] * G, turns)
    new, state = at_frames(scene, State(None, trajectory), fine * FPS, 60.0)
    assert (new.frames, new.fps) == (len(fine), 60.0)
    np.testing.assert_allclose(state.trajectory.com, flight(fine), atol=1e-9)
    wanted = Rotation.from_rotvec(fine[:, None] * spin).as_matrix()
    np.testing.assert_allclose(state.trajectory.deformation_gradient[:, 0], wanted, atol=1e-5)
    ball = flight(fine)[:, None] + 0.1 * fibonacci_sphere(80) @ wanted.transpose(0, 2, 1)
    np.testing.assert_allclose(state.trajectory.positions, ball, atol=1e-5)


@pytest.mark.parametrize("blow", [5.2, 5.5, 5.9])
def test_what_is_struck_lies_still_until_then(blow):
    speed = np.array([12.0, -3.0, 2.0])
    frames = np.arange(FRAMES)
    after = np.clip(frames - blow, 0, None)[:, None] / FPS
    scene, trajectory = scene_of(after * speed, np.where(frames[:, None] > blow, speed, 0.0))
    fine = np.arange(0, FRAMES - 1, 0.1)
    _, state = at_frames(scene, State(None, trajectory), fine, 200.0)
    np.testing.assert_allclose(state.trajectory.com, np.clip(fine - blow, 0, None)[:, None] / FPS * speed, atol=1e-6)
    assert state.trajectory.positions.shape == (len(fine), 80, 3)


def test_frames_stay_as_recorded_and_stretch_goes_evenly():
    stretch = np.array([np.diag([1 + 0.02 * k, 1, 1 - 0.02 * k]) for k in range(FRAMES)])
    com = np.zeros((FRAMES, 3))
    scene, trajectory = scene_of(com, com, None, stretch)
    _, same = at_frames(scene, State(None, trajectory), np.arange(FRAMES, dtype=float), FPS)
    np.testing.assert_array_equal(same.trajectory.positions, trajectory.positions)
    np.testing.assert_array_equal(same.trajectory.deformation_gradient, trajectory.deformation_gradient)
    _, half = at_frames(scene, State(None, trajectory), np.array([3.5]), FPS)
    np.testing.assert_allclose(half.trajectory.deformation_gradient[0, 0], np.diag([1.07, 1, 0.93]), atol=2e-3)


def test_poses_pass_through_theirs_without_a_kink():
    rng = np.random.default_rng(0)
    body = load_person("man", 200)
    swing = np.cumsum(0.1 * rng.normal(size=(FRAMES, 23, 3)), 0).astype(np.float32)
    turn = Rotation.from_rotvec(np.linspace(0, 3, FRAMES)[:, None] * [0, 0, 1]).as_matrix()[:, :2].reshape(-1, 6)
    motion = Motion(
        np.cumsum(0.1 * rng.normal(size=(FRAMES, 3)), 0).astype(np.float32), turn.astype(np.float32), swing, FPS
    )
    scene = Scene("s", body, None, "", FRAMES, FPS, G)
    fine = np.arange(0, FRAMES - 1 + 1e-9, 0.05)
    _, state = at_frames(scene, State(motion), fine, 400.0)
    for name in ("translation", "orientation", "body_pose"):
        np.testing.assert_allclose(getattr(state.motion, name)[::20], getattr(motion, name), atol=2e-5)
    speed = np.diff(state.motion.translation, axis=0)
    assert np.abs(np.diff(speed, axis=0)).max() < 0.2 * np.abs(speed).max()  # a chain of straight lines has 1


def test_contacts_keep_their_moment():
    com = np.zeros((FRAMES, 3))
    scene, trajectory = scene_of(com, com)
    touch = Contact(4.5, 22, 1.0, *[np.zeros(3)] * 4, 1.0, np.zeros(3), np.zeros(3), 0.0)
    _, state = at_frames(scene, State(None, trajectory, None, ContactSearch((touch,), 0.0, 4.5, 22)),
                         frames_at(FRAMES, FPS, 60.0), 60.0)  # fmt: skip
    assert state.contact.push.frame == pytest.approx(13.5)
    assert len(frames_at(FRAMES, FPS, 60.0)) == 36 and frames_at(FRAMES, FPS, 60.0)[-1] == FRAMES - 1
