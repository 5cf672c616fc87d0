"""The viewer with controls of the scene: sentence, object, material, seed, pull, and where the object stands."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import viser

from hoi.data import Run
from hoi.errors import InputError, RunError
from hoi.files import CONF
from hoi.live.rehearsal import OWN, Rehearsal, first_wish
from hoi.plan import format_plan, make_plan
from hoi.record import write
from hoi.reports import Bar, no_bar
from hoi.runner.jobs import rehearse, viewing_points
from hoi.runner.shelf import Shelf
from hoi.view.moments import Moments
from hoi.view.viewer import Viewer
from hoi.view.words import plain

MOST_PULL = 4.0
"""Of lambda_attr, on its slider [-]."""
HANDLE = 0.4
"""Size of what the object is moved by [m]."""


class Studio:
    """A scene in the browser, made anew whenever its controls change. `stop` ends it.

    Args:
        base: overrides, as of `python -m hoi.run`.
        folder: where runs are recorded.
        bar: shows how the first run goes on, before there is anything to look at.

    Raises:
        InputError: an override that is not allowed, or the port is taken.
        RunError: the first run cannot go on.
    """

    def __init__(
        self, base: Sequence[str], folder: Path, host: str = "127.0.0.1", port: int = 8080, bar: Bar = no_bar
    ) -> None:
        self._folder, self.wish = folder, first_wish(base)
        config, shelf = self.wish.config(base), Shelf()
        self._human_points = config.human_points
        self.run: Run = next(rehearse(config, make_plan(config), bar, shelf, [*base, *self.wish.choices()]))
        self.rehearsal = Rehearsal(base, shelf, self._seen, self._say)
        self.viewer = Viewer([Moments(self.run)], [""], host, port, controls=self._add_controls)
        self.rehearsal.want(self.wish)

    def stop(self) -> None:
        """End the rehearsal and the server."""
        self.rehearsal.stop()
        self.viewer.stop()

    def record(self) -> Path | None:
        """Write what is seen as a record, where it is finished; the file."""
        run = self.run
        if run.result["status"] != "done" or run.scene is None:
            self._say("not yet: the object's answer is on its way")
            return None
        numbers = (int(path.name) for path in self._folder.glob("[0-9]*") if path.name.isdecimal())
        path = self._folder / f"{max(numbers, default=0) + 1:03d}" / "run.mcap"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            points = viewing_points(run.scene, run.state, self._human_points)
            write(run, path, *points, plan_text=format_plan(run.plan))
        except (InputError, RunError, OSError) as error:
            self._say(str(error))
            return None
        self._say(f"recorded {path}")
        return path

    def _record(self) -> None:
        self.record()

    def _add_controls(self, server: viser.ViserServer) -> None:
        gui, wish = server.gui, self.wish
        self.controls: dict[str, Any] = {
            "sentence": gui.add_text("sentence", wish.sentence, multiline=True),
            "object": gui.add_dropdown("object", _named("object", wish.object), initial_value=wish.object),
            "material": gui.add_dropdown("material", (OWN, *_named("material")), initial_value=wish.material),
            "seed": gui.add_number("seed", wish.seed, min=0, step=1),
        }
        if wish.pull is not None:
            most = max(MOST_PULL, wish.pull)
            self.controls["pull"] = gui.add_slider("pull", 0.0, most, 0.1, wish.pull, hint="lambda_attr")
        for name, control in self.controls.items():
            control.on_update(lambda _, name=name, control=control: self._change(**{name: control.value}))
        self._status = gui.add_markdown("")
        gui.add_button("Record", icon=viser.Icon.DEVICE_FLOPPY).on_click(lambda _: self._record())
        gui.add_divider()
        self.place = server.scene.add_transform_controls(
            "/place", HANDLE, active_axes=(True, True, False), disable_rotations=True, depth_test=False,
            position=(*wish.place, 0.0),
        )  # fmt: skip
        self.place.on_update(
            lambda _: self._change(place=(float(self.place.position[0]), float(self.place.position[1])))
        )

    def _change(self, **changes: Any) -> None:
        self.wish = replace(self.wish, **changes)
        self.rehearsal.want(self.wish)

    def _seen(self, run: Run) -> None:
        self.run = run
        self.viewer.show([Moments(run)], [""])

    def _say(self, text: str) -> None:
        self._status.content = plain(text)


def _named(group: str, *more: str) -> tuple[str, ...]:
    """What `conf/` has to choose from; a file of one's own only where the command line names it."""
    found = {file.stem for file in (CONF / group).glob("*.yaml")} - {"from_file"}
    return tuple(sorted(found | set(more)))
