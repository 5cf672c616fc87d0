"""The record: what goes in comes out, the bytes are the run's alone, and broken files are refused in one line."""

import builtins
import errno
import hashlib
import json
import shutil
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest
from demo_run import fk, make_run
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from hoi import record
from hoi.data import ContactSearch, Material, Plan, Plane, Run, State
from hoi.errors import InputError, RunError
from hoi.gaussians import select
from hoi.record import message_digest
from hoi.record.parts import scene_files, scene_from_files
from hoi.record.schemas import FINEST, JSON_SCHEMAS, PROTOBUF_SCHEMAS, SHOWN, STRAIN, as_recorded, rounded
from hoi.render.cameras import look_at, project
from hoi.render.encode import encode


@pytest.fixture(scope="module")
def demo():
    return make_run()


@pytest.fixture(scope="module")
def path(demo, tmp_path_factory):
    path = tmp_path_factory.mktemp("record") / "run.mcap"
    save(path, demo)
    return path


@cache
def footage() -> record.Footage:
    """Five pictures, all different, from a camera that moves."""
    rng = np.random.default_rng(1)
    pictures = [np.full((32, 48, 3), 50 * shade, np.uint8) for shade in range(5)]
    eyes = rng.normal((5, -3, 2), 0.5, (5, 3))
    cameras = tuple(look_at(eye, (0, 1, 0.8), width=48, height=32) for eye in eyes)
    return record.Footage(encode(pictures, 20).units, cameras)


def save(path, demo, **options):
    record.write(*demo[:1], path, *demo[1:], **({"plan_text": "full\n", "footage": footage()} | options))


ROUNDED = {"positions": FINEST / 2, "deformation_gradient": STRAIN / 2}


def same(a, b, where="run"):
    """Equality of nested dataclasses, arrays by value, shape and, where they are large, type; but for rounding."""
    if is_dataclass(a):
        assert type(a) is type(b), where
        for f in fields(a):
            same(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    elif isinstance(a, tuple):
        assert isinstance(b, tuple) and len(a) == len(b), where
        for i, pair in enumerate(zip(a, b, strict=True)):
            same(*pair, f"{where}[{i}]")
    elif isinstance(a, np.ndarray) and (name := where.rpartition(".trajectory.")[2]) in ROUNDED:
        np.testing.assert_allclose(a, b, rtol=0, atol=ROUNDED[name], err_msg=where)
        assert a.dtype == b.dtype, where
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, where)
        assert a.ndim == 1 or a.dtype == b.dtype, where
    else:
        assert a == b and type(a) is type(b), (where, a, b)


def messages(path, topic=None):
    with open(path, "rb") as file:
        return [
            (channel.topic, message, decoded)
            for _, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory(), Json()]
            ).iter_decoded_messages(topic)
        ]


class Json:
    def decoder_for(self, encoding, schema):
        return json.loads if encoding == "json" else None


def test_round_trip_is_identity(demo, path):
    same(demo[0], record.read(path))


def test_a_record_of_a_record_is_the_same_to_the_byte(demo, path, tmp_path):
    """What is rounded once stays as it is; small objects are rounded finer."""
    again = tmp_path / "again.mcap"
    save(again, (record.read(path), *demo[1:]))
    assert message_digest(again) == message_digest(path)
    trajectory = demo[0].state.trajectory
    tiny = replace(trajectory, positions=trajectory.positions * np.float32(1e-3))
    error = abs(as_recorded(tiny).positions - tiny.positions).max()
    assert 0 < error < 1e-4 * np.ptp(tiny.positions[0])
    assert np.isnan(rounded(np.array([np.nan, 1.0], np.float32), FINEST)[0])


def test_a_person_alone_is_recorded_without_an_object(demo, tmp_path):
    run = demo[0]
    alone = replace(run, scene=replace(run.scene, object=None), state=State(motion=run.state.motion))
    save(tmp_path / "run.mcap", (alone, *demo[1:]), footage=None)
    same(alone, record.read(tmp_path / "run.mcap"))
    assert "object.npz" not in scene_files(alone.scene)
    with pytest.raises(ValueError, match="no trajectory"):
        save(tmp_path / "run.mcap", (replace(alone, state=run.state), *demo[1:]), footage=None)


