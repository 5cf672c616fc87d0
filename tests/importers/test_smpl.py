"""SMPL bodies from files of SMPL's layout, against SMPL by the book."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import roma
import torch
from demo_run import make_run
from smpl_files import JOINT, make_model, pickle_model, smpl_vertices

from hoi.body.avatar import load_avatar, save_avatar
from hoi.body.clothing import OUTFITS
from hoi.body.kinematics import rotation_to_6d
from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import body_tensors, pose_gaussians, pose_means, posed_means, stand_motion
from hoi.config import HumanConf, HumanKind
from hoi.config.validate import to_config
from hoi.data import Body
from hoi.errors import InputError
from hoi.gaussians import colours
from hoi.importers.smpl import load_smpl, read_smpl
from hoi.record.parts import scene_files, scene_from_files
from hoi.runner.scene import load_body

BETAS = (0.8, -1.2, 0.5)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[int, Path]:
    """Joints -> file."""
    folder = tmp_path_factory.mktemp("smpl")
    paths = {count: folder / f"MODEL_{count}.npz" for count in (24, 52, 55)}
    for count, path in paths.items():
        np.savez(path, **make_model(count, 20 if count == 55 else 16 if count == 52 else 10))
    return paths


def pose_of(seed: int, still: tuple[int, ...] = ()) -> np.ndarray:
    pose = np.random.default_rng(seed).normal(0, 0.5, (JOINT_COUNT, 3))
    pose[list(still)] = 0
    return pose


def triangles_of(body: Body, model: dict, betas) -> tuple[np.ndarray, np.ndarray]:
    """The triangle of each Gaussian in the T-pose and its barycentric coordinates there."""
    vertices = smpl_vertices(model, np.array(betas), np.zeros((len(model["weights"][0]), 3)), np.zeros(3))
    corners = vertices[model["f"].astype(int)]
    means = body.cloud.means.astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    bases = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], normal], axis=2)
    local = np.einsum("fij,nfj->nfi", np.linalg.inv(bases), means[:, None] - corners[:, 0])
    inside = np.concatenate([1 - local[..., :1] - local[..., 1:2], local[..., :2]], axis=2)
    off = np.abs(local[..., 2]) * np.linalg.norm(normal, axis=1) + np.maximum(-inside, 0).max(axis=2)
    face = off.argmin(axis=1)
    assert off[np.arange(len(means)), face].max() < 1e-4
    return face, inside[np.arange(len(means)), face]


@pytest.mark.parametrize("correctives", [True, False])
def test_poses_as_smpl_does(files, correctives):
    body = load_smpl(files[24], BETAS, 600, pose_correctives=correctives)
    model = make_model() if correctives else make_model() | {"posedirs": np.zeros_like(make_model()["posedirs"])}
    skin = body.skinning_weights[:, JOINT["head"]] < 0.5  # hair lies above the skin
    body = Body(
        body.name,
        replace(body.cloud, means=body.cloud.means[skin], quaternions=body.cloud.quaternions[skin]),
        body.skinning_weights[skin],
        body.rest_joints,
        pose_directions=None if body.pose_directions is None else body.pose_directions[skin],
    )
    face, inside = triangles_of(body, model, BETAS)
    pose, pelvis = pose_of(0), np.array([0.3, -0.2, 1.0])
    expected = smpl_vertices(model, np.array(BETAS), pose, pelvis)[model["f"].astype(int)]
    expected = np.einsum("nc,ncd->nd", inside, expected[face])
    orientation = rotation_to_6d(roma.rotvec_to_rotmat(torch.from_numpy(pose[:1])))
    given = (torch.from_numpy(pelvis)[None], orientation, torch.from_numpy(pose[None, 1:]))
    posed = pose_means(body_tensors(body, dtype=torch.float64), *given)[0].numpy()
    np.testing.assert_allclose(posed, expected, atol=2e-4)  # float16 directions
    moved = pose_means(replace(body_tensors(body, dtype=torch.float64), pose_directions=None), *given)[0].numpy()
    assert (np.abs(posed - moved).max() > 0.01) == correctives


@pytest.mark.parametrize("count", [52, 55])
def test_smpl_h_and_smpl_x_move_with_smpls_joints(files, count):
    """With fingers, jaw and eyes still they are the file's own model; the hands turn as wholes."""
    model = make_model(count, 20 if count == 55 else 16)
    read = read_smpl(files[count])
    assert read.family == {52: "SMPL-H", 55: "SMPL-X"}[count]
    assert read.shape_directions.shape[2] == {52: 16, 55: 10}[count]
    vertices, joints = read.shaped(BETAS)
    pose = np.zeros((count, 3))
    pose[:22] = pose_of(1)[:22]
    expected = smpl_vertices(model, np.array(BETAS), pose, np.zeros(3))
    six = roma.rotvec_to_rotmat(torch.from_numpy(pose[:24]))
    body = body_tensors(load_person("man", 100), dtype=torch.float64)
    tensors = replace(
        body,
        means=torch.from_numpy(vertices),
        weights=torch.from_numpy(read.weights),
        rest_joints=torch.from_numpy(joints),
        pose_directions=torch.from_numpy(read.pose_directions.astype(np.float64)),
    )
    body_pose = torch.from_numpy(np.concatenate([pose[1:22], np.zeros((2, 3))]))[None]
    posed = pose_means(tensors, torch.zeros(1, 3, dtype=torch.float64), rotation_to_6d(six[:1]), body_pose)
    np.testing.assert_allclose(posed[0], expected, atol=1e-6)
    first, middle = (22, 25) if count == 52 else (25, 28)
    np.testing.assert_allclose(joints[22], (model["J_regressor"] @ vertices)[middle])
    np.testing.assert_allclose(read.weights[6 * first : 6 * (first + 15), 22].min(), 0.7)
    if count == 55:
        np.testing.assert_allclose(read.weights[6 * 22 : 6 * 25, JOINT["head"]], 1)


