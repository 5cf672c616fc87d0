"""Formats of others: what their programs write is read for what it is, and what is broken is refused in one line."""

import gzip
import json
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import recfunctions
from plyfile import PlyData, PlyElement
from scipy.spatial import KDTree
from test_gaussians import assert_same, ply_table, random_cloud, spz_bytes, write_table

from hoi import gaussians
from hoi.data import GaussianCloud
from hoi.errors import InputError
from hoi.gaussians.khr import write_khr
from hoi.objects.load import UP

gaussforge = pytest.importorskip("gaussforge", reason="the independent encoder comes with the dev extra")


def encoded(cloud: GaussianCloud, kind: str, folder: Path, **how: int) -> Path:
    """A cloud as another program writes it."""
    gaussians.write_ply(cloud, folder / "source.ply")
    made = gaussforge.GaussForge().convert((folder / "source.ply").read_bytes(), "ply", kind, **how)
    path = folder / f"cloud.{kind}"
    path.write_bytes(made["data"])
    return path


def matched(back: GaussianCloud, cloud: GaussianCloud) -> GaussianCloud:
    """In the order of `cloud`: writers sort."""
    apart, rows = KDTree(back.means).query(cloud.means)
    assert len(back) == len(cloud) and len(np.unique(rows)) == len(rows) and apart.max() < 0.01
    return gaussians.select(back, rows)


# --- read as another program wrote it --------------------------------------------------------------------------------

STATED: dict[str, tuple[float, float, float, float]] = {
    "compressed.ply": (4e-3, 2e-3, 3e-3, 3e-3),
    "splat": (0, 1e-6, 5e-3, 2e-2),
    "ksplat": (0, 1e-6, 5e-3, 2e-2),
    "spz": (3e-4, 0.032, 3e-3, 2e-2),
    "sog": (3e-4, 0.01, 3e-3, 3e-3),
}
"""Error of position, log scale, opacity and colour coefficient."""


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize(
    ("kind", "how"),
    [
        ("compressed.ply", {}),
        ("splat", {}),
        ("ksplat", {}),
        ("sog", {}),
        *(("spz", {"spz_version": v}) for v in (2, 3, 4)),
    ],
)
def test_what_another_program_writes(tmp_path: Path, kind: str, how: dict[str, int], degree: int) -> None:
    cloud = random_cloud(700, degree)
    file = gaussians.read_file(encoded(cloud, kind, tmp_path, **how))
    back = file.cloud  # this program turns no axes
    assert file.up == ("+y" if kind == "spz" else "-y")
    back = matched(back, cloud)
    place, size, opacity, colour = STATED[kind]
    np.testing.assert_allclose(back.means, cloud.means, atol=place + 1e-7)
    np.testing.assert_allclose(np.log(back.scales), np.log(cloud.scales), atol=size + 1e-5)
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=opacity)
    np.testing.assert_allclose(back.sh[:, 0], cloud.sh[:, 0], atol=colour)
    turned = np.abs((back.quaternions * cloud.quaternions).sum(1)).min()
    assert turned > (0.99 if how.get("spz_version") == 2 else 0.9998)
    # The other program orders the harmonics of these two otherwise than those that the formats come from.
    if not (kind == "compressed.ply" and degree) and not (kind == "ksplat" and degree > 1):
        np.testing.assert_allclose(back.sh[:, 1:], cloud.sh[:, 1 : back.sh.shape[1]], atol=0.07)