def test_an_object_without_particles_is_none_as_older_records_of_a_person_have_it(demo):
    thing = demo[0].scene.object
    none = {name: getattr(thing, name)[:0] for name in ("particles", "volumes")}
    scene = replace(demo[0].scene, object=replace(thing, cloud=select(thing.cloud, np.arange(0)), **none))
    assert scene_from_files(scene_files(scene)).object is None


def variants(run: Run) -> dict[str, Run]:
    state, trajectory = run.state, run.state.trajectory
    search = state.contact
    twice = (replace(search.contacts[0], frame=1.5, v_in=np.inf), replace(search.contacts[0], frame=3.0))
    doubles = replace(
        trajectory,
        **{
            f.name: getattr(trajectory, f.name).astype(np.float64)
            for f in fields(trajectory)
            if f.name not in ("phase", "deformation_gradient")
        },
    )
    diverged = replace(state.motion, body_pose=np.full_like(state.motion.body_pose, np.nan))
    thing = run.scene.object
    wall = Plane(np.array([0.0, 2.0, 0.5]), np.array([0.0, -0.6, 0.8]), "slip", 0.0)
    core = Material("core", "neo_hookean", 1e6, 0.3, 300.0, 0.1, 0.2, yield_stress=np.inf, friction_angle=0.5)
    region = np.arange(len(thing.particles), dtype=np.int32) % 2
    parts = replace(thing, other_materials=(core,), region=region)
    return {
        "walls and regions": replace(run, scene=replace(run.scene, object=parts, planes=(*run.scene.planes, wall))),
        "no planes": replace(run, scene=replace(run.scene, planes=())),
        "no deformation": replace(run, state=replace(state, trajectory=replace(trajectory, deformation_gradient=None))),
        "no phase": replace(run, state=replace(state, trajectory=replace(trajectory, phase=()))),
        "float64": replace(run, state=replace(state, trajectory=doubles)),
        "no contact found": replace(run, state=replace(state, contact=ContactSearch((), np.inf, 2.0, 0))),
        "two contacts": replace(run, state=replace(state, contact=ContactSearch(twice, 0.0, 1.5, 11))),
        "not finite": replace(run, state=replace(state, motion=diverged)),
        "object only": replace(run, state=State(trajectory=trajectory)),
        "person only": replace(run, state=State(motion=state.motion)),
        "nothing computed": replace(run, state=State()),
        "no scene": replace(run, scene=None, state=State(), history=(), reports=(), plan=Plan("", (), (), ())),
        "text with commas": replace(
            run, history=({"stage": 'a "b",\n c', "loss": np.nan, "n": 3.0},), config_yaml="ä: 1"
        ),
    }


@pytest.mark.parametrize("name", variants(make_run()[0]))
def test_round_trip_of_what_may_be_absent(demo, name, tmp_path):
    run = variants(demo[0])[name]
    path = tmp_path / "run.mcap"
    record.write(run, path, plan_text="")
    back = record.read(path)
    if name == "text with commas":
        assert np.isnan(back.history[0].pop("loss")) and back.history == ({"stage": 'a "b",\n c', "n": 3.0},)
        run, back = replace(run, history=()), replace(back, history=())
    same(run, back)


def test_records_from_before_planes_and_regions(demo):
    scene = demo[0].scene
    files = scene_files(scene)
    facts = json.loads(files["scene.json"])
    del facts["planes"], facts["object"]["other_materials"]
    for name in ("yield_stress", "friction_angle"):
        del facts["object"]["material"][name]
    back = scene_from_files(files | {"scene.json": json.dumps(facts).encode()})
    same(replace(scene, planes=()), back)


