"""Biovision BVH: a skeleton with its rest offsets, then one line of channels a frame."""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hoi.data import Array
from hoi.errors import InputError, about

AXES = "XYZ"
CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in AXES)


@dataclass
class Joint:
    """One node of the hierarchy; end sites are not kept."""

    name: str
    parent: int
    """Index of the parent, -1 for the root."""
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    """From the parent in the rest pose, in the file's unit."""
    channels: tuple[str, ...] = field(default=())
    """In the order in which rotations are multiplied, the first outermost."""


@dataclass(frozen=True)
class Recording:
    """What a BVH file holds, in its own axes and unit."""

    joints: tuple[Joint, ...]
    """Parents before children."""
    values: Array
    """Channels of all joints in their order, angles in degrees, (F, C)."""
    fps: float

    def rest_positions(self) -> Array:
        """Joints with all channels at zero, the root at the origin, (J, 3)."""
        places = np.zeros((len(self.joints), 3))
        for row, joint in enumerate(self.joints):
            if joint.parent >= 0:
                places[row] = places[joint.parent] + joint.offset
        return places

    def poses(self) -> tuple[Array, Array]:
        """World rotations (F, J, 3, 3) and positions (F, J, 3). Position channels take the place of the offset."""
        rotations = np.empty((len(self.values), len(self.joints), 3, 3))
        positions = np.empty(rotations.shape[:-1])
        column = 0
        for row, joint in enumerate(self.joints):
            turn = np.broadcast_to(np.eye(3), (len(self.values), 3, 3))
            place = np.tile(np.asarray(joint.offset), (len(self.values), 1))
            for channel in joint.channels:
                axis, values = AXES.index(channel[0]), self.values[:, column]
                if channel.endswith("position"):
                    place[:, axis] = values
                else:
                    turn = turn @ turn_about(axis, np.radians(values))
                column += 1
            if joint.parent < 0:
                rotations[:, row], positions[:, row] = turn, place
                continue
            above = rotations[:, joint.parent]
            rotations[:, row] = above @ turn
            positions[:, row] = positions[:, joint.parent] + (above @ place[..., None])[..., 0]
        return rotations, positions


def turn_about(axis: int, angles: Array) -> Array:
    """Rotations (F, 3, 3) about a coordinate axis by angles (F,) [rad]."""
    turn = np.zeros((len(angles), 3, 3))
    after, last = (axis + 1) % 3, (axis + 2) % 3
    turn[:, axis, axis] = 1
    turn[:, after, after] = turn[:, last, last] = np.cos(angles)
    turn[:, last, after] = np.sin(angles)
    turn[:, after, last] = -turn[:, last, after]
    return turn


def read_bvh(path: Path) -> Recording:
    """Read a BVH file.

    Raises:
        InputError: it cannot be read, or is no whole BVH file.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    if "," in text:  # of decimals in half of the world, or between numbers
        text = text.replace(",", " " if re.search(r"\d\.\d", text) else ".")
    header, *motion = re.split(r"^\s*MOTION\s*$", text, maxsplit=1, flags=re.MULTILINE | re.IGNORECASE)
    if not motion or "HIERARCHY" not in header.upper():
        raise InputError(f"{path} is no BVH file: HIERARCHY and MOTION must each stand on a line of their own")
    with about(path):
        joints = _hierarchy(header)
        frames, values, fps = _motion(motion[0])
    columns = sum(len(joint.channels) for joint in joints)
    if len(values) != frames * columns:
        expected = f"{frames} frames of {columns} channels are {frames * columns}"
        raise InputError(f"{path} holds {len(values)} numbers after its frame time, {expected}; it may be cut short")
    if not np.isfinite(values).all():
        raise InputError(f"{path} holds numbers that are not finite")
    return Recording(joints, values.reshape(frames, columns), fps)


def _hierarchy(header: str) -> tuple[Joint, ...]:
    joints: list[Joint] = []
    open_nodes: list[int | None] = []
    """Indices of the joints around the current line; None for an end site."""
    entering: int | None = None
    for line in re.sub(r"([{}])", r"\n\1\n", header).splitlines():
        words = line.split()
        match [word.upper() for word in words[:1]]:
            case [] | ["HIERARCHY"]:
                continue
            case ["ROOT" | "JOINT"]:
                parent = open_nodes[-1] if open_nodes else -1
                if parent is None or (parent < 0 and joints):
                    raise InputError(f"{line.strip()!r} stands outside the one skeleton that is read")
                joints.append(Joint(" ".join(words[1:]), parent))
                entering = len(joints) - 1
            case ["END"]:
                entering = None
            case ["{"]:
                open_nodes.append(entering)
            case ["}"] if open_nodes:
                open_nodes.pop()
            case ["OFFSET"] if open_nodes:
                offset = _numbers(words[1:], line)
                if len(offset) != 3:
                    raise InputError(f"{line.strip()!r}: an offset has 3 numbers")
                if (at := open_nodes[-1]) is not None:
                    joints[at].offset = tuple(offset)
            case ["CHANNELS"] if open_nodes and (at := open_nodes[-1]) is not None:
                names = tuple(word.capitalize() for word in words[2:])
                if words[1:2] != [str(len(names))] or not set(names) <= set(CHANNELS):
                    raise InputError(f"{line.strip()!r}: must be a count and as many of {', '.join(CHANNELS)}")
                joints[at].channels = names
            case _:
                raise InputError(f"{line.strip()!r} is not understood")
    if not joints or open_nodes:
        raise InputError("its HIERARCHY has no joint or a brace that is not closed")
    return tuple(joints)


def _motion(text: str) -> tuple[int, Array, float]:
    """Number of frames, all values, frames a second."""
    head = re.match(r"\s*Frames:\s*(\d+)\s+Frame\s+Time:\s*(\S+)([^\n]*)\n?", text, re.IGNORECASE)
    if head is None:
        raise InputError("after MOTION there must be 'Frames: N' and 'Frame Time: SECONDS'")
    frames, (frame_time,) = int(head[1]), _numbers([head[2]], head[0].strip().replace("\n", " "))
    if frames < 1 or not (math.isfinite(frame_time) and frame_time > 0):
        raise InputError(f"{frames} frames of {frame_time:g} s each; both must be greater than 0")
    return frames, np.array(_numbers(text[head.end() :].split(), "the values of the frames")), 1 / frame_time


def _numbers(words: list[str], where: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{where.strip()!r}: {error}") from None
