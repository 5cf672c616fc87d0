"""Records below a folder: what is loaded, and hostile files refused by name before anything large is allocated."""

import io
import json
import struct
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from analysis.records import Record, find, load
from hoi.body import skinning
from hoi.errors import InputError
from hoi.record import write
from hoi.record.schemas import ObjectState
from tests.demo_run import make_run

BILLION = 1_000_000_000


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("records") / "run.mcap"
    run, points, colours = make_run()
    write(run, path, points, colours, plan_text="")
    return path


def test_find_is_sorted_and_takes_failed_runs(tmp_path):
    for name in ("b/run.mcap", "a/run.failed.mcap", "a/run.mcap", "c/run.mcap.part", "c/other.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / ".starts").mkdir()
    (tmp_path / ".starts" / "run.mcap").touch()  # hidden: left out
    names = [file.relative_to(tmp_path).as_posix() for file in find(tmp_path)]
    assert names == ["a/run.failed.mcap", "a/run.mcap", "b/run.mcap"]
    with pytest.raises(InputError, match="no such folder"):
        find(tmp_path / "none")


def test_skin_and_joints_are_those_of_torch(path):
    record = load(path)
    body, motion = record.run.scene.body, record.run.state.motion
    np.testing.assert_allclose(record.skin, skinning.posed_means(body, motion), atol=2e-6)
    np.testing.assert_allclose(record.joints, skinning.joint_paths(body, motion), atol=2e-6)
    assert record.points.shape == record.skin.shape
    blended = np.random.default_rng(0).dirichlet(np.ones(24), len(body.cloud)).astype(np.float32)
    directions = np.random.default_rng(1).normal(0, 1e-2, (len(body.cloud), 3, 207)).astype(np.float32)
    shaped = replace(body, skinning_weights=blended, pose_directions=directions)
    other = Record(path, replace(record.run, scene=replace(record.run.scene, body=shaped)))
    np.testing.assert_allclose(other.skin, skinning.posed_means(shaped, motion), atol=2e-5)


def test_without_motion_the_skin_is_what_is_shown(path):
    record = load(path)
    shown = Record(path, replace(record.run, state=replace(record.run.state, motion=None)))
    np.testing.assert_array_equal(shown.skin, record.points)
    assert shown.joints is None and shown.skin_joints is None


def test_config_may_be_missing_but_not_nonsense(path):
    run = load(path).run
    assert Record(path, replace(run, config_yaml="")).conf("scene", "name", default="?") == "?"
    assert Record(path, run).conf("scene", "name") == "kick_ball"
    for text in ("- 1", "a: [", "!!python/object:os.system x"):
        with pytest.raises(InputError, match=r"run.mcap: config.yaml"):
            _ = Record(path, replace(run, config_yaml=text)).config


# --- hostile files ---------------------------------------------------------------------------------------------------


def rewritten(path: Path, out: Path, *, attachments=None, message=None, schema=None) -> Path:
    """The record with other attachments, messages or schema names; what the functions return, None for as it was."""
    with open(path, "rb") as source, open(out, "wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start(library="hoi")
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata)
        files = [(a.name, a.data) for a in reader.iter_attachments()]
        for name, data in attachments(files) if attachments else files:
            writer.add_attachment(0, 0, name, "application/octet-stream", data)
        channels = {}
        for kind, channel, content in reader.iter_messages():
            if channel.id not in channels:
                name = (schema and schema(channel.topic)) or kind.name
                schema_id = writer.register_schema(name, kind.encoding, kind.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            data = (message and message(channel.topic, content.data)) or content.data
            writer.add_message(channels[channel.id], content.log_time, data, content.publish_time)
        writer.finish()
    return out


def refused(file: Path, match: str) -> None:
    """In one line that names the file, with little memory."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=match) as caught:
            load(file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)
    assert peak < 50e6


def test_as_it_was_is_read(path, tmp_path):
    assert load(rewritten(path, tmp_path / "run.mcap")).run.plan == load(path).run.plan


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "..", "C:\\x", "a/b", "line\nbreak"])
def test_path_names_in_attachments(path, tmp_path, name):
    refused(
        rewritten(path, tmp_path / "run.mcap", attachments=lambda files: [*files, (name, b"x")]), "is named as a path"
    )


def test_two_attachments_of_one_name(path, tmp_path):
    file = rewritten(path, tmp_path / "run.mcap", attachments=lambda files: [*files, ("plan.json", b"{}")])
    refused(file, "two attachments 'plan.json'")


@pytest.mark.parametrize("topic", ["/human/motion", "/object/state", "/contact"])
def test_wrong_schema(path, tmp_path, topic):
    file = rewritten(path, tmp_path / "run.mcap", schema=lambda at: "evil.Schema" if at == topic else None)
    refused(file, f"evil.Schema on {topic}, must be")


@pytest.mark.parametrize("shape", [(BILLION, 3), (BILLION, BILLION, BILLION), (0, 3), ()])
def test_particles_that_are_not_there(path, tmp_path, shape):
    def message(topic, data):
        if topic != "/object/state":
            return None
        state = ObjectState.FromString(data)
        state.positions.shape[:] = shape
        return state.SerializeToString()

    refused(rewritten(path, tmp_path / "run.mcap", message=message), "/object/state claims")


@pytest.mark.parametrize("dtype", ["O", "<U9", "<M8[s]", "<f1000000000"])
def test_particles_that_are_no_numbers(path, tmp_path, dtype):
    def message(topic, data):
        if topic != "/object/state":
            return None
        state = ObjectState.FromString(data)
        state.positions.dtype = dtype
        return state.SerializeToString()

    refused(rewritten(path, tmp_path / "run.mcap", message=message), "is damaged")


def test_not_finite(path, tmp_path):
    run, points, colours = make_run()
    positions = run.state.trajectory.positions.copy()
    positions[2, 7, 1] = np.nan
    broken = replace(run, state=replace(run.state, trajectory=replace(run.state.trajectory, positions=positions)))
    write(broken, tmp_path / "run.mcap", points, colours, plan_text="")
    refused(tmp_path / "run.mcap", r"trajectory.positions has nan at \[2, 7, 1\]")


def claiming(shape: tuple[int, ...], *, dtype: str = "<f4", data: bytes = b"\0" * 12) -> bytes:
    """An .npz whose array `means` claims a shape."""
    head = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("means.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (claiming((BILLION, 3)), "claims shape"),
        (claiming((10**12, 10**12)), "claims shape"),
        (claiming((1, 3), dtype="|O"), "must hold numbers"),
        (claiming((40_000_000,), dtype="|u1", data=b"\0" * 40_000_000), "damaged"),  # packed small, lacks the rest
        (b"PK nonsense", "is damaged"),
    ],
)
def test_clouds_that_are_not_there(path, tmp_path, data, match):
    def swap(files):
        return [(name, data if name == "object.npz" else content) for name, content in files]

    refused(rewritten(path, tmp_path / "run.mcap", attachments=swap), match)


def test_frames_that_are_not_there(path, tmp_path):
    def swap(files):
        facts = json.loads(dict(files)["state.json"])
        facts["trajectory"]["frames"] = BILLION
        return [(name, json.dumps(facts).encode() if name == "state.json" else data) for name, data in files]

    refused(rewritten(path, tmp_path / "run.mcap", attachments=swap), f"where {BILLION} should be")


def test_parts_that_do_not_fit(path, tmp_path):
    run, points, colours = make_run()
    few = replace(run.scene.object, particles=run.scene.object.particles[:70], volumes=run.scene.object.volumes[:70])
    write(replace(run, scene=replace(run.scene, object=few)), tmp_path / "run.mcap", points, colours, plan_text="")
    refused(tmp_path / "run.mcap", r"object.positions has shape \(5, 100, 3\), must have \(5, 70, 3\)")


def test_chunks_that_lie_about_their_size(path, tmp_path):
    data = path.read_bytes()
    magic = zstandard.ZstdCompressor(write_content_size=True).compress(b"x" * 300)[:4]
    at = data.index(magic)
    # A frame header that claims 8 exabytes: descriptor 0b11100000 has an eight-byte content size, single segment.
    lie = data[: at + 4] + bytes([0xE0]) + struct.pack("<Q", 2**62) + data[at + 13 :]
    (tmp_path / "run.mcap").write_bytes(lie)
    refused(tmp_path / "run.mcap", "a chunk claims")


def test_other_packings(path, tmp_path):
    with open(path, "rb") as source, open(tmp_path / "run.mcap", "wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.LZ4)
        writer.start()
        for entry in reader.iter_metadata():
            writer.add_metadata(entry.name, entry.metadata)
        channel = writer.register_channel("/x", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    refused(tmp_path / "run.mcap", "'lz4', must be zstd")


def test_deep_json(path, tmp_path):
    deep = b"[" * 200_000
    file = rewritten(
        path, tmp_path / "run.mcap", attachments=lambda files: [(n, deep if n == "plan.json" else d) for n, d in files]
    )
    refused(file, "is damaged")