def test_a_state_without_a_scene_is_refused(demo, tmp_path):
    with pytest.raises(ValueError, match="without a scene"):
        record.write(replace(demo[0], scene=None), tmp_path / "run.mcap", plan_text="")
    with pytest.raises(ValueError, match="go together"):
        record.write(demo[0], tmp_path / "run.mcap", demo[1], plan_text="")
    longer = record.Footage(footage().units * 2, footage().cameras * 2)
    with pytest.raises(ValueError, match="video of 10 pictures for a run of 5 frames"):
        record.write(demo[0], tmp_path / "run.mcap", plan_text="", footage=longer)
    with pytest.raises(ValueError, match="5 pictures and 1 cameras"):
        record.Footage(footage().units, footage().cameras[:1])
    assert not list(tmp_path.iterdir())


def test_message_bytes_are_the_runs_alone(demo, path, tmp_path):
    again = replace(demo[0], provenance={"started": "later"}, result={"seconds": "2"})
    save(tmp_path / "again.mcap", (again, *demo[1:]))
    assert record.message_digest(path) == record.message_digest(tmp_path / "again.mcap")
    trajectory = demo[0].state.trajectory
    moved = trajectory.positions.copy()
    moved[3, 7, 1] += 2 * FINEST
    other = replace(demo[0], state=replace(demo[0].state, trajectory=replace(trajectory, positions=moved)))
    save(tmp_path / "other.mcap", (other, *demo[1:]))
    assert record.message_digest(path) != record.message_digest(tmp_path / "other.mcap")
    save(tmp_path / "blind.mcap", demo, footage=None)
    assert record.message_digest(path) != record.message_digest(tmp_path / "blind.mcap")


def test_metadata_and_attachments(demo, path):
    assert record.read_metadata(path) == demo[0].provenance | demo[0].result
    with open(path, "rb") as file:
        reader = make_reader(file)
        names = [attachment.name for attachment in reader.iter_attachments()]
        order = [entry.name for entry in reader.iter_metadata()]
    assert order == ["hoi.record", "hoi.run", "hoi.result"]
    assert {"config.yaml", "plan.txt", "plan.json", "reports.json", "history.csv"} <= set(names)


