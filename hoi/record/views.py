"""What a viewer draws, derived from the run: points, joints, frames, bones, ground, contact arrows."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import ArrayLike

from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.data import Array, Contact, Motion, Run
from hoi.gaussians import colours
from hoi.record.schemas import POINT, SHOWN, rounded

WORLD, CAMERA = "world", "camera"
UPRIGHT = (0, 0, 0, 1)
_BONE, _GROUND = Color(r=0.15, g=0.45, b=0.85, a=1.0), Color(r=0.82, g=0.82, b=0.80, a=0.6)
_ARROW = Color(r=0.90, g=0.25, b=0.10, a=1.0)
_GROUND_SIZE = 8.0


def timestamp(nanoseconds: int) -> Timestamp:
    """Scene time as protobuf has it."""
    return Timestamp(seconds=nanoseconds // 10**9, nanos=nanoseconds % 10**9)


def views(
    run: Run,
    times: list[int],
    human_points: Array | None,
    human_colours: Array | None,
    object_stride: int,
    camera_poses: tuple[Array, Array] | None = None,
) -> Iterator[tuple[int, str, bytes]]:
    """(time [ns], topic, protobuf bytes) of what there is to see, frame by frame; nothing without a scene.

    `camera_poses` are those of `hoi.record.camera.poses`.
    """
    if run.scene is None:
        return
    motion, trajectory, search = run.state.motion, run.state.trajectory, run.state.contact
    skeleton = None if motion is None else _skeleton(motion, run.scene.body.rest_joints)
    thing = run.scene.object
    shown = slice(0, 0 if thing is None else len(thing.cloud), object_stride)
    object_colours = np.zeros((0, 3)) if thing is None else colours(thing.cloud)[shown]
    for frame, time in enumerate(times):
        transforms, entities = [], [_ground()]
        if skeleton is not None and frame < len(skeleton["positions"]):
            pose = {name: values[frame] for name, values in skeleton.items()}
            transforms += _joint_frames(pose)
            entities.append(_bones(pose["positions"]))
            poses = [_pose(*at) for at in zip(pose["positions"], pose["rotations"], strict=True)]
            yield time, "/human/joints", _bytes(PosesInFrame(timestamp=timestamp(time), frame_id=WORLD, poses=poses))
        if human_points is not None and human_colours is not None and frame < len(human_points):
            yield time, "/human/points", _points(time, human_points[frame], human_colours)
        if trajectory is not None and frame < len(trajectory.positions):
            com = _pose(trajectory.com[frame])
            transforms.append(_frame("object", trajectory.com[frame]))
            yield time, "/object/com", _bytes(PoseInFrame(timestamp=timestamp(time), frame_id=WORLD, pose=com))
            yield time, "/object/points", _points(time, trajectory.positions[frame, shown], object_colours)
        if camera_poses is not None and frame < len(camera_poses[0]):
            transforms.append(_frame(CAMERA, *(values[frame] for values in camera_poses)))
        if search is not None:
            # In every frame from the contact on, since a viewer that seeks sees the last message alone.
            seen = [contact for contact in search.contacts if contact.frame <= frame]
            entities += [_arrow(number, contact) for number, contact in enumerate(seen)]
        for transform in transforms:
            transform.timestamp.CopyFrom(timestamp(time))
        if transforms:
            yield time, "/tf", _bytes(FrameTransforms(transforms=transforms))
        for entity in entities:
            entity.timestamp.CopyFrom(timestamp(time))
        yield time, "/scene", _bytes(SceneUpdate(entities=entities))


def _skeleton(motion: Motion, rest_joints: Array) -> dict[str, Array]:
    """World positions (T, 24, 3), world and local rotations xyzw (T, 24, 4)."""
    import roma
    import torch

    from hoi.body.kinematics import forward_kinematics, local_rotations

    def tensor(array: Array) -> torch.Tensor:
        return torch.from_numpy(np.array(array, np.float64))

    local = local_rotations(tensor(motion.orientation), tensor(motion.body_pose))
    rotations, positions = forward_kinematics(local, tensor(motion.translation), tensor(rest_joints))
    return {
        "positions": positions.numpy(),
        "rotations": roma.rotmat_to_unitquat(rotations).numpy(),
        "local": roma.rotmat_to_unitquat(local).numpy(),
        "offsets": np.broadcast_to(rest_joints - rest_joints[list(PARENTS)], positions.shape),
    }


def _joint_frames(pose: dict[str, Array]) -> list[FrameTransform]:
    frames = [_frame(JOINT_NAMES[0], pose["positions"][0], pose["local"][0])]
    for joint, parent in enumerate(PARENTS[1:], start=1):
        frames.append(_frame(JOINT_NAMES[joint], pose["offsets"][joint], pose["local"][joint], JOINT_NAMES[parent]))
    return frames


def _frame(name: str, position: Array, xyzw: ArrayLike = UPRIGHT, parent: str = WORLD) -> FrameTransform:
    place, turn = _filled(Vector3, position), _filled(Quaternion, xyzw)
    return FrameTransform(parent_frame_id=parent, child_frame_id=name, translation=place, rotation=turn)


def _points(time: int, positions: Array, rgb: Array) -> bytes:
    packed = np.zeros(len(positions), POINT)
    for axis, name in enumerate("xyz"):
        packed[name] = rounded(positions[:, axis], SHOWN)
    for channel, name in enumerate(("red", "green", "blue")):
        packed[name] = np.rint(np.clip(rgb[:, channel], 0, 1) * 255)
    packed["alpha"] = 255
    kinds = {"f": PackedElementField.FLOAT32, "u": PackedElementField.UINT8}
    layout = [
        PackedElementField(name=name, offset=offset, type=kinds[dtype.kind])
        for name, (dtype, offset, *_) in (POINT.fields or {}).items()
    ]
    cloud = PointCloud(
        timestamp=timestamp(time),
        frame_id=WORLD,
        pose=_pose((0, 0, 0)),
        point_stride=POINT.itemsize,
        fields=layout,
        data=packed.tobytes(),
    )
    return _bytes(cloud)


def _ground() -> SceneEntity:
    size = _filled(Vector3, (_GROUND_SIZE, _GROUND_SIZE, 0.01))
    slab = CubePrimitive(pose=_pose((0, 0, -0.005)), size=size, color=_GROUND)
    return SceneEntity(id="ground", frame_id=WORLD, cubes=[slab])


def _bones(joints: Array) -> SceneEntity:
    ends = [joints[end] for joint, parent in enumerate(PARENTS[1:], start=1) for end in (parent, joint)]
    lines = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        pose=_pose((0, 0, 0)),
        thickness=3.0,
        scale_invariant=True,
        points=[_filled(Point3, end) for end in ends],
        color=_BONE,
    )
    return SceneEntity(id="skeleton", frame_id=WORLD, lines=[lines])


def _arrow(number: int, contact: Contact) -> SceneEntity:
    """The contact normal n, from the contact point."""
    x, y, z = map(float, contact.normal)
    # The shortest rotation of +x onto n; a half turn about z where n is -x.
    xyzw = np.array([0, -z, y, 1 + x]) if x > -1 + 1e-9 else np.array([0, 0, 1.0, 0])
    arrow = ArrowPrimitive(
        pose=_pose(contact.point, xyzw / np.linalg.norm(xyzw)),
        shaft_length=0.30,
        shaft_diameter=0.02,
        head_length=0.08,
        head_diameter=0.05,
        color=_ARROW,
    )
    return SceneEntity(id=f"contact/{number}", frame_id=WORLD, arrows=[arrow])


def _pose(position: ArrayLike, xyzw: ArrayLike = UPRIGHT) -> Pose:
    return Pose(position=_filled(Vector3, position), orientation=_filled(Quaternion, xyzw))


def _filled(kind: Any, values: ArrayLike) -> Any:
    """A vector, point or quaternion of x, y, z and perhaps w."""
    return kind(**dict(zip("xyzw", np.asarray(values, np.float64).tolist(), strict=False)))


def _bytes(message: Any) -> bytes:
    return message.SerializeToString(deterministic=True)
