"""What each topic holds: the schema a viewer decodes it by. Foxglove's JSON schemas know no nested arrays or unions."""

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import Default as default_pool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from hoi.data import Array, Contact, ObjectTrajectory

FORMAT = "1"
"""Raised when an older reader could no longer read what is written."""

_NUMBER = {"type": "number"}


def _numbers(description: str) -> dict[str, Any]:
    return {"type": "array", "items": _NUMBER, "description": description}


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


_CONTACT = {float: _NUMBER, str: {"type": "string"}, int: {"type": "integer"}, Array: _numbers("x, y, z")}

JSON_SCHEMAS = {
    "/human/motion": _object(
        "hoi.Motion",
        {
            "time": _NUMBER,
            "translation": _numbers("world position of the pelvis joint [m]"),
            "orientation": _numbers("first two rows of the pelvis rotation, row-major"),
            "body_pose": _numbers("axis-angle of joints 1..23 relative to their parents [rad], three numbers a joint"),
        },
    ),
    "/contact": _object(
        "hoi.Contact",
        {"time": _NUMBER, "joint_name": {"type": "string"}} | {f.name: _CONTACT[f.type] for f in fields(Contact)},  # pyright: ignore[reportArgumentType]
    ),
    "/object/energy": _object(
        "hoi.Energy",
        {
            "time": _NUMBER,
            **{name: {"type": "number", "description": "[J]"} for name in ("kinetic", "elastic", "potential", "total")},
            "speed": {"type": "number", "description": "of the centre of mass [m/s]"},
            "phase": {"type": "string"},
        },
    ),
}


def _object_state() -> Any:
    """The message class `hoi.ObjectState`, described here since it is the one schema Foxglove has none for."""
    file = FileDescriptorProto(name="hoi/ObjectState.proto", package="hoi", syntax="proto3")
    file.dependency.append(Timestamp.DESCRIPTOR.file.name)
    array, state = file.message_type.add(name="Array"), file.message_type.add(name="ObjectState")
    kind, label = FieldDescriptorProto, FieldDescriptorProto.LABEL_OPTIONAL
    array.field.add(name="dtype", number=1, type=kind.TYPE_STRING, label=label)  # as NumPy writes it: "<f4"
    array.field.add(name="shape", number=2, type=kind.TYPE_UINT32, label=kind.LABEL_REPEATED)
    array.field.add(name="data", number=3, type=kind.TYPE_BYTES, label=label)  # C order
    timestamp = f".{Timestamp.DESCRIPTOR.full_name}"
    state.field.add(name="timestamp", number=1, type=kind.TYPE_MESSAGE, type_name=timestamp, label=label)
    for number, name in enumerate(OBJECT_ARRAYS, start=2):
        state.field.add(name=name, number=number, type=kind.TYPE_MESSAGE, type_name=".hoi.Array", label=label)
    state.field.add(name="phase", number=2 + len(OBJECT_ARRAYS), type=kind.TYPE_STRING, label=label)
    pool = default_pool()
    pool.Add(file)  # pyright: ignore[reportAttributeAccessIssue]
    return GetMessageClass(pool.FindMessageTypeByName("hoi.ObjectState"))


MOTION_ARRAYS = ("translation", "orientation", "body_pose")
"""The arrays of `Motion` a message holds one frame of."""

OBJECT_ARRAYS = ("positions", "deformation_gradient", "com", "com_velocity", "energy")
"""The arrays of `ObjectTrajectory` a message holds one frame of; only the deformation gradient may be absent."""

FINEST = 2.0**-16
"""Places of the object's particles are rounded to this [m], or to what is finer and an 8192nd of its size."""
STRAIN = 2.0**-14
"""The deformation gradient is rounded to this [-]."""
SHOWN = 2.0**-13
"""Points that are only looked at are rounded to this [m]."""

ObjectState = _object_state()

PROTOBUF_SCHEMAS: dict[str, Any] = {
    "/object/state": ObjectState,
    "/object/points": PointCloud,
    "/human/points": PointCloud,
    "/human/joints": PosesInFrame,
    "/object/com": PoseInFrame,
    "/tf": FrameTransforms,
    "/scene": SceneUpdate,
    "/camera/calibration": CameraCalibration,
    "/camera/video": CompressedVideo,
}

ATTACHMENTS = {
    "config.yaml": "the whole composed config",
    "plan.txt": "the plan as it was printed",
    "plan.json": "the plan: steps, omissions, checks, variant",
    "scene.json": "names, prompt, frames, frame rate, gravity, planes, materials, where the person comes from",
    "body.npz": "the person's Gaussians in the T-pose, skinning weights, joints, pose blend shapes where there are any",
    "object.npz": "the object's Gaussians and particles at t = 0, rest volumes; regions and drawn Gaussians if any",
    "state.json": "which parts of the state there are, j*, t*, the smallest gap",
    "reports.json": "of each stage: seconds, iterations, numbers, notes",
    "history.csv": "losses by stage and iteration",
}
"""What stands beside the messages."""


POINT = np.dtype([(axis, "<f4") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue", "alpha")])
"""One packed point of a `foxglove.PointCloud`."""


def as_recorded(trajectory: ObjectTrajectory) -> ObjectTrajectory:
    """Its large arrays rounded, so that they compress."""
    size = float(np.ptp(trajectory.positions[0], axis=0).max()) if trajectory.positions.size else 0.0
    step = min(FINEST, 2.0 ** (math.floor(math.log2(size)) - 13)) if size > 0 else FINEST
    gradient = trajectory.deformation_gradient
    return replace(
        trajectory,
        positions=rounded(trajectory.positions, step),
        deformation_gradient=None if gradient is None else rounded(gradient, STRAIN),
    )


def rounded(array: Array, step: float) -> Array:
    """To multiples of a power of two: the last bits are zero."""
    return np.rint(array / step) * np.asarray(step, array.dtype)


def array_fields(array: Array) -> dict[str, Any]:
    """The fields of `hoi.Array`, little-endian."""
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    return {"dtype": array.dtype.str, "shape": array.shape, "data": array.tobytes()}


def channels(writer: Writer) -> Callable[[str], int]:
    """A function that gives a topic's channel id and registers it with its schema when it is first asked for."""
    known: dict[str, int] = {}
    schemas: dict[Any, int] = {}

    def channel(topic: str) -> int:
        if topic not in known and topic in JSON_SCHEMAS:
            schema = JSON_SCHEMAS[topic]
            schema_id = writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())
            known[topic] = writer.register_channel(topic, "json", schema_id)
        elif topic not in known:
            message = PROTOBUF_SCHEMAS[topic]
            if message not in schemas:
                schemas[message] = register_schema(writer, message)
            known[topic] = writer.register_channel(topic, "protobuf", schemas[message])
        return known[topic]

    return channel
