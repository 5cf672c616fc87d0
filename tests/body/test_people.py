"""The people in the package, and avatars from files."""

import time
from importlib import resources

import numpy as np
import pytest
from scipy.spatial import KDTree

from hoi.body.avatar import PLY_NAME, SKINNING_NAME, load_avatar, save_avatar
from hoi.body.dressed import Dressed, load, save
from hoi.body.people import PEOPLE, load_person, tilt_quaternions, z_order
from hoi.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from hoi.data import Body, fields_of
from hoi.errors import InputError
from hoi.gaussians import colours, rotation_matrices

HEIGHTS = {"man": 1.745, "woman": 1.66, "child": 1.31, "athlete": 1.80, "heavy": 1.745, "senior": 1.59, "runner": 1.70,
           "gentleman": 1.77}  # fmt: skip
"""Barefoot [m]."""
ASSETS = resources.files("hoi.body").joinpath("assets")


def joint(body: Body, name: str) -> np.ndarray:
    return body.rest_joints[JOINT_NAMES.index(name)]


@pytest.fixture(scope="module", params=HEIGHTS)
def person(request) -> Body:
    return load_person(request.param, 6000)


def test_height_with_shoes_and_hair(person):
    extent = person.cloud.means[:, 1].max() - person.cloud.means[:, 1].min()
    assert HEIGHTS[person.name] < extent < HEIGHTS[person.name] + 0.11


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


def test_gaussians_are_flat_and_know_their_surface(person):
    cloud = person.cloud
    np.testing.assert_allclose(np.linalg.norm(cloud.quaternions, axis=1), 1, atol=1e-6)
    assert np.median(cloud.scales.min(axis=1) / cloud.scales.max(axis=1)) < 0.4
    normals, openness = cloud.surface[:, 0].astype(np.float64), cloud.surface[:, 1].astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=2e-3)
    share = np.linalg.norm(openness, axis=1)
    assert share.max() <= 1.01 and 0.5 < np.median(share) and (share < 0.4).mean() > 0.01  # open skin, and creases
    flattest = rotation_matrices(cloud)[np.arange(len(cloud)), :, cloud.scales.argmin(axis=1)]
    assert np.median(np.abs((flattest * normals).sum(axis=1))) > 0.9
    height = cloud.means[:, 1]
    crown = normals[height > height.max() - 0.02, 1].mean()
    assert crown > (0.2 if person.name == "gentleman" else 0.5)  # whose hair stands every way
    assert normals[height < height.min() + 0.005, 1].mean() < -0.5
    at_hand = cloud.means[:, 0] > joint(person, "left_wrist")[0]
    palm, back = (at_hand & (sign * normals[:, 1] > 0.9) for sign in (-1, 1))
    assert cloud.means[palm, 1].mean() < cloud.means[back, 1].mean()


def test_surface_is_covered_without_holes(person):
    """Hardly a Gaussian is farther from its neighbours than three of its own standard deviations."""
    means = person.cloud.means.astype(np.float64)
    near = KDTree(means).query(means, 2)[0][:, 1]
    assert (near < 3 * person.cloud.scales.max(axis=1)).mean() > 0.97


def test_clothes_move_with_the_body_under_them(person):
    """Weights are near those of the bare mesh at the nearest skin."""
    with resources.files("hoi.body").joinpath("people.npz").open("rb") as file:
        mesh = np.load(file, allow_pickle=False)
        weights = np.zeros((len(mesh["weights"]), JOINT_COUNT))
        np.put_along_axis(weights, mesh["influences"].astype(int), mesh["weights"].astype(float), axis=1)
        skin = KDTree(mesh[f"{person.name}.vertices"]).query(person.cloud.means)[1]
    off = np.abs(weights[skin] - person.skinning_weights).sum(axis=1)
    assert off.mean() < 0.25 and np.quantile(off, 0.9) < 0.8


def test_skinning_weights(person):
    weights = person.skinning_weights
    assert weights.shape == (6000, JOINT_COUNT) and weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert set(weights.argmax(axis=1)) >= set(range(1, JOINT_COUNT)) - {JOINT_NAMES.index("spine2")}
    dominant = weights.argmax(axis=1)
    for name in ("left_hand", "right_foot", "head", "left_knee"):
        members = person.cloud.means[dominant == JOINT_NAMES.index(name)]
        assert np.linalg.norm(members.mean(axis=0) - joint(person, name)) < 0.27


