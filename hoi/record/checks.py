"""What a record must be before anything of it is believed: sizes before they are allocated, shapes, finite numbers."""

import io
import math
import zipfile
from collections.abc import Iterable
from dataclasses import fields
from typing import IO, Any

import numpy as np
import zstandard
from mcap.records import ChunkIndex
from numpy.lib import format as npy
from numpy.typing import NDArray

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import GaussianCloud, Run, SceneObject

MOST_BYTES = 2**33
"""Bytes that the messages, or the arrays of one attachment, may claim to unpack to."""
_CHUNK_HEAD = 9 + 28
"""Bytes of a chunk record before the name of its compression: opcode, length, two times, size, CRC."""


class Refused(ValueError):
    """What is wrong with a file, without its name."""


_CONTACT_VECTORS = ("point", "normal", "v_human", "v_object", "v_post", "impulse")
_MAY_BE_UNKNOWN = ("v_formula",)
"""NaN where a system or an older record does not say it."""


def check_chunks(file: IO[bytes], chunks: Iterable[ChunkIndex]) -> None:
    """Nothing, when no chunk unpacks to more than it says, nor all of them to more than `MOST_BYTES`.

    Raises:
        Refused: they do, or are packed in a way that no record is.
    """
    total = 0
    for chunk in chunks:
        total += chunk.uncompressed_size
        if chunk.compression not in ("", "zstd"):
            raise Refused(f"a chunk is packed as {chunk.compression[:20]!r}, must be zstd")
        if total > MOST_BYTES:
            raise Refused(f"its messages claim {total} bytes, at most {MOST_BYTES} are read")
        if chunk.compression == "zstd":
            file.seek(chunk.chunk_start_offset + _CHUNK_HEAD + 4 + len(chunk.compression) + 8)
            claimed = zstandard.frame_content_size(file.read(18))
            if claimed != chunk.uncompressed_size:
                raise Refused(f"a chunk claims {claimed} bytes, its index {chunk.uncompressed_size}")


def check_names(names: Iterable[str]) -> None:
    """Nothing, when attachments have plain names, each once.

    Raises:
        Refused: a name is a path, or comes twice.
    """
    seen: set[str] = set()
    for name in names:
        if not name or name in (".", "..") or not name.isprintable() or any(mark in name for mark in "/\\:"):
            raise Refused(f"its attachment {name[:80]!r} is named as a path, must be a plain name")
        if name in seen:
            raise Refused(f"it has two attachments {name[:80]!r}")
        seen.add(name)


