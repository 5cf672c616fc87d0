"""A filmstrip of a record: the person, the object and the contact in a row of pictures, and how fast they moved.

    python -m analysis.strip RUN.mcap [-o strip.png] [--frames 8] [--view side|front|three_quarter]

From the record alone: no torch, no taichi.
"""

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.points import VIEWS, Camera, draw, frame_points, spacing
from hoi import record
from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array, Contact, Run
from hoi.errors import InputError
from hoi.gaussians import colours

INK, MUTED, PERSON, OBJECT, CONTACT = "#22262b", "#7a828c", "#2b6cb0", "#c2571a", "#d61f3c"
PANEL_HEIGHT = 420
"""[pixel]"""
REACH = 0.9
"""The object is kept in the picture while it is this close to the person [m]."""
DPI = 150
GAP, HEAD, FOOT, CHART = 4, 52, 66, 170
"""Between the pictures, above them, below the chart, and the chart itself [pixel]."""


@dataclass(frozen=True)
class Film:
    """What of a record can be seen, frame by frame; a part the run does not have is empty."""

    run: Run
    fps: float
    person: Array
    """(T, M, 3) [m]"""
    person_colours: Array
    thing: Array
    """The object's Gaussians (T, N, 3) [m]"""
    thing_colours: Array
    joints: Array
    """(T, 24, 3) [m]"""

    @property
    def frames(self) -> int:
        return max(len(self.person), len(self.thing))

    @property
    def contact(self) -> Contact | None:
        """The contact that pushed the object, else the first touch."""
        search = self.run.state.contact
        if search is None or not search.contacts:
            return None
        return search.push or search.contacts[0]


def load(path: Path) -> Film:
    """Read what there is to see.

    Raises:
        InputError: as `hoi.record.read`, or the run has neither a motion nor a trajectory.
    """
    run = record.read(path)
    motion, trajectory = run.state.motion, run.state.trajectory
    if run.scene is None or (motion is None and trajectory is None):
        raise InputError(f"{path} has neither a motion nor a trajectory to show (status {run.result.get('status')})")
    nothing, no_colours = np.zeros((0, 0, 3)), np.zeros((0, 3))
    person, person_colours = (nothing, no_colours) if motion is None else record.posed_points(path)
    cloud = run.scene.object.cloud
    return Film(
        run=run,
        fps=run.scene.fps,
        person=person,
        person_colours=person_colours,
        thing=nothing if trajectory is None else trajectory.positions[:, : len(cloud)],
        thing_colours=no_colours if trajectory is None else np.clip(colours(cloud), 0, 1),
        joints=nothing if motion is None else record.joints(path),
    )


def choose_frames(frames: int, count: int, contact: float | None) -> list[int]:
    """`count` frames of 0..frames-1, increasing, with the first, the last and the one nearest to `contact`.

    Closer together around the contact; evenly spread without one.
    """
    count = min(count, frames)
    if contact is None:
        return sorted({round(frame) for frame in np.linspace(0, frames - 1, count)})
    middle = int(np.clip(round(contact), 0, frames - 1))
    before = int(np.clip(round((count - 1) * 0.45), 0, middle))
    after = min(count - 1 - before, frames - 1 - middle)
    before = min(count - 1 - after, middle)
    offsets = [
        sign * _spread(side, steps) for sign, side, steps in ((-1, middle, before), (1, frames - 1 - middle, after))
    ]
    return sorted({middle, *(middle + offsets[0]).tolist(), *(middle + offsets[1]).tolist()})


def _spread(side: int, steps: int) -> NDArray[np.int64]:
    """`steps` different whole numbers in 1..side, the largest included, finer towards 1."""
    wanted = side * (np.arange(1, steps + 1) / max(steps, 1)) ** 1.7
    chosen = np.maximum.accumulate(np.round(wanted).astype(int))
    for i in range(steps):
        chosen[i] = max(chosen[i], i + 1, chosen[i - 1] + 1 if i else 1)
    return np.minimum(chosen, side - np.arange(steps)[::-1])


