"""A finished run as Gaussians in the world, frame by frame: the person by skinning, the object by its F (torch)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import roma
import torch
from numpy.typing import NDArray
from torch import Tensor

from hoi import gaussians
from hoi.body.skinning import BodyTensors, body_tensors, pose_gaussians, posed_means
from hoi.data import Array, Body, GaussianCloud, Motion, ObjectTrajectory, Run, Scene, SceneObject, State
from hoi.objects.carrying import carried_by
from hoi.render.action import Action
from hoi.render.posing import Poser
from hoi.render.shown import scene_of
from hoi.render.splats import Splats, from_cloud

OUTLINE_DIRECTIONS = 32
"""In each of them the outermost Gaussian belongs to the outline."""
OUTLINE_FRAMES = 8
"""The frames, evenly spread, in which the object's outline is looked for."""
FAINTEST = 0.05
"""Opacity below which a Gaussian belongs to no outline, unless all are as faint."""
NEWTON_STEPS, NEWTON_TOLERANCE = 8, 1e-3
"""Of the polar decomposition. What is left after a step is the square of what that step changed."""


@dataclass(frozen=True)
class Person:
    """A body ready to be posed and drawn."""

    body: BodyTensors
    scales: Tensor
    """[m], (N, 3)."""
    opacities: Tensor
    """(N,)."""
    sh: Tensor
    """(N, K, 3), in the T-pose."""
    surface: Tensor | None = None
    """Normal and openness in the Gaussians' own frames, (N, 2, 3)."""


