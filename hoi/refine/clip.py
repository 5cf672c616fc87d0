"""The clip that the video prior sees of a scene: rendered frames, those of the window differentiable in theta.

What does not change is drawn once a viewpoint. No depth, and no gradient to what is not theta: colours, opacities and
the object are constants. A prior of silhouettes sees another, `hoi.refine.contact_clip`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hoi.body.skeleton import JOINT_COUNT, PARENTS
from hoi.body.skinning import joint_paths
from hoi.data import Body, Motion, ObjectTrajectory, Scene, State, fields_of
from hoi.gaussians import select
from hoi.refine.views import Framing, background, edge_on, ring
from hoi.refine.window import Window
from hoi.render import cameras
from hoi.render.cameras import Camera
from hoi.render.film import has_floor
from hoi.render.light import lit, lit_parts
from hoi.render.rasterise import rasterise, render_frames
from hoi.render.replay import Replay, person_tensors, posed
from hoi.render.splats import Splats, join

CACHE = 2**29
"""Bytes of pictures that are kept; those of further viewpoints are drawn whenever they are wanted."""


class Clip:
    """A scene's clip around a window, from any viewpoint."""

    def __init__(
        self,
        scene: Scene,
        motion: Motion,
        trajectory: ObjectTrajectory,
        window: Window,
        frames: Sequence[int],
        device: torch.device | str = "cpu",
    ) -> None:
        """
        Args:
            frames: scene frames of the clip, in order; those of the window stand side by side.
        """
        self.window = window
        self.frames = tuple(frames)
        places = [place for place, frame in enumerate(frames) if frame in window.frames]
        self.changing = slice(places[0], places[-1] + 1)
        """Places in the clip of the window's frames."""
        self._shown = Replay(scene, State(motion, trajectory), device)
        self._device, self._floor = device, has_floor(scene)
        rows = np.array(window.frames)
        self._translation, self._orientation, before = (
            torch.tensor(array[rows], dtype=torch.float32, device=device)
            for array in (motion.translation, motion.orientation, motion.body_pose)
        )
        moved = moved_by(scene.body, window.moving)
        self._limb = person_tensors(subset(scene.body, np.flatnonzero(moved)), device=device)
        rest = person_tensors(subset(scene.body, np.flatnonzero(~moved)), device=device)
        with torch.no_grad():
            things = [self._shown.parts(frame)[1] for frame in window.frames]
            others = posed(rest, self._translation, self._orientation, before)
        self._still = [lit_parts(pair) for pair in zip(others, things, strict=True)]
        self._kept: dict[Camera, tuple[Tensor, dict[int, Tensor]]] = {}
        self._room = CACHE

    def action(self) -> np.ndarray:
        """What a camera of the whole action has to show [m], (N, 3)."""
        return self._shown.action().points(sorted(set(self.frames)))

    def render(self, camera: Camera, body_pose: Tensor) -> Tensor:
        """RGB in [0, 1], (F, 3, height, width), differentiable in theta.

        Args:
            body_pose: theta of the window's frames, (W, 23, 3) [rad].

        Raises:
            InputError: as `hoi.render.rasterise.rasterise`.
        """
        behind, pictures = self._constant(camera)
        limbs = posed(self._limb, self._translation, self._orientation, body_pose)
        changed = {}
        for frame, limb, still in zip(self.window.frames, limbs, self._still, strict=True):
            changed[frame] = rasterise(join([lit(limb), *still]), camera, behind).colour.movedim(-1, 0)
        clip = torch.stack([changed[frame] if frame in changed else pictures[frame] for frame in self.frames])
        return clip.clamp(0, 1)

    def _constant(self, camera: Camera) -> tuple[Tensor, dict[int, Tensor]]:
        """What theta does not change, drawn once: the background, and the pictures of the other frames."""
        if camera in self._kept:
            return self._kept[camera]
        found = self._still_pictures(camera)
        size = sum(each.element_size() * each.numel() for each in (found[0], *found[1].values()))
        if size <= self._room:
            self._room -= size
            self._kept[camera] = found
        return found

    def _still_pictures(self, camera: Camera) -> tuple[Tensor, dict[int, Tensor]]:
        """The background (height, width, 3), and the pictures (3, height, width) of the frames outside the window."""
        behind = background(camera, floor=self._floor, device=self._device)
        outside = sorted(set(self.frames) - set(self.window.frames))
        drawn = render_frames((lit_parts(self._shown.parts(frame)) for frame in outside), camera, behind)
        return behind, {frame: picture.colour.movedim(-1, 0) for frame, picture in zip(outside, drawn, strict=True)}


