"""Gaussian clouds: files round trip, bad files are refused, colours and covariances follow motion."""

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import recfunctions
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from hoi import gaussians
from hoi.data import GaussianCloud
from hoi.errors import InputError


def random_cloud(count: int = 40, degree: int = 0, seed: int = 0) -> GaussianCloud:
    rng = np.random.default_rng(seed)
    return GaussianCloud(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        quaternions=Rotation.random(count, rng).as_quat(scalar_first=True, canonical=True).astype(np.float32),
        scales=rng.uniform(0.01, 0.1, (count, 3)).astype(np.float32),
        opacities=rng.uniform(0.05, 0.95, count).astype(np.float32),
        sh=rng.uniform(-0.5, 0.5, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def assert_same(a: GaussianCloud, b: GaussianCloud, atol: float = 1e-6) -> None:
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=atol, err_msg=name)
    np.testing.assert_allclose(np.abs((a.quaternions * b.quaternions).sum(1)), 1, atol=max(atol, 1e-6))


def ply_table(path: Path) -> np.ndarray:
    return np.array(PlyData.read(str(path))["vertex"].data)


def write_table(table: np.ndarray, path: Path, **how: object) -> None:
    PlyData([PlyElement.describe(table, "vertex")], **how).write(str(path))  # type: ignore[arg-type]


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", range(4))
def test_ply_round_trip(tmp_path: Path, degree: int) -> None:
    cloud = random_cloud(degree=degree)
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    assert_same(gaussians.read_gaussians(tmp_path / "c.ply"), cloud)
    rest = [f"f_rest_{i}" for i in range(3 * ((degree + 1) ** 2 - 1))]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity"]
    expected += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert ply_table(tmp_path / "c.ply").dtype.names == tuple(expected)


def test_ply_stores_raw_parameters_with_channel_major_rest(tmp_path: Path) -> None:
    cloud = random_cloud(degree=3)
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    table = ply_table(tmp_path / "c.ply")
    np.testing.assert_allclose(table["f_rest_0"], cloud.sh[:, 1, 0])  # red of the first three coefficients
    np.testing.assert_allclose(table["f_rest_1"], cloud.sh[:, 2, 0])
    np.testing.assert_allclose(table["f_rest_15"], cloud.sh[:, 1, 1])  # then green, then blue
    np.testing.assert_allclose(table["f_rest_44"], cloud.sh[:, 15, 2])
    np.testing.assert_allclose(np.exp(table["scale_1"]), cloud.scales[:, 1], rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-table["opacity"])), cloud.opacities, rtol=1e-5)
    np.testing.assert_allclose(table["rot_0"], cloud.quaternions[:, 0])


@pytest.mark.parametrize("how", [{"text": True}, {"byte_order": ">"}, {"byte_order": "<"}])
def test_ply_permuted_double_without_normals(tmp_path: Path, how: dict[str, object]) -> None:
    cloud = random_cloud(degree=2)
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    table = ply_table(tmp_path / "c.ply")
    assert table.dtype.names
    names = [n for n in np.random.default_rng(1).permutation(table.dtype.names) if n not in ("nx", "ny", "nz")]
    other = np.zeros(len(table), [(name, "f8") for name in names] + [("label", "i4")])
    for name in names:
        other[name] = table[name]
    for component in range(4):
        other[f"rot_{component}"] *= 3.7  # files hold quaternions of any length
    write_table(other, tmp_path / "other.ply", **how)
    assert_same(gaussians.read_gaussians(tmp_path / "other.ply"), cloud)


def test_splat_round_trip(tmp_path: Path) -> None:
    cloud = random_cloud(degree=1)
    gaussians.write_splat(cloud, tmp_path / "c.splat")
    assert (tmp_path / "c.splat").stat().st_size == 32 * len(cloud)
    back = gaussians.read_gaussians(tmp_path / "c.splat")
    np.testing.assert_array_equal(back.means, cloud.means)
    np.testing.assert_array_equal(back.scales, cloud.scales)
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(gaussians.colours(back), gaussians.colours(cloud), atol=0.5 / 255 + 1e-6)
    assert np.abs((back.quaternions * cloud.quaternions).sum(1)).min() > 0.9998