def compressed_ply(cloud: GaussianCloud, path: Path) -> None:
    """SuperSplat's layout, chunk by chunk, in plain Python, with harmonics where the cloud has them."""
    count = len(cloud)
    logs, rgb = np.log(cloud.scales.astype(float)), 0.5 + gaussians.SH_C0 * cloud.sh[:, 0].astype(float)
    names = [
        f"{end}_{v}"
        for group in ("x y z", "scale_x scale_y scale_z", "r g b")
        for end in ("min", "max")
        for v in group.split()
    ]
    chunks = np.zeros(-(-count // 256), [(name, "<f4") for name in names])
    packed = np.zeros(count, [(f"packed_{name}", "<u4") for name in ("position", "rotation", "scale", "color")])
    for k in range(len(chunks)):
        rows = slice(256 * k, 256 * (k + 1))
        for values, group in ((cloud.means, "x y z"), (logs, "scale_x scale_y scale_z"), (rgb, "r g b")):
            for axis, name in enumerate(group.split()):
                chunks[f"min_{name}"][k], chunks[f"max_{name}"][k] = values[rows, axis].min(), values[rows, axis].max()
    for i in range(count):
        chunk = chunks[i // 256]

        def share(value: float, name: str, bits: int, chunk: np.void = chunk) -> int:
            low, high = float(chunk[f"min_{name}"]), float(chunk[f"max_{name}"])
            return round((value - low) / (high - low) * (2**bits - 1))

        x, y, z = (share(float(cloud.means[i, a]), n, b) for a, n, b in ((0, "x", 11), (1, "y", 10), (2, "z", 11)))
        packed["packed_position"][i] = x << 21 | y << 11 | z
        x, y, z = (share(logs[i, a], f"scale_{n}", b) for a, n, b in ((0, "x", 11), (1, "y", 10), (2, "z", 11)))
        packed["packed_scale"][i] = x << 21 | y << 11 | z
        r, g, b = (share(rgb[i, a], n, 8) for a, n in enumerate("rgb"))
        packed["packed_color"][i] = r << 24 | g << 16 | b << 8 | round(float(cloud.opacities[i]) * 255)
        q = [float(v) for v in cloud.quaternions[i]]
        largest = max(range(4), key=lambda c: abs(q[c]))
        code = largest
        for c in range(4):
            if c != largest:
                code = code << 10 | round((q[c] * np.copysign(1, q[largest]) * 0.5**0.5 + 0.5) * 1023)
        packed["packed_rotation"][i] = code
    elements = [PlyElement.describe(chunks, "chunk"), PlyElement.describe(packed, "vertex")]
    if cloud.sh.shape[1] > 1:
        rest = cloud.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1)
        sh = np.zeros(count, [(f"f_rest_{j}", "u1") for j in range(rest.shape[1])])
        for j in range(rest.shape[1]):
            sh[f"f_rest_{j}"] = np.clip(np.floor((rest[:, j] / 8 + 0.5) * 256), 0, 255)
        elements.append(PlyElement.describe(sh, "sh"))
    PlyData(elements, byte_order="<", comments=["Generated by SuperSplat 2.0"]).write(str(path))


@pytest.mark.parametrize("degree", range(4))
def test_compressed_ply(tmp_path: Path, degree: int) -> None:
    cloud = random_cloud(300, degree)
    compressed_ply(cloud, tmp_path / "c.compressed.ply")
    back = gaussians.read_gaussians(tmp_path / "c.compressed.ply")
    np.testing.assert_allclose(back.means, cloud.means, atol=4e-3)
    np.testing.assert_allclose(np.log(back.scales), np.log(cloud.scales), atol=2e-3)
    np.testing.assert_allclose(gaussians.colours(back), gaussians.colours(cloud), atol=1 / 255)
    np.testing.assert_allclose(back.sh[:, 1:], cloud.sh[:, 1:], atol=1 / 64 + 1e-6)
    assert np.abs((back.quaternions * cloud.quaternions).sum(1)).min() > 0.99999


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_ksplat_of_all_levels(tmp_path: Path, level: int, degree: int) -> None:
    """Two sections, full and partial buckets, laid out by hand."""
    cloud = random_cloud(300, degree, seed=level)
    parts, heads, bodies = [slice(0, 220), slice(220, 300)], [], []
    kinds = ("<f4", "<f2", "<f2")[level], ("<f4", "<f2", "u1")[level]
    for rows in parts:
        part = gaussians.select(cloud, np.arange(300)[rows])
        count, bucket = len(part), 64
        full, rest = divmod(count, bucket)
        partial = [rest - 5, 5] if level and rest > 5 else []
        buckets = full + len(partial) if level else 0
        head = bytearray(1024)
        struct.pack_into("<IIIIfH", head, 0, count, count, bucket if level else 0, buckets, 8.0, 12 if level else 0)
        struct.pack_into("<I", head, 24, 32767 if level else 0)
        struct.pack_into("<IIH", head, 32, full if level else 0, len(partial), degree)
        owner = np.repeat(np.arange(max(buckets, 1)), [bucket] * full + partial if level else [count])
        centres = np.array([part.means[owner == k].mean(0) for k in range(buckets)], "<f4").reshape(-1, 3)
        body = np.array(partial, "<u4").tobytes() + centres.tobytes()
        for i in range(count):
            if level:
                body += np.rint((part.means[i] - centres[owner[i]]) / 4.0 * 32767 + 32767).astype("<u2").tobytes()
            else:
                body += part.means[i].astype("<f4").tobytes()
            body += part.scales[i].astype(kinds[0]).tobytes() + part.quaternions[i].astype(kinds[0]).tobytes()
            rgba = [*gaussians.colours(part)[i].clip(0, 1), part.opacities[i]]
            body += np.rint(np.array(rgba) * 255).astype("u1").tobytes()
            for band in range(1, degree + 1):
                values = part.sh[i, band**2 : (band + 1) ** 2].T.reshape(-1)
                stored = np.rint((values + 1.5) / 3 * 255) if level == 2 else values
                body += stored.astype(kinds[1]).tobytes()
        heads.append(bytes(head))
        bodies.append(body)
    main = bytearray(4096)
    struct.pack_into("<BBxxIIIIH", main, 0, 0, 1, 2, 2, 300, 300, level)
    struct.pack_into("<ff", main, 36, -1.5, 1.5)
    (tmp_path / "c.ksplat").write_bytes(bytes(main) + b"".join(heads) + b"".join(bodies))
    back = gaussians.read_gaussians(tmp_path / "c.ksplat")
    np.testing.assert_allclose(back.means, cloud.means, atol=2e-4 if level else 0)
    np.testing.assert_allclose(back.scales, cloud.scales, rtol=1e-3)
    np.testing.assert_allclose(back.sh[:, 1:], cloud.sh[:, 1:], atol=(1e-7, 1e-3, 7e-3)[level])
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=0.5 / 255 + 1e-6)
    assert np.abs((back.quaternions * cloud.quaternions).sum(1)).min() > 0.9999


def test_sog_of_version_1_and_as_a_folder(tmp_path: Path) -> None:
    cloud = random_cloud(700)
    with zipfile.ZipFile(encoded(cloud, "sog", tmp_path)) as archive:
        (tmp_path / "folder").mkdir()
        archive.extractall(tmp_path / "folder")
    folder = tmp_path / "folder"
    assert_same(matched(gaussians.read_gaussians(folder), cloud), cloud, atol=0.02)
    from PIL import Image

    meta = json.loads((folder / "meta.json").read_text())
    for part in ("scales", "sh0"):  # the same bytes between bounds
        picture = np.asarray(Image.open(folder / meta[part]["files"][0]).convert("RGBA")).copy()
        book = np.array(meta[part].pop("codebook"))
        values = book[picture[:, :, :3]]
        low, high = values.min((0, 1)), values.max((0, 1))
        picture[:, :, :3] = np.rint((values - low) / (high - low) * 255)
        ends = [low.tolist(), high.tolist()]
        if part == "sh0":
            logits = np.log(np.maximum(picture[:, :, 3], 1) / (255.5 - picture[:, :, 3]))
            picture[:, :, 3] = np.rint((logits + 6) / 12 * 255)
            ends = [[*ends[0], -6.0], [*ends[1], 6.0]]
        meta[part] |= {"mins": ends[0], "maxs": ends[1]}
        Image.fromarray(picture, "RGBA").save(folder / meta[part]["files"][0], lossless=True, exact=True)
    meta["means"]["shape"] = [meta.pop("count"), 3]
    del meta["version"]
    (folder / "meta.json").write_text(json.dumps(meta))
    back = matched(gaussians.read_gaussians(folder / "meta.json"), cloud)
    np.testing.assert_allclose(np.log(back.scales), np.log(cloud.scales), atol=0.02)
    np.testing.assert_allclose(back.opacities, cloud.opacities, atol=0.02)
    np.testing.assert_allclose(gaussians.colours(back), gaussians.colours(cloud), atol=1 / 255)


# --- which way is up -------------------------------------------------------------------------------------------------


def commented(cloud: GaussianCloud, path: Path, *comments: str) -> Path:
    gaussians.write_ply(cloud, path)
    PlyData([PlyElement.describe(ply_table(path), "vertex")], byte_order="<", comments=list(comments)).write(str(path))
    return path


@pytest.mark.parametrize(
    ("comments", "up"),
    [
        ((), "-y"),
        (("Generated by Nerfstudio 1.1.5", "Vertical Axis: z"), "+z"),
        (("Vertical Axis: y",), "+y"),
        (("vertical axis: x",), "+x"),
        (("Exported from Brush", "Vertical axis: y", "SH degree: 3"), "-y"),
        (("Exported from Brush", "Vertical axis: 0.02 -0.99 0.1"), "-y"),
        (("Exported from Brush", "Vertical axis: 0 0 1"), "+z"),
        (("Vertical axis: who knows",), "-y"),
    ],
)
def test_a_comment_says_what_is_up(tmp_path: Path, comments: tuple[str, ...], up: str) -> None:
    file = gaussians.read_file(commented(random_cloud(), tmp_path / "c.ply", *comments))
    assert file.up == up and file.why
    assert not comments or "axis" in file.why.lower()


AXES = {"RUB": 4, "RDF": 6, "LUF": 7, "RUF": 8, "RFU": 12, "RBU": 16, "LDB": 1, "RFD": 10}
PHYSICAL = {"R": [1, 0, 0], "L": [-1, 0, 0], "U": [0, 0, 1], "D": [0, 0, -1], "F": [0, 1, 0], "B": [0, -1, 0]}


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize("version", [3, 4])
def test_spz_in_any_axes_stands_upright_and_is_not_mirrored(tmp_path: Path, name: str, version: int) -> None:
    cloud = random_cloud(60, degree=0)  # the world: x right, y forward, z up
    axes = np.array([PHYSICAL[letter] for letter in name], float)  # rows: the file's axes in the world
    mirrored = np.linalg.det(axes) < 0
    stored = replace(cloud, means=(cloud.means @ axes.T).astype(np.float32))
    content = gzip.decompress(spz_bytes(stored, 3, bits=16))
    extension = struct.pack("<III", 0xADBE0003, 4, AXES[name])
    path = tmp_path / "c.spz"
    if version == 3:
        path.write_bytes(gzip.compress(content[:14] + b"\2" + content[15:] + extension))
    else:
        path.write_bytes(spz_version_4(content, extension))
    file = gaussians.read_file(path)
    assert name in file.why and any("mirrored" in note for note in file.notes) == mirrored
    upright = gaussians.transform(file.cloud, UP[file.up])
    np.testing.assert_allclose(upright.means[:, 2], cloud.means[:, 2], atol=1e-4)
    # Seen from above, what is right of the first point stays right of it.
    first, second = upright.means[:, :2], cloud.means[:, :2]
    turn = np.linalg.svd(first.T.astype(float) @ second)
    assert np.linalg.det(turn[0] @ turn[2]) > 0


def spz_version_4(content: bytes, extension: bytes = b"") -> bytes:
    """Version 3's content, unpacked, as version 4."""
    import zstandard

    _, _, count, degree, bits, _, _ = struct.unpack_from("<IIIBBBB", content)
    widths, at, streams = (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)), 16, []
    for width in widths:
        streams.append(content[at : at + width * count])
        at += width * count
    packed = [zstandard.compress(stream) for stream in streams]
    table = b"".join(struct.pack("<QQ", len(p), len(s)) for p, s in zip(packed, streams, strict=True))
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, count, degree, bits, 2 * bool(extension), 6, 32 + len(extension))
    return head + extension + table + b"".join(packed)


