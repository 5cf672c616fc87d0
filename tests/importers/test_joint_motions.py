"""Motions that are joints alone: HumanML3D's features, made here after its definition, and the joints themselves."""

import numpy as np
import pytest
from demo_run import person
from scipy.spatial.transform import Rotation

from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.body.skinning import joint_paths, sole_height
from hoi.data import Array, Body, Motion
from hoi.errors import InputError
from hoi.importers.joints import places_of
from hoi.importers.motions import read_motion

FRAMES, FPS = 41, 20.0


@pytest.fixture(scope="module")
def body() -> Body:
    return person(np.random.default_rng(0), 500)


def bent(body: Body) -> Motion:
    """Somebody who goes round a curve with bent knees and elbows, from the origin facing +Y, on the ground."""
    clock = np.arange(FRAMES) / FPS
    pose = np.zeros((FRAMES, 23, 3))

    def set_to(name: str, angles: str, values) -> None:
        values = np.broadcast_to(np.stack([np.broadcast_to(v, FRAMES) for v in values], -1), (FRAMES, len(angles)))
        pose[:, JOINT_NAMES.index(name) - 1] = Rotation.from_euler(angles, values).as_rotvec()

    for sign, side in ((1, "left"), (-1, "right")):
        wave = np.sin(4 * clock + sign)
        set_to(f"{side}_hip", "XYZ", (-0.5 + 0.4 * wave, sign * 0.3, 0.1 * wave))
        set_to(f"{side}_knee", "X", (0.9 + 0.5 * wave,))
        set_to(f"{side}_ankle", "X", (0.2 * wave,))
        set_to(f"{side}_collar", "Z", (0.1 * wave,))
        set_to(f"{side}_shoulder", "XYZ", (0.6 * wave, 0.3, -sign * 1.1))
        set_to(f"{side}_elbow", "Y", (-sign * (1.0 + 0.4 * wave),))
    set_to("spine1", "XZ", (0.2 * np.sin(3 * clock), 0.1))
    set_to("spine3", "XYZ", (0.1, 0.3 * np.sin(2 * clock), 0.1))
    set_to("neck", "X", (0.2 * np.sin(5 * clock),))
    root = Rotation.from_euler("ZX", np.stack([np.pi + 1.5 * clock, np.pi / 2 + 0.1 * np.sin(3 * clock)], -1))
    path = np.stack([0.4 * np.sin(2 * clock), 1.2 * clock, 0.9 + 0.03 * np.cos(5 * clock)], -1)
    path -= path[0] * (1, 1, 0)
    motion = Motion(path, root.as_matrix()[:, :2].reshape(FRAMES, 6), pose, FPS)
    motion.translation[:, 2] -= joints_of(body, motion)[..., 2].min() - sole_height(body)
    return motion


def turns_of(motion: Motion) -> list[Rotation]:
    """Local rotations of the joints, each over all frames."""
    rows = np.asarray(motion.orientation, np.float64).reshape(-1, 2, 3)
    root = np.concatenate([rows, np.cross(rows[:, 0], rows[:, 1])[:, None]], axis=1)
    return [Rotation.from_matrix(root), *(Rotation.from_rotvec(motion.body_pose[:, joint]) for joint in range(23))]


def joints_of(body: Body, motion: Motion) -> Array:
    """Forward kinematics of its own, by scipy: (F, 24, 3), z up."""
    world, places = [], []
    for joint, (parent, turn) in enumerate(zip(PARENTS, turns_of(motion), strict=True)):
        if parent < 0:
            world.append(turn)
            places.append(np.asarray(motion.translation, np.float64))
        else:
            world.append(world[parent] * turn)
            places.append(places[parent] + world[parent].apply(body.rest_joints[joint] - body.rest_joints[parent]))
    return np.stack(places, axis=1)


def y_up(places: Array) -> Array:
    """22 joints with y up and z forward of a start that faces +Y."""
    return np.stack([-places[:, :22, 0], places[:, :22, 2], places[:, :22, 1]], axis=-1)


def humanml(places: Array) -> Array:
    """The 263 features of joints (F, 22, 3), y up, as motion_process.py has them: (F - 1, 263). What hoi does not use
    is noise."""
    across = places[:, 2] - places[:, 1] + places[:, 17] - places[:, 16]
    forward = np.cross([0.0, 1, 0], across)
    heading = Rotation.from_euler("y", -np.arctan2(forward[:, 0], forward[:, 2])[:, None])  # to +z
    half = (heading[1:] * heading[:-1].inv()).as_quat()
    half = np.arcsin(half[:, 1] * np.sign(half[:, 3]))
    velocity = heading[1:].apply(np.diff(places[:, 0], axis=0))
    flat = places - places[:, :1] * (1, 0, 1)
    local = np.stack([heading.apply(flat[:, joint]) for joint in range(22)], axis=1)
    root = np.stack([half, velocity[:, 0], velocity[:, 2], local[:-1, 0, 1]], axis=-1)
    noise = np.random.default_rng(0).normal(size=(len(root), 196))
    return np.concatenate([root, local[:-1, 1:].reshape(len(root), 63), noise], axis=1)