def viewpoints(
    clip: Clip | None,
    contact: Framing | None,
    normal: np.ndarray | None,
    count: int,
    elevation: float,
    distance: float | None,
    size: tuple[int, int],
) -> list[Camera]:
    """The ring of cameras (paper, Rendering and Sampling): around a contact, or where None around the whole action.

    Args:
        clip: of whose action; None where there is a contact.
        normal: of the surface that is touched, (3,); where there is one, the cameras look along that surface.
        size: (height, width) of the pictures [pixel].

    Raises:
        InputError: as `hoi.refine.views.ring`, `edge_on` there and `hoi.render.cameras.circle`.
    """
    height, width = size
    if contact is not None and normal is not None:
        return edge_on(contact, normal, count, elevation, width=width, height=height, distance=distance)
    if contact is not None:
        return ring(contact, count, elevation, width=width, height=height, distance=distance)
    assert clip is not None
    points = clip.action()
    if distance is None:
        return cameras.circle(points, count, elevation, width=width, height=height)
    centre = (points.min(0) + points.max(0)) / 2
    around = Framing(centre, float(np.linalg.norm(points - centre, axis=1).max()))
    return ring(around, count, elevation, width=width, height=height, distance=distance)


def contact_framing(
    scene: Scene, motion: Motion, trajectory: ObjectTrajectory, window: Window, radius: float
) -> Framing:
    """A framing of the point of contact, or where none was found of the object's Gaussian nearest to j_c at t_c."""
    if window.push is not None:
        return Framing(np.asarray(window.push.point, np.float64), radius)
    frame = min(window.frames, key=lambda frame: abs(frame - window.t_c))
    joint = joint_paths(scene.body, motion, [frame])[0, window.joint]
    surface = trajectory.positions[frame, : len(scene.thing.cloud)]
    nearest = np.linalg.norm(surface - joint, axis=1).argmin()
    return Framing(surface[nearest].astype(np.float64), radius)


def moved_by(body: Body, joints: Sequence[int]) -> np.ndarray:
    """Which of a body's Gaussians the turns of some joints move, (N,)."""
    below = np.zeros(JOINT_COUNT, dtype=bool)
    for joint in range(JOINT_COUNT):  # parents come first
        below[joint] = joint in joints or (PARENTS[joint] >= 0 and below[PARENTS[joint]])
    moved = body.skinning_weights[:, below].max(axis=1) > 0
    if body.pose_directions is not None:
        columns = body.pose_directions.reshape(len(body.cloud), 3, JOINT_COUNT - 1, 9)[:, :, np.array(joints) - 1]
        moved |= np.abs(columns).max(axis=(1, 2, 3)) > 0
    return np.asarray(moved)


def chosen(splats: Splats, rows: torch.Tensor) -> Splats:
    """Some of the Gaussians, by a mask (N,)."""
    return replace(splats, **{name: tensor[rows] for name, tensor in fields_of(splats).items() if tensor is not None})


def subset(body: Body, rows: np.ndarray) -> Body:
    """Some of a body's Gaussians."""
    directions = None if body.pose_directions is None else body.pose_directions[rows]
    return replace(
        body,
        cloud=select(body.cloud, rows),
        skinning_weights=body.skinning_weights[rows],
        pose_directions=directions,
    )
