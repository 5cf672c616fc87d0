"""The people in the package, and avatars from files."""

import time

import numpy as np
import pytest

from hoi.body.avatar import PLY_NAME, SKINNING_NAME, load_avatar, save_avatar
from hoi.body.clothing import OUTFITS
from hoi.body.people import load_person, tilt_quaternions
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Body
from hoi.errors import InputError
from hoi.gaussians import colours, rotation_matrices

HEIGHTS = {"man": 1.745, "woman": 1.66, "child": 1.31, "athlete": 1.80, "heavy": 1.745, "senior": 1.59}


def joint(body: Body, name: str) -> np.ndarray:
    return body.rest_joints[JOINT_NAMES.index(name)]


@pytest.fixture(scope="module", params=HEIGHTS)
def person(request) -> Body:
    return load_person(request.param, 6000)


def test_height(person):
    extent = person.cloud.means[:, 1].max() - person.cloud.means[:, 1].min()
    hair = OUTFITS[person.name].hair_thickness
    assert extent == pytest.approx(HEIGHTS[person.name] + hair, abs=0.02)


def test_limbs_of_the_t_pose_are_straight(person):
    for side, sign in (("left", 1), ("right", -1)):
        for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")):
            bone = joint(person, f"{side}_{end}") - joint(person, f"{side}_{start}")
            np.testing.assert_allclose(bone / np.linalg.norm(bone), [sign, 0, 0], atol=1e-5)
        for start, end in (("hip", "knee"), ("knee", "ankle")):
            bone = joint(person, f"{side}_{end}") - joint(person, f"{side}_{start}")
            np.testing.assert_allclose(bone / np.linalg.norm(bone), [0, -1, 0], atol=1e-5)
        foot = joint(person, f"{side}_foot") - joint(person, f"{side}_ankle")
        assert foot[2] > 0.5 * np.linalg.norm(foot)


def test_skeleton_is_symmetric_about_the_pelvis_at_the_origin(person):
    np.testing.assert_allclose(person.rest_joints[0], 0, atol=1e-6)
    mirror = [
        JOINT_NAMES.index(name.replace("left", "*").replace("right", "left").replace("*", "right"))
        for name in JOINT_NAMES
    ]
    np.testing.assert_allclose(person.rest_joints[mirror] * [-1, 1, 1], person.rest_joints, atol=1e-5)


def test_gaussians_are_flat_on_the_surface(person):
    cloud = person.cloud
    np.testing.assert_allclose(np.linalg.norm(cloud.quaternions, axis=1), 1, atol=1e-6)
    assert (cloud.scales[:, 2] < 0.5 * cloud.scales[:, :2].min(axis=1)).all()
    normals = rotation_matrices(cloud)[:, :, 2]
    crown, toes = cloud.means[:, 1].argmax(), cloud.means[:, 1] < cloud.means[:, 1].min() + 0.005
    assert normals[crown, 1] > 0.9
    assert normals[toes, 1].mean() < -0.7
    left_palm = (cloud.means[:, 0] > joint(person, "left_wrist")[0]) & (normals[:, 1] < -0.9)
    back_of_hand = (cloud.means[:, 0] > joint(person, "left_wrist")[0]) & (normals[:, 1] > 0.9)
    assert cloud.means[left_palm, 1].mean() < cloud.means[back_of_hand, 1].mean()


def test_surface_is_covered_evenly(person):
    """Every Gaussian has a neighbour within two of its own standard deviations, and none sits on another."""
    means = person.cloud.means.astype(np.float64)
    for i in range(0, len(means), 37):
        distance = np.linalg.norm(means - means[i], axis=1)
        distance[i] = np.inf
        assert 0 < distance.min() < 2 * person.cloud.scales[i, 0]


def test_skinning_weights(person):
    weights = person.skinning_weights
    assert weights.shape == (6000, JOINT_COUNT) and weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert set(weights.argmax(axis=1)) >= set(range(1, JOINT_COUNT)) - {JOINT_NAMES.index("spine2")}
    dominant = weights.argmax(axis=1)
    for name in ("left_hand", "right_foot", "head", "left_knee"):
        members = person.cloud.means[dominant == JOINT_NAMES.index(name)]
        assert np.linalg.norm(members.mean(axis=0) - joint(person, name)) < 0.25


def test_wears_clothes(person):
    outfit, cloud = OUTFITS[person.name], person.cloud
    rgb = colours(cloud)
    assert rgb.min() >= 0 and rgb.max() <= 1
    chest = joint(person, "spine3") + np.array([0, 0, 0.15])
    thigh = joint(person, "left_hip") + np.array([0, -0.08, 0.1])
    for index, colour in (
        (np.linalg.norm(cloud.means - chest, axis=1).argmin(), outfit.shirt),
        (np.linalg.norm(cloud.means - thigh, axis=1).argmin(), outfit.trousers),
        (cloud.means[:, 1].argmax(), outfit.hair),
        (cloud.means[:, 0].argmax(), outfit.skin),
        (cloud.means[:, 1].argmin(), outfit.sole),
    ):
        shade = rgb[index] / np.array(colour)
        assert np.ptp(shade) < 1e-3 and 0.75 < shade.mean() < 1.05