def make_strip(film: Film, path: Path, count: int = 8, view: str = "three_quarter") -> None:
    """Write the filmstrip as PNG.

    Raises:
        InputError: a bad name, frame count or view, or the file cannot be written.
    """
    if path.suffix.lower() != ".png":
        raise InputError(f"-o {path}: the filmstrip is a .png file")
    if not 1 <= count <= 24:
        raise InputError(f"--frames {count}: 1 to 24 are allowed")
    if view not in VIEWS:
        raise InputError(f"--view {view}: allowed are {', '.join(VIEWS)}")
    contact = film.contact
    chosen = choose_frames(film.frames, count, None if contact is None else contact.frame)
    camera = frame_points(_action(film, chosen), view, PANEL_HEIGHT)
    figure, panels, chart = _layout(len(chosen), camera)
    radii = [0.75 * spacing(cloud[0]) if len(cloud) else np.zeros(0) for cloud in (film.person, film.thing)]
    struck = None if contact is None else min(chosen, key=lambda frame: abs(frame - contact.frame))
    for axes, frame in zip(panels, chosen, strict=True):
        _panel(axes, film, camera, frame, np.concatenate(radii), contact if frame == struck else None)
    _speeds(chart, film, chosen)
    words = [
        figure.text(0.008, 0.985, _title(film.run), va="top", fontsize=13, color=INK, weight="bold"),
        figure.text(0.992, 0.985, _outcome(film), va="top", ha="right", fontsize=12, color=MUTED),
    ]
    crowding = sum(text.get_window_extent().width for text in words) / (0.97 * figure.bbox.width)
    for text in words:
        text.set_fontsize(float(text.get_fontsize()) / max(crowding, 1.0))
    try:
        figure.savefig(path, dpi=DPI)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        plt.close(figure)


def _action(film: Film, chosen: list[int]) -> Array:
    """The points that the camera has to show: the person, the object while it is close, and the ground below."""
    people = [film.person[frame] for frame in chosen if frame < len(film.person)]
    things = [film.thing[frame] for frame in chosen if frame < len(film.thing)]
    if people:
        low, high = np.concatenate(people).min(0), np.concatenate(people).max(0)
        centres = [thing.mean(0) for thing in things]
        gaps = [np.linalg.norm(np.maximum(0, np.maximum(low - c, c - high))) for c in centres]
        closest = min(gaps, default=0.0)
        things = [thing for thing, gap in zip(things, gaps, strict=True) if gap <= max(REACH, closest)]
    points = np.concatenate(people + things)
    return np.concatenate([points, points * (1, 1, 0)])


def _layout(count: int, camera: Camera) -> tuple[Figure, list[Axes], Axes]:
    row = count * camera.width + (count - 1) * GAP
    scale = max(1.0, 1100 / row)  # room for the words where there are few pictures
    below = FOOT + CHART + 26
    width, height = scale * row, scale * camera.height + HEAD + below
    figure = plt.figure(figsize=(width / DPI, height / DPI), facecolor="white")
    size = (scale * camera.width / width, scale * camera.height / height)
    lefts = [scale * index * (camera.width + GAP) / width for index in range(count)]
    panels = [figure.add_axes((left, below / height, *size)) for left in lefts]
    return figure, panels, figure.add_axes((78 / width, FOOT / height, 1 - 100 / width, CHART / height))