def person_tensors(body: Body, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> Person:
    """All Gaussians of `body` as tensors."""
    scales, opacities, sh = (
        torch.tensor(array, dtype=dtype, device=device)
        for array in (body.cloud.scales, body.cloud.opacities, body.cloud.sh)
    )
    surface = None
    if body.cloud.surface is not None:
        own = body.cloud.surface.astype(np.float64) @ gaussians.rotation_matrices(body.cloud)
        surface = torch.tensor(own, dtype=dtype, device=device)
    return Person(body_tensors(body, dtype=dtype, device=device), scales, opacities, sh, surface)


def posed(person: Person, translation: Tensor, orientation: Tensor, body_pose: Tensor) -> list[Splats]:
    """The person in each of T poses, differentiable in them and in every tensor of `person`.

    Args:
        translation: (T, 3) [m], orientation: (T, 6), body_pose: (T, 23, 3) [rad], see `hoi.data.Motion`.

    Returns:
        T Splats: means by linear blend skinning, covariances R diag(scales^2) R^T, harmonics and surfaces turned by the
        blended rotation of the joints.
    """
    means, rotations = pose_gaussians(person.body, translation, orientation, body_pose)
    root = rotations * person.scales[:, None, :]
    sigma = root @ root.mT
    turns: Sequence[Tensor | None] = [None] * len(means)
    surfaces: Sequence[Tensor | None] = [None] * len(means)
    if person.surface is not None:
        surfaces = (person.surface @ rotations.mT).unbind()
    if person.sh.shape[1] > 1:
        rest = roma.unitquat_to_rotmat(torch.nn.functional.normalize(person.body.quaternions, dim=-1).roll(-1, -1))
        turns = (rotations @ rest.mT).unbind()
    return [
        Splats(mean, covariance, person.opacities, person.sh, turn, surface)
        for mean, covariance, turn, surface in zip(means.unbind(), sigma.unbind(), turns, surfaces, strict=True)
    ]


def polar_rotation(deformation_gradient: Tensor) -> Tensor:
    """The rotation nearest to F, R of F = R S, for F (N, 3, 3); not differentiable.

    Newton's iteration R <- (R + R^-T) / 2 (Higham 1986); by SVD where F mirrors or is too close to singular for it.
    """
    rows = deformation_gradient.movedim(0, -1).contiguous()  # (3, 3, N): long vectors, not small matrices
    settled = torch.zeros(len(deformation_gradient), dtype=torch.bool, device=rows.device)
    for _ in range(NEWTON_STEPS):
        cofactors = torch.stack([torch.linalg.cross(rows[i - 2], rows[i - 1], dim=0) for i in range(3)])
        determinant = (rows[0] * cofactors[0]).sum(0)
        before, rows = rows, 0.5 * (rows + cofactors / determinant)
        settled = ((rows - before).abs().amax((0, 1)) < NEWTON_TOLERANCE) & (determinant > 0)
        if settled.all():
            break
    rotation = rows.movedim(-1, 0).contiguous()
    if not settled.all():
        rotation[~settled] = torch.as_tensor(roma.special_procrustes(deformation_gradient[~settled]))
    return rotation


class _MovingPerson:
    def __init__(self, body: Body, motion: Motion, device: torch.device | str) -> None:
        self.frames = len(motion)
        self._body, self._motion, self._device = body, motion, device
        self._poser = None if body.pose_directions is not None else Poser(body, motion, device)
        self._same_as = _last_change(
            [array.reshape(len(motion), -1) for array in (motion.translation, motion.orientation, motion.body_pose)]
        )
        self._shown: tuple[int, Splats] | None = None

    def at(self, frame: int) -> Splats:
        frame = int(self._same_as[frame])
        if self._shown is None or self._shown[0] != frame:
            self._shown = frame, self._with_blend_shapes(frame) if self._poser is None else self._poser.at(frame)
        return self._shown[1]

    @cached_property
    def _tensors(self) -> Person:
        return person_tensors(self._body, device=self._device)

    def _with_blend_shapes(self, frame: int) -> Splats:
        arrays = (self._motion.translation, self._motion.orientation, self._motion.body_pose)
        (found,) = posed(self._tensors, *(torch.tensor(a[frame : frame + 1], device=self._device) for a in arrays))
        return found

    def outline(self) -> Array:
        """The outermost Gaussians of each limb [m], (T, n, 3)."""
        seen = _visible(self._body.cloud)
        strongest = self._body.skinning_weights[seen].argmax(1)
        limbs = [seen[strongest == joint] for joint in np.unique(strongest)]
        rows = np.concatenate([limb[_outermost(self._body.cloud.means[limb])] for limb in limbs])
        return posed_means(self._body, self._motion, subset=rows).astype(np.float64)


class _MovingObject:
    """The first particles are the Gaussians, or carry those that are drawn; without F they only move."""

    def __init__(self, thing: SceneObject, trajectory: ObjectTrajectory, device: torch.device | str) -> None:
        self.frames = len(trajectory.positions)
        self._cloud, self._device, self._carried = thing.cloud, device, carried_by(thing)
        self._positions = trajectory.positions[:, : len(thing.cloud)]
        gradient = trajectory.deformation_gradient
        self._gradient = None if gradient is None else gradient[:, : len(thing.cloud)]
        cloud = thing.cloud if thing.drawn is None else thing.drawn
        self._still = from_cloud(cloud, device)
        self._root = torch.tensor(
            gaussians.rotation_matrices(cloud) * cloud.scales[:, None, :], dtype=torch.float32, device=device
        )
        self._same_as = _last_change([self._positions, *([] if self._gradient is None else [self._gradient])])
        self._shown: tuple[int, Splats] | None = None

    def at(self, frame: int) -> Splats:
        frame = int(self._same_as[frame])
        if self._shown is None or self._shown[0] != frame:
            self._shown = frame, self._moved(frame)
        return self._shown[1]

    def _moved(self, frame: int) -> Splats:
        positions, gradient = self._positions[frame], None if self._gradient is None else self._gradient[frame]
        if self._carried is not None:
            positions, gradient = self._carried.moved(positions, gradient)
        means = self._tensor(positions)
        if gradient is None:
            return replace(self._still, means=means)
        deformation = self._tensor(gaussians.limited(gradient))
        root = deformation @ self._root
        turns, surface = None, self._still.surface
        if self._still.sh.shape[1] > 1 or surface is not None:
            turns = polar_rotation(deformation)
            surface = surface if surface is None else surface @ turns.mT
        turns = turns if self._still.sh.shape[1] > 1 else None
        return replace(self._still, means=means, covariances=root @ root.mT, turns=turns, surface=surface)

    def _tensor(self, array: Array) -> Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self._device)

    def outline(self) -> Array:
        """The outermost Gaussians [m], (T, m, 3)."""
        seen = _visible(self._cloud)
        spread = np.unique(np.linspace(0, self.frames - 1, OUTLINE_FRAMES).round().astype(int))
        rows = np.unique(np.concatenate([seen[_outermost(self._positions[at][seen])] for at in spread]))
        return self._positions[:, rows].astype(np.float64)


