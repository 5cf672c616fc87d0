"""Where things are in a scene file, in our terms: up, turns, planes, boxes, and the velocity that pushes give."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.data import Array
from hoi.importers.physgaussian.reader import SceneFile
from hoi.objects.load import UP

CENTRE = np.ones(3)
"""Where PhysGaussian puts the centre of the object."""
PADDING = 3
"""Cells that its bounding box keeps free at the rim of the grid."""
TOUCHES = 1e-9
"""Slack when boxes are compared, in the file's units."""


@dataclass(frozen=True)
class Frame:
    """From the file's simulation space to the world's axes, with the object's centre as the origin."""

    turn: Array
    """The file's up to Z, shape (3, 3)."""
    rotation: Array
    """From the axes of the object's Gaussians to the world's, shape (3, 3)."""
    scale: float
    """Longest side of the object, in the file's units."""
    longest: float
    """The same [m]."""
    points: Array | None
    """The object's Gaussians in their own axes, shape (N, 3), where they are at hand."""

    @property
    def factor(self) -> float:
        """Metres a unit of the file's."""
        return self.longest / self.scale

    @property
    def along_axes(self) -> bool:
        """Whether the object's own axes are the world's, but for their order and signs."""
        return bool(np.allclose(np.abs(self.rotation).max(axis=0), 1, atol=1e-6))

    @property
    def reach(self) -> Array:
        """Half the sides of the object as it stands, shape (3,), in the file's units; a cube if they are not known."""
        if self.points is None:
            return np.full(3, self.scale / 2)
        sides = np.ptp(self.points @ self.rotation.T, axis=0)
        return self.scale / 2 * sides / sides.max()

    @property
    def size(self) -> float:
        """Longest side along the object's own axes [m], which `object.size` is."""
        if self.points is None:
            return self.longest
        return self.longest * float(
            np.ptp(self.points, axis=0).max() / np.ptp(self.points @ self.rotation.T, axis=0).max()
        )

    def point(self, values: Any) -> Array:
        """A point, in the file's units."""
        return self.turn @ (np.array(values) - CENTRE)

    def vector(self, values: Any) -> Array:
        """A direction, or a vector of physical units."""
        return self.turn @ np.array(values)

    def half(self, values: Any) -> Array:
        """Half sizes of a box, in the file's units."""
        return np.abs(self.turn) @ np.array(values)


def frame_of(file: SceneFile, points: Array | None, size: float | None, remarks: list[str]) -> Frame:
    """The frame of a file for an object whose longest side shall be `size` [m], by default what the file says."""
    turn = _upright(file, remarks)
    rotation = turn
    for axis, angle in reversed(file.rotations):
        rotation = rotation @ Rotation.from_euler("xyz"[axis], angle, degrees=True).as_matrix()
    scale = float(file.numbers["scale"])
    frame = Frame(turn, rotation, scale, size or scale, points)
    if points is None and not frame.along_axes:
        remarks.append("scale: is of the turned object; without --object it is taken along the object's own axes")
    return frame


def _upright(file: SceneFile, remarks: list[str]) -> Array:
    """The rotation that brings the file's up to Z: against gravity, or where there is none as its camera has it."""
    up = -np.array(file.gravity) if any(file.gravity) else np.array(file.up)
    if np.count_nonzero(up) != 1:
        remarks.append(f"up: {up.tolist()} is not along an axis; the axes stay as they are, Z is up")
        return np.eye(3)
    axis = int(np.abs(up).argmax())
    return UP[("+" if up[axis] > 0 else "-") + "xyz"[axis]]


def placing(rotation: Array) -> tuple[str, float, list[float]]:
    """`object.up`, yaw [rad] and orientation that make a rotation; the orientation where no up axis can."""
    for up, upright in UP.items():
        rest = rotation @ upright.T
        if np.allclose(rest[2], [0, 0, 1], atol=1e-6):
            return up, tidy([np.arctan2(rest[1, 0], rest[0, 0])])[0], [1.0, 0.0, 0.0, 0.0]
    return "+z", 0.0, tidy(Rotation.from_matrix(rotation).as_quat(scalar_first=True))


def tidy(values: Any) -> list[float]:
    """As plain numbers, without the dust of rotations."""
    return [float(value) for value in np.round(values, 9) + 0.0]


# --- planes ----------------------------------------------------------------------------------------------------------


def planes(file: SceneFile, frame: Frame, remarks: list[str]) -> list[dict[str, Any]]:
    """Planes in our terms, relative to the object's centre [m]."""
    duration = file.numbers["frame_dt"] * file.numbers["frame_num"]
    found = []
    for index, condition in enumerate(file.conditions):
        kind = condition["type"]
        where = f"boundary_conditions.{index} ({kind})"
        plane = None
        if kind == "particle_impulse":
            continue
        if kind == "bounding_box":
            plane = _floor_of_grid(file, frame)
            remarks.append(f"{where}: its floor alone; the others keep particles on the grid, which here follows them")
        elif kind not in ("surface_collider", "cuboid"):
            remarks.append(f"{where}: moves particles by hand; nothing here does")
        elif condition["start_time"] > 0 or condition["end_time"] < duration:
            remarks.append(f"{where}: is there for a part of the time; a plane always is")
        elif kind == "cuboid":
            plane = _face_of(condition, frame)
            if plane is None:
                remarks.append(f"{where}: holds or moves a part of the space, not all on one side of the object")
        elif condition["surface"] == "cut":
            remarks.append(f"{where}: a knife; there are none here")
        else:
            plane = _collider(condition, frame)
            if condition["surface"] != "sticky":
                remarks.append(f"{where}: {condition['surface']}, as it says; PhysGaussian makes every surface sticky")
        if plane is not None:
            found.append(plane)
    return found


