"""MCAP -> Run, in NumPy. Whatever is wrong with a file is said in one line."""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from mcap.reader import McapReader, SeekingReader
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from hoi.data import Array, Contact, ContactSearch, Motion, ObjectTrajectory, Plan, Run, StageReport, State, Target
from hoi.errors import InputError
from hoi.record.camera import Footage, camera_of
from hoi.record.checks import Refused, check_chunks, check_names, check_npz, check_run
from hoi.record.parts import history_from_csv, restore, scene_from_files
from hoi.record.schemas import (
    FORMAT,
    JSON_SCHEMAS,
    MOTION_ARRAYS,
    OBJECT_ARRAYS,
    POINT,
    PROTOBUF_SCHEMAS,
    ObjectState,
)
from hoi.record.views import CAMERA


class NoVideo(InputError):
    """A record that is whole, but has no video."""


def read(path: Path) -> Run:
    """The run as it was given to `write`.

    Raises:
        InputError: no such file, an unfinished, damaged or foreign one, or one that lacks a part.
    """
    with _opened(path) as reader:
        metadata = _metadata(reader, path)
        attachments = list(reader.iter_attachments())
        check_names(attachment.name for attachment in attachments)
        files = {attachment.name: attachment.data for attachment in attachments}
        needed = ["config.yaml", "plan.json", "state.json", "reports.json", "history.csv"]
        if "scene.json" in files:
            needed += ["body.npz"] if json.loads(files["scene.json"])["object"] is None else ["body.npz", "object.npz"]
        for name in needed:
            if name not in files:
                raise InputError(f"{path} lacks its attachment {name}")
            if name.endswith(".npz"):
                check_npz(name, files[name])
        facts = json.loads(files["state.json"])
        run = Run(
            config_yaml=files["config.yaml"].decode(),
            provenance=metadata["hoi.run"],
            result=metadata["hoi.result"],
            plan=restore(Plan, json.loads(files["plan.json"])),
            reports=tuple(restore(StageReport, report) for report in json.loads(files["reports.json"])),
            history=history_from_csv(files["history.csv"]),
            scene=scene_from_files(files) if "scene.json" in files else None,
            state=_state(reader, facts, path),
        )
        check_run(run)
        return run


def read_metadata(path: Path) -> dict[str, str]:
    """Provenance and result in one, without reading the rest.

    Raises:
        InputError: as `read`.
    """
    with _opened(path) as reader:
        metadata = _metadata(reader, path)
    return metadata["hoi.run"] | metadata["hoi.result"]


def posed_points(path: Path) -> tuple[Array, Array]:
    """The person's points to look at [m], shape (T, M, 3), and their colours in [0, 1], shape (M, 3).

    Raises:
        InputError: as `read`, or the record shows no person.
    """
    with _opened(path) as reader:
        _metadata(reader, path)
        clouds = [_points(PointCloud.FromString(data)) for data in _topic(reader, "/human/points", path)]
        positions = np.stack([np.stack([cloud[axis] for axis in "xyz"], -1) for cloud in clouds])
    colours = np.stack([clouds[0][name] for name in ("red", "green", "blue")], -1)
    return positions, colours / np.float32(255)


def joints(path: Path) -> Array:
    """World positions of the joints [m], shape (T, 24, 3).

    Raises:
        InputError: as `read`, or the record shows no person.
    """
    with _opened(path) as reader:
        _metadata(reader, path)
        frames = [PosesInFrame.FromString(data).poses for data in _topic(reader, "/human/joints", path)]
    return np.array([[[p.position.x, p.position.y, p.position.z] for p in poses] for poses in frames])