def spz_bytes(cloud: GaussianCloud, version: int, bits: int = 12) -> bytes:
    """A cloud as SPZ, one Gaussian after the other, in plain Python."""
    blocks: list[list[int]] = [[], [], [], [], [], []]
    for i in range(len(cloud)):
        for value in cloud.means[i]:
            blocks[0] += round(float(value) * 2**bits).to_bytes(3, "little", signed=True)
        blocks[1].append(round(float(cloud.opacities[i]) * 255))
        blocks[2] += [round((float(v) * 0.15 + 0.5) * 255) for v in cloud.sh[i, 0]]
        blocks[3] += [round((float(np.log(v)) + 10) * 16) for v in cloud.scales[i]]
        xyzw = [float(v) for v in np.roll(cloud.quaternions[i], -1)]
        if version == 2:
            blocks[4] += [round(v * np.copysign(1, xyzw[3]) * 127.5 + 127.5) for v in xyzw[:3]]
        else:
            largest = max(range(4), key=lambda c: abs(xyzw[c]))
            packed = largest
            for component in range(4):
                if component != largest:
                    value = xyzw[component] * float(np.copysign(1, xyzw[largest]))
                    packed = packed << 10 | (value < 0) << 9 | round(abs(value) * 2**0.5 * 511)
            blocks[4] += packed.to_bytes(4, "little")
        blocks[5] += [round(float(v) * 128) + 128 for v in cloud.sh[i, 1:].ravel()]
    header = b"NGSP" + version.to_bytes(4, "little") + len(cloud).to_bytes(4, "little")
    header += bytes([gaussians.sh_degree(cloud), bits, 0, 0])
    return gzip.compress(header + b"".join(bytes(block) for block in blocks))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("degree", range(4))
def test_spz(tmp_path: Path, version: int, degree: int) -> None:
    cloud = random_cloud(degree=degree)
    (tmp_path / "c.spz").write_bytes(spz_bytes(cloud, version))
    back = gaussians.read_gaussians(tmp_path / "c.spz")
    np.testing.assert_allclose(back.means, cloud.means, atol=0.5 / 4096 + 1e-6)
    np.testing.assert_allclose(np.log(back.scales), np.log(cloud.scales), atol=0.5 / 16 + 1e-5)
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(back.sh[:, 0], cloud.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-5)
    np.testing.assert_allclose(back.sh[:, 1:], cloud.sh[:, 1:], atol=0.5 / 128 + 1e-6)
    assert np.abs((back.quaternions * cloud.quaternions).sum(1)).min() > (0.99 if version == 2 else 0.99999)


def test_model_directory_gives_its_last_iteration(tmp_path: Path) -> None:
    for iteration, count in ((7000, 5), (30000, 7), (400, 3)):
        folder = tmp_path / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        gaussians.write_ply(random_cloud(count), folder / "point_cloud.ply")
    assert len(gaussians.read_gaussians(tmp_path)) == 7
    with pytest.raises(InputError, match="iteration_"):
        gaussians.read_gaussians(tmp_path / "point_cloud")


# --- bad files -------------------------------------------------------------------------------------------------------