def test_points_and_joints(demo, path):
    run, points, colours = demo
    positions, rgb = record.posed_points(path)
    np.testing.assert_allclose(positions, points, rtol=0, atol=SHOWN / 2 + FINEST)
    np.testing.assert_allclose(rgb, colours, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(record.joints(path), fk(run.scene.body, run.state.motion)[1], atol=1e-6)


def test_video_comes_back(demo, path):
    back = record.video(path)
    assert back.units == footage().units
    points = np.random.default_rng(0).normal((0, 1, 0.8), 0.3, (20, 3))
    for camera, original in zip(back.cameras, footage().cameras, strict=True):
        assert (camera.width, camera.height, camera.near) == (original.width, original.height, original.near)
        np.testing.assert_allclose(camera.world_to_camera, original.world_to_camera, atol=1e-12)
        for a, b in zip(project(camera, points), project(original, points), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9)


def test_video_is_what_viewers_ask_for(path):
    """Each message decodes to one picture as soon as it comes; the first, and every key frame, needs none before it."""
    decoder = av.CodecContext.create("h264", "r")
    decoder.flags |= av.codec.context.Flags.low_delay
    decoder.thread_count = 1
    means, keys = [], []
    for _, message, picture in messages(path, "/camera/video"):
        assert (picture.format, picture.frame_id) == ("h264", "camera")
        assert picture.timestamp.ToNanoseconds() == message.log_time
        assert picture.data.startswith((b"\0\0\1", b"\0\0\0\1"))
        kinds = {nal[0] & 31 for nal in picture.data.split(b"\0\0\1")[1:]}
        keys.append(5 in kinds)
        assert ({7, 8} <= kinds) == keys[-1], "SPS and PPS go with an IDR"
        (shown,) = decoder.decode(av.Packet(picture.data))
        means.append(shown.to_ndarray(format="rgb24").mean())
    np.testing.assert_allclose(means, [0, 50, 100, 150, 200], atol=3)
    assert keys[0] and not all(keys)


def test_calibration_projects_like_the_camera(path):
    """What a viewer does with P and the frame on /tf."""
    for number, ((_, _, calibration), (_, _, tf)) in enumerate(
        zip(messages(path, "/camera/calibration"), messages(path, "/tf"), strict=True)
    ):
        camera = footage().cameras[number]
        (place,) = (t for t in tf.transforms if t.child_frame_id == calibration.frame_id)
        assert place.parent_frame_id == "world"
        assert (calibration.width, calibration.height, calibration.distortion_model) == (48, 32, "plumb_bob")
        assert np.array_equal(np.reshape(calibration.R, (3, 3)), np.eye(3)) and not any(calibration.D)
        matrix_p = np.reshape(calibration.P, (3, 4))
        assert np.array_equal(matrix_p[:, :3], np.reshape(calibration.K, (3, 3)))
        point = np.array([0.1, 1.1, 0.9])
        t = place.translation
        local = matrix(place.rotation).T @ (point - [t.x, t.y, t.z])
        u, v, w = matrix_p @ [*local, 1]
        pixel, depth = project(camera, point)
        np.testing.assert_allclose([u / w, v / w, w], [*pixel, depth], atol=1e-9)


def test_a_record_without_a_video_says_so(demo, tmp_path):
    save(tmp_path / "blind.mcap", demo, footage=None)
    same(demo[0], record.read(tmp_path / "blind.mcap"))
    refused(tmp_path / "blind.mcap", "has no video: its run failed, or was made with render=none", [record.video])
    assert not messages(tmp_path / "blind.mcap", ["/camera/video", "/camera/calibration"])


def test_times_are_the_scenes(demo, path):
    run = demo[0]
    everything = messages(path)
    times = [message.log_time for _, message, _ in everything]
    assert times == sorted(times) and all(m.log_time == m.publish_time for _, m, _ in everything)
    frames = [round(frame * 1e9 / run.scene.fps) for frame in range(run.scene.frames)]
    for topic in (*PROTOBUF_SCHEMAS, "/human/motion", "/object/energy"):
        assert [m.log_time for t, m, _ in everything if t == topic] == frames, topic
    ((_, message, contact),) = messages(path, "/contact")
    assert message.log_time == 75_000_000 and contact["joint_name"] == "right_foot"


def test_viewers_can_decode_what_they_draw(demo, path):
    run = demo[0]
    frame = 3
    seen = {topic: [decoded for t, _, decoded in messages(path) if t == topic] for topic in PROTOBUF_SCHEMAS}
    cloud = seen["/object/points"][frame]
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "red", "green", "blue", "alpha"]
    assert len(cloud.data) == len(run.scene.object.cloud) * cloud.point_stride and cloud.pose.orientation.w == 1
    xyz = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)[:, :12].copy().view("<f4")
    np.testing.assert_allclose(xyz, run.state.trajectory.positions[frame, : len(xyz)], rtol=0, atol=SHOWN / 2 + FINEST)

    rotations, positions = fk(run.scene.body, run.state.motion)
    transforms = {t.child_frame_id: t for t in seen["/tf"][frame].transforms}
    place, turn, name = np.zeros(3), np.eye(3), "right_foot"
    while name != "world":
        t = transforms[name]
        local = matrix(t.rotation)
        place = [t.translation.x, t.translation.y, t.translation.z] + local @ place
        turn, name = local @ turn, t.parent_frame_id
    np.testing.assert_allclose(place, positions[frame, 11], atol=1e-6)
    np.testing.assert_allclose(turn, rotations[frame, 11], atol=1e-6)
    com = transforms["object"].translation
    np.testing.assert_allclose([com.x, com.y, com.z], run.state.trajectory.com[frame], atol=1e-6)

    arrows = [[e for e in update.entities if e.id.startswith("contact")] for update in seen["/scene"]]
    assert [len(found) for found in arrows] == [0, 0, 1, 1, 1]
    direction = matrix(arrows[2][0].arrows[0].pose.orientation) @ [1, 0, 0]
    np.testing.assert_allclose(direction, run.state.contact.contacts[0].normal, atol=1e-6)


def matrix(q):
    w, v = q.w, np.array([q.x, q.y, q.z])
    cross = np.cross(np.eye(3), v)
    return np.eye(3) * (w * w - v @ v) + 2 * np.outer(v, v) + 2 * w * cross


