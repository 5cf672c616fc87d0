"""What moved where as CSV, a line a frame, for spreadsheets and plots."""

import csv
import math
from pathlib import Path

from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import joint_frames
from hoi.data import Run
from hoi.files import whole_file
from hoi.render.shown import scene_of

AXES = "xyz"


def write_csv(run: Run, path: Path) -> None:
    """Write time [s], the object's centre of mass [m], velocity [m/s], energies [J] and phase, the joints [m].

    Raises:
        InputError: as `hoi.render.shown.scene_of`, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    scene, motion, trajectory = scene_of(run), run.state.motion, run.state.trajectory
    columns: dict[str, list[float | int | str]] = {}
    if trajectory is not None:
        for name, values in (("object_", trajectory.com), ("object_v", trajectory.com_velocity)):
            columns |= {f"{name}{axis}": values[:, i].tolist() for i, axis in enumerate(AXES)}
        kinds = ("kinetic", "elastic", "potential")
        columns |= {f"{kind}_energy": trajectory.energy[:, i].tolist() for i, kind in enumerate(kinds)}
        if trajectory.phase:
            columns["phase"] = list(trajectory.phase)
    if motion is not None:
        places = joint_frames(scene.body, motion)[1]
        for joint, name in enumerate(JOINT_NAMES):
            columns |= {f"{name}_{axis}": places[:, joint, i].tolist() for i, axis in enumerate(AXES)}
    frames = len(next(iter(columns.values())))
    head = {"frame": list(range(frames)), "time": [frame / scene.fps for frame in range(frames)]}
    with whole_file(path) as part, part.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([*head, *columns])
        for row in zip(*head.values(), *columns.values(), strict=True):
            table.writerow([_cell(value) for value in row])


def _cell(value: float | int | str) -> str:
    """Nine digits are a float32's; a number that is none stays empty."""
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return str(value)
