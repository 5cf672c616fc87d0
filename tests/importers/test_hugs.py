"""HUGS people, from a tiny checkpoint of the exact layout, against HUGS's own way of posing them."""

from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import roma
import torch
from hugs_files import COUNT, Tiny
from smpl_files import make_model
from torch import nn

from hoi.body.avatar import load_avatar, save_avatar
from hoi.body.kinematics import forward_kinematics, rotation_to_6d
from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import body_tensors, pose_gaussians, pose_means
from hoi.data import Body
from hoi.errors import InputError
from hoi.importers.hugs import load_hugs
from hoi.importers.smpl import read_smpl

BETAS = [0.4, -0.9]


def transforms(pose: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
    """A_k = G_k [I, -J_k] of a pose (24, 3), (24, 4, 4)."""
    rotations, positions = forward_kinematics(roma.rotvec_to_rotmat(pose), joints[0], joints)
    matrices = torch.eye(4).repeat(24, 1, 1)
    matrices[:, :3, :3] = rotations
    matrices[:, :3, 3] = positions - (rotations @ joints[:, :, None])[..., 0]
    return matrices


def hugs_posed(canonical: dict, pose: torch.Tensor, joints: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Means (N, 3) and blended matrices (N, 3, 3) as HUGS computes them: T_i = sum w A_pose A_canonical^-1."""
    spread = torch.zeros(JOINT_COUNT, 3)
    spread[1, 2], spread[2, 2] = 1.0, -1.0
    both = transforms(pose, joints) @ torch.linalg.inv(transforms(spread, joints))
    blended = torch.einsum("nk,kij->nij", canonical["weights"], both)
    means = canonical["means"]
    if "posedirs" in canonical:
        feature = (roma.rotvec_to_rotmat(pose[1:]) - torch.eye(3)).reshape(1, -1)
        means = means + (feature @ canonical["posedirs"]).reshape(-1, 3)
    return (blended @ nn.functional.pad(means, (0, 1), value=1.0)[..., None])[:, :3, 0], blended[:, :3, :3]


@pytest.fixture
def smpl(tmp_path) -> Path:
    path = tmp_path / "SMPL_NEUTRAL.npz"
    np.savez(path, **make_model())
    return path


def converted(tiny: Tiny, smpl: Path, **changes) -> Body:
    path = smpl.parent / "human_final.pth"
    torch.save(tiny.checkpoint() | changes, path)
    return load_hugs(path, smpl, BETAS)


def joints_of(smpl: Path) -> torch.Tensor:
    return torch.from_numpy(read_smpl(smpl).shaped(BETAS)[1]).float()


def posed(body: Body, pose: torch.Tensor) -> torch.Tensor:
    orientation = rotation_to_6d(roma.rotvec_to_rotmat(pose[:1]))
    return pose_means(body_tensors(body), torch.zeros(1, 3), orientation, pose[None, 1:])[0]


def test_the_t_pose_is_hugs_own(smpl):
    tiny = Tiny()
    body, canonical, joints = converted(tiny, smpl), tiny.canonical(), joints_of(smpl)
    means, blended = hugs_posed(canonical, torch.zeros(JOINT_COUNT, 3), joints)
    np.testing.assert_allclose(body.cloud.means, means - joints[0], atol=2e-6)
    np.testing.assert_allclose(body.rest_joints, joints - joints[0], atol=1e-6)
    np.testing.assert_allclose(body.skinning_weights, canonical["weights"], atol=1e-5)
    np.testing.assert_allclose(body.cloud.opacities, canonical["opacity"], atol=1e-6)
    np.testing.assert_allclose(body.cloud.scales, canonical["scales"].clamp_min(1e-6), atol=1e-6)
    assert body.cloud.sh.shape == (COUNT, 1, 3)
    np.testing.assert_allclose(body.cloud.sh[:, 0], canonical["shs"][:, 0], atol=1e-6)
    u, _, vt = np.linalg.svd(blended.numpy())
    turned = u @ vt @ canonical["rotations"].numpy()
    rotations = roma.unitquat_to_rotmat(torch.from_numpy(body.cloud.quaternions[:, [1, 2, 3, 0]]))
    np.testing.assert_allclose(rotations, turned, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(body.cloud.quaternions, axis=1), 1, atol=1e-6)
    assert body.pose_directions is None and "HUGS, human_final.pth" in body.source and "licence" in body.source


def test_the_t_pose_is_not_the_canonical_pose(smpl):
    """Legs come together: what hangs on the left hip alone turns by a radian about it."""
    tiny = Tiny(one_joint=True)  # all on the left knee, which the hip carries
    body, canonical, joints = converted(tiny, smpl), tiny.canonical(), joints_of(smpl)
    assert canonical["weights"][:, 4].min() > 0.999
    turn = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, -1.0]))
    expected = (canonical["means"] - joints[1]) @ turn.T + joints[1] - joints[0]
    np.testing.assert_allclose(body.cloud.means, expected, atol=1e-4)


@pytest.mark.parametrize("blendshapes", [False, True])
def test_where_one_joint_carries_it_every_pose_is_hugs_own(smpl, blendshapes):
    tiny = Tiny(blendshapes, one_joint=True)
    body, joints = converted(tiny, smpl), joints_of(smpl)
    assert (body.pose_directions is not None) == blendshapes
    pose = 0.5 * torch.randn(JOINT_COUNT, 3, generator=torch.Generator().manual_seed(3))
    means, _ = hugs_posed(tiny.canonical(), pose, joints)
    np.testing.assert_allclose(posed(body, pose), means - joints[0], atol=2e-3 if blendshapes else 2e-4)
    if blendshapes:
        plain = replace(body, pose_directions=None)
        assert (posed(plain, pose) - (means - joints[0])).abs().max() > 0.02


def test_what_blending_in_two_steps_costs_is_small_near_the_t_pose(smpl):
    tiny = Tiny()
    body, joints = converted(tiny, smpl), joints_of(smpl)
    pose = torch.randn(JOINT_COUNT, 3, generator=torch.Generator().manual_seed(4))
    errors = []
    for angle in (0.3, 0.03):
        means, _ = hugs_posed(tiny.canonical(), angle * pose, joints)
        errors.append(float((posed(body, angle * pose) - (means - joints[0])).norm(dim=1).max()))
    assert errors[1] < 0.2 * errors[0]


def test_flat_gaussians_get_a_third_scale(smpl):
    body = converted(Tiny(scales=2), smpl)
    np.testing.assert_allclose(body.cloud.scales[:, 2], 1e-5)
    assert (body.cloud.scales[:, :2] > 1e-5).any()


def test_active_harmonics_are_kept(smpl):
    tiny = Tiny()
    body = converted(tiny, smpl, active_sh_degree=1)
    np.testing.assert_allclose(body.cloud.sh, tiny.canonical()["shs"][:, :4], atol=1e-6)


def test_faint_gaussians_are_pruned(smpl):
    tiny = Tiny()
    faint = tiny.canonical()["opacity"].median()
    tiny.appearance["opacity"][0].bias.data += torch.logit(torch.tensor(0.005)) - torch.logit(faint)
    opacity = tiny.canonical()["opacity"]
    body = converted(tiny, smpl)
    assert 0 < len(body.cloud) < COUNT
    np.testing.assert_allclose(body.cloud.opacities, opacity[opacity >= 0.005], atol=1e-6)
    assert len(body.cloud) == len(body.skinning_weights) == len(body.cloud.means)
    tiny.appearance["opacity"][0].bias.data -= 100
    with pytest.raises(InputError, match=r"every Gaussian is fainter than 0\.005"):
        converted(tiny, smpl)


def test_is_an_avatar(smpl):
    body = converted(Tiny(blendshapes=True), smpl)
    save_avatar(body, smpl.parent / "person")
    loaded = load_avatar(smpl.parent / "person")
    np.testing.assert_allclose(loaded.cloud.means, body.cloud.means, atol=1e-6)
    np.testing.assert_array_equal(loaded.pose_directions, body.pose_directions)
    assert loaded.source == body.source
    pose = 0.3 * torch.randn(JOINT_COUNT, 3, generator=torch.Generator().manual_seed(5))
    means, rotations = pose_gaussians(
        body_tensors(loaded), torch.zeros(1, 3), rotation_to_6d(torch.eye(3))[None], pose[None, 1:]
    )
    assert torch.isfinite(means).all() and torch.isfinite(rotations).all()


def without(values: dict, *names: str) -> dict:
    *folders, last = names
    node = values
    for name in folders:
        node[name] = OrderedDict(node[name])
        node = node[name]
    del node[last]
    return values


class Harmless:
    pass


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: without(c, "xyz"), "xyz: missing; not the human of a HUGS checkpoint"),
        (lambda c: without(c, "triplane", "plane_xz"), r"triplane\.plane_xz: missing"),
        (lambda c: without(c, "geometry_dec", "scales.1.bias"), r"geometry_dec\.scales\.1\.bias: missing"),
        (lambda c: without(c, "deformation_dec", "skinning_linear.weight_g"), "skinning_linear.weight_g: missing"),
        (lambda c: without(c, "active_sh_degree"), "active_sh_degree=None: must be 0, 1, 2 or 3"),
        (lambda c: c | {"triplane": 3}, r"triplane\.plane_xy: missing"),
        (lambda c: c | {"xyz": c["xyz"][:, :2]}, r"xyz: shape \(60, 2\); must be a tensor of shape \(any, 3\)"),
        (lambda c: c | {"xyz": "here"}, "xyz: str; must be a tensor"),
        (lambda c: c | {"xyz": c["xyz"] * 2}, r"xyz: must be points within \[-1, 1\]\^3"),
        (lambda c: c | {"xyz": c["xyz"] * torch.nan}, "xyz: holds values that are not finite"),
        (lambda c: c | {"scaling_multiplier": c["denom"][:5]}, r"scaling_multiplier: shape \(5, 1\)"),
        (lambda c: [c], "holds a list; must be the dictionary of a HUGS human"),
        (lambda c: c | {"extra": Harmless()}, r"names test_hugs\.Harmless, which is no tensor; refused"),
    ],
)
def test_names_what_is_wrong(smpl, change, message):
    path = smpl.parent / "human_000001.pth"
    torch.save(change(Tiny().checkpoint()), path)
    with pytest.raises(InputError, match=message) as caught:
        load_hugs(path, smpl, BETAS)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"", b"not a checkpoint", b"PK\x03\x04broken"])
def test_other_files(smpl, content):
    path = smpl.parent / "human.pth"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"human\.pth: ") as caught:
        load_hugs(path, smpl, BETAS)
    assert "\n" not in str(caught.value)