def test_pkl_and_npz_give_the_same_person(files, tmp_path):
    path = pickle_model(tmp_path / "MODEL_24.pkl", make_model())
    one, other = load_smpl(path, BETAS, 300), load_smpl(files[24], BETAS, 300)
    for name, values in vars(one.cloud).items():
        np.testing.assert_array_equal(values, getattr(other.cloud, name))
    np.testing.assert_array_equal(one.pose_directions, other.pose_directions)


def test_betas_and_seed_decide(files):
    plain, again, shaped, other = (
        load_smpl(files[24], betas, 300, seed) for betas, seed in (((), 0), ((0, 0), 0), ((2.0,), 0), ((), 1))
    )
    np.testing.assert_array_equal(plain.cloud.means, again.cloud.means)
    assert np.abs(plain.rest_joints - shaped.rest_joints).max() > 1e-3
    np.testing.assert_array_equal(plain.rest_joints, other.rest_joints)
    assert not np.array_equal(plain.cloud.means, other.cloud.means)
    np.testing.assert_allclose(plain.rest_joints[0], 0)


def test_wears_the_clothes_of_the_outfit(files):
    body = load_smpl(files[24], gaussians=2000, outfit="athlete")
    rgb, dominant = colours(body.cloud), body.skinning_weights.argmax(axis=1)
    for joint, colour in (("spine2", "shirt"), ("left_hip", "trousers"), ("left_hand", "skin"), ("left_foot", "shoes")):
        shades = rgb[dominant == JOINT[joint]] / np.array(getattr(OUTFITS["athlete"], colour))
        assert (np.ptp(shades, axis=1) < 1e-3).mean() > 0.5, joint
    crown = body.cloud.means[:, 1].argmax()
    assert np.ptp(rgb[crown] / np.array(OUTFITS["athlete"].hair)) < 1e-3


def test_says_that_it_is_not_free(files):
    source = load_smpl(files[24], BETAS, 300).source
    assert "SMPL, MODEL_24.npz, betas [0.8, -1.2, 0.5]; licence: SMPL" in source and "non-commercial" in source


def test_stands_and_is_drawn_like_any_person(files):
    body = load_smpl(files[24], gaussians=800)
    motion = stand_motion(body, 2, 20.0)
    means = posed_means(body, motion)
    assert abs(means[..., 2].min()) < 1e-5
    np.testing.assert_allclose(posed_means(body, motion, subset=np.array([3, 700])), means[:, [3, 700]], atol=1e-6)


def test_gradient_through_pose_correctives(files):
    tensors = body_tensors(load_smpl(files[24], gaussians=100), np.array([0, 50]), dtype=torch.float64)
    pose = torch.from_numpy(pose_of(2))
    inputs = (
        torch.zeros(1, 3, dtype=torch.float64, requires_grad=True),
        rotation_to_6d(roma.rotvec_to_rotmat(pose[:1])).requires_grad_(),
        pose[None, 1:].clone().requires_grad_(),
    )
    assert torch.autograd.gradcheck(lambda *given: pose_gaussians(tensors, *given), inputs)


