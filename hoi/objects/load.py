"""From a name or a file to an object in the scene: metric, Z up, filled, placed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud, Material, SceneObject
from hoi.errors import InputError, about
from hoi.gaussians import files, transform
from hoi.gaussians.files import holds_mesh, load_file_clean
from hoi.objects import cleaning, shapes
from hoi.objects.filling import Filling, fill_cloud, fill_mesh
from hoi.objects.meshes import WAYS, cover, read_mesh
from hoi.objects.thinning import sample, thin

MAX_GAUSSIANS = 60_000

UP = {
    "+z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "+y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "+x": np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]),
    "-x": np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]),
}
"""A file's up axis -> the rotation that brings it to +z. The x axis stays where it is, unless it is the one."""

AUTO = "auto"
"""In place of an axis: what the file says."""


@dataclass(frozen=True)
class LoadedObject:
    """An object on its own: metres, Z up, bounding box of its Gaussians centred at the origin."""

    name: str
    cloud: GaussianCloud
    particles: Array
    """[m], (P, 3); the first rows are `cloud.means`."""
    volumes: Array
    """[m^3], (P,)."""
    size: float
    """Largest extent [m]."""
    notes: tuple[str, ...]
    """What loading did, one line each."""
    drawn: GaussianCloud | None = None
    """What is shown, where that is more than `cloud`."""


def load_builtin(
    shape: str, spacing: float, size: float | None = None, max_gaussians: int = MAX_GAUSSIANS
) -> LoadedObject:
    """A built-in object.

    Args:
        shape: a name in `hoi.objects.shapes.SHAPES`.
        spacing: distance between interior particles [m], about half a cell of the simulation's grid.
        size: largest extent [m]; the object's own by default.
        max_gaussians: more than this are thinned.

    Raises:
        InputError: unknown shape, size not positive, spacing that does not fit the size.
    """
    if shape not in shapes.SHAPES:
        raise InputError(f"object shape {shape!r}: unknown; allowed are {', '.join(sorted(shapes.SHAPES))}")
    kind = shapes.SHAPES[shape]
    size = max(kind.extent) if size is None else size
    _check_lengths(size, spacing)
    surface = shapes.build(kind, size)
    cloud, thinned = sample(surface.cloud, max_gaussians)
    filling = fill_mesh(cloud.means.astype(np.float64), surface.vertices, surface.faces, spacing)
    return _assemble(shape, cloud, filling, size, thinned)


def load_file(
    path: Path,
    size: float,
    up: str,
    spacing: float,
    max_gaussians: int = MAX_GAUSSIANS,
    name: str | None = None,
    max_drawn: int | None = None,
) -> LoadedObject:
    """An object from a file: Gaussians, cleaned (see `hoi.objects.cleaning`), or a mesh (see `hoi.objects.meshes`).

    Args:
        path: see `hoi.gaussians.read_file`; or a .glb, .gltf, .obj, .ply or .stl with triangles.
        size: largest extent of the cleaned object [m]; files are not metric.
        up: the file's up axis, a key of `UP`, or "auto", which takes what the file or else its format says.
        spacing: distance between interior particles [m], about half a cell of the simulation's grid.
        max_gaussians: of the surface that is simulated, whose particles they are; more than this are thinned.
        max_drawn: of what is shown; None shows what is simulated.

    Raises:
        InputError: the file cannot be used, unknown up axis, size not positive, spacing that does not fit the size.
    """
    path = Path(path)
    if up not in (AUTO, *UP):
        raise InputError(f"object up axis {up!r}: unknown; allowed are {AUTO}, {', '.join(UP)}")
    if max_gaussians < 1:
        raise InputError(f"object max_gaussians {max_gaussians}: must be at least 1")
    _check_lengths(size, spacing)
    shown = max(max_gaussians, max_drawn or 0)
    if holds_mesh(path):
        return _of_mesh(path, size, up, spacing, max_gaussians, shown, name)
    it = load_file_clean(path)
    notes = list(it.notes)
    if up == AUTO:
        up = it.up
        notes.append(f"up is {up}: {it.why}")
    with about(path):
        cloud, cleaned = cleaning.clean(it.cloud)
    lower, upper = cloud.means.min(0).astype(np.float64), cloud.means.max(0).astype(np.float64)
    scale = size / (upper - lower).max()
    whole = transform(cloud, UP[up], scale, -scale * UP[up] @ (lower + upper) / 2)
    cloud, thinned = thin(whole, max_gaussians)
    loaded = _assemble(name or path.stem, cloud, fill_cloud(cloud, spacing), size, [*notes, *cleaned, *thinned])
    return _drawing(loaded, whole, shown)


def _of_mesh(
    path: Path, size: float, up: str, spacing: float, max_gaussians: int, shown: int, name: str | None
) -> LoadedObject:
    """An object of a mesh file: covered with Gaussians, and filled."""
    mesh, notes = read_mesh(path), []
    if up == AUTO:
        up, why = WAYS[path.suffix.lower()]
        notes.append(f"up is {up}: {why}")
    lower, upper = mesh.vertices.min(0), mesh.vertices.max(0)
    scale = size / (upper - lower).max()
    shift = -scale * UP[up] @ (lower + upper) / 2
    whole = transform(cover(mesh, scale, shown), UP[up], scale, shift)
    if len(whole) < 2:
        raise InputError(f"{path}: a mesh of which nothing is seen: all of it is transparent")
    cloud, thinned = thin(whole, max_gaussians)
    kind = (
        "a watertight mesh, filled as one"
        if mesh.watertight
        else "a mesh with holes or loose faces, filled like a capture"
    )
    notes.append(f"{kind}: {len(mesh.faces)} triangles in {len(mesh.parts)} part{'s' * (len(mesh.parts) > 1)}")
    if mesh.watertight:
        vertices = scale * mesh.vertices @ UP[up].T + shift
        filling = fill_mesh(cloud.means.astype(np.float64), vertices, mesh.faces, spacing)
    else:
        filling = fill_cloud(cloud, spacing)
    return _drawing(_assemble(name or path.stem, cloud, filling, size, [*notes, *thinned]), whole, shown)


