"""Other systems' outputs as records: what goes in can be measured in what comes out; broken files cost one line."""

import json
import struct
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh

from analysis.ingest import meshes
from analysis.ingest.__main__ import main
from analysis.ingest.contact import centre_of_mass_path, find_contact, velocity
from analysis.ingest.gltf import Animated
from analysis.ingest.points import in_our_world, object_of, tracked_points, triangle_areas
from analysis.metrics import DYNAMICS, METRICS
from analysis.records import load
from hoi import record
from hoi.data import Material
from hoi.errors import InputError
from hoi.record.schemas import SHOWN
from hoi.render.encode import encode, write_mp4

RUBBER = Material("rubber", "neo_hookean", 1e5, 0.4, 100.0, 0.5, 0.5)
FPS, FRAMES, RADIUS = 20.0, 21, 0.2


# ---- a scene that is known: a slab "person" walks at 2 m/s in +y; a ball at rest leaves at 3 m/s when it is met


def slab():
    box = trimesh.creation.box(extents=(0.4, 0.2, 1.6)).subdivide().subdivide()
    path = np.stack([[0.0, 2.0 * t / FPS - 1.0, 0.8] for t in range(FRAMES)])
    return meshes.MeshSequence(box.vertices + path[:, None], np.asarray(box.faces, np.int64), FPS)


def ball(leaves: float = 8.0):
    sphere = trimesh.creation.icosphere(3, RADIUS)
    path = np.stack([[0.0, 0.1 + 3.0 * max(t - leaves, 0.0) / FPS, 1.0] for t in range(FRAMES)])
    return meshes.MeshSequence(sphere.vertices + path[:, None], np.asarray(sphere.faces, np.int64), FPS)


def save(folder: Path, mesh: meshes.MeshSequence, name: str, y_up: bool = False, **more) -> Path:
    vertices = mesh.vertices @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if y_up else mesh.vertices
    np.savez(folder / name, vertices=vertices.astype(np.float32), faces=mesh.faces, **more)
    return folder / name


def run(capsys, *words) -> tuple[int, str, str]:
    try:
        code = main([str(word) for word in words])
    except SystemExit as error:
        code = error.code
    out = capsys.readouterr()
    return code, out.out, out.err


# ---- GLB