def _floor_of_grid(file: SceneFile, frame: Frame) -> dict[str, Any]:
    """The side of the bounding box that is down: it takes away the outward velocity, without friction."""
    limit = float(file.numbers["grid_lim"])
    padding = PADDING * limit / file.numbers["n_grid"]
    up = frame.turn.T @ [0, 0, 1]  # in the file's axes
    corner = np.where(up > 0, padding, limit - padding)
    return {"point": [0.0, 0.0, frame.factor * frame.point(corner)[2]], "normal": [0.0, 0.0, 1.0], "contact": "slip"}


def _collider(condition: Mapping[str, Any], frame: Frame) -> dict[str, Any]:
    point, normal = frame.factor * frame.point(condition["point"]), frame.vector(condition["normal"])
    plane = {"point": tidy(point), "normal": tidy(normal)}
    if condition["surface"] == "sticky":
        return plane | {"contact": "stick"}
    if condition["friction"] == 0:
        return plane | {"contact": "slip"}
    return plane | {"contact": "coulomb", "friction": condition["friction"]}


def _face_of(condition: Mapping[str, Any], frame: Frame) -> dict[str, Any] | None:
    """The face towards the object of a box at rest beside it that is wider than it; None of any other."""
    centre, half = frame.point(condition["point"]), frame.half(condition["size"])
    covers = np.abs(centre) + frame.reach <= half + TOUCHES
    beside = np.abs(centre) - half - frame.reach >= -TOUCHES
    for axis in range(3):
        if covers[[other for other in range(3) if other != axis]].all() and beside[axis]:
            normal = np.zeros(3)
            normal[axis] = -np.sign(centre[axis])
            face = frame.factor * (centre + half * normal) * np.abs(normal)
            return (
                None
                if any(condition["velocity"])
                else {"point": tidy(face), "normal": tidy(normal), "contact": "stick"}
            )
    return None


# --- boxes and pushes ------------------------------------------------------------------------------------------------


def boxes(file: SceneFile, frame: Frame, remarks: list[str]) -> list[dict[str, Any]]:
    """The boxes of additional_material_params in the object's own frame, in units of its size; none if it is askew."""
    if file.parts and not frame.along_axes:
        remarks.append("additional_material_params: its boxes are not along the axes of the object, which is askew")
        return []
    _, yaw, _ = placing(frame.rotation)
    to_own = (Rotation.from_euler("z", yaw).as_matrix().T @ frame.turn) / frame.scale
    return [
        {"centre": tidy(to_own @ (np.array(part["point"]) - CENTRE)), "half_size": tidy(np.abs(to_own) @ part["size"])}
        for part in file.parts
    ]


def velocity(file: SceneFile, frame: Frame, remarks: list[str]) -> list[float]:
    """Of the object after the pushes that its particles are given at the start [m/s].

    Each particle gets force dt, and weighs density dx^3 over the number of particles in its cell: N particles in M
    cells leave with force dt N / (density dx^3 M) on average.
    """
    total = np.zeros(3)
    for index, condition in enumerate(file.conditions):
        if condition["type"] != "particle_impulse":
            continue
        where = f"boundary_conditions.{index} (particle_impulse)"
        centre, half = frame.point(condition["point"]), frame.half(condition["size"])
        if condition["start_time"] > 0:
            remarks.append(f"{where}: comes later; an object has a velocity at the start alone")
        elif not (np.abs(centre) + frame.reach <= half + TOUCHES).all():
            remarks.append(f"{where}: pushes a part of the object; an object starts with one velocity")
        elif frame.points is None or "particle_filling" in file.given:
            why = "--object is not given" if frame.points is None else "particle_filling adds to them"
            remarks.append(f"{where}: a force on each particle, whose number is not known: {why}")
        else:
            turned = frame.points @ frame.rotation.T
            low, high = turned.min(axis=0), turned.max(axis=0)
            places = (turned - (low + high) / 2) * frame.scale / (high - low).max() + CENTRE
            dx = file.numbers["grid_lim"] / file.numbers["n_grid"]
            cells = len(np.unique(np.floor(places / dx), axis=0))
            mass = file.numbers["density"] * dx**3 * cells / len(places)
            seconds = condition["num_dt"] * file.numbers["substep_dt"]
            gained = frame.vector(condition["force"]) * seconds / mass
            remarks.append(f"{where}: taken as the velocity it gives on average, {gained.round(4).tolist()} m/s")
            total += gained
    return tidy(total)