def limb_angles(read: Array, expected: Array) -> Array:
    """Degrees between the bones of the limbs."""
    bones = [(PARENTS[j], j) for j in (4, 5, 7, 8, 10, 11, 18, 19, 20, 21)]
    ours, theirs = (np.stack([p[:, end] - p[:, start] for start, end in bones], 1) for p in (read, expected))
    sine = np.linalg.norm(np.cross(ours, theirs), axis=-1)
    return np.degrees(np.arctan2(sine, (ours * theirs).sum(-1)))


@pytest.mark.parametrize("kind", ["features", "a batch of one", "float32", "joints", "a start elsewhere"])
def test_the_motion_is_that_of_the_joints(tmp_path, body, kind):
    motion = bent(body)
    expected = joints_of(body, motion)
    places = y_up(expected)
    if kind == "a start elsewhere":
        places = Rotation.from_euler("y", 2.0).apply(places.reshape(-1, 3)).reshape(places.shape)
        places = places + np.array([3.0, 0, -2.0])
    given = {"joints": places, "a start elsewhere": places}.get(kind, humanml(places))
    given = given[None] if kind == "a batch of one" else given
    np.save(tmp_path / "m.npy", given.astype(np.float32) if kind == "float32" else given)
    read, notes = read_motion(tmp_path / "m.npy", body, FRAMES - 1, FPS)
    got, expected = joints_of(body, read)[:, :22], expected[: FRAMES - 1, :22]
    assert limb_angles(got, expected).max() < 0.1
    assert np.abs(got - expected).max() < 1e-3 and np.abs(read.translation - expected[:, 0]).max() < 1e-3
    assert "at 20 Hz, y up" in notes[0] and "inverse kinematics" in notes[1]


def test_limbs_are_turned_as_they_bend(tmp_path, body):
    """The turn of a thigh or upper arm about itself is in no joint of its own."""
    motion = bent(body)
    np.save(tmp_path / "m.npy", humanml(y_up(joints_of(body, motion))))
    read, _ = read_motion(tmp_path / "m.npy", body, FRAMES - 1, FPS)
    parts = [f"{s}_{p}" for s in ("left", "right") for p in ("hip", "knee", "shoulder", "elbow")]
    for joint in map(JOINT_NAMES.index, ["pelvis", "spine1", *parts]):
        between = turns_of(read)[joint].inv() * turns_of(motion)[joint][: FRAMES - 1]
        assert np.degrees(between.magnitude()).max() < 2, JOINT_NAMES[joint]


def test_another_size_takes_the_path_with_it(tmp_path, body):
    """A person twice as tall goes twice as far: on our body it is our motion."""
    motion = bent(body)
    np.save(tmp_path / "m.npy", humanml(2 * y_up(joints_of(body, motion))))
    read, _ = read_motion(tmp_path / "m.npy", body, FRAMES - 1, FPS)
    np.testing.assert_allclose(read.translation, motion.translation[: FRAMES - 1], atol=1e-3)


def test_another_rate_can_be_said(tmp_path, body):
    np.save(tmp_path / "m.npy", humanml(y_up(joints_of(body, bent(body)))))
    assert "at 60 Hz" in read_motion(tmp_path / "m.npy", body, 9, FPS, rate=60.0)[1][0]


def test_heading_is_twice_what_the_features_say():
    """HumanML3D keeps half angles: a quarter turn in ten frames, a metre ahead in each frame's heading."""
    features = np.zeros((11, 263))
    features[:, 0], features[:, 2], features[:, 3] = np.pi / 40, 0.1, 0.9
    features[:, 4:7] = (0, 1.0, 0.2)  # joint 1 ahead of the pelvis
    places = places_of(features)
    ahead = places[:, 1] - places[:, 0] * (1, 0, 1)
    np.testing.assert_allclose(ahead[0], (0, 1, 0.2), atol=1e-12)
    np.testing.assert_allclose(ahead[-1], (-0.2, 1, 0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places[:, 0], axis=0), axis=1), 0.1)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((5, 251)), "KIT-ML's skeleton of 21 joints"), (np.zeros((5, 100)), r"has shape \(5, 100\), must be"),
        (np.zeros((0, 263)), "has shape"), (np.full((5, 263), np.nan), "not finite"),
        (np.array([{"motion": 1}]), "Python objects, which are not unpickled"), (np.array(["a"]), "cannot be read as"),
        (np.random.default_rng(0).normal(size=(30, 263)), "must be x Std"), (np.zeros((5, 263)), "change their length"),
        (np.zeros((3, 5, 263)), "has shape"), (np.array(3.0), "has shape"),
    ],
)  # fmt: skip
def test_what_is_no_such_motion_is_one_line(tmp_path, body, array, message):
    np.save(tmp_path / "m.npy", array, allow_pickle=True)
    with pytest.raises(InputError, match=message) as caught:
        read_motion(tmp_path / "m.npy", body, 5, FPS)
    assert "\n" not in str(caught.value) and str(tmp_path / "m.npy") in str(caught.value)


def test_files_that_are_no_npy(tmp_path, body):
    (tmp_path / "m.npy").write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read"):
        read_motion(tmp_path / "m.npy", body, 5, FPS)
    with (tmp_path / "z.npy").open("wb") as file:
        np.savez(file, poses=np.zeros(3))
    with pytest.raises(InputError, match=r"an \.npz; call it so"):
        read_motion(tmp_path / "z.npy", body, 5, FPS)


def test_the_joints_of_hoi_agree_with_those_here(body):
    motion = bent(body)
    np.testing.assert_allclose(joint_paths(body, motion), joints_of(body, motion), atol=1e-5)