def test_wears_clothes(person):
    """Shirt, trousers, skin and hair are of different colours, and the face is finer than the chest."""
    cloud, rgb = person.cloud, colours(person.cloud)
    assert rgb.min() >= 0 and rgb.max() <= 1

    def around(place: np.ndarray) -> np.ndarray:
        return np.argsort(np.linalg.norm(cloud.means - place, axis=1))[:40]

    chest = around(joint(person, "spine3") + np.array([0, 0, 0.15]))
    shin = around(joint(person, "left_knee") + np.array([0, -0.12, 0.08]))
    hand = around(joint(person, "left_hand"))
    seen = [np.median(rgb[rows], axis=0) for rows in (chest, shin, hand)]
    if person.name != "gentleman":  # whose suit is of one cloth
        assert np.abs(seen[0] - seen[1]).max() > 0.1
    assert np.abs(seen[0] - seen[2]).max() > 0.1
    face = around(joint(person, "head") + np.array([0, 0.06, 0.12]))
    assert np.median(cloud.scales[face].max(axis=1)) < 0.7 * np.median(cloud.scales[chest].max(axis=1))


@pytest.mark.parametrize("name", PEOPLE)
def test_fewer_gaussians_cover_the_same_surface(name):
    whole, fewer = load_person(name).cloud, load_person(name, 8000).cloud
    assert len(whole) > 30_000
    areas = [(cloud.scales[:, 0] * cloud.scales[:, 1] * cloud.opacities).sum() for cloud in (whole, fewer)]
    assert areas[1] == pytest.approx(areas[0], rel=0.05)
    assert np.ptp(fewer.means, axis=0) == pytest.approx(np.ptp(whole.means, axis=0), rel=0.02)


def test_the_files_are_small_and_each_says_where_it_comes_from():
    sizes = [len(ASSETS.joinpath(f"{name}.npz").read_bytes()) for name in PEOPLE]
    assert max(sizes) <= 1_500_000 and sum(sizes) <= 12_000_000
    notice = ASSETS.joinpath("NOTICE.md").read_text(encoding="utf-8")
    assert "CC0 1.0" in notice and all(f"| {name} |" in notice for name in PEOPLE)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_person_comes_back_from_its_file(seed, tmp_path):
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(3, 500, 4))
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    normals = rng.normal(size=(2, 500, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    weights = np.zeros((500, JOINT_COUNT))
    np.put_along_axis(
        weights, np.argsort(rng.random((500, JOINT_COUNT)), 1)[:, :3], rng.dirichlet((1, 1, 1), 500), axis=1
    )
    made = Dressed("x", rng.uniform(-1, 1, (500, 3)), unit[0], np.exp(rng.uniform(-8, -4, (500, 3))), rng.random(500),
                   rng.random((500, 3)), normals[0], rng.random((500, 1)) * normals[1],
                   weights, rng.normal(size=(24, 3)))  # fmt: skip
    save(made, tmp_path / "x.npz")
    back = load("x", (tmp_path / "x.npz").open("rb"))
    order = z_order(made.means)
    for key, allowed in (("means", 4e-5), ("opacities", 2e-3), ("rgb", 2e-3), ("normals", 0.02), ("openness", 0.02),
                         ("weights", 5e-3)):  # fmt: skip
        np.testing.assert_allclose(getattr(back, key), getattr(made, key)[order], atol=allowed)
    np.testing.assert_allclose(back.scales, made.scales[order], rtol=0.02)
    assert np.abs((back.quaternions * made.quaternions[order]).sum(1)).min() > 0.999


def test_seed_decides():
    first, again, other = (load_person("man", 1000, seed).cloud for seed in (0, 0, 1))
    for name, values in fields_of(first).items():
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
    with pytest.raises(
        InputError, match=r"human='giant'.*man, woman, child, athlete, heavy, senior, runner, gentleman"
    ):
        load_person("giant")
    with pytest.raises(InputError, match="gaussians=0: must be at least 100"):
        load_person("man", 0)
    with pytest.raises(InputError, match=r"gaussians=900000: man has \d+; that or fewer"):
        load_person("man", 900_000)


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
