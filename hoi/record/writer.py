"""Run -> MCAP."""

import heapq
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array, Contact, Motion, ObjectTrajectory, Run, fields_of
from hoi.files import whole_file
from hoi.record.camera import Footage, poses
from hoi.record.camera import messages as camera_messages
from hoi.record.parts import history_to_csv, scene_files, to_json
from hoi.record.schemas import FORMAT, MOTION_ARRAYS, OBJECT_ARRAYS, ObjectState, array_fields, as_recorded, channels
from hoi.record.views import timestamp, views

_REFUSED = ("; out must be a folder that can be written to", "set out elsewhere")
_MEDIA_TYPES = {".yaml": "application/yaml", ".txt": "text/plain", ".json": "application/json", ".csv": "text/csv"}

Message = tuple[int, str, bytes]
"""Time [ns], topic, data."""


def write(
    run: Run,
    path: Path,
    human_points: Array | None = None,
    human_colours: Array | None = None,
    *,
    plan_text: str,
    object_stride: int = 1,
    footage: Footage | None = None,
) -> None:
    """Write the whole run to `path`: under `path` + ".part" first, renamed when it is complete.

    Args:
        run: what to write, but for `state.object_states`; a failed run has a scene and a state as far as it came.
        path: the record; an older one is replaced.
        human_points: posed Gaussian means to look at [m], shape (T, M, 3), world; usually thinned out.
        human_colours: their colours in [0, 1], shape (M, 3).
        plan_text: the plan as it was printed.
        object_stride: every which of the object's Gaussians to show in `/object/points`; `/object/state` has them all.
        footage: the video of the run, a picture a frame; without cameras it has a frame rate of its own, and needs no
            scene.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
        ValueError: a state without a scene, a trajectory without an object, points without colours, or a video that is
            not as long as the run.
    """
    state = run.state
    if run.scene is None and any(part is not None for part in (state.motion, state.trajectory, state.contact)):
        raise ValueError("a run without a scene can have no state")
    if state.trajectory is not None and run.scene is not None and run.scene.object is None:
        raise ValueError("a run without an object can have no trajectory")
    if (human_points is None) != (human_colours is None):
        raise ValueError("human_points and human_colours go together")
    if footage is not None and footage.cameras and len(footage) != _frames(run):
        raise ValueError(f"a video of {len(footage)} pictures for a run of {_frames(run)} frames")
    if state.trajectory is not None:
        run = replace(run, state=replace(state, trajectory=as_recorded(state.trajectory)))
    with whole_file(path, *_REFUSED) as part, open(part, "wb") as file:
        writer = Writer(file)
        writer.start(library="hoi")
        writer.add_metadata("hoi.record", {"format": FORMAT})
        writer.add_metadata("hoi.run", run.provenance)
        before = {
            "config.yaml": run.config_yaml.encode(),
            "plan.txt": plan_text.encode(),
            "plan.json": to_json(run.plan),
        }
        if run.scene is not None:
            before |= scene_files(run.scene)
        _attach(writer, before)
        channel = channels(writer)
        for time, topic, data in _messages(run, human_points, human_colours, object_stride, footage):
            writer.add_message(channel(topic), time, data, publish_time=time)
        _attach(writer, {"state.json": to_json(_facts(run)), "reports.json": to_json(run.reports)})
        _attach(writer, {"history.csv": history_to_csv(run.history)})
        writer.add_metadata("hoi.result", run.result)
        writer.finish()
        file.flush()
        os.fsync(file.fileno())


def _attach(writer: Writer, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        writer.add_attachment(0, 0, name, media_type, data)


def _facts(run: Run) -> dict:
    """What of the state fits in no message: which parts there are, and the little facts about them."""
    state = run.state
    motion, trajectory, search = state.motion, state.trajectory, state.contact
    dtypes = {} if motion is None else {name: getattr(motion, name).dtype.str for name in MOTION_ARRAYS}
    return {
        "motion": None if motion is None else {"fps": motion.fps, "frames": len(motion), "dtypes": dtypes},
        "trajectory": None if trajectory is None else {"frames": len(trajectory.positions)},
        "target": state.target,
        "later": state.later,
        "contact": None if search is None else fields_of(search) | {"contacts": len(search.contacts)},
    }


def _messages(
    run: Run, points: Array | None, colours: Array | None, object_stride: int, footage: Footage | None
) -> Iterator[Message]:
    """All messages in the order of their times; each stream is in order already."""
    streams = []
    if footage is not None and footage.fps is not None:
        own_times = [_nanoseconds(picture, footage.fps) for picture in range(len(footage))]
        streams.append(camera_messages(footage, own_times))
    if run.scene is not None:
        state, fps = run.state, run.scene.fps
        frames = max(_frames(run), 0 if points is None else len(points))
        times = [_nanoseconds(frame, fps) for frame in range(frames)]
        camera_poses = None if footage is None or not footage.cameras else poses(footage.cameras)
        streams.append(views(run, times, points, colours, object_stride, camera_poses))
        if footage is not None and footage.fps is None:
            streams.append(camera_messages(footage, times))
        if state.motion is not None:
            streams.append(_motion(state.motion, times))
        if state.trajectory is not None:
            streams.append(_trajectory(state.trajectory, times))
        if state.contact is not None:
            streams.append(_contacts(state.contact.contacts, fps))
    return heapq.merge(*streams, key=lambda message: message[0])


def _frames(run: Run) -> int:
    """Frames of what moves."""
    motion, trajectory = run.state.motion, run.state.trajectory
    return max(0 if motion is None else len(motion), 0 if trajectory is None else len(trajectory.positions))


def _nanoseconds(frame: float, fps: float) -> int:
    return round(frame / fps * 1e9)


def _motion(motion: Motion, times: list[int]) -> Iterator[Message]:
    for frame, time in zip(range(len(motion)), times, strict=False):
        arrays = {name: getattr(motion, name)[frame].ravel() for name in MOTION_ARRAYS}
        yield time, "/human/motion", to_json({"time": time / 1e9, **arrays})


def _trajectory(trajectory: ObjectTrajectory, times: list[int]) -> Iterator[Message]:
    for frame, time in zip(range(len(trajectory.positions)), times, strict=False):
        arrays = {name: getattr(trajectory, name) for name in OBJECT_ARRAYS}
        phase = trajectory.phase[frame] if trajectory.phase else ""
        message = ObjectState(
            timestamp=timestamp(time),
            phase=phase,
            **{name: array_fields(array[frame]) for name, array in arrays.items() if array is not None},
        )
        yield time, "/object/state", message.SerializeToString(deterministic=True)
        energies = trajectory.energy[frame].tolist()
        kinds = dict(zip(("kinetic", "elastic", "potential"), energies, strict=True)) | {"total": sum(energies)}
        speed = float(np.linalg.norm(trajectory.com_velocity[frame]))
        yield time, "/object/energy", to_json({"time": time / 1e9, **kinds, "speed": speed, "phase": phase})


def _contacts(contacts: tuple[Contact, ...], fps: float) -> Iterator[Message]:
    for contact in sorted(contacts, key=lambda contact: contact.frame):
        time = _nanoseconds(contact.frame, fps)
        name = JOINT_NAMES[contact.joint] if contact.joint >= 0 else ""
        yield time, "/contact", to_json({"time": time / 1e9, "joint_name": name, **fields_of(contact)})
