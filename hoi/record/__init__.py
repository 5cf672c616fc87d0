"""One MCAP file per run, written whole or not at all: the only room that knows the format.

Reading needs neither torch nor taichi. `log_time` is the scene's time in nanoseconds from 0, so that the same run gives
the same message bytes; wall-clock facts stand in the metadata alone.

| topic | encoding | for |
|---|---|---|
| `/human/motion` | JSON | the person: translation, orientation, pose (exact) |
| `/object/state` | protobuf `hoi.ObjectState` | the object: particles (to 8 um), F (to 3e-5); com, energy, phase |
| `/contact` | JSON | one message a contact, at its time (exact) |
| `/human/points`, `/object/points` | `foxglove.PointCloud` | what a viewer draws |
| `/human/joints`, `/object/com`, `/tf` | `foxglove.PosesInFrame`, `PoseInFrame`, `FrameTransforms` | skeleton, object |
| `/scene` | `foxglove.SceneUpdate` | bones, ground, contact arrows |
| `/camera/video` | `foxglove.CompressedVideo` | the video, H.264, a picture a frame |
| `/camera/calibration` | `foxglove.CameraCalibration` | its camera, which is the frame `camera` on `/tf` |
| `/object/energy` | JSON | kinetic, elastic, potential, total, speed, phase, to plot |

Metadata: `hoi.record` (format), `hoi.run` (provenance), `hoi.result`. Attachments: `config.yaml`, `plan.txt`,
`plan.json`, `scene.json`, `body.npz`, `object.npz`, `state.json`, `reports.json`, `history.csv`.
"""

from hoi.record.camera import Footage
from hoi.record.reader import NoVideo, joints, message_digest, posed_points, read, read_metadata, video
from hoi.record.writer import write

__all__ = ["Footage", "NoVideo", "joints", "message_digest", "posed_points", "read", "read_metadata", "video", "write"]