class Glb:
    """A GLB, piece by piece."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "buffers": [], "nodes": []}
        self.binary = b""

    def accessor(self, array, kind, **more):
        array = np.asarray(array)
        code = {"f4": 5126, "u2": 5123, "u1": 5121, "u4": 5125}[array.dtype.str[1:]]
        count = array.size if kind == "SCALAR" else len(array)
        self.json["accessors"].append(
            {"bufferView": self.view(array), "componentType": code, "count": count, "type": kind} | more
        )
        return len(self.json["accessors"]) - 1

    def view(self, array):
        data = np.ascontiguousarray(array).tobytes()
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data + b"\0" * (-len(data) % 4)
        return len(self.json["bufferViews"]) - 1

    def bytes(self):
        self.json["buffers"] = [{"byteLength": len(self.binary)} | self.json.pop("buffer", {})]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self.binary)
        head = struct.pack("<III", 0x46546C67, 2, size) + struct.pack("<II", len(text), 0x4E4F534A)
        return head + text + struct.pack("<II", len(self.binary), 0x004E4942) + self.binary

    def save(self, path):
        path.write_bytes(self.bytes())
        return path


TETRA = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRA_FACES = np.uint16([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetra_glb(**primitive) -> Glb:
    glb = Glb()
    primitive = {
        "attributes": {"POSITION": glb.accessor(TETRA, "VEC3")} | primitive.pop("attributes", {}),
        "indices": glb.accessor(TETRA_FACES.ravel(), "SCALAR"),
    } | primitive
    glb.json["meshes"] = [{"primitives": [primitive]}]
    return glb


def animate(glb: Glb, node: int, path: str, times, values, kind: str, interpolation: str = "LINEAR"):
    animation = glb.json.setdefault("animations", [{"channels": [], "samplers": []}])[0]
    sampler = {"input": glb.accessor(np.float32(times), "SCALAR"), "output": glb.accessor(np.float32(values), kind)}
    animation["samplers"].append(sampler | {"interpolation": interpolation})
    animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": path}})


def at(path: Path, time: float, name: str | None = None):
    file = Animated(path)
    return file.vertices(file.below(name), time)


def test_nodes_move_turn_and_hang_on_each_other(tmp_path):
    glb = tetra_glb()
    glb.json["nodes"] = [
        {"name": "world", "children": [1], "translation": [0, 0, 10], "scale": [2, 2, 2]},
        {"name": "thing", "mesh": 0},
        {"name": "other", "mesh": 0},
    ]
    animate(glb, 0, "translation", [0, 1], [[0, 0, 10], [4, 0, 10]], "VEC3")
    quarter = [0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)]
    animate(glb, 1, "rotation", [0, 1], [[0, 0, 0, 1], quarter], "VEC4")
    path = glb.save(tmp_path / "a.glb")
    eighth = np.cos(np.pi / 4)
    turn = np.array([[eighth, -eighth, 0], [eighth, eighth, 0], [0, 0, 1]])
    np.testing.assert_allclose(at(path, 0.5, "thing"), 2 * TETRA @ turn.T + [2, 0, 10], atol=1e-6)
    np.testing.assert_allclose(at(path, 9.0, "world")[1], [4, 2, 10], atol=1e-6)  # held; +x turned to +y
    np.testing.assert_allclose(at(path, 0.5, "other"), TETRA, atol=1e-6)
    assert len(at(path, 0.0)) == 8
    with pytest.raises(InputError, match=r"no node 'nobody'; it has other, thing, world"):
        Animated(path).below("nobody")


def test_interpolations(tmp_path):
    glb = tetra_glb()
    glb.json["nodes"] = [{"mesh": 0}, {"mesh": 0}]
    animate(glb, 0, "translation", [1, 2], [[1, 0, 0], [5, 0, 0]], "VEC3", "STEP")
    # A cubic with in- and out-tangents of x(t) = t^3 on [0, 2] is that cubic.
    keys = [[[0, 0, 0], [0, 0, 0], [0, 0, 0]], [[12, 0, 0], [8, 0, 0], [0, 0, 0]]]
    animate(glb, 1, "translation", [0, 2], np.reshape(keys, (6, 3)), "VEC3", "CUBICSPLINE")
    path = glb.save(tmp_path / "a.glb")
    for time, step, cubic in ((0.5, 1, 0.125), (1.99, 1, 1.99**3), (2.0, 5, 8), (3.0, 5, 8)):
        found = at(path, time)
        np.testing.assert_allclose(found[0], [step, 0, 0], atol=1e-5)
        np.testing.assert_allclose(found[4], [cubic, 0, 0], atol=1e-5)


def test_morph_targets_also_sparse_ones(tmp_path):
    glb = tetra_glb()
    sparse = {
        "componentType": 5126, "count": 4, "type": "VEC3",
        "sparse": {
            "count": 1,
            "indices": {"bufferView": glb.view(np.uint16([3])), "componentType": 5123},
            "values": {"bufferView": glb.view(np.float32([[0, 0, 2]]))},
        },
    }  # fmt: skip
    glb.json["accessors"].append(sparse)
    rise = len(glb.json["accessors"]) - 1
    slide = glb.accessor(np.float32(np.tile([1, 0, 0], (4, 1))), "VEC3")
    glb.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": rise}, {"POSITION": slide}]
    glb.json["nodes"] = [{"mesh": 0}]
    animate(glb, 0, "weights", [0, 1], [0, 0, 1, 0.5], "SCALAR")
    path = glb.save(tmp_path / "a.glb")
    np.testing.assert_allclose(at(path, 0.5), TETRA + [0.25, 0, 0] + np.eye(4)[:, 3:] * [0, 0, 1], atol=1e-6)


def test_skins(tmp_path):
    glb = tetra_glb()
    weights = np.float32([[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0]])
    attributes = glb.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = glb.accessor(np.uint8(np.tile([0, 1, 0, 0], (4, 1))), "VEC4")
    attributes["WEIGHTS_0"] = glb.accessor(np.uint8(np.rint(weights * 255)), "VEC4", normalized=True)
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    inverse[1, 3, :3] = [0, 0, -1]  # column-major: the second joint rests at z = 1
    glb.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": glb.accessor(inverse.reshape(2, 16), "MAT4")}]
    glb.json["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"children": [2]},
        {"translation": [0, 0, 1]},
    ]
    animate(glb, 2, "translation", [0, 1], [[0, 0, 1], [2, 0, 1]], "VEC3")
    path = glb.save(tmp_path / "a.glb")
    shift = 2 * weights[:, 1:2] * [1, 0, 0]
    np.testing.assert_allclose(at(path, 1.0), TETRA + shift, atol=0.01)  # the weights are bytes


def test_a_glb_becomes_a_sequence_at_the_wanted_rate(tmp_path):
    glb = tetra_glb()
    glb.json["nodes"] = [{"mesh": 0}, {"mesh": 0}]
    animate(glb, 0, "translation", [0, 0.5], [[0, 0, 0], [1, 0, 0]], "VEC3")
    mesh = meshes.read(glb.save(tmp_path / "a.glb"), None, 20.0)
    assert mesh.vertices.shape == (11, 8, 3) and mesh.fps == 20.0
    np.testing.assert_allclose(mesh.vertices[:, 0, 0], np.linspace(0, 1, 11), atol=1e-6)
    np.testing.assert_array_equal(mesh.faces[4:], TETRA_FACES + 4)


def broken_glbs() -> dict[str, bytes]:
    whole = tetra_glb()
    whole.json["nodes"] = [{"mesh": 0}]
    animate(whole, 0, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "VEC3")
    good = whole.bytes()

    def changed(change) -> bytes:
        glb = tetra_glb()
        glb.json["nodes"] = [{"mesh": 0}]
        animate(glb, 0, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "VEC3")
        change(glb.json)
        return glb.bytes()

    ring = {"scenes": [{"nodes": [1]}]}
    return {
        "empty": b"",
        "foreign": b"solid ascii stl" * 9,
        "truncated": good[: len(good) // 2],
        "no_json": good[:12] + struct.pack("<II", 0, 7) + good[20:],
        "not_json": good[:20] + b"}" + good[21:],
        "version": good[:4] + struct.pack("<I", 1) + good[8:],
        "huge_count": changed(lambda j: j["accessors"][0].update(count=10**9)),
        "beyond": changed(lambda j: j["accessors"][0].update(count=1000)),
        "negative": changed(lambda j: j["bufferViews"][0].update(byteOffset=-8)),
        "cycle": changed(lambda j: j["nodes"].extend([{"children": [2]}, {"children": [1]}]) or j.update(ring)),
        "corner": changed(lambda j: j["accessors"][0].update(count=3)),
        "still": changed(lambda j: j.pop("animations")),
        "meshless": changed(lambda j: j["nodes"][0].pop("mesh")),
        "draco": changed(lambda j: j.update(extensionsRequired=["KHR_draco_mesh_compression"])),
        "outside": changed(lambda j: j.update(buffer={"uri": "../../etc/passwd"})),
        "types": changed(lambda j: j.update(nodes="abc")),
        "no_kind": changed(lambda j: j["accessors"][0].update(componentType=77)),
        "backwards": changed(lambda j: j["animations"][0]["samplers"][0].update(input=0)),
    }  # fmt: skip


@pytest.mark.parametrize("name", broken_glbs())
def test_broken_glbs_cost_one_line(tmp_path, name):
    bad = tmp_path / f"{name}.glb"
    bad.write_bytes(broken_glbs()[name])
    with pytest.raises(InputError) as refused:
        meshes.read(bad, None, FPS)
    assert "\n" not in str(refused.value) and str(bad) in str(refused.value)


# ---- other meshes


def test_obj_folders_are_read_in_the_order_of_their_numbers(tmp_path):
    mesh = ball()
    for kind in ("obj", "ply"):
        folder = tmp_path / kind
        folder.mkdir()
        for frame in range(11):
            trimesh.Trimesh(mesh.vertices[frame], mesh.faces, process=False).export(folder / f"f{frame}.{kind}")
        (folder / "notes.txt").write_text("not a mesh")
        found = meshes.read(folder, None, FPS)
        np.testing.assert_allclose(found.vertices, mesh.vertices[:11], atol=1e-6)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        assert found.fps is None
    trimesh.creation.box().export(tmp_path / "obj" / "f11.obj")
    with pytest.raises(InputError, match=r"f11.obj has other vertices or faces than f0.obj"):
        meshes.read(tmp_path / "obj", None, FPS)


def test_broken_meshes_cost_one_line(tmp_path):
    good, other = save(tmp_path, ball(), "good.npz", fps=FPS), slab()
    vertices, faces = other.vertices.astype(np.float32), other.faces
    infinite = vertices.copy()
    infinite[3, 5] = np.inf
    cases = {
        "nan": {"vertices": infinite, "faces": faces},
        "faceless": {"vertices": vertices},
        "corner": {"vertices": vertices, "faces": faces + 10**6},
        "flat": {"vertices": vertices[0], "faces": faces},
        "one": {"vertices": vertices[:1], "faces": faces},
        "point": {"vertices": 0 * vertices, "faces": faces},
        "rate": {"vertices": vertices, "faces": faces, "fps": np.float32(np.nan)},
        "pickled": {"vertices": np.array([{}], object), "faces": faces},
        "texts": {"vertices": np.array(["a"]), "faces": faces},
    }
    for name, arrays in cases.items():
        np.savez(tmp_path / f"{name}.npz", **arrays)
    (tmp_path / "cut.npz").write_bytes(good.read_bytes()[:500])
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "mesh.fbx").write_bytes(b"Kaydara")
    (tmp_path / "folder").mkdir()
    for name in [*(f"{name}.npz" for name in (*cases, "cut", "empty", "missing")), "mesh.fbx", "folder"]:
        with pytest.raises(InputError) as refused:
            meshes.read(tmp_path / name, None, FPS)
        assert "\n" not in str(refused.value) and name in str(refused.value)


def test_person_and_object_must_fit_together(tmp_path, capsys):
    good, other = save(tmp_path, ball(), "good.npz", fps=FPS), slab()
    short = meshes.MeshSequence(other.vertices[:7], other.faces, None)
    words = ("--scene", "kick_soccer_ball", "--system", "X", "-o", tmp_path / "run.mcap", "--object", good, "--person")
    for name, mesh, more in (("short.npz", short, {}), ("rates.npz", other, {"fps": 30.0})):
        code, _, err = run(capsys, *words, save(tmp_path, mesh, name, **more))
        assert code == 2 and err.count("\n") == 1 and name in err, err
        assert not (tmp_path / "run.mcap").exists()


def test_the_rate_must_be_known(tmp_path, capsys):
    files = [save(tmp_path, mesh, name) for mesh, name in ((slab(), "a.npz"), (ball(), "b.npz"))]
    words = ("--scene", "kick_soccer_ball", "--system", "X", "-o", tmp_path / "run.mcap")
    code, _, err = run(capsys, *words, "--person", files[0], "--object", files[1])
    assert code == 2 and "--fps" in err


# ---- points, contact, centre of mass


def test_points_stay_on_their_triangles():
    mesh = slab()
    points, colours = tracked_points(mesh, 5000, seed=0)
    np.testing.assert_allclose(points - points[:1], (mesh.vertices - mesh.vertices[:1])[:, :1] + 0 * points, atol=1e-9)
    local = np.abs(points[0] - mesh.vertices[0].mean(axis=0)) / [0.2, 0.1, 0.8]
    np.testing.assert_allclose(local.max(axis=1), 1.0, atol=1e-9)  # on the box's sides
    side = (np.abs(local[:, 1] - 1) < 1e-9).mean()
    assert side == pytest.approx(0.4 * 1.6 / (0.4 * 1.6 + 0.2 * 1.6 + 0.4 * 0.2), abs=0.01)  # by area
    assert colours.shape == (5000, 3)


def test_the_object_has_the_mass_of_its_volume_and_its_inside_follows():
    mesh = ball()
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    stretch = np.diag([1.3, 0.9, 0.9])
    centre = mesh.vertices.mean(axis=1, keepdims=True)
    mesh.vertices[5] = ((mesh.vertices[5] - centre[5]) @ (turn @ stretch).T) + centre[5]
    thing, positions = object_of(mesh, "ball", RUBBER, seed=0)
    volume = trimesh.Trimesh(mesh.vertices[0], mesh.faces).volume
    assert thing.masses.sum() == pytest.approx(100.0 * volume, rel=1e-5)
    inner = positions[:, len(thing.cloud) :]
    assert inner.shape[1] > 500 and (np.linalg.norm(inner[0] - centre[0], axis=1) < RADIUS).all()
    np.testing.assert_allclose(inner[5], (inner[0] - centre[0]) @ (turn @ stretch).T + centre[5], atol=1e-4)


def test_an_open_mesh_is_an_object_too():
    mesh = ball()
    thing, _ = object_of(meshes.MeshSequence(mesh.vertices, mesh.faces[:-1], FPS), "ball", RUBBER, seed=0)
    assert "estimate" in thing.notes[0]
    assert thing.masses.sum() == pytest.approx(100.0 * 4 / 3 * np.pi * RADIUS**3, rel=0.25)


def test_contact_is_found_where_it_is():
    """The slab's face is at y = -0.9 + 0.1 f, the ball's nearest point at -0.1: they meet at frame 8."""
    person, thing = slab(), ball()
    skin, _ = tracked_points(person, 8000, seed=0)
    surface, _ = tracked_points(thing, 4000, seed=1)
    com = centre_of_mass_path(thing.vertices, thing.faces, triangle_areas(thing))
    np.testing.assert_allclose(com[0], [0, 0.1, 1.0], atol=1e-9)
    search = find_contact(skin, surface, com, FPS, distance=0.01, mass=2.0, restitution=0.5)
    push = search.push
    assert push is not None and push.joint == -1
    assert push.frame == pytest.approx(8.0, abs=0.11) and push.gap <= 0.01  # 0.01 m are 0.1 frames
    np.testing.assert_allclose(push.v_human, [0, 2, 0], atol=1e-9)
    np.testing.assert_allclose(push.v_object, 0, atol=1e-9)
    np.testing.assert_allclose(push.normal, [0, 1, 0], atol=0.05)
    assert push.v_in == pytest.approx(2.0, rel=0.01)
    np.testing.assert_allclose(push.impulse, 2.0 * push.v_post, atol=1e-9)
    speed = velocity(com, FPS, search)
    np.testing.assert_allclose(speed[:8, 1], 0, atol=1e-9)
    np.testing.assert_allclose(speed[9:, 1], 3, atol=1e-9)


def test_no_contact_leaves_the_smallest_gap():
    person, thing = slab(), ball()
    person.vertices[..., 0] += 2.0
    skin, surface = tracked_points(person, 2000, 0)[0], tracked_points(thing, 2000, 1)[0]
    search = find_contact(skin, surface, surface.mean(axis=1), FPS, distance=0.01, mass=1.0, restitution=0.5)
    assert search.push is None and not search.contacts
    assert search.smallest_gap == pytest.approx(2.0 - 0.2 - RADIUS, abs=0.02)


def test_the_world_is_metres_and_z_up(tmp_path):
    mesh = meshes.read(save(tmp_path, slab(), "a.npz", y_up=True), None, FPS)
    np.testing.assert_allclose(in_our_world(mesh, 2.0, "y").vertices, 2 * slab().vertices, atol=1e-6)


# ---- the records


@pytest.fixture(scope="module")
def ingested(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ingest")
    pictures = [np.full((50, 65, 3), 20 * shade, np.uint8)[:, :64] for shade in range(9)]
    write_mp4(encode(pictures, 12), folder / "clip.mp4")
    person, thing = (save(folder, m, f"{n}.npz", y_up=True, fps=FPS) for m, n in ((slab(), "person"), (ball(), "ball")))
    words = ["--scene", "kick_soccer_ball", "--system", "AnimateAnyMesh", "--person", person, "--object", thing]
    words += ["--video", folder / "clip.mp4", "--seed", 3, "--seconds", 12.5, "-o", folder / "mesh" / "run.mcap"]
    assert main([str(word) for word in words]) == 0
    words = [
        "--scene",
        "punch_blue_ball",
        "--system",
        "4D-fy",
        "--video",
        folder / "clip.mp4",
        "--prompt",
        "a man punches",
    ]
    assert main([str(word) for word in [*words, "-o", folder / "video" / "run.mcap"]]) == 0
    return folder


def test_a_mesh_record_holds_what_the_metrics_need(ingested):
    path = ingested / "mesh" / "run.mcap"
    run = record.read(path)
    facts = run.provenance | run.result
    assert (facts["scene"], facts["experiment"], facts["variant"]) == ("kick_soccer_ball", "baseline", "AnimateAnyMesh")
    assert (facts["seed"], facts["status"], float(facts["seconds"])) == ("3", "done", 12.5)
    assert run.plan.variant == "AnimateAnyMesh" and run.scene is not None and run.state.motion is None
    assert len(run.scene.body.cloud) == 0 and (run.scene.frames, run.scene.fps) == (FRAMES, FPS)
    skin, colours = record.posed_points(path)
    assert skin.shape == (FRAMES, 6000, 3) and colours.shape == (6000, 3)
    np.testing.assert_allclose(np.diff(skin, axis=0), np.broadcast_to([0, 0.1, 0], skin[1:].shape), atol=SHOWN)
    assert skin[0, :, 2].min() == pytest.approx(0.0, abs=0.01)
    trajectory, search = run.state.trajectory, run.state.contact
    assert trajectory is not None and set(trajectory.phase) == {"ingested"}
    assert search is not None and search.push is not None and search.push.frame == pytest.approx(8.0, abs=0.2)
    np.testing.assert_allclose(trajectory.com_velocity[-1], [0, 3, 0], atol=1e-4)
    with pytest.raises(InputError, match="/human/joints"):
        record.joints(path)
    dynamics = [metric(load(path)) for metric in METRICS.values() if metric.group == DYNAMICS]
    assert dynamics and np.isnan(dynamics).all()  # a mesh says nothing of joints and masses


def test_a_video_record_holds_the_video(ingested):
    for folder in ("mesh", "video"):
        path = ingested / folder / "run.mcap"
        footage = record.video(path)
        assert len(footage) == 9 and footage.cameras == () and footage.fps == 12.0
        decoder = av.CodecContext.create("h264", "r")
        frames = [frame for unit in footage.units for frame in decoder.decode(av.Packet(unit))] + decoder.decode(None)
        means = [frame.to_ndarray(format="rgb24").mean() for frame in frames]
        np.testing.assert_allclose(means, 20 * np.arange(9), atol=4)
        assert path.with_suffix(".mp4").is_file()
    run = record.read(ingested / "video" / "run.mcap")
    assert run.scene is None and run.state.trajectory is None and run.plan.variant == "4D-fy"
    assert "a man punches" in run.config_yaml and np.isnan(float(run.result["seconds"]))
    with pytest.raises(InputError, match="/human/points"):
        record.posed_points(ingested / "video" / "run.mcap")


def test_the_same_files_give_the_same_messages(ingested, tmp_path):
    words = ["--scene", "kick_soccer_ball", "--system", "AnimateAnyMesh", "--seed", 3, "-o", tmp_path / "run.mcap"]
    for name, file in (("person", "person.npz"), ("object", "ball.npz"), ("video", "clip.mp4")):
        words += [f"--{name}", ingested / file]
    assert main([str(word) for word in words]) == 0
    first, again = ingested / "mesh" / "run.mcap", tmp_path / "run.mcap"
    assert record.message_digest(first) == record.message_digest(again)
    hashes = [record.read_metadata(path)["config_hash"] for path in (first, again, ingested / "video" / "run.mcap")]
    assert hashes[0] == hashes[1] != hashes[2]


def test_broken_videos_cost_one_line(ingested, tmp_path, capsys):
    good = (ingested / "clip.mp4").read_bytes()
    cases = {
        "cut.mp4": good[: len(good) * 3 // 4],
        "head.mp4": good[:200],
        "empty.mp4": b"",
        "foreign.mp4": b"#EXTM3U\nfile:///etc/passwd\n" * 50,
        "noise.mp4": np.random.default_rng(0).bytes(5000),
    }
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
    for name in (*cases, "missing.mp4"):
        words = ("--scene", "kick_soccer_ball", "--system", "X", "-o", tmp_path / "run.mcap")
        code, _, err = run(capsys, *words, "--video", tmp_path / name)
        assert code == 2 and err.count("\n") == 1 and name in err, (name, err)
        assert not (tmp_path / "run.mcap").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--scene", "moon_walk"), "allowed are dribble"),
        (("--system", "full"), "a variant of our own"),
        (("--system", "../.."), "a name of up to"),
        (("--system", "two\nlines"), "a name of up to"),
        (("--fps", "0"), "--fps"),
        (("--fps", "nan"), "--fps"),
        (("--up", "x"), "--up"),
        (("--person", "a.glb"), "go together"),
        (("--prompt", " "), "--prompt"),
        (("-o", "run.txt"), ".mcap"),
        (("--seconds", "inf"), "--seconds"),
    ],
)
def test_bad_options_cost_one_line(tmp_path, capsys, words, said):
    default = (
        "--scene",
        "kick_soccer_ball",
        "--system",
        "X",
        "-o",
        tmp_path / "run.mcap",
        "--video",
        tmp_path / "x.mp4",
    )
    code, _, err = run(capsys, *default, *words)
    assert code == 2 and err.count("\n") == 1 and said in err, err


def test_a_record_is_not_replaced_unasked(ingested, capsys):
    words = ("--scene", "punch_blue_ball", "--system", "4D-fy", "--video", ingested / "clip.mp4")
    code, _, err = run(capsys, *words, "-o", ingested / "video" / "run.mcap")
    assert code == 2 and "--overwrite" in err