def test_json_messages_keep_their_schema(path):
    for topic, schema in JSON_SCHEMAS.items():
        found = messages(path, topic)
        assert found, topic
        for prop in schema["properties"].values():  # all that Foxglove can parse
            assert prop["type"] in ("number", "integer", "string") or prop["items"] == {"type": "number"}
        for _, _, decoded in found:
            assert set(decoded) == set(schema["properties"])
    jsonschema = pytest.importorskip("jsonschema")
    for topic, schema in JSON_SCHEMAS.items():
        jsonschema.Draft202012Validator.check_schema(schema)
        for _, _, decoded in messages(path, topic):
            jsonschema.validate(decoded, schema)


def test_object_stride_thins_the_view_alone(demo, path, tmp_path):
    save(tmp_path / "thin.mcap", demo, object_stride=4)
    (_, _, cloud), *_ = messages(tmp_path / "thin.mcap", "/object/points")
    assert len(cloud.data) == 15 * cloud.point_stride
    same(record.read(path), record.read(tmp_path / "thin.mcap"))


# --- refusals --------------------------------------------------------------------------------------------------------


READERS = (record.read, record.read_metadata, record.posed_points, record.joints, record.video, record.message_digest)


def refused(path, message, readers=READERS):
    for reader in readers:
        with pytest.raises(InputError, match=message) as caught:
            reader(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_missing_and_foreign_files(tmp_path):
    refused(tmp_path / "none.mcap", "no such file")
    refused(tmp_path, "is a folder")
    (tmp_path / "empty.mcap").touch()
    refused(tmp_path / "empty.mcap", "not an MCAP file")
    (tmp_path / "text.mcap").write_text("a: 1\n" * 100)
    refused(tmp_path / "text.mcap", "not an MCAP file")
    with open(tmp_path / "foreign.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    refused(tmp_path / "foreign.mcap", "none that hoi wrote", READERS[:-1])


@pytest.mark.parametrize("share", (0.001, 0.3, 0.9, 0.9999))
def test_unfinished_files(path, tmp_path, share):
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(len(whole) * share)])
    refused(cut, "unfinished record")


def test_a_part_file_is_unfinished(path, tmp_path):
    part = tmp_path / "run.mcap.part"
    shutil.copy(path, part)
    refused(part, "unfinished record")


def test_other_formats_and_missing_parts(demo, path, tmp_path, monkeypatch):
    monkeypatch.setattr("hoi.record.writer.FORMAT", "2")
    save(tmp_path / "new.mcap", demo)
    refused(tmp_path / "new.mcap", "record format 2, this version reads 1", READERS[:-1])
    monkeypatch.undo()

    def without(lacking):
        def copy(original):
            with open(path, "rb") as source, open(tmp_path / "lacks.mcap", "wb") as target:
                reader, writer = make_reader(source), Writer(target)
                writer.start()
                for entry in reader.iter_metadata():
                    if entry.name != lacking:
                        writer.add_metadata(entry.name, entry.metadata)
                for a in reader.iter_attachments():
                    if a.name != lacking:
                        writer.add_attachment(0, 0, a.name, a.media_type, a.data)
                for schema, channel, message in reader.iter_messages():
                    if channel.topic != lacking:
                        number = writer.register_schema(schema.name, schema.encoding, schema.data)
                        number = writer.register_channel(channel.topic, channel.message_encoding, number)
                        writer.add_message(number, message.log_time, message.data, message.publish_time)
                writer.finish()
            return tmp_path / "lacks.mcap"

        return copy(path)

    same(demo[0], record.read(without("nothing")))
    for part in ("state.json", "body.npz", "history.csv", "config.yaml", "hoi.result"):
        refused(without(part), f"lacks its (attachment|metadata) {part}", [record.read])
    for topic, count in {"/human/motion": 5, "/object/state": 5, "/contact": 1}.items():
        refused(without(topic), f"0 messages on {topic} where {count} should be", [record.read])
    refused(without("/human/points"), "no messages on /human/points", [record.posed_points])
    refused(without("/camera/video"), "has no video", [record.video])
    refused(without("/camera/calibration"), "0 messages on /camera/calibration where 5 should be", [record.video])
    refused(without("/tf"), "no messages on /tf", [record.video])