class Replay:
    """What a person in motion and an object show in each frame, whichever there is; `replay` is that of a run.

    Frames may be asked for in any order; in sequence they cost least.
    """

    def __init__(
        self, scene: Scene, state: State, device: torch.device | str = "cpu", *, relight: bool = False
    ) -> None:
        """
        Args:
            relight: captured clouds get the surface that their flattest axes tell, so that light can be put on them.
        """
        scene, self.captured = _with_surfaces(scene) if relight else (scene, frozenset())
        self.scene, self.state, self._device = scene, state, device
        self.fps = scene.fps
        self._parts: dict[str, _MovingPerson | _MovingObject] = {}
        if state.motion is not None:
            self._parts["person"] = _MovingPerson(scene.body, state.motion, device)
        if state.trajectory is not None:
            self._parts["object"] = _MovingObject(scene.thing, state.trajectory, device)
        self.frames: int = next(iter(self._parts.values())).frames

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parts: "person", "object"."""
        return tuple(self._parts)

    def retimed(self, frames: Array, fps: float) -> "Replay":
        """The replay whose frames are these fractional ones (F,), see `hoi.render.between.at_frames`."""
        from hoi.render.between import at_frames

        found = Replay(*at_frames(self.scene, self.state, frames, fps), self._device)
        found.captured = self.captured
        return found

    def parts(self, frame: int) -> tuple[Splats, ...]:
        """Person and object in a frame, whichever the run has.

        A part that has not moved since the frame asked for before is the same object as then. No gradients.
        """
        if not 0 <= frame < self.frames:
            raise IndexError(f"frame {frame}: 0 to {self.frames - 1} are there")
        with torch.no_grad():
            return tuple(part.at(frame) for part in self._parts.values())

    @cached_property
    def _action(self) -> Action:
        outlines = {name: part.outline() for name, part in self._parts.items()}
        nothing = np.zeros((self.frames, 0, 3))
        return Action(outlines.get("person", nothing), outlines.get("object", nothing), self.fps)

    def action(self) -> Action:
        """What a camera has to show."""
        return self._action


def replay(run: Run, device: torch.device | str = "cpu", *, relight: bool = False) -> Replay:
    """Prepare a run, as `hoi.record.read` gives it, for being drawn.

    Raises:
        InputError: as `hoi.render.shown.scene_of`.
    """
    return Replay(scene_of(run), run.state, device, relight=relight)


def _with_surfaces(scene: Scene) -> tuple[Scene, frozenset[str]]:
    """The scene with a surface for clouds that have none, and which parts those are."""
    captured = set()
    if scene.body.cloud.surface is None:
        captured.add("person")
        scene = replace(scene, body=replace(scene.body, cloud=gaussians.with_surface(scene.body.cloud)))
    if scene.object is not None and scene.object.cloud.surface is None:
        captured.add("object")
        scene = replace(scene, object=replace(scene.object, cloud=gaussians.with_surface(scene.object.cloud)))
    return scene, frozenset(captured)


def _visible(cloud: GaussianCloud) -> NDArray[np.int_]:
    """Indices of the Gaussians that make an outline; all, where all are faint."""
    seen = cloud.opacities >= FAINTEST
    return np.flatnonzero(seen if seen.any() else ~seen)


def _outermost(points: Array) -> NDArray[np.int_]:
    """Indices of the points that are outermost in some direction."""
    return np.unique((points @ gaussians.fibonacci_sphere(OUTLINE_DIRECTIONS).T.astype(points.dtype)).argmax(0))


def _last_change(series: Sequence[NDArray[Any]]) -> NDArray[np.int_]:
    """For each of T frames the first one since which none of the arrays (T, ...) has changed, (T,)."""
    frames = np.arange(len(series[0]))
    for frame in frames[1:]:
        # One entry tells most frames apart, and spares the pass over all of them.
        if all(values[frame].flat[0] == values[frame - 1].flat[0] for values in series):
            if all(np.array_equal(values[frame], values[frame - 1]) for values in series):
                frames[frame] = frames[frame - 1]
    return frames