def check_npz(name: str, data: bytes) -> None:
    """Nothing, when the arrays in an .npz are numbers and as large as their shapes claim. Nothing is unpacked.

    Raises:
        Refused: they are not.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        total = 0
        for member in archive.infolist():
            total += member.file_size
            with archive.open(member) as stream:
                version = npy.read_magic(stream)
                read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
                shape, _, dtype = read(stream)
                head = stream.tell()
            if dtype.kind not in "fiu":
                raise Refused(f"{name}: {member.filename[:40]} holds {dtype.str}, must hold numbers")
            size = dtype.itemsize
            for extent in shape:
                size *= extent
            if size + head != member.file_size or total > MOST_BYTES:
                claim = f"{member.filename[:40]} claims shape {shape}, {size} bytes"
                raise Refused(f"{name}: {claim}, it has {member.file_size - head}, at most {MOST_BYTES} are read")


def check_run(run: Run) -> None:
    """Nothing, when the parts of a run have the shapes that they must have, and fit together.

    Raises:
        Refused: one has not.
    """
    scene, state = run.scene, run.state
    if scene is not None:
        _check_cloud("body", scene.body.cloud)
        _check("body.skinning_weights", scene.body.skinning_weights, (len(scene.body.cloud), JOINT_COUNT))
        _check("body.rest_joints", scene.body.rest_joints, (JOINT_COUNT, 3))
        if scene.object is not None:
            _check_object(scene.object)
        elif state.trajectory is not None:
            raise Refused("it has a trajectory, and no object")
        _check("gravity", scene.gravity, (3,))
        if not (math.isfinite(scene.fps) and scene.fps > 0):
            raise Refused(f"its frame rate is {scene.fps}, must be above 0")
    if (motion := state.motion) is not None:
        frames = len(motion.translation)
        _check("motion.translation", motion.translation, (frames, 3))
        _check("motion.orientation", motion.orientation, (frames, 6))
        _check("motion.body_pose", motion.body_pose, (frames, JOINT_COUNT - 1, 3))
    if (trajectory := state.trajectory) is not None:
        frames, particles = len(trajectory.positions), None if scene is None else len(scene.thing.particles)
        _check("object.positions", trajectory.positions, (frames, particles, 3))
        for name in ("com", "com_velocity", "energy"):
            _check(f"object.{name}", getattr(trajectory, name), (frames, 3))
        if trajectory.deformation_gradient is not None:
            _check("object.deformation_gradient", trajectory.deformation_gradient, (frames, particles, 3, 3))
    for contact in state.contact.contacts if state.contact is not None else ():
        _check_joint("a contact", contact.joint, unknown=state.motion is None)
        for name in _CONTACT_VECTORS:
            _check(f"contact.{name}", getattr(contact, name), (3,))
    if state.target is not None:
        _check_joint("the target", state.target.joint)


def check_finite(run: Run) -> None:
    """Nothing, when all that moves is finite, as it is in each run that is done.

    Raises:
        Refused: something is not.
    """
    scene, state = run.scene, run.state
    owners: dict[str, Any] = {"motion": state.motion, "trajectory": state.trajectory}
    owners["contact"] = None if state.contact is None else state.contact.push
    if scene is not None:
        owners |= {"scene": scene, "object": scene.object, "body": scene.body, "body.cloud": scene.body.cloud}
    for owner_name, owner in owners.items():
        for f in fields(owner) if owner is not None else ():
            array = getattr(owner, f.name)
            if f.name not in _MAY_BE_UNKNOWN and isinstance(array, np.ndarray) and not np.isfinite(array).all():
                where = np.argwhere(~np.isfinite(array))[0].tolist()
                raise Refused(f"{owner_name}.{f.name} has {array[tuple(where)]} at {where}, must be finite")


def _check(name: str, array: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if extent is None else str(extent) for extent in shape)
        raise Refused(f"{name} has shape {array.shape}, must have ({wanted})")


def _check_cloud(name: str, cloud: GaussianCloud) -> None:
    count = len(cloud)
    shapes = {"means": (count, 3), "quaternions": (count, 4), "scales": (count, 3), "opacities": (count,)}
    for field, shape in (shapes | {"sh": (count, None, 3)}).items():
        _check(f"{name}.{field}", getattr(cloud, field), shape)


def _check_joint(whose: str, joint: int, unknown: bool = False) -> None:
    if not -unknown <= joint < JOINT_COUNT:
        raise Refused(f"{whose} has joint {joint}, must be 0 to {JOINT_COUNT - 1}")


def _check_object(thing: SceneObject) -> None:
    _check_cloud("object", thing.cloud)
    if thing.drawn is not None:
        _check_cloud("object.drawn", thing.drawn)
    particles = len(thing.particles)
    _check("object.particles", thing.particles, (particles, 3))
    _check("object.volumes", thing.volumes, (particles,))
    _check("object.velocity", thing.velocity, (3,))
    _check("object.angular_velocity", thing.angular_velocity, (3,))
    if thing.region is not None:
        _check("object.region", thing.region, (particles,))
        if particles and not 0 <= thing.region.min() <= thing.region.max() < len(thing.materials):
            raise Refused(f"object.region names a material beyond the {len(thing.materials)} there are")
    if len(thing.cloud) > particles:
        raise Refused(f"its object has {len(thing.cloud)} Gaussians and {particles} particles, must have as many")
