"""Capture-like clouds with a truth: which Gaussians are the thing, and what lies around it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from bodies import cloud_of
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud
from hoi.gaussians import fibonacci_sphere


def join(*clouds: GaussianCloud) -> GaussianCloud:
    names = ("means", "quaternions", "scales", "opacities", "sh")
    return GaussianCloud(*(np.concatenate([getattr(c, n) for c in clouds]) for n in names))


def flat(points: Array, normals: Array, size: float, rgb: object = 0.5, opacity: float = 0.9) -> GaussianCloud:
    """Flat Gaussians along a surface, a tenth as thick as wide, turned about their normals at random."""
    cloud = cloud_of(points, size, rgb, opacity)
    cloud.scales[:, 2] = size / 10
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0.0, 1, 0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    turns = Rotation.from_matrix(np.stack([first, np.cross(normals, first), normals], 2))
    spin = Rotation.from_euler("z", np.random.default_rng(9).uniform(0, 6.3, (len(points), 1)))
    cloud.quaternions[:] = (turns * spin).as_quat(scalar_first=True)
    return cloud


def box(extent: Array, centre: Array, spacing: float, rgb: object = 0.5, jitter: float = 0.2) -> GaussianCloud:
    """The six faces of a box, a Gaussian a tile of about `spacing`."""
    rng = np.random.default_rng(1)
    points, normals = [], []
    for axis, side in ((axis, side) for axis in range(3) for side in (-1, 1)):
        across = [a for a in range(3) if a != axis]
        counts = np.maximum(1, np.rint(np.asarray(extent)[across] / spacing)).astype(int)
        tiles = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), -1).reshape(-1, 2)
        face = np.zeros((len(tiles), 3))
        face[:, across] = ((tiles + 0.5 + rng.uniform(-jitter, jitter, tiles.shape)) / counts - 0.5) * np.asarray(
            extent
        )[across]
        face[:, axis] = side * extent[axis] / 2
        points.append(face + centre)
        normals.append(np.tile(side * np.eye(3)[axis], (len(face), 1)))
    return flat(np.concatenate(points), np.concatenate(normals), 0.6 * spacing, rgb)


def ball(radius: float, centre: Array, spacing: float, rgb: object = 0.5) -> GaussianCloud:
    normals = fibonacci_sphere(int(4 * np.pi * radius**2 / spacing**2))
    return flat(radius * normals + centre, normals, 0.6 * spacing, rgb)


def tube(start: Array, end: Array, radius: float, spacing: float, rgb: object = 0.5) -> GaussianCloud:
    """The side of a cylinder from one point to another."""
    axis = np.subtract(end, start)
    length = np.linalg.norm(axis)
    frame = np.linalg.svd(axis[None] / length)[2]
    rows, around = max(2, round(length / spacing)), max(6, round(2 * np.pi * radius / spacing))
    i, j = np.divmod(np.arange(rows * around), around)
    angle = 2 * np.pi * (j + 0.5 * (i % 2)) / around
    out = np.cos(angle)[:, None] * frame[1] + np.sin(angle)[:, None] * frame[2]
    return flat(np.asarray(start) + ((i + 0.5) / rows)[:, None] * axis + radius * out, out, 0.6 * spacing, rgb)


def ring(centre: Array, radius: float, thickness: float, spacing: float) -> GaussianCloud:
    """A torus in the x-z plane, as a handle is."""
    rows, around = round(2 * np.pi * radius / spacing), max(6, round(2 * np.pi * thickness / spacing))
    i, j = np.divmod(np.arange(rows * around), around)
    u, v = 2 * np.pi * i / rows, 2 * np.pi * j / around
    out = np.column_stack([np.cos(u) * np.cos(v), np.sin(v), np.sin(u) * np.cos(v)])
    middle = radius * np.column_stack([np.cos(u), 0 * u, np.sin(u)])
    return flat(np.asarray(centre) + middle + thickness * out, out, 0.6 * spacing)


@dataclass(frozen=True)
class Capture:
    thing: GaussianCloud
    around: GaussianCloud

    @property
    def cloud(self) -> GaussianCloud:
        return join(self.thing, self.around)


def haze(seed: int, count: int = 600, reach: float = 2.0) -> GaussianCloud:
    """Faint Gaussians of many sizes all over the place."""
    rng = np.random.default_rng(seed)
    cloud = cloud_of(rng.uniform(-reach, reach, (count, 3)), 1.0)
    cloud.scales[:] = np.exp(rng.uniform(np.log(0.005), np.log(0.1), (count, 3)))
    cloud.opacities[:] = rng.uniform(0.01, 0.2, count)
    return cloud


def dome(radius: float = 8.0, count: int = 500) -> GaussianCloud:
    """A background of large opaque Gaussians all around."""
    normals = fibonacci_sphere(count)
    return flat(radius * normals, normals, 1.2 * radius * (4 * np.pi / count) ** 0.5 / 2)


def dust(seed: int, count: int = 80) -> GaussianCloud:
    """Opaque specks that float, well away."""
    rng = np.random.default_rng(seed)
    where = rng.normal(size=(count, 3))
    where *= rng.uniform(1.3, 4, (count, 1)) / np.linalg.norm(where, axis=1, keepdims=True)
    return cloud_of(where, 0.01)


def statue() -> Capture:
    """A finely captured ball on a plain plinth of 96 large Gaussians."""
    thing = join(ball(0.25, [0, 0, 0.25], 0.008), box([0.5, 0.5, 0.8], [0, 0, -0.4], 0.125))
    return Capture(thing, join(haze(0), dome()))


def stool() -> Capture:
    """A finely captured seat on four thin, plain legs that end a seam below it."""
    seat = box([0.5, 0.5, 0.04], [0, 0, 0.4], 0.008)
    legs = [tube([x, y, -0.3], [x, y, 0.37], 0.012, 0.012) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    return Capture(join(seat, *legs), join(haze(1), dome()))


def mug() -> Capture:
    """A mug with a handle."""
    body = join(tube([0, 0, -0.3], [0, 0, 0.3], 0.25, 0.012), tube([0, 0, -0.28], [0, 0, 0.3], 0.23, 0.012))
    return Capture(join(body, ring([0.4, 0, 0], 0.15, 0.02, 0.01)), join(haze(2), dome(6.0, 300), dust(2)))


def labelled() -> Capture:
    """A plain ball of few large Gaussians with a label of very many tiny ones on it."""
    u, v = np.random.default_rng(3).uniform(-0.1, 0.1, (2, 6000))
    points = np.column_stack([u, -np.sqrt(0.25**2 - u**2 - v**2), v])
    return Capture(join(ball(0.25, [0, 0, 0], 0.035), flat(points, points, 0.002)), join(haze(3, 500, 1.0), dome(5.0)))


def crate() -> Capture:
    """An opaque box of 216 large Gaussians."""
    return Capture(box([1.0, 1.0, 1.0], [0, 0, 0], 1 / 6, jitter=0), join(haze(4), dust(4)))


def bottles() -> Capture:
    """Two unlike things side by side, nearly their height apart."""
    first = join(
        tube([0, 0, -0.5], [0, 0, 0.2], 0.2, 0.02), ball(0.2, [0, 0, 0.2], 0.02), ball(0.2, [0, 0, -0.5], 0.02)
    )
    second = join(tube([1.1, 0, -0.5], [1.1, 0, 0], 0.12, 0.04), ball(0.12, [1.1, 0, 0], 0.04))
    return Capture(join(first, second), join(haze(5), dome(9.0, 800)))


CAPTURES: dict[str, Callable[[], Capture]] = {
    made.__name__: made for made in (statue, stool, mug, labelled, crate, bottles)
}