def test_gradient_is_finite_in_the_t_pose(files):
    tensors = body_tensors(load_smpl(files[24], gaussians=200))
    pose = torch.zeros(1, 23, 3, requires_grad=True)
    pose_means(tensors, torch.zeros(1, 3), rotation_to_6d(torch.eye(3))[None], pose).square().sum().backward()
    assert pose.grad is not None and torch.isfinite(pose.grad).all() and pose.grad.abs().max() > 0


@pytest.mark.parametrize("correctives", [True, False])
def test_avatar_and_record_keep_the_correctives(files, tmp_path, correctives):
    body = load_smpl(files[24], BETAS, 300, pose_correctives=correctives)
    save_avatar(body, tmp_path / "ann")
    loaded = load_avatar(tmp_path / "ann")
    assert loaded.name == "ann" and loaded.source == body.source
    scene = replace(make_run()[0].scene, body=body)
    recorded = scene_from_files(scene_files(scene)).body
    for back in (loaded, recorded):
        if correctives:
            np.testing.assert_array_equal(back.pose_directions, body.pose_directions)
        else:
            assert back.pose_directions is None


def test_by_config(composed, files):
    config = to_config(composed("human=smpl", f"human.path={files[24]}", "human.betas=[0.5,-1]", "human.person=woman"))
    body = load_body(replace(config.human, gaussians=300), seed=0)
    expected = load_smpl(files[24], [0.5, -1.0], 300, 0, "woman")
    np.testing.assert_array_equal(body.cloud.means, expected.cloud.means)
    np.testing.assert_array_equal(body.cloud.sh, expected.cloud.sh)
    bare = HumanConf(HumanKind.smpl, "x", path=str(files[24]), gaussians=300, pose_correctives=False)
    assert load_body(bare, 0).pose_directions is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_template": None, "f": None}, "v_template, f: missing; not an SMPL model file"),
        ({"weights": lambda w: w[:, :23]}, r"weights: 23 joints; must be 24 \(SMPL\), 52 \(SMPL-H\), 55 \(SMPL-X\)"),
        ({"weights": lambda w: 1.1 * w}, "weights: must not be negative, and each row must sum to 1"),
        ({"posedirs": lambda p: p[:, :, :200]}, r"posedirs: shape \(144, 3, 200\); must be \(144, 3, 207\)"),
        ({"shapedirs": lambda s: s[:, :2]}, r"shapedirs: shape .*must be \(144, 3, any\)"),
        ({"J_regressor": lambda r: r.T}, r"J_regressor: shape \(144, 24\); must be \(24, 144\)"),
        ({"kintree_table": lambda k: k[:, ::-1]}, "kintree_table: parents .*; SMPL's are"),
        ({"f": lambda f: f + 1}, "f: must be triangles of the 144 vertices"),
        ({"f": lambda f: f[:0]}, "f: must be triangles"),
        ({"v_template": lambda v: v * np.nan}, "v_template: float64; must be finite numbers"),
        ({"v_template": lambda v: v.astype(str)}, "v_template: .*must be"),
        ({"v_template": lambda v: 1000 * v}, r"the person would be 1.*e\+03 m tall; must be 0.3 to 4"),
        ({"v_template": lambda v: v[0]}, "v_template: "),
    ],
)
def test_names_what_is_wrong(tmp_path, changes, message):
    model: dict = make_model()
    for key, change in changes.items():
        if change is None:
            del model[key]
        else:
            model[key] = change(model[key])
    path = tmp_path / "MODEL.npz"
    np.savez(path, **model)
    with pytest.raises(InputError, match=message) as caught:
        load_smpl(path, gaussians=300)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"betas": [0.1] * 11}, "betas: 11 given; this SMPL file has 10"),
        ({"betas": [np.nan]}, r"betas=\[nan\]: must be finite"),
        ({"betas": [1e4]}, "the person would be .* m tall"),
        ({"gaussians": 5}, "gaussians=5: must be at least 100"),
        ({"outfit": "king"}, "person='king': no such outfit; choose one of man, woman"),
    ],
)
def test_refuses_impossible_options(files, options, message):
    with pytest.raises(InputError, match=message):
        load_smpl(files[24], **options)


def test_a_body_without_a_head(tmp_path):
    model = make_model()
    model["weights"][:, JOINT["spine1"]] += model["weights"][:, JOINT["head"]]
    model["weights"][:, JOINT["head"]] = 0
    np.savez(tmp_path / "MODEL.npz", **model)
    with pytest.raises(InputError, match="weights: no vertex moves with the head"):
        load_smpl(tmp_path / "MODEL.npz")