def test_mirrored_spz_shows_the_same_colours() -> None:
    cloud = random_cloud(50, degree=3)
    from hoi.gaussians.spz import _ODD_IN_X

    mirrored = cloud.sh.copy()
    mirrored[:, _ODD_IN_X] *= -1
    directions = gaussians.fibonacci_sphere(50)
    seen = gaussians.colours(replace(cloud, sh=mirrored), directions * [-1, 1, 1])
    np.testing.assert_allclose(seen, gaussians.colours(cloud, directions), atol=1e-6)


# --- the many faces of a PLY -----------------------------------------------------------------------------------------


def changed(cloud: GaussianCloud, path: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
    gaussians.write_ply(cloud, path)
    write_table(change(ply_table(path)), path)
    return path


def small(count: int = 500) -> GaussianCloud:
    cloud = random_cloud(count)
    return replace(cloud, scales=cloud.scales / 4)


def test_activated_values_are_taken_as_they_are(tmp_path: Path) -> None:
    cloud = small()

    def activated(table: np.ndarray, opacities: bool = True, scales: bool = True) -> np.ndarray:
        if opacities:
            table["opacity"] = cloud.opacities
        for axis in range(3) if scales else ():
            table[f"scale_{axis}"] = cloud.scales[:, axis]
        return table

    for which in ({}, {"opacities": False}, {"scales": False}):
        file = gaussians.read_file(changed(cloud, tmp_path / "c.ply", lambda t, w=which: activated(t, **w)))
        assert_same(file.cloud, cloud, atol=1e-5)
        assert len(file.notes) == 2 - len(which)
    raw = gaussians.read_file(changed(cloud, tmp_path / "c.ply", lambda table: table))
    assert_same(raw.cloud, cloud, atol=1e-5)
    assert raw.notes == ()


def test_a_cloud_in_millimetres_with_positive_log_scales_stays_raw(tmp_path: Path) -> None:
    cloud = gaussians.transform(random_cloud(500), np.eye(3), 1000.0)
    file = gaussians.read_file(changed(cloud, tmp_path / "c.ply", lambda table: table))
    np.testing.assert_allclose(file.cloud.scales, cloud.scales, rtol=1e-5)


def test_filter_3d_is_applied(tmp_path: Path) -> None:
    cloud = small()
    width = np.float32(0.01)
    file = gaussians.read_file(
        changed(
            cloud,
            tmp_path / "c.ply",
            lambda t: recfunctions.append_fields(t, "filter_3D", np.full(500, width), usemask=False),
        )
    )
    wider = np.sqrt(cloud.scales.astype(float) ** 2 + 1e-4)
    np.testing.assert_allclose(file.cloud.scales, wider, rtol=1e-4)
    kept = cloud.opacities * (cloud.scales.astype(float) / wider).prod(1)
    np.testing.assert_allclose(file.cloud.opacities, kept, rtol=1e-3, atol=1e-6)
    assert any("filter_3D" in note for note in file.notes)


def test_two_scales_are_flat_gaussians(tmp_path: Path) -> None:
    cloud = small()
    file = gaussians.read_file(changed(cloud, tmp_path / "c.ply", lambda t: recfunctions.drop_fields(t, "scale_2")))
    np.testing.assert_allclose(file.cloud.scales[:, :2], cloud.scales[:, :2], rtol=1e-5)
    assert (0 < file.cloud.scales[:, 2]).all() and (file.cloud.scales[:, 2] < 0.1 * cloud.scales[:, :2].min(1)).all()
    assert any("2DGS" in note for note in file.notes)


@pytest.mark.parametrize("kind", ["u1", "f4"])
def test_red_green_blue_in_place_of_harmonics(tmp_path: Path, kind: str) -> None:
    cloud = small()
    rgb = np.clip(gaussians.colours(cloud), 0, 1)

    def coloured(table: np.ndarray) -> np.ndarray:
        table = recfunctions.drop_fields(table, ["f_dc_0", "f_dc_1", "f_dc_2"])
        values = [(rgb[:, c] * 255).round().astype("u1") if kind == "u1" else rgb[:, c].astype("f4") for c in range(3)]
        return recfunctions.append_fields(table, ["red", "green", "blue"], values, usemask=False)

    file = gaussians.read_file(changed(cloud, tmp_path / "c.ply", coloured))
    np.testing.assert_allclose(gaussians.colours(file.cloud), rgb, atol=0.5 / 255 + 1e-6)


def test_coordinates_of_a_map_keep_their_shape(tmp_path: Path) -> None:
    cloud = small()
    far = np.array([448_262.25, 5_411_932.5, 112.0])

    def moved(table: np.ndarray) -> np.ndarray:
        wide = table.astype([(n, "f8" if n in "xyz" else "f4") for n in table.dtype.names or ()])
        for axis, name in enumerate("xyz"):
            wide[name] = cloud.means[:, axis].astype(float) + far[axis]
        return wide

    file = gaussians.read_file(changed(cloud, tmp_path / "c.ply", moved))
    means = file.cloud.means - file.cloud.means.mean(0)
    np.testing.assert_allclose(means, cloud.means - cloud.means.mean(0), atol=1e-6)
    assert any("centred" in note for note in file.notes)


def test_empty_rows_are_dropped_and_counted_and_zero_turns_named(tmp_path: Path) -> None:
    cloud = small()

    def padded(table: np.ndarray) -> np.ndarray:
        return np.concatenate([table, np.zeros(700, table.dtype)])

    clean, notes = gaussians.load_clean(changed(cloud, tmp_path / "c.ply", padded))
    assert_same(clean, cloud, atol=1e-5)
    assert notes == ["dropped 700 empty rows, zero in place and rotation"]

    def unturned(table: np.ndarray) -> np.ndarray:
        for name in ("rot_0", "rot_1", "rot_2", "rot_3"):
            table[name] = 0
        return table

    with pytest.raises(InputError, match=r"500 of 500 .*quaternion of zero"):
        gaussians.load_clean(changed(cloud, tmp_path / "c.ply", unturned))
    with pytest.raises(InputError, match=r"all 500 rows are zero"):
        gaussians.load_clean(changed(cloud, tmp_path / "c.ply", np.zeros_like))


def test_gzipped_files_are_opened(tmp_path: Path) -> None:
    cloud = small()
    gaussians.write_ply(cloud, tmp_path / "c.ply")
    (tmp_path / "c.ply.gz").write_bytes(gzip.compress((tmp_path / "c.ply").read_bytes()))
    assert_same(gaussians.read_gaussians(tmp_path / "c.ply.gz"), cloud, atol=1e-5)
    gaussians.write_splat(cloud, tmp_path / "c.splat")
    (tmp_path / "c.splat.gz").write_bytes(gzip.compress((tmp_path / "c.splat").read_bytes()))
    assert_same(gaussians.read_gaussians(tmp_path / "c.splat.gz"), cloud, atol=0.02)


# --- glTF ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", range(4))
def test_khr_round_trip_and_its_place_in_the_scene(tmp_path: Path, degree: int) -> None:
    import pygltflib

    cloud = random_cloud(200, degree)
    write_khr(cloud, tmp_path / "c.glb")
    file = gaussians.read_file(tmp_path / "c.glb")
    assert_same(file.cloud, cloud)
    assert file.up == "+y"
    document = pygltflib.GLTF2().load(str(tmp_path / "c.glb"))
    assert document is not None and document.extensionsUsed == ["KHR_gaussian_splatting"]
    turn = np.array([0.5, 0.5, 0.5, 0.5])
    document.nodes[0].children, document.nodes[0].mesh = [1], None
    document.nodes[0].rotation, document.nodes[0].scale = turn.tolist(), [2.0, 2.0, 2.0]
    document.nodes.append(pygltflib.Node(mesh=0, translation=[1.0, 2.0, 3.0]))
    document.save(str(tmp_path / "moved.glb"))
    moved = gaussians.read_gaussians(tmp_path / "moved.glb")
    rotation = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    expected = gaussians.transform(cloud, rotation, 2.0, 2.0 * rotation @ [1, 2, 3])
    np.testing.assert_allclose(moved.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(gaussians.covariances(moved), gaussians.covariances(expected), atol=1e-6)
    directions = gaussians.fibonacci_sphere(200)
    np.testing.assert_allclose(gaussians.colours(moved, directions), gaussians.colours(expected, directions), atol=1e-5)


def test_gltf_with_its_buffer_beside_and_packed_as_spz(tmp_path: Path) -> None:
    cloud = random_cloud(100)
    write_khr(cloud, tmp_path / "c.glb")
    data = (tmp_path / "c.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    document["buffers"][0]["uri"] = "data.bin"
    (tmp_path / "data.bin").write_bytes(data[28 + length :])
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    assert_same(gaussians.read_gaussians(tmp_path / "c.gltf"), cloud)
    spz = spz_bytes(cloud, 3)
    primitive = {"mode": 0, "attributes": {}, "extensions": {"KHR_gaussian_splatting": {
        "extensions": {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}}}}  # fmt: skip
    (tmp_path / "data.bin").write_bytes(spz)
    document |= {"meshes": [{"primitives": [primitive]}], "bufferViews": [{"buffer": 0, "byteLength": len(spz)}]}
    (tmp_path / "c.gltf").write_text(json.dumps(document | {"buffers": [{"uri": "data.bin", "byteLength": len(spz)}]}))
    assert_same(gaussians.read_gaussians(tmp_path / "c.gltf"), cloud, atol=0.05)
    document["buffers"][0]["uri"] = "../outside.bin"
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match="beside it"):
        gaussians.read_gaussians(tmp_path / "c.gltf")


# --- what is not read, and what is broken ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.rad", b"RAD0....", "a .rad file"),
        ("a.usdz", b"PK\3\4....", "a USD file"),
        ("a.ckpt", b"PK\3\4....", "a PyTorch checkpoint"),
        ("a.ply", b"<!DOCTYPE html><html>", "a web page"),
        ("a.ply", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        ("a.lcc", b"\0\1\2", "an .lcc file"),
    ],
)
def test_what_is_not_read_is_called_by_its_name(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        gaussians.read_gaussians(tmp_path / name)
    assert said in str(caught.value) and "mesh" not in str(caught.value)


def malformed(folder: Path) -> list[Path]:
    """Well over a hundred broken files of all formats."""
    cloud = random_cloud(600, 1)
    sources = {kind: encoded(cloud, kind, folder, **how).read_bytes() for kind, how in (
        ("compressed.ply", {}), ("ksplat", {}), ("sog", {}), ("spz", {"spz_version": 4}), ("splat", {}))}  # fmt: skip
    write_khr(cloud, folder / "k.glb")
    sources |= {"glb": (folder / "k.glb").read_bytes(), "v3.spz": spz_bytes(cloud, 3)}
    sources["ply"] = (folder / "source.ply").read_bytes()
    rng, made = np.random.default_rng(0), []
    (folder / "bad").mkdir()

    def add(kind: str, what: str, content: bytes) -> None:
        made.append(folder / "bad" / f"{what}.{kind}")
        made[-1].write_bytes(content)

    for kind, content in sources.items():
        for share in (0.01, 0.1, 0.3, 0.6, 0.9, 0.999):
            add(kind, f"cut_{share}", content[: int(len(content) * share)])
        add(kind, "magic", b"XXXX" + content[4:])
        for at in (4, 8, 12, 16, 20, 24, 28, 4096, 4100, 4104, 4108):
            if at + 4 < len(content):
                add(kind, f"huge_at_{at}", content[:at] + b"\xff\xff\xff\x7f" + content[at + 4 :])
        for number in range(8):
            noisy = bytearray(content)
            for at in rng.integers(0, min(len(content), 6000), 40):
                noisy[at] = rng.integers(256)
            add(kind, f"noise_{number}", bytes(noisy))
    zeros = gzip.compress(b"\0" * 200_000_000, 9)
    add("ply.gz", "bomb", gzip.compress(b"ply\n" + b"\0" * 1_000_000_000, 1))
    add("spz", "bomb", gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 2**31, 3, 12, 0, 0) + b"\0" * 50_000_000))
    add("spz", "zeros", zeros)
    lying = gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 9_999_999, 3, 12, 0, 0) + b"\0" * 649_999_935, 1)
    add("spz", "many", lying)
    header = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty list uchar int y\nend_header\n"
    add("ply", "claims", header.format("binary_little_endian", 10**12).encode() + b"\0" * 100)
    add("ply", "claims_text", header.format("ascii", 10**15).encode() + b"1 1 1\n")
    chunk = "element chunk 99999999999\nproperty float min_x\nelement vertex 1\nproperty uint packed_position\n"
    add("ply", "claims_chunks", f"ply\nformat binary_little_endian 1.0\n{chunk}end_header\n".encode())
    for name, text in (("meta", b"{"), ("list", b"[]"), ("count", b'{"version": 2, "count": 99999999999}'),
                       ("deep", b"[" * 100_000), ("none", b'{"version": 2, "count": 3, "means": null}')):  # fmt: skip
        stream = BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            archive.writestr("meta.json", text)
        add("sog", f"json_{name}", stream.getvalue())
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", b" " * 600_000_000)
    add("sog", "zip_bomb", stream.getvalue())
    for name, document in (
        ("circle", {"scenes": [{"nodes": [0]}], "nodes": [{"children": [0]}]}),
        (
            "count",
            {
                "meshes": [
                    {"primitives": [{"attributes": {"POSITION": 0}, "extensions": {"KHR_gaussian_splatting": {}}}]}
                ]
            },
        ),
        ("scene", {"scene": 7, "scenes": [{}]}),
        ("mesh", {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": -1}]}),
        ("list", []),
    ):
        add("gltf", name, json.dumps(document).encode())
    return made


READ_ALL = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_DATA, (2 << 30, 2 << 30))
from hoi.errors import InputError
from hoi.gaussians import load_clean
read = refused = 0
for name in sys.stdin.read().split("\\n"):
    try:
        load_clean(Path(name))
        read += 1
    except InputError as error:
        assert str(error).startswith(name) and "\\n" not in str(error) and len(str(error)) < 600, (name, str(error))
        refused += 1
    except BaseException as error:
        print(name, repr(error))
print(read, refused)
"""


def test_broken_files_are_refused_in_one_line_and_little_memory(tmp_path: Path) -> None:
    files = malformed(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", READ_ALL], input="\n".join(map(str, files)), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    *failed, counts = done.stdout.strip().split("\n")
    assert not failed, failed
    read, refused = map(int, counts.split())
    assert read + refused == len(files) > 150 and refused > 100