def video(path: Path) -> Footage:
    """What the camera saw: the encoded pictures, and the camera of each.

    Raises:
        InputError: as `read`.
        NoVideo: the record has none.
    """
    with _opened(path) as reader:
        _metadata(reader, path)
        messages = [message for _, _, message in reader.iter_messages(["/camera/video"])]
        pictures = [message.data for message in messages]
        if not pictures:
            raise NoVideo(f"{path} has no video: its run failed, or was made with render=none")
        transforms = [FrameTransforms.FromString(m.data).transforms for _, _, m in reader.iter_messages(["/tf"])]
        places = [place for frame in transforms for place in frame if place.child_frame_id == CAMERA]
        summary = reader.get_summary()
        calibrated = summary is None or any(c.topic == "/camera/calibration" for c in summary.channels.values())
        if not calibrated and not places:  # another system's
            units = tuple(CompressedVideo.FromString(data).data for data in pictures)
            seconds = (messages[-1].log_time - messages[0].log_time) / 1e9
            return Footage(units, (), round((len(units) - 1) / seconds, 6))
        calibrations = _topic(reader, "/camera/calibration", path, len(pictures))
        if not transforms:
            raise InputError(f"{path} has no messages on /tf")
        if len(places) != len(pictures):
            raise InputError(f"{path} has {len(places)} frames {CAMERA} on /tf where {len(pictures)} should be")
        cameras = [
            camera_of(CameraCalibration.FromString(data), place)
            for data, place in zip(calibrations, places, strict=True)
        ]
        return Footage(tuple(CompressedVideo.FromString(data).data for data in pictures), tuple(cameras))


def message_digest(path: Path) -> str:
    """SHA-256 over topic, log time and data of all messages, in their order: equal for equal runs.

    Raises:
        InputError: no such file, or an unfinished, damaged or foreign one.
    """
    digest = hashlib.sha256()
    with _opened(path) as reader:
        for _, channel, message in reader.iter_messages():
            digest.update(f"{channel.topic}\n{message.log_time}\n{len(message.data)}\n".encode())
            digest.update(message.data)
    return digest.hexdigest()


