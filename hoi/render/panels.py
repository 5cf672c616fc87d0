"""Runs and views side by side in one clock: what is seen, and its video or filmstrip."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hoi import record
from hoi.data import Array, Camera, Run
from hoi.errors import InputError, about
from hoi.render import Backend
from hoi.render.cameras import ACTION, TOP_UP, VIEWS, circle, frame_action
from hoi.render.cameras import view as view_of
from hoi.render.director import contact_frame
from hoi.render.encode import check_fps, encode, write_mp4, write_png
from hoi.render.film import cameras_of, choose_frames, film
from hoi.render.layout import Pixels, columns_for, shrink, tile, write_on
from hoi.render.look import USUAL, Look
from hoi.render.replay import Replay, replay

TURN = 100
"""Viewpoints around a moment that is frozen: the paper's."""
SMOOTH = 60.0
"""Pictures a second of slow motion, unless told otherwise."""
SLOW = (0.12, 0.4)
"""Slow motion is full and over this long before and after the contact [s]."""
STRIP_PICTURES, STRIP_HEIGHT = 8, 240


@dataclass(frozen=True)
class Panel:
    """One of the pictures that are seen side by side."""

    replay: Replay
    frames: Sequence[int]
    """Which frame of the run each picture shows."""
    cameras: Sequence[Camera]
    """One a picture."""
    label: str


@dataclass(frozen=True)
class Clock:
    """The moments that a video shows."""

    times: Sequence[float]
    """[s]"""
    fps: float
    """Pictures a second, as it is played."""
    between: bool = False
    """Whether the moments lie between frames; otherwise each shows the nearest."""

    def frames(self, replay: Replay) -> list[int]:
        """The frame of a run nearest to each time; after its end the last."""
        return [min(round(time * replay.fps), replay.frames - 1) for time in self.times]


def make_clock(
    replays: Sequence[Replay],
    frames: slice,
    speed: float,
    freeze: int | None,
    fps: float | None = None,
    slow: float = 1.0,
) -> Clock:
    """The clock of the run with most frames a second, until the longest has ended.

    Args:
        frames: of that clock.
        speed: 1 is real time.
        freeze: the frame at which time stands, for one turn.
        fps: pictures a second, with moments between the frames; None shows each frame once.
        slow: how many times slower it goes around the first run's contact.

    Raises:
        InputError: there is no such frame, or the speed cannot be played.
    """
    own = max(each.fps for each in replays)
    count = max(math.ceil(each.frames * own / each.fps - 1e-6) for each in replays)
    if freeze is not None and not 0 <= freeze < count:
        raise InputError(f"--freeze {freeze}: frames 0 to {count - 1} are there")
    shown = list(range(count))[frames] if freeze is None else [freeze] * TURN
    if not shown:
        raise InputError(f"--frames: none of the frames 0 to {count - 1} is left")
    if freeze is None and (fps is not None or slow > 1):
        rate = fps or SMOOTH
        with about(f"--fps {rate:g}"):
            played = check_fps(rate)
        at = contact_frame(replays[0]) / replays[0].fps
        return Clock(_moments(shown[0] / own, (shown[-1] + 1) / own, at, speed / rate, slow), float(played), True)
    with about(f"--speed {speed:g}"):
        played = check_fps(own * speed)
    return Clock([frame / own for frame in shown], float(played))


def _moments(start: float, end: float, contact: float, step: float, slow: float) -> list[float]:
    """Times [s] from one to another, `slow` times as close around the contact as elsewhere."""
    times, time = [], start
    while time < end - 1e-9:
        times.append(time)
        away = np.clip((abs(time - contact) - SLOW[0]) / (SLOW[1] - SLOW[0]), 0, 1)
        near = 1 - away * away * (3 - 2 * away)
        time += step / (1 + (slow - 1) * near)
    return times


def make_panels(
    replays: Sequence[Replay], labels: Sequence[str], view: str, size: tuple[int, int], clock: Clock
) -> list[Panel]:
    """A panel for each run, or with view "all" one for each view of each run.

    Runs side by side are seen from the same place, unless the camera follows what happens in each.
    """
    names = list(VIEWS) if view == "all" else [view]
    points = np.concatenate([each.action().points() for each in replays])
    panels = []
    for shown, label in zip(replays, labels, strict=True):
        frames: Sequence[int] = clock.frames(shown)
        if clock.between:
            moments = np.minimum(np.array(clock.times) * shown.fps, shown.frames - 1)
            shown, frames = shown.retimed(moments, clock.fps), range(len(moments))
        for name in names:
            words = [label] * (len(replays) > 1) + [name.replace("_", " ")] * (len(names) > 1)
            panels.append(
                Panel(shown, frames, _cameras(name, shown, frames, points, size, len(replays) > 1), "  ·  ".join(words))
            )
    return panels


