"""A filmstrip of a record: the person, the object and the contact in a row of pictures, and how fast they moved.

    python -m analysis.strip RUN.mcap [-o strip.png] [--frames 8] [--view side]

From the record alone; the pictures are `hoi.render`'s.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.body.parts import struck_together, struck_with
from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array, Contact, Run
from hoi.errors import InputError, RunError
from hoi.files import whole_file
from hoi.render.cameras import TOP_UP, VIEWS, Camera, fitting_width, frame_action, project
from hoi.terminal.program import program

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hoi.render.replay import Replay

INK, MUTED, PERSON, OBJECT, CONTACT = "#22262b", "#7a828c", "#2b6cb0", "#c2571a", "#d61f3c"
PANEL_HEIGHT = 420
"""[pixel]"""
ASPECTS = (0.55, 1.25)
"""The least and the largest width / height of a picture."""
STANDING = tuple(name for name in VIEWS if name != "follow")
DPI = 150
GAP, HEAD, FOOT, CHART = 4, 52, 66, 170
"""Between the pictures, above them, below the chart, and the chart itself [pixel]."""


@dataclass(frozen=True)
class Film:
    """What of a record can be seen, frame by frame."""

    run: Run
    replay: Replay
    thing: Array
    """Middle of the object's Gaussians [m], (T, 3); empty where the run has no trajectory."""
    joints: Array
    """(T, 24, 3) [m]; empty where the run has no motion."""

    @property
    def frames(self) -> int:
        return self.replay.frames

    @property
    def fps(self) -> float:
        return self.replay.fps

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
        InputError: as `hoi.record.read` and `hoi.render.shown.scene_of`.
    """
    from hoi import record
    from hoi.render.replay import replay
    from hoi.render.shown import scene_of

    run = record.read(path)
    motion, trajectory = run.state.motion, run.state.trajectory
    scene = scene_of(run, path)
    return Film(
        run=run,
        replay=replay(run),
        thing=np.zeros((0, 3)) if trajectory is None else trajectory.positions[:, : len(scene.thing.cloud)].mean(1),
        joints=np.zeros((0, 24, 3)) if motion is None else record.joints(path),
    )


def make_strip(shown: Film, path: Path, count: int = 8, view: str = "three_quarter") -> None:
    """Write the filmstrip as PNG.

    Raises:
        InputError: a bad name, frame count or view, or the file cannot be written.
    """
    import matplotlib.pyplot as plt

    from hoi.render.film import choose_frames, film

    if path.suffix.lower() != ".png":
        raise InputError(f"-o {path}: the filmstrip is a .png file")
    if not 1 <= count <= 24:
        raise InputError(f"--frames {count}: 1 to 24 are allowed")
    if view not in STANDING:
        raise InputError(f"--view {view}: allowed are {', '.join(STANDING)}")
    contact = shown.contact
    chosen = choose_frames(shown.frames, count, None if contact is None else contact.frame)
    camera = _camera(shown, view)
    figure, panels, chart = _layout(len(chosen), camera)
    struck = None if contact is None else min(chosen, key=lambda frame: abs(frame - contact.frame))
    pictures = film(shown.replay, [camera] * len(chosen), frames=chosen)
    for axes, frame, picture in zip(panels, chosen, pictures, strict=True):
        axes.imshow(picture, extent=(0, camera.width, camera.height, 0))
        _mark(axes, shown, camera, frame, contact if frame == struck else None)
    _speeds(chart, shown, chosen)
    words = [
        figure.text(0.008, 0.985, _title(shown.run), va="top", fontsize=13, color=INK, weight="bold"),
        figure.text(0.992, 0.985, _outcome(shown), va="top", ha="right", fontsize=12, color=MUTED),
    ]
    crowding = sum(text.get_window_extent().width for text in words) / (0.97 * figure.bbox.width)
    for text in words:
        text.set_fontsize(float(text.get_fontsize()) / max(crowding, 1.0))
    try:
        with whole_file(path) as part:
            figure.savefig(part, dpi=DPI, format="png")
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        plt.close(figure)


def _camera(shown: Film, view: str) -> Camera:
    points, up = shown.replay.action().points(), TOP_UP if view == "top" else (0, 0, 1)
    width = fitting_width(points, VIEWS[view], PANEL_HEIGHT, ASPECTS, up=up)
    return frame_action(points, VIEWS[view], width=width, height=PANEL_HEIGHT, up=up)


def _layout(count: int, camera: Camera) -> tuple[Figure, list[Axes], Axes]:
    import matplotlib.pyplot as plt

    row = count * camera.width + (count - 1) * GAP
    scale = max(1.0, 1100 / row)  # room for the words where there are few pictures
    below = FOOT + CHART + 26
    width, height = scale * row, scale * camera.height + HEAD + below
    figure = plt.figure(figsize=(width / DPI, height / DPI), facecolor="white")
    size = (scale * camera.width / width, scale * camera.height / height)
    lefts = [scale * index * (camera.width + GAP) / width for index in range(count)]
    panels = [figure.add_axes((left, below / height, *size)) for left in lefts]
    return figure, panels, figure.add_axes((78 / width, FOOT / height, 1 - 100 / width, CHART / height))


def _mark(axes: Axes, shown: Film, camera: Camera, frame: int, contact: Contact | None) -> None:
    """What is known about a picture, on it: the object's path, the time, the contact."""
    from matplotlib import patheffects

    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xticks=[], yticks=[])
    glow = [patheffects.withStroke(linewidth=2.5, foreground="white", alpha=0.85)]
    if len(shown.thing):
        path, _ = project(camera, shown.thing[: frame + 1])
        axes.plot(*path.T, color=OBJECT, linewidth=1.1, alpha=0.65, linestyle=(0, (1, 1.6)))
    accent = MUTED if contact is None else CONTACT
    for side in axes.spines.values():
        side.set(color=accent if contact is not None else "#d5d9dd", linewidth=1.6 if contact is not None else 0.6)
    if contact is not None:
        ends, _ = project(camera, np.stack([contact.point, contact.point + 0.35 * contact.normal]))
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
    text = f"{frame / shown.fps:.2f} s" if contact is None else f"contact {contact.frame / shown.fps:.3f} s"
    axes.text(
        0.03,
        0.025,
        text,
        transform=axes.transAxes,
        fontsize=12,
        color=INK if contact is None else accent,
        path_effects=glow,
    )