def cut(content: bytes) -> bytes:
    return content[: len(content) * 2 // 3]


def make_bad(folder: Path, kind: str) -> Path:
    cloud, path = random_cloud(), folder / "bad.ply"
    gaussians.write_ply(cloud, path)
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "truncated ply":
        path.write_bytes(cut(path.read_bytes()))
    elif kind == "truncated ascii ply":
        write_table(ply_table(path), path, text=True)
        path.write_bytes(cut(path.read_bytes()))
    elif kind == "broken ply header":
        path.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex many\nend_header\n")
    elif kind == "ply header of bytes":
        path.write_bytes(b"ply\n" + bytes(range(256)) * 3)
    elif kind == "mesh ply":
        write_table(np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4")]), path)
    elif kind == "ply without vertices":
        PlyData([PlyElement.describe(np.zeros(3, [("a", "f4")]), "face")]).write(str(path))
    elif kind == "odd f_rest":
        table = ply_table(path)
        write_table(recfunctions.append_fields(table, "f_rest_0", table["x"], usemask=False), path)
    elif kind == "no gaussian":
        write_table(ply_table(path)[:0], path)
    elif kind == "splat of a wrong size":
        path = folder / "bad.splat"
        path.write_bytes(b"\0" * 33)
    elif kind == "text":
        path = folder / "bad.txt"
        path.write_text("hello")
    elif kind == "truncated spz":
        path = folder / "bad.spz"
        path.write_bytes(cut(spz_bytes(cloud, 3)))
    elif kind == "short spz":
        path = folder / "bad.spz"
        path.write_bytes(gzip.compress(cut(gzip.decompress(spz_bytes(cloud, 3)))))
    elif kind == "future spz":
        path = folder / "bad.spz"
        path.write_bytes(spz_bytes(cloud, 4))
    elif kind == "other gzip":
        path = folder / "bad.spz"
        path.write_bytes(gzip.compress(b"hello"))
    elif kind == "missing":
        path = folder / "none.ply"
    return path


@pytest.mark.parametrize(
    "kind",
    """missing, empty, truncated ply, truncated ascii ply, broken ply header, ply header of bytes, mesh ply,
    ply without vertices, odd f_rest, no gaussian, splat of a wrong size, text, truncated spz, short spz, future spz,
    other gzip""".replace("\n    ", " ").split(", "),
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = make_bad(tmp_path, kind)
    with pytest.raises(InputError) as caught:
        gaussians.load_clean(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_few_unusable_gaussians_are_dropped_and_many_refused(tmp_path: Path) -> None:
    cloud = random_cloud(1000)
    cloud.means[3, 1] = np.nan
    cloud.scales[5, 0] = np.inf
    cloud.quaternions[7] = 0
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    clean, notes = gaussians.load_clean(tmp_path / "c.ply")
    assert_same(clean, gaussians.select(cloud, np.delete(np.arange(1000), [3, 5, 7])))
    assert len(notes) == 1 and "3" in notes[0]
    cloud.means[:20, 0] = np.nan
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    with pytest.raises(InputError, match="20 of 1000"):
        gaussians.load_clean(tmp_path / "c.ply")


# --- colour and geometry ---------------------------------------------------------------------------------------------


def test_sh_basis_is_orthonormal() -> None:
    basis = gaussians.sh_basis(gaussians.fibonacci_sphere(20000), 3)
    np.testing.assert_allclose(4 * np.pi / 20000 * basis.T @ basis, np.eye(16), atol=1e-4)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("each", [False, True])
def test_rotated_harmonics_show_the_old_colour_along_the_turned_direction(degree: int, each: bool) -> None:
    cloud = random_cloud(degree=degree)
    rng = np.random.default_rng(2)
    rotation = Rotation.random(len(cloud), rng).as_matrix() if each else Rotation.random(None, rng).as_matrix()
    directions = rng.normal(size=(len(cloud), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turned = replace(cloud, sh=gaussians.rotate_sh(cloud.sh, rotation))
    turned_directions = (rotation @ directions[:, :, None])[:, :, 0]
    np.testing.assert_allclose(
        gaussians.colours(turned, turned_directions), gaussians.colours(cloud, directions), atol=1e-5
    )


def test_colours_of_degree_zero() -> None:
    rgb = np.random.default_rng(3).uniform(size=(10, 3))
    cloud = replace(random_cloud(10), sh=gaussians.sh_from_colours(rgb))
    np.testing.assert_allclose(gaussians.colours(cloud), rgb, atol=1e-6)
    np.testing.assert_allclose(gaussians.colours(cloud, gaussians.fibonacci_sphere(10)), rgb, atol=1e-6)


def test_transform_moves_covariances_along() -> None:
    cloud = random_cloud(degree=3)
    rotation = Rotation.random(None, np.random.default_rng(4)).as_matrix()
    moved = gaussians.transform(cloud, rotation, scale=2.5, translation=[1, 2, 3])
    np.testing.assert_allclose(moved.means, 2.5 * cloud.means @ rotation.T + [1, 2, 3], atol=1e-5)
    expected = 2.5**2 * rotation @ gaussians.covariances(cloud) @ rotation.T
    np.testing.assert_allclose(gaussians.covariances(moved), expected, atol=1e-6)
    back = gaussians.transform(moved, rotation.T, 1 / 2.5, -rotation.T @ [1, 2, 3] / 2.5)
    assert_same(back, cloud, atol=1e-5)


def test_deformation_gives_f_sigma_ft() -> None:
    cloud = random_cloud(degree=1)
    gradient = np.eye(3) + 0.3 * np.random.default_rng(5).normal(size=(len(cloud), 3, 3))
    expected = gradient @ gaussians.covariances(cloud) @ gradient.transpose(0, 2, 1)
    deformed = gaussians.deform(cloud, cloud.means + 1, gradient)
    np.testing.assert_allclose(gaussians.covariances(deformed), expected, atol=1e-7)


def test_deformation_by_a_rotation_is_the_rotation() -> None:
    cloud = random_cloud(degree=3)
    rotation = Rotation.random(None, np.random.default_rng(6)).as_matrix()
    rigid = gaussians.transform(cloud, rotation)
    deformed = gaussians.deform(cloud, rigid.means, np.broadcast_to(rotation, (len(cloud), 3, 3)))
    np.testing.assert_allclose(gaussians.covariances(deformed), gaussians.covariances(rigid), atol=1e-7)
    np.testing.assert_allclose(deformed.sh, rigid.sh, atol=1e-5)
