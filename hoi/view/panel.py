"""What stands beside the picture: play, scrub and speed, the switches, loss curves, plans, facts."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from hoi.data import Run
from hoi.view.clock import Clock, Player
from hoi.view.nodes import SWITCHES, Shown
from hoi.view.words import Curves, curves_of, facts_markdown, plain, plan_markdown

SPEEDS = {f"{speed:g} x": speed for speed in (0.1, 0.25, 0.5, 1.0, 2.0)}
COLOURS = ("#1f6fb4", "#d6492a", "#3a9a4a", "#8a55b8", "#c08a1e", "#4aa8a8", "#b0457f", "#6b6b6b")
"""Of the curves, again from the start where there are more."""


class Panel:
    """Play, scrub, speed and switches. What they change is `shown` and the player; then `draw(frame)` is called."""

    def __init__(
        self, gui: viser.GuiApi, clock: Clock, player: Player, shown: Shown, draw: Callable[[int], None]
    ) -> None:
        self._clock, self._player = clock, player
        self._button = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._slider = gui.add_slider("frame", 0, max(clock.frames - 1, 1), 1, 0)
        self._time = gui.add_markdown("")
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
        self.at(0)
        self._button.on_click(lambda _: self.toggle())
        gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: self.toggle())
        self._slider.on_update(lambda event: self._scrub(event, draw))
        self._speed.on_update(lambda _: player.set_speed(SPEEDS[self._speed.value]))
        self.switches = {name: self._switch(gui, name, shown, draw) for name in SWITCHES}
        self._opacity = gui.add_slider("opacity", 0.1, 1.0, 0.05, shown.opacity)

        @self._opacity.on_update
        def _(_: Any) -> None:
            shown.opacity = float(self._opacity.value)
            draw(self.frame)

    @property
    def frame(self) -> int:
        """Of the clock, where the slider stands."""
        return min(int(self._slider.value), self._clock.frames - 1)

    def at(self, frame: int) -> None:
        """Show which frame is seen."""
        self._slider.value = frame
        self._time.content = f"{frame / self._clock.fps:.2f} s of {(self._clock.frames - 1) / self._clock.fps:.2f} s"

    def toggle(self) -> None:
        """Play or pause."""
        if self._player.playing:
            self._player.pause()
        else:
            self._player.seek(self.frame)
            self._player.play()
        playing = self._player.playing
        self._button.label = "Pause" if playing else "Play"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _scrub(self, event: viser.GuiEvent, draw: Callable[[int], None]) -> None:
        if event.client_id is None:  # moved by the player
            return
        if self._player.playing:
            self.toggle()
        self._player.seek(self.frame)
        draw(self.frame)

    def _switch(self, gui: viser.GuiApi, name: str, shown: Shown, draw: Callable[[int], None]) -> Any:
        box = gui.add_checkbox(name, getattr(shown, name))

        @box.on_update
        def _(_: Any) -> None:
            setattr(shown, name, bool(box.value))
            draw(self.frame)

        return box


def add_tabs(gui: viser.GuiApi, runs: Sequence[Run], labels: Sequence[str]) -> viser.GuiTabGroupHandle:
    """Losses, plans and facts of the runs."""
    tabs = gui.add_tab_group()
    curves = curves_of(runs, labels)
    if curves:
        with tabs.add_tab("losses"):
            for each in curves:
                _chart(gui, each)
    for title, words in (("plan", plan_markdown), ("record", facts_markdown)):
        with tabs.add_tab(title):
            for run, label in zip(runs, labels, strict=True):
                if len(runs) > 1:
                    gui.add_markdown(f"### {plain(label)}")
                gui.add_markdown(words(run))
    return tabs


def _chart(gui: viser.GuiApi, curves: Curves) -> None:
    lines = [
        {"label": name, "stroke": COLOURS[number % len(COLOURS)], "width": 1.5}
        for number, name in enumerate(curves.losses)
    ]
    values = tuple(np.log10(each) if curves.logarithmic else each for each in curves.losses.values())
    gui.add_uplot(  # its own logarithmic axis writes all that is below 0.001 as 0
        (curves.iterations, *values),
        ({"label": "iteration"}, *lines),  # pyright: ignore[reportArgumentType]
        title=f"{curves.title}, log10" if curves.logarithmic else curves.title,
        scales={"x": {"time": False}},
        height=220,
    )