def _speeds(axes: Axes, shown: Film, chosen: list[int]) -> None:
    """Speed of the joint that strikes and of the object over time."""
    contact, target, trajectory = shown.contact, shown.run.state.target, shown.run.state.trajectory
    highest = 0.0
    if len(shown.joints) > 1:
        speeds = np.linalg.norm(np.gradient(shown.joints, 1 / shown.fps, axis=0), axis=-1)
        fastest = int(speeds.max(0).argmax())
        joint = contact.joint if contact is not None else target.joint if target is not None else fastest
        name = JOINT_NAMES[joint].replace("_", " ")
        axes.plot(np.arange(len(speeds)) / shown.fps, speeds[:, joint], color=PERSON, linewidth=1.6, label=name)
        highest = speeds[:, joint].max()
    if trajectory is not None:
        speed = np.linalg.norm(trajectory.com_velocity, axis=1)
        name = shown.run.scene.thing.name if shown.run.scene is not None else "object"
        axes.plot(np.arange(len(speed)) / shown.fps, speed, color=OBJECT, linewidth=1.6, label=name.replace("_", " "))
        highest = max(highest, speed.max())
    top = 1.12 * highest if highest > 0 else 1.0
    search = shown.run.state.contact
    for each in () if search is None else search.contacts:
        axes.axvline(each.frame / shown.fps, color=CONTACT, linewidth=1.0)
    marks = np.array(chosen) / shown.fps
    axes.plot(marks, np.full(len(marks), 0.0), "^", color=INK, markersize=4, clip_on=False, zorder=5)
    end = max((shown.frames - 1) / shown.fps, 1 / shown.fps)
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


def _velocity_after(shown: Film, contact: Contact) -> Array:
    """The object's velocity when the contact is over: V_post, or where the limb took its time, what became of it."""
    trajectory = shown.run.state.trajectory
    if contact.duration == 0 or trajectory is None:
        return contact.v_post
    over = math.ceil(contact.frame + contact.duration * shown.fps)
    return trajectory.com_velocity[min(over, len(trajectory.com_velocity) - 1)]


def _outcome(shown: Film) -> str:
    contact, search = shown.contact, shown.run.state.contact
    if contact is not None and search is not None:
        speed = float(np.linalg.norm(_velocity_after(shown, contact) - contact.v_object))
        limb = (struck_with(contact) if search.push is None else struck_together(search)).replace("_", " ")
        return f"{limb}, closing speed {contact.v_in:.1f} m/s, object sped up by {speed:.1f} m/s"
    if search is not None:
        time = search.smallest_gap_frame / shown.fps
        return f"no contact: closest {100 * search.smallest_gap:.1f} cm at {time:.2f} s"
    return "no contact searched for"


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `python -m analysis.strip`; the exit code."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {__package__}.strip",
        description="A filmstrip of a record: person, object and contact in a row of pictures, and their speeds.",
        epilog="example: %(prog)s runs/kick_soccer_ball/laptop/full/s0/run.mcap -o strip.png",
    )
    parser.add_argument("record", type=Path, metavar="RUN.mcap")
    parser.add_argument("-o", "--out", type=Path, help="PNG to write (default: strip.png beside the record)")
    parser.add_argument("--frames", type=int, default=8, help="how many pictures (default: 8)")
    parser.add_argument("--view", default="three_quarter", help=f"{', '.join(STANDING)} (default: three_quarter)")
    options = parser.parse_args(arguments)
    out = options.out or options.record.with_name("strip.png")
    try:
        make_strip(load(options.record), out, options.frames, options.view)
    except (InputError, RunError) as error:
        print(f"strip: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 3
    print(out)
    return 0


if __name__ == "__main__":
    program(main)
