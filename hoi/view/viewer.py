"""The viewer: a server for the browser, runs side by side, and their clock."""

import contextlib
import io
import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import viser

from hoi.data import Array
from hoi.errors import InputError
from hoi.render.cameras import FOV_Y, VIEWS, frame_action
from hoi.render.marks import largest_impulse, marks_of
from hoi.view.clock import Player, common_clock
from hoi.view.moments import Moments, load, single_threaded
from hoi.view.nodes import RunNodes, Shown
from hoi.view.panel import Panel, add_tabs

ALONE, TOGETHER = VIEWS["three_quarter"], (0.35, 0.88, 0.32)
"""Where the first camera stands, seen from the action: one run as in its video; several in front of them."""
WINDOW, PANEL = (1280, 760), 340
"""The browser's picture, and the width of what covers its right side [pixel], which the first view is made for."""
MARGIN = 1.0
"""Between people side by side, at least [m]."""


class Viewer:
    """Runs in the browser, side by side. `show` puts others in their place, `stop` ends it."""

    def __init__(
        self, all_moments: Sequence[Moments], labels: Sequence[str], host: str = "127.0.0.1", port: int = 8080,
        playing: bool = True, controls: Callable[[viser.ViserServer], None] | None = None,
    ) -> None:  # fmt: skip
        """Listens.

        Args:
            all_moments: at least one run.
            labels: one a run, written above it where there are several.
            port: 0 takes any that is free.
            controls: puts more of them above those of the viewer.

        Raises:
            InputError: the port is taken.
        """
        single_threaded()
        _check_port(host, port)
        self.clock = common_clock([moments.replay for moments in all_moments])
        self.shown, self._drawing, self._ended = Shown(), threading.RLock(), threading.Event()
        with contextlib.redirect_stdout(io.StringIO()):  # viser's banner
            names = dict.fromkeys(moments.run.scene.name for moments in all_moments if moments.run.scene)
            self.server = viser.ViserServer(host, port, label=" · ".join(names), verbose=False)
        self.port = self.server.get_port()
        self.server.scene.configure_default_lights(cast_shadow=False)
        self._place_camera(all_moments)
        self.player = Player(self.clock, self.draw)
        gui = self.server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        if controls is not None:
            controls(self.server)
        self.nodes: list[RunNodes] = []
        self._tabs: viser.GuiTabGroupHandle | None = None
        self._preparing: threading.Thread | None = None
        self.panel = Panel(gui, self.clock, self.player, self.shown, self.draw)
        self.show(all_moments, labels)
        self.player.start()
        if playing and self.clock.frames > 1:
            self.panel.toggle()

    def show(self, all_moments: Sequence[Moments], labels: Sequence[str]) -> None:
        """These runs in place of the ones that are seen; they last as long."""
        with self._drawing, self.server.atomic():
            for nodes in self.nodes:
                nodes.remove()
            if self._tabs is not None:
                self._tabs.remove()
            runs = [moments.run for moments in all_moments]
            marks = [marks_of(run) for run in runs]
            largest = largest_impulse(tuple(contact for each in marks for contact in each.contacts))
            offsets = _offsets(all_moments)
            self._all = all_moments
            self.nodes = [
                RunNodes(self.server.scene, f"run{number}", moments, mark, offset, label, largest)
                for number, (moments, mark, offset, label) in enumerate(
                    zip(all_moments, marks, offsets, labels if len(runs) > 1 else [""], strict=True)
                )
            ]
            self._tabs = add_tabs(self.server.gui, runs, labels)
            self.draw(self.panel.frame)
        self._preparing = threading.Thread(target=self._prepare, args=[all_moments], daemon=True, name="prepare")
        self._preparing.start()

    def draw(self, frame: int) -> None:
        """Show a frame of the clock in all runs at once."""
        with self._drawing, self.server.atomic():
            self.panel.at(frame)
            for moments, nodes in zip(self._all, self.nodes, strict=True):
                nodes.show(self.clock.frame_of(moments.replay, frame), self.shown)

    def stop(self) -> None:
        """End the player and the server."""
        self._ended.set()
        self.player.stop()
        if self._preparing is not None:
            self._preparing.join()  # torch may not be at work when Python ends
        with contextlib.redirect_stdout(io.StringIO()):  # viser's good-bye
            self.server.stop()

    def _prepare(self, all_moments: Sequence[Moments]) -> None:
        """Work out the frames before they are played, so far as there is room for them and they are seen."""
        for moments in all_moments:
            for frame in range(moments.replay.frames):
                if self._ended.is_set() or self._all is not all_moments or not moments.prepare(frame):
                    break

    def _place_camera(self, all_moments: Sequence[Moments]) -> None:
        offsets = _offsets(all_moments)
        points = [moments.replay.action().points() for moments in all_moments]
        seen = np.concatenate([each + offset for each, offset in zip(points, offsets, strict=True)])
        (width, height), direction = WINDOW, ALONE if len(offsets) == 1 else TOGETHER
        camera = frame_action(seen, direction, width=width - PANEL, height=height)
        distance = float(((seen - camera.position) @ camera.forward).mean())
        eye = camera.position + distance * PANEL / 2 / camera.fx * camera.world_to_camera[0, :3]
        start = self.server.initial_camera
        start.fov = FOV_Y
        start.position = tuple(eye)
        start.look_at = tuple(eye + distance * camera.forward)


def of_records(paths: Sequence[Path], host: str = "127.0.0.1", port: int = 8080, playing: bool = True) -> Viewer:
    """A viewer of finished runs.

    Raises:
        InputError: as `hoi.view.moments.load`, or the port is taken.
    """
    single_threaded()
    _check_port(host, port)  # before the records are read
    all_moments = load(paths)
    return Viewer(all_moments, _labels(all_moments, paths), host, port, playing)


def _check_port(host: str, port: int) -> None:
    """viser would quietly take another one.

    Raises:
        InputError: it is taken, or may not be used.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise InputError(
                f"--port {port}: cannot listen on {host} ({error.strerror}); give another, or 0 for any"
            ) from None


def _labels(all_moments: Sequence[Moments], paths: Sequence[Path]) -> list[str]:
    if len(paths) == 1:
        return [all_moments[0].run.plan.variant]
    from hoi.render.panels import labels_of

    return labels_of([moments.run for moments in all_moments], paths)


def _offsets(all_moments: Sequence[Moments]) -> list[Array]:
    """From left to right, seen from in front, in whole metres so that the grids of the floors agree; (3,) each."""
    actions = [moments.replay.action() for moments in all_moments]
    extents = [(each.person if each.person.shape[1] else each.thing)[..., 0] for each in actions]
    step = np.ceil(max(float(x.max()) for x in extents) - min(float(x.min()) for x in extents) + MARGIN)
    middle = np.round((len(all_moments) - 1) / 2)
    return [np.array([(middle - number) * step, 0.0, 0.0]) for number in range(len(all_moments))]