def _cameras(
    name: str, shown: Replay, frames: Sequence[int], points: Array, size: tuple[int, int], beside: bool
) -> Sequence[Camera]:
    """One a picture. Beside other runs the action is seen from the front and the side, from one place for all."""
    width, height = size
    if name == "turntable":
        return circle(points, len(frames), width=width, height=height)
    if name == ACTION and not beside:
        directed = cameras_of(shown, name, width, height)
        return [directed[frame] for frame in frames]
    if name == "follow":
        following = view_of(name, shown.action(), width=width, height=height)
        assert isinstance(following, list)
        return [following[frame] for frame in frames]
    up = TOP_UP if name == "top" else (0, 0, 1)
    direction = VIEWS["three_quarter" if name == ACTION else name]
    return [frame_action(points, direction, width=width, height=height, up=up)] * len(frames)


@dataclass(frozen=True)
class Drawing:
    """How pictures are drawn; see `hoi.render.film.film`."""

    sh_degree: int | None = None
    backend: Backend = "taichi"
    device: str = "cpu"
    look: Look = USUAL


def rows_of_pictures(panels: Sequence[Panel], how: Drawing) -> Iterator[list[Pixels]]:
    """The panels' pictures, time after time."""
    films = [film(panel.replay, panel.cameras, frames=panel.frames, **vars(how)) for panel in panels]
    for row in zip(*films, strict=True):
        yield list(row)


def make_video(
    panels: Sequence[Panel],
    clock: Clock,
    path: Path,
    how: Drawing = Drawing(),
    drawn: Callable[[], object] = lambda: None,
) -> None:
    """Draw the panels side by side and write an MP4; `drawn` is called after each picture.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """

    def composed() -> Iterator[Pixels]:
        for time, row in zip(clock.times, rows_of_pictures(panels, how), strict=True):
            yield tile(_labelled(row, panels, time) if len(panels) > 1 else row, columns_for(len(panels)))
            drawn()

    write_mp4(encode(composed(), clock.fps), path)


def make_strip(panels: Sequence[Panel], clock: Clock, path: Path, how: Drawing = Drawing()) -> None:
    """Write moments side by side as PNG, each panel in a row of its own; see `choose_frames`.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    search = panels[0].replay.state.contact
    first = None if search is None or not search.contacts else search.push or search.contacts[0]
    contact = None
    if first is not None:  # its place among the moments that are shown
        contact = float(np.argmin(np.abs(np.array(clock.times) - first.frame / panels[0].replay.fps)))
    chosen = choose_frames(len(clock.times), STRIP_PICTURES, contact)
    fewer = [
        replace(panel, frames=[panel.frames[i] for i in chosen], cameras=[panel.cameras[i] for i in chosen])
        for panel in panels
    ]
    columns = [[shrink(picture, STRIP_HEIGHT) for picture in row] for row in rows_of_pictures(fewer, how)]
    columns[0] = [write_on(picture, panel.label) for picture, panel in zip(columns[0], panels, strict=True)]
    for index, column in zip(chosen, columns, strict=True):
        column[0] = write_on(column[0], f"{clock.times[index]:.2f} s", bottom=True)
    write_png(tile([picture for row in zip(*columns, strict=True) for picture in row], len(columns)), path)


def _labelled(row: Sequence[Pixels], panels: Sequence[Panel], time: float) -> list[Pixels]:
    words = [write_on(picture, panel.label) for picture, panel in zip(row, panels, strict=True)]
    return [write_on(words[0], f"{time:.2f} s", bottom=True), *words[1:]]


def labels_of(runs: Sequence[Run], paths: Sequence[Path]) -> list[str]:
    """What tells the runs apart: their variants, or, where these are not all different, what differs in the paths."""
    variants = [run.plan.variant for run in runs]
    if len(set(variants)) == len(variants):
        return variants
    parts = [path.absolute().parts for path in paths]
    shared = set.intersection(*map(set, parts))
    return ["/".join(part for part in each if part not in shared) or each[-1] for each in parts]


def load(path: Path, device: str, *, relight: bool = False) -> tuple[Run, Replay]:
    """The run of a record, and what it shows.

    Raises:
        InputError: as `hoi.record.read`, or it has nothing to show.
    """
    run = record.read(path)
    with about(path):
        return run, replay(run, device, relight=relight)
