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
from mcap.reader import McapReader, make_reader
from mcap.writer import MCAP0_MAGIC

from hoi.data import (
    Array,
    Check,
    Contact,
    ContactSearch,
    Motion,
    ObjectTrajectory,
    Omission,
    Plan,
    Run,
    StageReport,
    State,
    Step,
    Target,
)
from hoi.errors import InputError
from hoi.record.camera import Footage, camera_of
from hoi.record.parts import history_from_csv, restore, scene_from_files
from hoi.record.schemas import FORMAT, MOTION_ARRAYS, OBJECT_ARRAYS, POINT, ObjectState, to_array
from hoi.record.views import CAMERA


def read(path: Path) -> Run:
    """The run as it was given to `write`.

    Raises:
        InputError: no such file, an unfinished, damaged or foreign one, or one that lacks a part.
    """
    with _opened(path) as reader:
        metadata = _metadata(reader, path)
        files = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        needed = ["config.yaml", "plan.json", "state.json", "reports.json", "history.csv"]
        needed += ["body.npz", "object.npz"] if "scene.json" in files else []
        for name in needed:
            if name not in files:
                raise InputError(f"{path} lacks its attachment {name}")
        facts = json.loads(files["state.json"])
        plan = json.loads(files["plan.json"])
        return Run(
            config_yaml=files["config.yaml"].decode(),
            provenance=metadata["hoi.run"],
            result=metadata["hoi.result"],
            plan=Plan(
                variant=plan["variant"],
                steps=tuple(restore(Step, step) for step in plan["steps"]),
                omissions=tuple(restore(Omission, omission) for omission in plan["omissions"]),
                checks=tuple(restore(Check, check) for check in plan["checks"]),
            ),
            reports=tuple(restore(StageReport, report) for report in json.loads(files["reports.json"])),
            history=history_from_csv(files["history.csv"]),
            scene=scene_from_files(files) if "scene.json" in files else None,
            state=_state(reader, facts, path),
        )


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
        clouds = [
            np.frombuffer(PointCloud.FromString(data).data, POINT) for data in _topic(reader, "/human/points", path)
        ]
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
        InputError: as `read`, or the record has no video.
    """
    with _opened(path) as reader:
        _metadata(reader, path)
        pictures = [message.data for _, _, message in reader.iter_messages(["/camera/video"])]
        if not pictures:
            raise InputError(f"{path} has no video: its run failed, or was made with render=none")
        calibrations = _topic(reader, "/camera/calibration", path, len(pictures))
        transforms = [FrameTransforms.FromString(data).transforms for data in _topic(reader, "/tf", path)]
        places = [place for frame in transforms for place in frame if place.child_frame_id == CAMERA]
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
            yield make_reader(file, validate_crcs=True)
    except InputError:
        raise
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
    messages = [message.data for _, _, message in reader.iter_messages([topic])]
    if count is None and not messages:
        raise InputError(f"{path} has no messages on {topic}")
    if count is not None and len(messages) != count:
        raise InputError(f"{path} has {len(messages)} messages on {topic} where {count} should be")
    return messages


def _state(reader: McapReader, facts: dict[str, Any], path: Path) -> State:
    motion = trajectory = contact = None
    if facts["motion"] is not None:
        motion = _motion(_topic(reader, "/human/motion", path, facts["motion"]["frames"]), facts["motion"])
    if facts["trajectory"] is not None:
        trajectory = _trajectory(_topic(reader, "/object/state", path, facts["trajectory"]["frames"]))
    if facts["contact"] is not None:
        messages = _topic(reader, "/contact", path, facts["contact"]["contacts"])
        contact = ContactSearch(
            contacts=tuple(restore(Contact, json.loads(message)) for message in messages),
            smallest_gap=float(facts["contact"]["smallest_gap"]),
            smallest_gap_frame=float(facts["contact"]["smallest_gap_frame"]),
            smallest_gap_joint=int(facts["contact"]["smallest_gap_joint"]),
        )
    target = None if facts["target"] is None else restore(Target, facts["target"])
    return State(motion=motion, trajectory=trajectory, target=target, contact=contact)


def _motion(messages: list[bytes], facts: dict[str, Any]) -> Motion:
    rows = [json.loads(message) for message in messages]
    arrays = {name: np.array([row[name] for row in rows], facts["dtypes"][name]) for name in MOTION_ARRAYS}
    arrays["body_pose"] = arrays["body_pose"].reshape(len(rows), -1, 3)
    return Motion(**arrays, fps=float(facts["fps"]))


def _trajectory(messages: list[bytes]) -> ObjectTrajectory:
    states = [ObjectState.FromString(message) for message in messages]
    arrays = {
        name: np.stack([to_array(getattr(state, name)) for state in states])
        for name in OBJECT_ARRAYS
        if states[0].HasField(name)
    }
    phase = tuple(state.phase for state in states)
    return ObjectTrajectory(**arrays, phase=phase if any(phase) else ())
