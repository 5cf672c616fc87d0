"""Animated meshes from files: GLB, .npz of vertices and faces, or a folder of OBJ or PLY, one a frame."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array
from hoi.errors import InputError

MOST_FRAMES = 2000
MOST_NUMBERS = 3 * 10**8
"""Coordinates of all vertices in all frames."""
FORMATS = "a .glb, an .npz of vertices (T, V, 3) and faces (F, 3), or a folder of .obj or .ply"


@dataclass(frozen=True)
class MeshSequence:
    """Triangles whose corners move."""

    vertices: Array
    """(T, V, 3)."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    fps: float | None
    """None where the file does not say."""
    colours: Array | None = None
    """RGB in [0, 1], (V, 3)."""


def read(path: Path, node: str | None, fps: float) -> MeshSequence:
    """An animated mesh in its file's axes and units.

    Args:
        node: of a GLB, whose triangles are meant; None: all.
        fps: at which a GLB's animation, which is continuous, is looked at.

    Raises:
        InputError: one line: no such file, or it is broken, too large, or no animated mesh.
    """
    if path.is_dir():
        read = _folder(path)
    elif not path.exists():
        raise InputError(f"{path}: no such file")
    elif path.suffix.lower() == ".glb":
        read = _glb(path, node, fps)
    elif path.suffix.lower() == ".npz":
        read = _npz(path)
    else:
        raise InputError(f"{path}: an animated mesh is {FORMATS}")
    if node is not None and path.suffix.lower() != ".glb":
        raise InputError(f"{path}: only a .glb has nodes to name")
    return checked(read, path)


def checked(mesh: MeshSequence, path: Path) -> MeshSequence:
    """The mesh, when it is one.

    Raises:
        InputError: shapes, indices, numbers or sizes that no animated mesh has.
    """
    vertices, faces = mesh.vertices, mesh.faces
    if vertices.ndim != 3 or vertices.shape[2] != 3 or vertices.shape[1] < 4:
        raise InputError(f"{path}: vertices has shape {vertices.shape}, must be (T, V, 3) of 4 or more vertices")
    if not 2 <= len(vertices) <= MOST_FRAMES:
        raise InputError(f"{path} has {len(vertices)} frames, 2 to {MOST_FRAMES} are allowed")
    if vertices.size > MOST_NUMBERS:
        raise InputError(f"{path} has {vertices.size} coordinates, at most {MOST_NUMBERS} are read")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise InputError(f"{path}: faces has shape {faces.shape}, must be (F, 3)")
    if not 0 <= faces.min() <= faces.max() < vertices.shape[1]:
        raise InputError(f"{path}: a face has a corner beyond its {vertices.shape[1]} vertices")
    if not np.isfinite(vertices).all():
        frame = int(np.argwhere(~np.isfinite(vertices))[0][0])
        raise InputError(f"{path}: a vertex of frame {frame} is not finite")
    if not np.ptp(vertices[0], axis=0).any():
        raise InputError(f"{path}: all its vertices are in one place")
    if mesh.colours is not None and (mesh.colours.shape != (vertices.shape[1], 3)):
        raise InputError(f"{path}: colours has shape {mesh.colours.shape}, must be ({vertices.shape[1]}, 3)")
    if mesh.fps is not None and not 0.1 <= mesh.fps <= 1000:
        raise InputError(f"{path}: fps is {mesh.fps:g}, 0.1 to 1000 are allowed")
    return replace(mesh, vertices=np.asarray(vertices, np.float64), faces=faces.astype(np.int64))


def _glb(path: Path, node: str | None, fps: float) -> MeshSequence:
    from .gltf import Animated

    file = Animated(path)
    parts = file.below(node)
    frames = int(round(file.end * fps, 6)) + 1
    if frames < 2:
        raise InputError(f"{path} is not animated: its last key is at {file.end:g} s")
    if frames > MOST_FRAMES:
        raise InputError(f"{path} lasts {file.end:g} s, at most {MOST_FRAMES} frames at {fps:g} a second are allowed")
    first = file.vertices(parts, 0.0)
    if frames * first.size > MOST_NUMBERS:
        raise InputError(f"{path} has {frames * first.size} coordinates, at most {MOST_NUMBERS} are read")
    rest = [file.vertices(parts, frame / fps) for frame in range(1, frames)]
    before = np.cumsum([0, *(part.corners for part in parts)])
    coloured = all(part.colours is not None for part in parts)
    return MeshSequence(
        vertices=np.stack([first, *rest]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, before, strict=False)]),
        fps=fps,
        colours=np.concatenate([part.colours for part in parts if part.colours is not None]) if coloured else None,
    )


def _npz(path: Path) -> MeshSequence:
    from hoi.record.checks import Refused, check_npz

    try:
        check_npz(path.name, path.read_bytes())
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in ("vertices", "faces", "fps", "colours") if name in file.files}
    except Refused as error:
        raise InputError(f"{path.parent / ''}{error}") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:  # zipfile and numpy raise whatever they trip over
        raise InputError(f"{path} is damaged: {' '.join(str(error).split()) or type(error).__name__}") from error
    missing = [name for name in ("vertices", "faces") if name not in arrays]
    if missing:
        raise InputError(f"{path} lacks {' and '.join(missing)}; it must hold vertices (T, V, 3) and faces (F, 3)")
    if arrays["faces"].dtype.kind not in "iu" or arrays["vertices"].dtype.kind != "f":
        raise InputError(f"{path}: faces must be whole numbers, vertices floating-point ones")
    fps = arrays.get("fps")
    if fps is not None and fps.size != 1:
        raise InputError(f"{path}: fps must be one number, has shape {fps.shape}")
    rate = None if fps is None else float(fps.ravel()[0])
    return MeshSequence(arrays["vertices"], arrays["faces"], rate, arrays.get("colours"))


def _folder(path: Path) -> MeshSequence:
    """One mesh a frame, in the order of the numbers in their names."""
    import trimesh

    files = sorted(
        (file for file in path.iterdir() if file.suffix.lower() in (".obj", ".ply")),
        key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)],
    )
    if not 2 <= len(files) <= MOST_FRAMES:
        raise InputError(f"{path} has {len(files)} .obj or .ply files, 2 to {MOST_FRAMES} are allowed")
    frames, faces = [], np.zeros((0, 3), np.int64)
    for file in files:
        try:
            with open(file, "rb") as stream:
                kind = file.suffix[1:].lower()
                mesh = trimesh.load_mesh(stream, kind, process=False, maintain_order=True, skip_materials=True)
            vertices, now = np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)
        except OSError as error:
            raise InputError(f"{file} cannot be read: {error.strerror}") from error
        except Exception as error:  # as above
            raise InputError(f"{file} is damaged: {' '.join(str(error).split())[:120]}") from error
        if not frames:
            faces = now
        if now.shape != faces.shape or (now != faces).any() or (frames and vertices.shape != frames[0].shape):
            raise InputError(f"{file} has other vertices or faces than {files[0].name}: each must be one mesh, moved")
        frames.append(vertices)
        if len(frames) * vertices.size > MOST_NUMBERS:
            raise InputError(f"{path} has more than {MOST_NUMBERS} coordinates")
    return MeshSequence(np.stack(frames), faces, None)
