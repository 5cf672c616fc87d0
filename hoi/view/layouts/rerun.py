"""A record in Rerun: what its own importer reads of the MCAP, what that leaves out, and a blueprint for both.

The importer of Rerun 0.41 reads points, joints, transforms, video and camera. What it keeps as bytes, the scene's lines
and the JSON of energies and contacts, is read here and logged beside them, in the same recording and on the same clock.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi import record
from hoi.data import Array, Run
from hoi.errors import InputError
from hoi.files import whole_file
from hoi.render.marks import bones
from hoi.render.shown import scene_of

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

APPLICATION = "hoi"
CLOCK = "message_log_time"
"""The importer's timeline of MCAP's log times, which are the scene's."""
WORLD = "world"
POINTS = ("/human/points", "/object/points")
VIDEO, CALIBRATION = "/camera/video", "/camera/calibration"
BONES, GROUND, NORMAL = "/human/bones", "/ground", "/contact/normal"
ENERGY, SPEED, PHASE = "/object/energies", "/object/speed", "/object/phase"
COLOURS = {"kinetic": (43, 108, 176), "elastic": (194, 87, 26), "potential": (95, 158, 110), "total": (34, 38, 43)}
BONE, FLOOR, ARROW = (43, 108, 176), (209, 209, 204), (214, 31, 60)
GROUND_SIZE, NORMAL_LENGTH = 8.0, 0.4
"""[m]"""


def save(path: Path, out: Path) -> None:
    """Write the record as .rrd with its blueprint.

    Raises:
        InputError: as `hoi.record.read`, nothing to show, no Rerun here, or `out` cannot be written.
        RunError: the disk is full or broken.
    """
    with _recording(path) as (stream, run):
        if not out.parent.is_dir():
            raise InputError(f"-o {out}: no such folder {out.parent}")
        with whole_file(out) as part:
            stream.save(part, default_blueprint=blueprint())
            _log(stream, run, path)
            stream.disconnect()


def open_viewer(path: Path) -> None:
    """Show the record in Rerun's viewer until that is closed.

    Raises:
        InputError: as `save`, or the viewer cannot open a window here.
        RunError: as `save`.
    """
    with tempfile.TemporaryDirectory() as folder:
        shown = Path(folder) / f"{path.stem}.rrd"
        save(path, shown)
        # By the interpreter, since the command `rerun` is on no path where the environment is not activated.
        viewer = subprocess.run([sys.executable, "-m", "rerun", str(shown)], stderr=subprocess.PIPE, text=True)
    if viewer.returncode > 0:
        instead = "-o FILE.rrd, then rerun FILE.rrd --web-viewer, takes a browser"
        raise InputError(f"Rerun opens no window; {instead}: {_last(viewer.stderr)}")


def _last(text: str) -> str:
    """The last line that says something, without colours."""
    lines = [line.strip() for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()]
    return next((line for line in reversed(lines) if line), "it gives no reason")


def blueprint() -> "Blueprint":
    """Scene in 3D and video on the left; energies, speed and phases on the right."""
    import rerun.blueprint as rrb

    scene = rrb.Spatial3DView(
        name="Scene",
        origin="/",
        contents=[*POINTS, BONES, GROUND, NORMAL, CALIBRATION, VIDEO, "/tf"],
        background=(238, 240, 242),
        spatial_information=rrb.SpatialInformation(target_frame=WORLD),
        eye_controls=rrb.EyeControls3D(position=(3.4, -0.6, 1.5), look_target=(0, 0.7, 0.8), eye_up=(0, 0, 1)),
    )
    plots = rrb.Vertical(
        rrb.Spatial2DView(name="Video", origin=VIDEO),
        rrb.TimeSeriesView(name="Energy of the object [J]", origin=ENERGY),
        rrb.TimeSeriesView(name="Speed of the object [m/s]", origin=SPEED),
        rrb.StateTimelineView(name="Phase of the object", origin=PHASE),
        row_shares=[3, 2, 2, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, plots, column_shares=[3, 2]),
        rrb.TimePanel(timeline=CLOCK, playback_speed=0.5, loop_mode="all", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


@contextmanager
def _recording(path: Path) -> "Iterator[tuple[RecordingStream, Run]]":
    """A stream without a sink, and what to log to it."""
    run = record.read(path)
    scene_of(run, path)
    os.environ.setdefault("RUST_LOG", "error")  # read when Rerun is imported
    try:
        from rerun import RecordingStream
    except ImportError:
        raise InputError("Rerun is not installed: pip install 'hoi[rerun]'") from None
    with RecordingStream(APPLICATION) as stream:
        yield stream, run


def _log(stream: "RecordingStream", run: Run, path: Path) -> None:
    import rerun as rr

    stream.log_file_from_path(path)
    fps, here = scene_of(run).fps, rr.CoordinateFrame(WORLD)
    half = (GROUND_SIZE / 2, GROUND_SIZE / 2, 0.005)
    floor = rr.Boxes3D(half_sizes=[half], centers=[(0, 0, -0.005)], colors=[FLOOR], fill_mode="solid")
    stream.log(GROUND, floor, here, static=True)
    if run.state.motion is not None:
        stream.log(BONES, here, static=True)
        for frame, joints in enumerate(record.joints(path)):
            _at(stream, frame / fps)
            stream.log(BONES, rr.LineStrips3D(bones(joints), colors=[BONE], radii=[0.008]))
    if (trajectory := run.state.trajectory) is not None:
        energies = zip(COLOURS, (*trajectory.energy.T, trajectory.energy.sum(1)), strict=True)
        for name, values in energies:
            _curve(stream, f"{ENERGY}/{name}", values, fps, COLOURS[name])
        _curve(stream, SPEED, np.linalg.norm(trajectory.com_velocity, axis=1), fps, COLOURS["elastic"])
        for frame, phase in enumerate(trajectory.phase):
            if frame == 0 or phase != trajectory.phase[frame - 1]:
                _at(stream, frame / fps)
                stream.log(PHASE, rr.StateChange(state=phase))
    if run.state.contact is not None and run.state.contact.contacts:
        contacts = sorted(run.state.contact.contacts, key=lambda contact: contact.frame)
        stream.log(NORMAL, here, static=True)
        for number, contact in enumerate(contacts, start=1):
            _at(stream, contact.frame / fps)
            normals = [NORMAL_LENGTH * seen.normal for seen in contacts[:number]]
            origins = [seen.point for seen in contacts[:number]]
            stream.log(NORMAL, rr.Arrows3D(vectors=normals, origins=origins, colors=[ARROW], radii=[0.012]))


def _curve(stream: "RecordingStream", entity: str, values: Array, fps: float, colour: tuple[int, int, int]) -> None:
    """Numbers (T,) over time, named as the last part of the entity."""
    import rerun as rr

    stream.log(entity, rr.SeriesLines(colors=[colour], names=[entity.rpartition("/")[2]]), static=True)
    for frame, value in enumerate(values):
        _at(stream, frame / fps)
        stream.log(entity, rr.Scalars(float(value)))


def _at(stream: "RecordingStream", seconds: float) -> None:
    stream.set_time(CLOCK, timestamp=np.datetime64(round(seconds * 1e9), "ns"))
