"""Limb and object around their contact: who may touch, where the object's surface is, how well they meet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.body.skinning import posed_means
from hoi.data import Array, Body, Motion, ObjectTrajectory, Scene
from hoi.refine.fidelity import Fidelity, instants, measure, signed_distances, surfaces_near
from hoi.refine.surface import Surface
from hoi.refine.window import Window

NEAR = 0.1
"""Gaussians of the limb that stay farther from the object's box than this are not looked at [m]."""


@dataclass(frozen=True)
class Meeting:
    """Made by `meet`."""

    body: Body
    motion: Motion
    """From before stage 3."""
    window: Window
    frames: Array
    """The instants at which limb and object are compared: in the window, t_c among them, fractional, (F,)."""
    surfaces: tuple[Surface, ...]
    """The object's at each of them."""
    rows: NDArray[np.integer]
    """The limb's Gaussians that come near the object, (M,)."""
    striking: NDArray[np.bool_]
    """Which of them belong to the striking joint, (M,)."""

    @property
    def at_contact(self) -> int:
        """Which of `frames` is t_c."""
        return int(np.abs(self.frames - self.window.t_c).argmin())

    def signed_distances(self, motion: Motion) -> Array:
        """Of the limb of a motion to the object [m], (F, M)."""
        skin = posed_means(self.body, motion, frames=self.frames, subset=self.rows)
        return signed_distances(self.surfaces, skin)

    def fidelity(self, motion: Motion, distance: float) -> Fidelity:
        """How well the limb of a motion meets the object, with d_contact = `distance` [m]."""
        return measure(self.signed_distances(motion), self.striking, self.at_contact, distance)


def meet(scene: Scene, motion: Motion, trajectory: ObjectTrajectory, window: Window) -> Meeting | None:
    """Prepare the meeting in a window; None where limb and object stay apart."""
    body, thing = scene.body, scene.thing
    dominant = body.dominant_joints
    limb = np.flatnonzero(np.isin(dominant, window.limb))
    frames = instants(window.frames[0], window.frames[-1], [window.t_c])
    skin = posed_means(body, motion, frames=frames, subset=limb)
    surface = trajectory.positions[list(window.frames), : len(thing.cloud)]
    low, high = surface.min(axis=(0, 1)) - NEAR, surface.max(axis=(0, 1)) + NEAR
    near = np.all((skin >= low) & (skin <= high), axis=-1).any(axis=0)
    rows = limb[near]
    if not np.any(dominant[rows] == window.joint):
        return None
    box = skin[:, near].min(axis=(0, 1)), skin[:, near].max(axis=(0, 1))
    surfaces = surfaces_near(thing, trajectory, window.push, scene.fps, frames, box)
    return Meeting(body, motion, window, frames, surfaces, rows, dominant[rows] == window.joint)