def test_seed_decides():
    first, again, other = (load_person("man", 1000, seed).cloud for seed in (0, 0, 1))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(again, name))
    assert not np.array_equal(first.means, other.means)


@pytest.mark.parametrize("count", [100, 2500])
def test_count_is_exact(count):
    body = load_person("woman", count)
    assert len(body.cloud) == len(body.skinning_weights) == count
    assert body.cloud.sh.shape == (count, 1, 3)


def test_loads_fast():
    load_person("man", 100)
    start = time.process_time()
    load_person("man")
    assert time.process_time() - start < 2.0


def test_refuses_strangers_and_empty_clouds():
    with pytest.raises(InputError, match=r"human='giant'.*man, woman, child, athlete, heavy, senior"):
        load_person("giant")
    with pytest.raises(InputError, match="gaussians=0: must be at least 100"):
        load_person("man", 0)


def test_tilt_takes_z_to_the_normal():
    normals = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0, 0.8], [0, -1, 0], [1e-7, 0, -1]], dtype=np.float64)
    w, x, y, z = tilt_quaternions(normals).T
    third = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)
    np.testing.assert_allclose(third, normals, atol=1e-6)


@pytest.fixture
def avatar(tmp_path):
    body = load_person("child", 300)
    save_avatar(body, tmp_path)
    return body, tmp_path


def test_avatar_round_trip(avatar):
    body, folder = avatar
    loaded = load_avatar(folder / PLY_NAME)
    np.testing.assert_allclose(loaded.cloud.means, body.cloud.means, atol=1e-6)
    np.testing.assert_allclose(loaded.cloud.scales, body.cloud.scales, rtol=1e-5)
    np.testing.assert_allclose(loaded.cloud.opacities, body.cloud.opacities, atol=1e-5)
    np.testing.assert_allclose(loaded.skinning_weights, body.skinning_weights, atol=1e-6)
    np.testing.assert_array_equal(loaded.rest_joints, body.rest_joints)
    assert loaded.source == body.source


def broken(folder, **changes):
    with np.load(folder / SKINNING_NAME) as data:
        arrays = {key: data[key] for key in data.files}
    for key, value in changes.items():
        if value is None:
            del arrays[key]
        else:
            arrays[key] = value(arrays[key]) if callable(value) else value
    np.savez(folder / SKINNING_NAME, **arrays)


def poisoned(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.flat[7] = np.nan
    return array


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weights": None}, "weights: missing"),
        ({"licence": None}, "licence: missing"),
        ({"weights": poisoned}, "weights: holds values that are not finite"),
        ({"rest_joints": poisoned}, "rest_joints: holds values that are not finite"),
        ({"weights": lambda w: w[:-1]}, r"weights: .*\(299, 24\).*must be numbers of shape \(300, 24\)"),
        ({"rest_joints": np.array(["a"] * 24)}, "rest_joints: .*must be numbers"),
        ({"weights": lambda w: 1.2 * w}, "weights: row .* sums to 1.2"),
        ({"weights": lambda w: np.roll(w, 1, axis=1) * 2 - w}, "weights: .*must not be negative"),
        ({"parents": np.arange(24)}, "parents="),
        ({"joint_names": np.array(JOINT_NAMES[::-1])}, "joint_names="),
        ({"up": "z"}, "up='z': must be 'y'"),
        ({"pose": "apose"}, "pose='apose': must be 'tpose'"),
    ],
)
def test_avatar_names_what_is_wrong(avatar, changes, message):
    _, folder = avatar
    broken(folder, **changes)
    with pytest.raises(InputError, match=message) as error:
        load_avatar(folder / PLY_NAME)
    assert SKINNING_NAME in str(error.value) and "\n" not in str(error.value)


def test_avatar_accepts_smpl_root_parent_and_rounded_rows(avatar):
    _, folder = avatar
    broken(folder, parents=np.array((4294967295, *PARENTS[1:]), dtype=np.uint32), weights=lambda w: 1.004 * w)
    np.testing.assert_allclose(load_avatar(folder / PLY_NAME).skinning_weights.sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("content", [None, b"", b"not a zip", b"PK\x03\x04broken"])
def test_avatar_without_usable_skinning(avatar, content):
    _, folder = avatar
    path = folder / SKINNING_NAME
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=SKINNING_NAME):
        load_avatar(folder / PLY_NAME)


def test_avatar_never_unpickles(avatar):
    _, folder = avatar
    broken(folder, source=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"not a skinning \.npz of plain arrays"):
        load_avatar(folder / PLY_NAME)