def _panel(axes: Axes, film: Film, camera: Camera, frame: int, radii: Array, contact: Contact | None) -> None:
    clouds = [cloud[frame] if frame < len(cloud) else None for cloud in (film.person, film.thing)]
    parts = zip(clouds, (film.person_colours, film.thing_colours), strict=True)
    shown = [(cloud, rgb) for cloud, rgb in parts if cloud is not None]
    points, rgb = (np.concatenate(part) for part in zip(*shown, strict=True))
    axes.imshow(draw(camera, points, rgb, radii[-len(points) :] if clouds[0] is None else radii[: len(points)]))
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])
    glow = [patheffects.withStroke(linewidth=2.5, foreground="white", alpha=0.85)]
    if len(film.thing):
        path, _ = camera.project(film.thing[: frame + 1].mean(1))
        axes.plot(*path.T, color=OBJECT, linewidth=1.1, alpha=0.65, linestyle=(0, (1, 1.6)))
    accent = MUTED if contact is None else CONTACT
    for side in axes.spines.values():
        side.set(color=accent if contact is not None else "#d5d9dd", linewidth=1.6 if contact is not None else 0.6)
    if contact is not None:
        ends, _ = camera.project(np.stack([contact.point, contact.point + 0.35 * contact.normal]))
        arrow = {"arrowstyle": "-|>", "color": CONTACT, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", ends[1], ends[0], arrowprops=arrow)
        axes.plot(*ends[0], "*", color=CONTACT, markersize=11, markeredgecolor="white", markeredgewidth=0.7)
        axes.annotate(
            "n",
            ends[1],
            (3, 3),
            textcoords="offset points",
            color=CONTACT,
            fontsize=12,
            style="italic",
            path_effects=glow,
        )
    text = f"{frame / film.fps:.2f} s" if contact is None else f"contact {contact.frame / film.fps:.3f} s"
    axes.text(
        0.03,
        0.025,
        text,
        transform=axes.transAxes,
        fontsize=12,
        color=INK if contact is None else accent,
        path_effects=glow,
    )


def _speeds(axes: Axes, film: Film, chosen: list[int]) -> None:
    """Speed of the joint that strikes and of the object over time."""
    contact, target, trajectory = film.contact, film.run.state.target, film.run.state.trajectory
    highest = 0.0
    if len(film.joints) > 1:
        speeds = np.linalg.norm(np.gradient(film.joints, 1 / film.fps, axis=0), axis=-1)
        fastest = int(speeds.max(0).argmax())
        joint = contact.joint if contact is not None else target.joint if target is not None else fastest
        name = JOINT_NAMES[joint].replace("_", " ")
        axes.plot(np.arange(len(speeds)) / film.fps, speeds[:, joint], color=PERSON, linewidth=1.6, label=name)
        highest = speeds[:, joint].max()
    if trajectory is not None:
        speed = np.linalg.norm(trajectory.com_velocity, axis=1)
        name = film.run.scene.object.name if film.run.scene is not None else "object"
        axes.plot(np.arange(len(speed)) / film.fps, speed, color=OBJECT, linewidth=1.6, label=name.replace("_", " "))
        highest = max(highest, speed.max())
    top = 1.12 * highest if highest > 0 else 1.0
    search = film.run.state.contact
    for each in () if search is None else search.contacts:
        axes.axvline(each.frame / film.fps, color=CONTACT, linewidth=1.0)
    marks = np.array(chosen) / film.fps
    axes.plot(marks, np.full(len(marks), 0.0), "^", color=INK, markersize=4, clip_on=False, zorder=5)
    end = max((film.frames - 1) / film.fps, 1 / film.fps)
    axes.set(xlim=(0, end), ylim=(0, top), xlabel="time [s]", ylabel="speed [m/s]")
    axes.tick_params(labelsize=10, colors=MUTED)
    axes.xaxis.label.set(size=11, color=MUTED)
    axes.yaxis.label.set(size=11, color=MUTED)
    axes.grid(axis="y", color="#e6e9ec", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#c5cad0")
    axes.legend(loc="upper left", fontsize=11, frameon=False, labelcolor=INK, ncols=2)


def _title(run: Run) -> str:
    if run.scene is None:
        return ""
    return f"“{run.scene.motion_prompt}”  ·  {run.scene.name}  ·  {run.plan.variant}"


def _velocity_after(film: Film, contact: Contact) -> Array:
    """The object's velocity when the contact is over: V_post, or where the limb took its time, what became of it."""
    trajectory = film.run.state.trajectory
    if contact.duration == 0 or trajectory is None:
        return contact.v_post
    over = math.ceil(contact.frame + contact.duration * film.fps)
    return trajectory.com_velocity[min(over, len(trajectory.com_velocity) - 1)]


def _outcome(film: Film) -> str:
    contact, search = film.contact, film.run.state.contact
    if contact is not None:
        speed = float(np.linalg.norm(_velocity_after(film, contact) - contact.v_object))
        joint = JOINT_NAMES[contact.joint].replace("_", " ")
        return f"{joint}, closing speed {contact.v_in:.1f} m/s, object sped up by {speed:.1f} m/s"
    if search is not None:
        time = search.smallest_gap_frame / film.fps
        return f"no contact: closest {100 * search.smallest_gap:.1f} cm at {time:.2f} s"
    return "no contact searched for"


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m analysis.strip`; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m analysis.strip", description="A filmstrip of a record.")
    parser.add_argument("record", type=Path, metavar="RUN.mcap")
    parser.add_argument("-o", "--out", type=Path, help="PNG to write (default: strip.png beside the record)")
    parser.add_argument("--frames", type=int, default=8, help="how many pictures (default: 8)")
    parser.add_argument("--view", default="three_quarter", help=f"{', '.join(VIEWS)} (default: three_quarter)")
    options = parser.parse_args(arguments)
    out = options.out or options.record.with_name("strip.png")
    try:
        make_strip(load(options.record), out, options.frames, options.view)
    except InputError as error:
        print(f"strip: {error}", file=sys.stderr)
        return 2
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