@contextmanager
def _opened(path: Path) -> Iterator[McapReader]:
    """A reader of a finished MCAP; what fails while it is in use is the file's fault."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder, not a record")
    try:
        with open(path, "rb") as file:
            head = file.read(len(MCAP0_MAGIC))
            size = file.seek(0, 2)
            file.seek(max(0, size - len(MCAP0_MAGIC)))
            tail = file.read()
            file.seek(0)
            if head != MCAP0_MAGIC[: len(head)] or not head:
                raise InputError(f"{path} is not an MCAP file")
            if path.suffix == ".part" or tail != MCAP0_MAGIC or size < 2 * len(MCAP0_MAGIC):
                raise InputError(f"{path} is an unfinished record (no footer): its run was stopped or is still going")
            # No part of a file is longer than the file: what claims to be is refused before it is allocated.
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=size)
            if (summary := reader.get_summary()) is None:
                raise InputError(f"{path} is an MCAP, but none that hoi wrote (no summary)")
            check_chunks(file, summary.chunk_indexes)
            yield reader
    except InputError:
        raise
    except Refused as error:
        raise InputError(f"{path} is damaged: {error}") from error
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    except Exception as error:  # the decoders below raise whatever they trip over
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} is damaged: {reason}") from error


def _metadata(reader: McapReader, path: Path) -> dict[str, dict[str, str]]:
    found = {entry.name: entry.metadata for entry in reader.iter_metadata()}
    if "hoi.record" not in found:
        raise InputError(f"{path} is an MCAP, but none that hoi wrote (no metadata hoi.record)")
    if found["hoi.record"].get("format") != FORMAT:
        raise InputError(f"{path} has record format {found['hoi.record'].get('format')}, this version reads {FORMAT}")
    for name in ("hoi.run", "hoi.result"):
        if name not in found:
            raise InputError(f"{path} lacks its metadata {name}")
    return found


def _topic(reader: McapReader, topic: str, path: Path, count: int | None = None) -> list[bytes]:
    """The messages of a topic; some, or as many as `count`, must be there."""
    return _topics(reader, {topic: count}, path)[topic]


def _topics(reader: McapReader, counts: dict[str, int | None], path: Path) -> dict[str, list[bytes]]:
    """The messages of several topics, as many of each as `_topic` wants, in one pass over the file."""
    found: dict[str, list[bytes]] = {topic: [] for topic in counts}
    checked: set[int] = set()
    for schema, channel, message in reader.iter_messages(list(counts)) if counts else ():
        if channel.id not in checked:
            wanted, encoding = _schema_of(channel.topic)
            if schema is None or (schema.name, channel.message_encoding) != (wanted, encoding):
                what = f"{channel.message_encoding} {None if schema is None else schema.name}"
                raise InputError(f"{path} has {what[:80]} on {channel.topic}, must be {encoding} {wanted}")
            checked.add(channel.id)
        found[channel.topic].append(message.data)
    for topic, count in counts.items():
        if count is None and not found[topic]:
            raise InputError(f"{path} has no messages on {topic}")
        if count is not None and len(found[topic]) != count:
            raise InputError(f"{path} has {len(found[topic])} messages on {topic} where {count} should be")
    return found


def _schema_of(topic: str) -> tuple[str, str]:
    """Name and encoding of what a topic holds."""
    if topic in JSON_SCHEMAS:
        return JSON_SCHEMAS[topic]["title"], "json"
    return PROTOBUF_SCHEMAS[topic].DESCRIPTOR.full_name, "protobuf"


def _points(cloud: PointCloud) -> NDArray[np.void]:
    """The packed points of a cloud; a view."""
    layout = [(field.name, field.offset) for field in cloud.fields]
    if cloud.point_stride != POINT.itemsize or layout != [(n, f[1]) for n, f in (POINT.fields or {}).items()]:
        raise Refused(f"/human/points has points of {cloud.point_stride} bytes, must be {POINT.names}")
    return np.frombuffer(cloud.data, POINT)


def _state(reader: McapReader, facts: dict[str, Any], path: Path) -> State:
    motion = trajectory = contact = None
    topics = {
        "motion": ("/human/motion", "frames"),
        "trajectory": ("/object/state", "frames"),
        "contact": ("/contact", "contacts"),
    }
    counts = {topic: int(facts[part][key]) for part, (topic, key) in topics.items() if facts[part] is not None}
    messages = _topics(reader, {topic: count for topic, count in counts.items() if count}, path)
    if facts["motion"] is not None:
        motion = _motion(messages["/human/motion"], facts["motion"])
    if facts["trajectory"] is not None:
        trajectory = _trajectory(messages["/object/state"])
    if facts["contact"] is not None:
        contacts = tuple(restore(Contact, json.loads(message)) for message in messages.get("/contact", ()))
        contact = restore(ContactSearch, facts["contact"], contacts=contacts)
    target = None if facts["target"] is None else restore(Target, facts["target"])
    later = tuple(restore(Target, each) for each in facts.get("later", ()))  # records from before have one strike
    return State(motion, trajectory, target, contact, later)


def _motion(messages: list[bytes], facts: dict[str, Any]) -> Motion:
    rows = [json.loads(message) for message in messages]
    arrays = {name: np.array([row[name] for row in rows], facts["dtypes"][name]) for name in MOTION_ARRAYS}
    arrays["body_pose"] = arrays["body_pose"].reshape(len(rows), -1, 3)
    return Motion(**arrays, fps=float(facts["fps"]))


def _trajectory(messages: list[bytes]) -> ObjectTrajectory:
    states = [ObjectState.FromString(message) for message in messages]
    arrays = {
        name: np.stack([_array(getattr(state, name)) for state in states])
        for name in OBJECT_ARRAYS
        if states[0].HasField(name)
    }
    phase = tuple(state.phase for state in states)
    return ObjectTrajectory(**arrays, phase=phase if any(phase) else ())


def _array(message: Any) -> Array:
    """The inverse of `hoi.record.schemas.array_fields`; a view of the message."""
    dtype, shape = np.dtype(message.dtype), tuple(message.shape)
    size = dtype.itemsize
    for extent in shape:
        size *= extent
    if dtype.kind not in "fiu" or size != len(message.data):
        raise Refused(f"/object/state claims {shape} of {dtype.str}, it has {len(message.data)} bytes")
    return np.frombuffer(message.data, dtype).reshape(shape)