def _drawing(loaded: LoadedObject, whole: GaussianCloud, most: int) -> LoadedObject:
    """The object with all of `whole`, up to `most`, to be drawn where that is more than it has."""
    drawn, notes = thin(whole, most)
    if len(drawn) <= len(loaded.cloud) or most <= len(loaded.cloud):
        return loaded
    return replace(loaded, drawn=drawn, notes=(*loaded.notes, *notes, f"{len(drawn)} Gaussians drawn"))


def up_in(path: Path) -> tuple[str, str]:
    """The axis of a file that `up="auto"` takes, and what says so.

    Raises:
        InputError: the file cannot be read.
    """
    return WAYS[path.suffix.lower()] if holds_mesh(path) else files.up_in(path)


def load_cloud(name: str, cloud: GaussianCloud, spacing: float, max_gaussians: int = MAX_GAUSSIANS) -> LoadedObject:
    """An object of Gaussians in memory [m], Z up, as they are: not cleaned, but thinned to `max_gaussians` and filled.

    Raises:
        InputError: no Gaussians, or a spacing that does not fit their extent.
    """
    if len(cloud) == 0:
        raise InputError(f"object {name}: a cloud without Gaussians")
    cloud, thinned = thin(cloud, max_gaussians)
    size = float(np.ptp(cloud.means, axis=0).max())
    _check_lengths(size, spacing)
    return _assemble(name, cloud, fill_cloud(cloud, spacing), size, thinned)


def place(
    loaded: LoadedObject,
    material: Material,
    position: Sequence[float | None] = (0.0, 1.0, None),
    yaw: float = 0.0,
    orientation: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    angular_velocity: Sequence[float] = (0.0, 0.0, 0.0),
) -> SceneObject:
    """Put an object into the world at t = 0.

    Args:
        position: where the centre of its bounding box goes [m]; a z of None sets it down on the ground.
        yaw: turn about the vertical [rad], after `orientation`.
        orientation: quaternion wxyz of any length.
        velocity: of the centre of mass [m/s].
        angular_velocity: about the centre of mass [rad/s].

    Raises:
        InputError: a value is not finite or of the wrong length.
    """
    x, y, z = _vector("position", [0.0 if i == 2 and v is None else v for i, v in enumerate(position)], 3)
    on_ground = position[2] is None
    quaternion = _vector("orientation", orientation, 4)
    if not quaternion.any():
        raise InputError("object orientation (0, 0, 0, 0): a quaternion wxyz must not be zero")
    (heading,) = _vector("yaw", [yaw], 1)
    rotation = (Rotation.from_euler("z", heading) * Rotation.from_quat(quaternion, scalar_first=True)).as_matrix()
    turned = loaded.particles @ rotation.T
    means = turned[: len(loaded.cloud)]
    lower, upper = means.min(0), means.max(0)
    translation = np.array([x, y, z]) - (lower + upper) / 2
    if on_ground:
        translation[2] = -turned[:, 2].min()
    cloud = transform(loaded.cloud, rotation, 1.0, translation)
    particles = np.concatenate([cloud.means, turned[len(cloud) :] + translation]).astype(np.float32)
    return SceneObject(
        name=loaded.name,
        cloud=cloud,
        particles=particles,
        volumes=loaded.volumes,
        material=material,
        velocity=_vector("velocity", velocity, 3),
        angular_velocity=_vector("angular_velocity", angular_velocity, 3),
        size=loaded.size,
        notes=loaded.notes,
        drawn=None if loaded.drawn is None else transform(loaded.drawn, rotation, 1.0, translation),
    )


def _assemble(name: str, cloud: GaussianCloud, filling: Filling, size: float, notes: list[str]) -> LoadedObject:
    particles = np.concatenate([cloud.means, filling.interior]).astype(np.float32)
    filled = (
        f"{len(cloud)} Gaussians, {len(filling.interior)} particles inside, {filling.volumes.sum():.3g} m^3 solid, "
        f"{filling.enclosed:.0%} of it within a closed surface"
    )
    return LoadedObject(name, cloud, particles, filling.volumes.astype(np.float32), float(size), (*notes, filled))


def _check_lengths(size: float, spacing: float) -> None:
    if not (np.isfinite(size) and size > 0):
        raise InputError(f"object size {size}: must be a positive length in metres")
    if not (np.isfinite(spacing) and 0 < spacing <= size / 4):
        raise InputError(
            f"particle spacing {spacing}: must be positive and at most a quarter of the size, {size / 4:g}"
        )


def _vector(field: str, values: Sequence[float | None], length: int) -> Array:
    try:
        vector = np.array(values, np.float64)
    except (TypeError, ValueError):
        vector = np.full(1, np.nan)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise InputError(f"object {field} {values}: must be {length} finite number{'s' * (length > 1)}")
    return vector
