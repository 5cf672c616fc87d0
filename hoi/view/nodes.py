"""One run as nodes of viser's scene. The only thing that changes from frame to frame is what is switched on."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, Plane
from hoi.render.marks import (
    Marks,
    bones,
    impulse_arrow,
    is_level,
    normal_arrow,
    plane_axes,
    trail,
    trail_colours,
)
from hoi.view.moments import UNIT, Moments, Packed, faded

BONE, NORMAL, IMPULSE = (38, 115, 217), (214, 39, 60), (240, 140, 20)
LINE, SECTION = (214, 214, 212), (178, 178, 176)
WALL_SIZE = 4.0
"""Side of the square that stands for a wall [m]."""
FADE = 40.0
"""Where the lines of the floor end [m]."""
AT_REST = 0.05
"""Speed below which none is written [m/s]."""


@dataclass
class Shown:
    """What is switched on."""

    person: bool = True
    object: bool = True
    skeleton: bool = False
    contact: bool = True
    trail: bool = True
    particles: bool = False
    ground: bool = True
    opacity: float = 1.0
    """Of all Gaussians, times their own."""


SWITCHES = tuple(field.name for field in fields(Shown) if field.name != "opacity")


class RunNodes:
    """A run at its place among others."""

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        moments: Moments,
        marks: Marks,
        offset: Array,
        label: str,
        largest: float,
    ) -> None:
        """
        Args:
            offset: where the run's origin is shown [m], (3,).
            label: written above the person; none where empty.
            largest: impulse of all runs that are seen together [N s].
        """
        self.marks, self._moments = marks, moments
        assert moments.run.scene is not None  # checked by `hoi.render.replay.replay`
        thing = moments.run.scene.object
        self._above = 0.0 if thing is None else 0.6 * thing.size  # where the speed is written [m]
        root = f"/{name}"
        self._root = scene.add_frame(root, show_axes=False, position=np.asarray(offset))
        first = moments.at(0)
        self._splats = {part: _splats(scene, f"{root}/{part}", packed) for part, packed in first.items()}
        self._skeleton = self._trail = self._speed = self._particles = None
        if marks.joints is not None:
            self._skeleton = scene.add_line_segments(
                f"{root}/skeleton", bones(marks.joints[0]), BONE, thickness=4, thickness_units="screen", visible=False
            )
        if marks.com is not None and marks.speed is not None and len(marks.com) > 1:
            ends, colours = trail(marks.com, 0), trail_colours(marks.speed)
            self._trail = scene.add_line_segments(f"{root}/trail", ends, colours, thickness=3, thickness_units="screen")
            self._speed = scene.add_label(f"{root}/speed", "", anchor="bottom-left", font_screen_scale=0.9)
        if marks.particles is not None and marks.particle_colours is not None:
            self._particles = scene.add_point_cloud(
                f"{root}/particles",
                marks.particles[0],
                marks.particle_colours,
                point_size=0.006,
                point_shape="circle",
                precision="float32",
                visible=False,
            )
        self._contacts = [
            (contact.frame, _contact_nodes(scene, f"{root}/contact/{number}", contact, largest))
            for number, contact in enumerate(marks.contacts)
        ]
        self._planes = [_plane(scene, f"{root}/ground/{number}", plane) for number, plane in enumerate(marks.planes)]
        if label:
            scene.add_label(f"{root}/label", label, position=_above(marks), anchor="bottom-center")

    def remove(self) -> None:
        """Take the run out of the scene."""
        self._root.remove()

    def show(self, frame: int, shown: Shown) -> None:
        """Draw a frame of the run."""
        for part, packed in self._moments.at(frame).items():
            visible = getattr(shown, part)
            if visible:
                self._splats[part].buffer = faded(packed, shown.opacity)
            self._splats[part].visible = visible
        if self._skeleton is not None and self.marks.joints is not None:
            if shown.skeleton:
                self._skeleton.points = bones(self.marks.joints[frame]).astype(np.float32)
            self._skeleton.visible = shown.skeleton
        if self._particles is not None and self.marks.particles is not None:
            if shown.particles:
                self._particles.points = self.marks.particles[frame].astype(np.float32)
            self._particles.visible = shown.particles
        self._show_trail(frame, shown.trail)
        for at, nodes in self._contacts:
            for node in nodes:
                node.visible = shown.contact and at <= frame
        for plane in self._planes:
            plane.visible = shown.ground

    def _show_trail(self, frame: int, visible: bool) -> None:
        if self._trail is None or self._speed is None or self.marks.com is None or self.marks.speed is None:
            return
        if visible:
            self._trail.points = trail(self.marks.com, frame)
            self._speed.position = self.marks.com[frame] + (0, 0, self._above)
            self._speed.text = f"{self.marks.speed[frame]:.1f} m/s"
        self._trail.visible = visible
        self._speed.visible = visible and bool(self.marks.speed[frame] >= AT_REST)


def _splats(scene: viser.SceneApi, name: str, packed: Packed) -> viser.GaussianSplatHandle:
    nothing = np.zeros((1, 3))
    handle = scene.add_gaussian_splats(name, nothing, np.zeros((1, 3, 3)), nothing, np.zeros((1, 1)), scale=UNIT)
    handle.buffer = packed
    return handle


def _contact_nodes(scene: viser.SceneApi, name: str, contact: Any, largest: float) -> list[Any]:
    """The normal, and the impulse where one was given."""

    def arrow(part: str, ends: NDArray[Any], colour: tuple[int, int, int]) -> Any:
        return scene.add_arrows(
            f"{name}/{part}",
            ends[None].astype(np.float32),
            colour,
            shaft_radius=0.008,
            head_radius=0.022,
            head_length=0.06,
            visible=False,
        )

    nodes = [arrow("normal", normal_arrow(contact), NORMAL)]
    strength = float(np.linalg.norm(contact.impulse))
    if strength > 0:
        ends = impulse_arrow(contact, largest)
        nodes.append(arrow("impulse", ends, IMPULSE))
        text = f"{strength:.0f} N s" if strength >= 10 else f"{strength:.2g} N s"
        nodes.append(scene.add_label(f"{name}/strength", text, position=ends[1], visible=False, font_screen_scale=0.9))
    return nodes


def _plane(scene: viser.SceneApi, name: str, plane: Plane) -> Any:
    """The floor as far as one sees, a wall as a square."""
    x, y, z, w = Rotation.from_matrix(plane_axes(plane.normal)).as_quat()
    level = is_level(plane)
    return scene.add_grid(
        name,
        width=WALL_SIZE,
        height=WALL_SIZE,
        infinite_grid=level,
        cell_size=1.0 if level else 0.5,
        section_size=5.0 if level else 1.0,
        cell_color=LINE,
        section_color=SECTION,
        fade_distance=FADE,
        plane_opacity=0.0 if level else 0.25,
        plane_color=(235, 235, 232),
        wxyz=(w, x, y, z),
        position=np.asarray(plane.point),
    )


def _above(marks: Marks) -> Array:
    """A hand above the head, or above the object where there is nobody."""
    if marks.joints is not None:
        return marks.joints[0, 15] + (0, 0, 0.4)
    assert marks.com is not None  # a run shows a person, an object or both
    return marks.com[0] + (0, 0, 0.5)
