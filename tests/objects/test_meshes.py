"""Meshes as objects: covered with flat Gaussians in their colours, filled, upright."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import KDTree

from hoi import gaussians
from hoi.errors import InputError
from hoi.gaussians.files import holds_mesh
from hoi.objects.load import load_file, up_in
from hoi.objects.meshes import cover, read_mesh

RED, BLUE = np.array([200, 40, 30]) / 255, np.array([40, 80, 210]) / 255
BALL = np.pi / 6 * 0.4**3


def striped() -> trimesh.Trimesh:
    """A ball of diameter 1, red for y above 0 and blue below, by its texture."""
    ball = trimesh.creation.icosphere(4, 0.5)
    pixels = np.empty((64, 8, 3), "u1")
    pixels[:32], pixels[32:] = RED * 255, BLUE * 255
    uv = np.column_stack([ball.vertices[:, 0] + 0.5, ball.vertices[:, 1] + 0.5])
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(pixels))
    return trimesh.Trimesh(
        ball.vertices, ball.faces, visual=trimesh.visual.TextureVisuals(uv, material=material), process=False
    )


def made(kind: str, folder: Path) -> Path:
    mesh = striped()
    if kind in ("ply", "stl"):
        mesh = trimesh.creation.icosphere(4, 0.5)
    if kind == "ply":
        high = mesh.vertices[:, 2:] > 0
        mesh.visual.vertex_colors = np.uint8(255 * np.where(high, RED, BLUE))
    path = folder / f"ball.{kind}"
    if kind == "obj":
        mesh.visual = trimesh.visual.TextureVisuals(mesh.visual.uv, image=mesh.visual.material.baseColorTexture)
    if kind == "gltf":
        for name, content in trimesh.exchange.gltf.export_gltf(mesh.scene()).items():
            (folder / (path.name if name == "model.gltf" else name)).write_bytes(content)
    else:
        mesh.export(path)
    return path


@pytest.mark.parametrize("kind", ["glb", "gltf", "obj", "ply", "stl"])
def test_a_ball_of_every_format(tmp_path: Path, kind: str) -> None:
    path = made(kind, tmp_path)
    assert holds_mesh(path) and up_in(path)[0] == ("+z" if kind in ("ply", "stl") else "+y")
    loaded = load_file(path, 0.4, "auto", 0.02, 3000, max_drawn=20_000)
    assert any("watertight" in note for note in loaded.notes) and any("up is" in note for note in loaded.notes)
    assert loaded.volumes.sum() == pytest.approx(BALL, rel=0.01)
    drawn = loaded.drawn
    assert drawn is not None and len(loaded.cloud) <= 3000 < len(drawn) <= 20_000
    assert np.linalg.norm(drawn.means, axis=1) == pytest.approx(0.2, rel=0.01)
    normals = gaussians.rotation_matrices(drawn)[:, :, 2]
    assert ((normals * drawn.means).sum(1) > 0.19).all()
    assert (drawn.scales[:, 2] < 0.2 * drawn.scales[:, 0]).all()
    nearest = KDTree(drawn.means).query(drawn.means, 2)[0][:, 1]
    assert np.percentile(nearest, 99) < 4 * np.median(nearest)
    if kind != "stl":
        rgb, z = gaussians.colours(drawn), drawn.means[:, 2]
        np.testing.assert_allclose(rgb[z > 0.03], np.broadcast_to(RED, (np.count_nonzero(z > 0.03), 3)), atol=0.02)
        np.testing.assert_allclose(rgb[z < -0.03], np.broadcast_to(BLUE, (np.count_nonzero(z < -0.03), 3)), atol=0.02)


def test_an_open_mesh_is_filled_like_a_capture_and_says_so(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(4, 0.5)
    ball.update_faces(np.arange(len(ball.faces)) % 40 != 0)  # 128 holes, each narrower than those that are closed
    ball.export(tmp_path / "torn.stl")
    loaded = load_file(tmp_path / "torn.stl", 0.4, "auto", 0.02, 5000)
    assert any("holes" in note and "capture" in note for note in loaded.notes)
    assert loaded.volumes.sum() == pytest.approx(BALL, rel=0.05)


def test_parts_are_placed_and_merged(tmp_path: Path) -> None:
    box, ball = trimesh.creation.box((1, 1, 1)), trimesh.creation.icosphere(3, 0.25)
    box.visual.face_colors, ball.visual.vertex_colors = [255, 0, 0, 255], [0, 255, 0, 255]
    scene = trimesh.Scene()
    scene.add_geometry(box)
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([0, 0.75, 0]))
    scene.export(tmp_path / "two.glb")
    loaded = load_file(tmp_path / "two.glb", 1.5, "auto", 0.05, 5000)
    assert any("2 parts" in note for note in loaded.notes)
    rgb, z = gaussians.colours(loaded.cloud), loaded.cloud.means[:, 2]
    assert (rgb[z > 0.35, 1] > 0.9).all() and np.ptp(loaded.cloud.means, axis=0) == pytest.approx([1, 1, 1.5], rel=0.02)


def test_a_flipped_mesh_is_turned_right(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(3, 0.5)
    ball.invert()
    ball.export(tmp_path / "inside_out.stl")
    assert load_file(tmp_path / "inside_out.stl", 0.4, "auto", 0.02, 3000).volumes.sum() == pytest.approx(
        BALL, rel=0.02
    )


def test_linear_factors_and_masks_of_gltf(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    box.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[0.5, 0.5, 0.5, 1.0])
    )
    box.export(tmp_path / "grey.glb")
    cloud = cover(read_mesh(tmp_path / "grey.glb"), 1.0, 2000)
    np.testing.assert_allclose(gaussians.colours(cloud), 0.735, atol=0.01)  # linear one half, as it is shown
    pixels = np.full((2, 2, 4), 255, "u1")
    pixels[:, 0, 3] = 0
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(pixels, "RGBA"), alphaMode="MASK", alphaCutoff=0.5
    )
    plane = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]], process=False)
    plane.visual = trimesh.visual.TextureVisuals([[0.05, 0], [0.95, 0], [0.95, 1], [0.05, 1]], material=material)
    plane.export(tmp_path / "half.glb")
    half = cover(read_mesh(tmp_path / "half.glb"), 1.0, 4000)
    assert 1500 < len(half) < 2500 and half.means[:, 0].min() > 0.4


def test_the_same_seed_gives_the_same_gaussians(tmp_path: Path) -> None:
    mesh = read_mesh(made("glb", tmp_path))
    np.testing.assert_array_equal(cover(mesh, 1.0, 5000).means, cover(mesh, 1.0, 5000).means)


def broken(folder: Path) -> list[Path]:
    glb, stl, obj = (made(kind, folder).read_bytes() for kind in ("glb", "stl", "obj"))
    files = {
        "cut.glb": glb[: len(glb) // 2],
        "cut.stl": stl[: len(stl) // 2],
        "count.stl": stl[:80] + struct.pack("<I", 2**31) + stl[84:],
        "empty.obj": b"",
        "points.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
        "index.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 900\n",
        "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "point.obj": b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n",
        "json.glb": struct.pack("<4sII", b"glTF", 2, 28) + struct.pack("<I4s", 8, b"JSON") + b"{broken}",
        "accessor.gltf": json.dumps(
            {
                "asset": {"version": "2.0"},
                "meshes": [{"primitives": [{"attributes": {"POSITION": 4}}]}],
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
            }
        ).encode(),
        "claims.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\nproperty float x\n"
                      b"element face 5\nproperty list uchar int vertex_indices\nend_header\n",
    }  # fmt: skip
    (folder / "bad").mkdir()
    for name, content in (
        files | {"noise.stl": np.random.default_rng(0).bytes(500), "text.obj": obj[:0] + b"hello"}
    ).items():
        (folder / "bad" / name).write_bytes(content)
    return sorted((folder / "bad").iterdir())


def test_broken_meshes_are_refused_in_one_line(tmp_path: Path) -> None:
    for path in broken(tmp_path):
        with pytest.raises(InputError) as caught:
            load_file(path, 0.4, "auto", 0.02, 3000)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