def test_damage_never_gives_a_traceback(path, tmp_path):
    rng = np.random.default_rng(0)
    whole = np.frombuffer(path.read_bytes(), np.uint8)
    outcomes = set()
    for _ in range(60):
        broken = whole.copy()
        at = rng.integers(8, len(whole) - 8)
        broken[at : at + rng.integers(1, 64)] ^= np.uint8(rng.integers(1, 256))
        (tmp_path / "broken.mcap").write_bytes(broken.tobytes())
        try:
            record.read(tmp_path / "broken.mcap")
            outcomes.add("unharmed")
        except InputError as error:
            assert "\n" not in str(error)
            outcomes.add("refused")
    assert "refused" in outcomes


# --- failures while writing ------------------------------------------------------------------------------------------


class Failing:
    """A file that fails after some bytes."""

    def __init__(self, file, error, after):
        self.file, self.error, self.left = file, error, after

    def write(self, data):
        self.left -= len(data)
        if self.left < 0:
            raise self.error
        return self.file.write(data)

    def __getattr__(self, name):
        return getattr(self.file, name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()


@pytest.mark.parametrize("after", (0, 10_000, 60_000))
@pytest.mark.parametrize(
    "error, raised, message",
    [
        (
            OSError(errno.ENOSPC, "No space left on device"),
            RunError,
            "cannot write .*run.mcap: No space left on device",
        ),
        (PermissionError(errno.EACCES, "Permission denied"), InputError, "cannot write .*run.mcap: Permission denied"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
    ],
)
def test_a_failed_write_leaves_the_old_record_and_nothing_else(
    demo, path, tmp_path, monkeypatch, error, raised, message, after
):
    target = tmp_path / "run.mcap"
    shutil.copy(path, target)
    before = hashlib.sha256(target.read_bytes()).hexdigest()

    def failing_open(name, mode="r", *rest, **options):
        file = builtins.open(name, mode, *rest, **options)
        return Failing(file, error, after) if "w" in mode else file

    monkeypatch.setattr("hoi.record.writer.open", failing_open, raising=False)
    with pytest.raises(raised, match=message) as caught:
        save(target, demo)
    assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]
    assert hashlib.sha256(target.read_bytes()).hexdigest() == before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full is Linux's")
def test_a_full_disk(demo, tmp_path):
    (tmp_path / "run.mcap.part").symlink_to("/dev/full")
    with pytest.raises(RunError, match="No space left on device"):
        save(tmp_path / "run.mcap", demo)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there(demo, tmp_path):
    with pytest.raises(InputError, match="No such file or directory"):
        save(tmp_path / "none" / "run.mcap", demo)


# --- other programs --------------------------------------------------------------------------------------------------


def test_reading_needs_no_torch(path):
    code = (
        "import sys; from pathlib import Path; from hoi import record; "
        f"p = Path({str(path)!r}); record.read(p); record.posed_points(p); record.joints(p); "
        "record.video(p); print(sorted({'torch', 'taichi', 'av', 'matplotlib', 'transformers'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.skipif(shutil.which("rerun") is None, reason="rerun is not installed (pip install rerun-sdk)")
def test_rerun_reads_it(path, tmp_path):
    def rerun(*words):
        return subprocess.run(["rerun", *words], capture_output=True, text=True, check=True)

    check = rerun("mcap", "check", "--full", str(path))
    topics = [
        line for line in check.stdout.splitlines() if "/" in line and "Status" not in line and ".mcap" not in line
    ]
    assert len(topics) == len(PROTOBUF_SCHEMAS) + len(JSON_SCHEMAS)
    assert all(line.startswith("ok") for line in topics), check.stdout
    rerun("mcap", "convert", str(path), "-o", str(tmp_path / "run.rrd"))
    rerun("rrd", "verify", str(tmp_path / "run.rrd"))
    shown = rerun("rrd", "print", str(tmp_path / "run.rrd")).stdout
    for part in ("Points3D:positions", "Points3D:colors", "Transform3D:child_frame", "InstancePoses3D:translations"):
        assert part in shown
