"""The clip that a prior of silhouettes sees: the contact itself, at instants around t_c, edge on.

A contact lies between frames, and a limb is deepest between others: frames alone show neither. So the instants are
evenly spread over the window, or over less of it, with t_c in the middle, theta as it goes between frames. The object
is its section through the contact (`hoi.refine.silhouettes.section`).
"""

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from hoi.body.interpolate import interpolate_pose
from hoi.data import Array, Motion, ObjectTrajectory, Scene, State
from hoi.refine.clip import moved_by, subset
from hoi.refine.fidelity import surfaces_near
from hoi.refine.silhouettes import coverage, section
from hoi.refine.surface import Surface
from hoi.refine.views import Framing
from hoi.refine.window import Window
from hoi.render.cameras import Camera
from hoi.render.replay import Replay, person_tensors, posed

FLAT = 0.5
"""An object of which more than this share is too thin to have an inside has no section: it is shown as a whole."""
TEMPOS = (1.0, 0.5)
"""Shares of the window that clips show: a fast limb is in and out again within a tenth of it."""
SHORTEST = 0.5
"""Half of a window as it is shown at least [frames]."""


class ContactClip:
    """Of a scene's contact, from any viewpoint."""

    changing = slice(None)
    """Places in the clip that follow theta: all."""

    def __init__(
        self,
        scene: Scene,
        motion: Motion,
        trajectory: ObjectTrajectory,
        window: Window,
        count: int,
        contact: Framing,
        device: torch.device | str = "cpu",
        tempo: float = 1.0,
    ) -> None:
        """
        Args:
            count: instants in the clip.
            contact: what a picture shows.
            tempo: share of the window that it shows.
        """
        self._scene, self._state, self._window, self._contact = scene, State(motion, trajectory), window, contact
        half = tempo * max(window.half_width, SHORTEST)
        self.instants = (window.t_c + np.linspace(-half, half, count)).clip(0, len(motion) - 1)
        """[frame], (F,)."""
        self._first = max(int(self.instants[0]) - 1, 0)  # how a motion goes between frames depends on their neighbours
        span = slice(self._first, int(self.instants[-1]) + 3)
        self._translation, self._orientation, self._before = (
            torch.tensor(array[span], dtype=torch.float32, device=device)
            for array in (motion.translation, motion.orientation, motion.body_pose)
        )
        within = [
            row for row, frame in enumerate(window.frames) if self._first <= frame < self._first + len(self._before)
        ]
        self._rows = torch.tensor(within, device=device)
        self._places = torch.tensor([window.frames[row] - self._first for row in within], device=device)
        moved = moved_by(scene.body, window.moving)
        self._limb, self._rest = (
            person_tensors(subset(scene.body, np.flatnonzero(rows)), device=device) for rows in (moved, ~moved)
        )
        self._device = device
        self._kept: dict[Camera, list[Tensor]] = {}

    def render(self, camera: Camera, body_pose: Tensor) -> Tensor:
        """Silhouettes of limb, rest of the person and object in [0, 1], (F, 3, height, width), differentiable in theta.

        Args:
            body_pose: theta of the window's frames, (W, 23, 3) [rad].
        """
        theta = self._before.index_put((self._places,), body_pose[self._rows].to(self._before))
        limbs = posed(self._limb, *self._at_instants(theta))
        if camera not in self._kept:
            self._kept[camera] = self._still(camera)
        shown = zip(limbs, self._kept[camera], strict=True)
        return torch.stack([torch.cat([coverage(limb, camera)[None], still]) for limb, still in shown]).clamp(0, 1)

    def _at_instants(self, theta: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return interpolate_pose(self._translation, self._orientation, theta, self.instants - self._first)

    @torch.no_grad()
    def _still(self, camera: Camera) -> list[Tensor]:
        """What theta does not change at each instant: rest and object, (2, height, width)."""
        others = posed(self._rest, *self._at_instants(self._before))
        things = [
            self._whole(instant, camera)
            if surface is None
            else section(surface, self._contact.centre, camera).to(self._device)
            for instant, surface in zip(self.instants, self._surfaces, strict=True)
        ]
        return [torch.stack([coverage(rest, camera), thing]) for rest, thing in zip(others, things, strict=True)]

    def _whole(self, instant: float, camera: Camera) -> Tensor:
        """The outline of an object that has no section, in the nearest frame."""
        return coverage(Replay(self._scene, self._state, self._device).parts(round(instant))[1], camera)

    @cached_property
    def _surfaces(self) -> list[Surface | None]:
        """The object's around the contact at each instant; None where it has no inside."""
        centre, reach = self._contact.centre, 1.5 * self._contact.radius  # a picture's corners
        near: tuple[Array, Array] = (centre - reach, centre + reach)
        trajectory, push = self._state.trajectory, self._window.push
        assert trajectory is not None
        found = surfaces_near(self._scene.thing, trajectory, push, self._scene.fps, self.instants, near)
        return [surface if surface.thin.mean() <= FLAT else None for surface in found]
