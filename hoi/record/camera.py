"""The run as a camera saw it: its video, its calibration and its place, as messages and back."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from hoi.data import Array, Camera
from hoi.record.views import CAMERA, timestamp

FORMAT, NO_DISTORTION = "h264", "plumb_bob"


@dataclass(frozen=True)
class Footage:
    """What a camera saw of a run."""

    units: tuple[bytes, ...]
    """H.264 access units in Annex B, a picture each, in the order in which they are shown: joined they are a stream
    that players take. No B-frames; parameter sets with every key frame."""
    cameras: tuple[Camera, ...]
    """Which took each of them; empty where no one knows, as of another system's video."""
    fps: float | None = None
    """Pictures a second of a video without cameras; None where there is a picture a frame of the run."""

    def __post_init__(self) -> None:
        if self.cameras and len(self.units) != len(self.cameras):
            raise ValueError(f"{len(self.units)} pictures and {len(self.cameras)} cameras")
        if bool(self.cameras) != (self.fps is None):
            raise ValueError("a video has either cameras or a frame rate of its own")

    def __len__(self) -> int:
        return len(self.units)


def poses(cameras: Sequence[Camera]) -> tuple[Array, Array]:
    """Positions [m] (T, 3) and rotations xyzw (T, 4) that take the camera's axes (x right, y down, z forward) to the
    world's."""
    from scipy.spatial.transform import Rotation

    turns = np.stack([camera.world_to_camera[:3, :3].T for camera in cameras])
    return np.stack([camera.position for camera in cameras]), Rotation.from_matrix(turns).as_quat(canonical=True)


def messages(footage: Footage, times: Sequence[int]) -> Iterator[tuple[int, str, bytes]]:
    """(time [ns], topic, protobuf bytes): a picture a frame, and its calibration where there is one."""
    cameras = footage.cameras or (None,) * len(footage)
    for time, unit, camera in zip(times, footage.units, cameras, strict=False):
        if camera is not None:
            yield time, "/camera/calibration", _calibration(time, camera).SerializeToString(deterministic=True)
        picture = CompressedVideo(timestamp=timestamp(time), frame_id=CAMERA, data=unit, format=FORMAT)
        yield time, "/camera/video", picture.SerializeToString(deterministic=True)


def _calibration(time: int, camera: Camera) -> CameraCalibration:
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return CameraCalibration(
        timestamp=timestamp(time),
        frame_id=CAMERA,
        width=camera.width,
        height=camera.height,
        distortion_model=NO_DISTORTION,
        D=[0.0] * 5,
        K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )


def camera_of(calibration: CameraCalibration, place: FrameTransform) -> Camera:
    """The camera of a message of `/camera/calibration` and its frame in `/tf`, exact but for the last digits."""
    from scipy.spatial.transform import Rotation

    q, t, intrinsics = place.rotation, place.translation, list(calibration.K)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix().T
    pose[:3, 3] = -pose[:3, :3] @ [t.x, t.y, t.z]
    fx, _, cx, _, fy, cy = intrinsics[:6]
    return Camera(calibration.width, calibration.height, fx, fy, cx, cy, pose)
