"""The built-in objects: closed meshes with a pattern, covered with flat Gaussians.

Metres, Z up, the centre at the origin. The cabinet's drawers face -y, towards a person at the origin when it stands in
front of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud
from hoi.gaussians import fibonacci_sphere, sh_from_colours
from hoi.objects import relief as reliefs
from hoi.objects.relief import TILT, Relief, surface_of

Pattern = Callable[[Array, Array], Array]
"""Surface points [m] (N, 3) of the shape at its own size and outward normals (N, 3) -> RGB (N, 3)."""

SPACING = 0.005
"""Wanted distance between neighbouring Gaussians [m]: below the contact distance of 1 cm (paper, Contact Detection)."""
MIN_GAUSSIANS, MAX_GAUSSIANS = 1000, 12000
OPACITY = 0.92
_WIDTH = 0.62  # standard deviation in spacings: neighbours blend without gaps
_THICKNESS = 0.08  # likewise, along the normal
_RIM = 0.7  # width of a box's outermost Gaussians beside the others
_SPHERE_SUBDIVISIONS = 4
_SECTIONS = 64  # of a cylinder


@dataclass(frozen=True)
class Shape:
    """A ball, a box or an upright cylinder with a pattern."""

    kind: str
    """"ball", "box" or "cylinder"."""
    extent: tuple[float, float, float]
    """Bounding box [m]."""
    pattern: Pattern
    relief: Relief | None = None
    """Heights that only light sees."""
    front_detail: float = 1.0
    """A box's front (-y) has this many times as many Gaussians a metre, for what is drawn on it [-]."""


@dataclass(frozen=True)
class Surface:
    """A built-in object at its final size."""

    cloud: GaussianCloud
    vertices: Array
    """Closed mesh [m], (V, 3)."""
    faces: NDArray[np.integer]
    """Triangles, outward, (F, 3)."""


def build(shape: Shape, size: float) -> Surface:
    """Mesh and Gaussians of a shape whose largest extent is `size` [m]."""
    import trimesh

    scale = size / max(shape.extent)
    extent = scale * np.array(shape.extent)
    if shape.kind == "ball":
        mesh = trimesh.creation.icosphere(subdivisions=_SPHERE_SUBDIVISIONS, radius=size / 2)
        points, frames, footprints = _cover_sphere(size / 2)
    elif shape.kind == "cylinder":
        mesh = trimesh.creation.cylinder(extent[0] / 2, extent[2], sections=_SECTIONS)
        points, frames, footprints = _cover_cylinder(extent[0] / 2, extent[2])
    else:
        mesh = trimesh.creation.box(extents=extent)
        points, frames, footprints = _cover_box(extent, shape.front_detail)
    surface = surface_of(shape.relief, points, frames, footprints, scale)
    cloud = GaussianCloud(
        means=points.astype(np.float32),
        quaternions=Rotation.from_matrix(frames).as_quat(scalar_first=True).astype(np.float32),
        scales=np.column_stack([_WIDTH * footprints, _THICKNESS * footprints.min(1)]).astype(np.float32),
        opacities=np.full(len(points), OPACITY, np.float32),
        sh=sh_from_colours(_average(shape.pattern, points, frames, footprints, scale)),
        surface=surface.astype(np.float16),
    )
    return Surface(cloud, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces))


# --- covering a surface ----------------------------------------------------------------------------------------------


def _count(area: float) -> int:
    return int(np.clip(area / SPACING**2, MIN_GAUSSIANS, MAX_GAUSSIANS))


def _cover_sphere(radius: float) -> tuple[Array, Array, Array]:
    """Points (N, 3), frames (N, 3, 3) with columns tangent, tangent, normal, and footprints (N, 2) [m]."""
    area = 4 * np.pi * radius**2
    normals = fibonacci_sphere(_count(area))
    first = np.cross([0.0, 0.0, 1.0], normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(normals, first), normals], 2)
    return radius * normals, frames, np.full((len(normals), 2), np.sqrt(area / len(normals)))


def _cover_box(extent: Array, front_detail: float) -> tuple[Array, Array, Array]:
    """The same for a box: each face is cut into equal, nearly square tiles with a Gaussian in the middle."""
    a, b, c = extent
    area = 2 * (a * b + b * c + c * a)
    spacing = np.sqrt((area + (front_detail**2 - 1) * a * c) / _count(area))
    points, frames, footprints = [], [], []
    for axis, side in ((axis, side) for axis in range(3) for side in (-1, 1)):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        finer = front_detail if (axis, side) == (1, -1) else 1.0
        counts = np.maximum(1, np.rint(extent[across] / spacing * finer)).astype(int)
        tile = extent[across] / counts
        index = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), -1).reshape(-1, 2)
        face = np.zeros((len(index), 3))
        face[:, across] = (index + 0.5) * tile - extent[across] / 2
        face[:, axis] = side * extent[axis] / 2
        frame = np.zeros((3, 3))
        frame[across[0], 0], frame[across[1], 1], frame[axis, 2] = side, 1, side
        rim = (index == 0) | (index == counts - 1)  # narrower, so that edges stay sharp
        points.append(face)
        frames.append(np.broadcast_to(frame, (len(index), 3, 3)))
        footprints.append(np.where(rim, _RIM, 1.0) * tile)
    return np.concatenate(points), np.concatenate(frames), np.concatenate(footprints)


def _cover_cylinder(radius: float, height: float) -> tuple[Array, Array, Array]:
    """The same for an upright cylinder: rings around its side, and rings on its ends."""
    spacing = np.sqrt(2 * np.pi * radius * (height + radius) / _count(2 * np.pi * radius * (height + radius)))
    rows, rings = max(1, round(height / spacing)), max(1, round(radius / spacing))
    levels = (np.arange(rows) + 0.5) * height / rows - height / 2
    bands = [(radius, level, height / rows, 0) for level in levels]
    widths = (np.arange(rings) + 0.5) * radius / rings
    bands += [(width, end * height / 2, radius / rings, end) for end in (-1, 1) for width in widths]
    points, frames, footprints = [], [], []
    for width, level, across, end in bands:
        count = max(1, round(2 * np.pi * width / spacing))
        angle = 2 * np.pi * (np.arange(count) + 0.5) / count
        out = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        along = np.column_stack([-out[:, 1], out[:, 0], 0 * angle])
        normal = out if end == 0 else np.broadcast_to([0.0, 0.0, end], out.shape)
        points.append(width * out + [0, 0, level])
        frames.append(np.stack([along, np.cross(normal, along), normal], 2))
        footprints.append(np.tile([2 * np.pi * width / count, across], (count, 1)))
    return np.concatenate(points), np.concatenate(frames), np.concatenate(footprints)


def _average(pattern: Pattern, points: Array, frames: Array, footprints: Array, scale: float) -> Array:
    """Mean colour over each Gaussian's footprint, so that lines finer than the Gaussians stay lines."""
    steps = [(i, j) for i in np.linspace(-0.6, 0.6, 5) for j in np.linspace(-0.6, 0.6, 5)]
    first, second, normals = np.moveaxis(frames, 2, 0)
    moved = (points + i * footprints[:, :1] * first + j * footprints[:, 1:] * second for i, j in steps)
    return np.mean([pattern(p / scale, normals) for p in moved], axis=0)


# --- patterns --------------------------------------------------------------------------------------------------------


def _soccer(points: Array, normals: Array) -> Array:
    """Truncated icosahedron: 12 black pentagons, 20 white hexagons, grey seams."""
    import trimesh

    icosahedron = trimesh.creation.icosahedron()
    pentagons, hexagons = np.asarray(icosahedron.vertices), np.asarray(icosahedron.triangles_center)
    pentagons, hexagons = (n / np.linalg.norm(n, axis=1, keepdims=True) for n in (pentagons, hexagons))
    # A direction lies in the face whose plane it meets first; distances of the planes for edge length 1.
    directions = points / np.linalg.norm(points, axis=1, keepdims=True) @ TILT
    reach = np.concatenate([directions @ pentagons.T / 2.32744, directions @ hexagons.T / 2.26728], 1)
    best = np.partition(reach, -2, axis=1)
    rgb = np.full((len(points), 3), 0.93)
    rgb[best[:, -1] - best[:, -2] < 0.006] = 0.45
    rgb[reach.argmax(1) < 12] = 0.06
    return rgb


def _basketball(points: Array, normals: Array) -> Array:
    """Orange with the eight panels' dark seams: two great circles and two bowed ones."""
    _, y, z = (points / np.linalg.norm(points, axis=1, keepdims=True) @ TILT).T
    rgb = np.tile([0.85, 0.40, 0.13], (len(points), 1))
    seam = np.minimum.reduce([np.abs(y), np.abs(z), np.abs(np.abs(y) - 0.52 - 0.34 * z**2)]) < 0.028
    rgb[seam] = [0.10, 0.07, 0.06]
    return rgb


def _blue(points: Array, normals: Array) -> Array:
    """Blue with a white band, so that its spin can be seen."""
    rgb = np.tile([0.10, 0.32, 0.80], (len(points), 1))
    rgb[np.abs(points @ [0.36, 0.48, 0.8]) < 0.014] = [0.92, 0.94, 0.97]
    return rgb


def _cabinet(points: Array, normals: Array) -> Array:
    """Grey steel with four drawers; each has a gap around it, a label and a handle."""
    width, _, height = FILE_CABINET_EXTENT
    x, z = points[:, 0], points[:, 2]
    rgb = np.tile([0.58, 0.60, 0.62], (len(points), 1))
    front = normals[:, 1] < -0.5
    drawers = 4
    drawer_height = (height - 0.06) / drawers
    level = (z + height / 2 - 0.03) / drawer_height
    within = (level - np.floor(level) - 0.5) * drawer_height  # height above the drawer's middle
    inside = front & (np.abs(x) < width / 2 - 0.02) & (level > 0) & (level < drawers)
    edge = (np.abs(within) > drawer_height / 2 - 0.007) | (np.abs(x) > width / 2 - 0.034)
    rgb[inside] = [0.66, 0.68, 0.70]
    rgb[inside & edge] = [0.18, 0.19, 0.20]
    rgb[inside & (np.abs(x) < 0.075) & (np.abs(within - 0.005) < 0.013)] = [0.12, 0.12, 0.13]
    rgb[inside & (np.abs(x) < 0.045) & (np.abs(within - 0.06) < 0.018)] = [0.93, 0.92, 0.86]
    rgb[(z < -height / 2 + 0.025) & (np.abs(normals[:, 2]) < 0.5)] = [0.15, 0.15, 0.16]
    return rgb


def _cardboard(points: Array, normals: Array) -> Array:
    """Brown with packing tape over the seam between the flaps."""
    half = CARDBOARD_BOX_EXTENT[0] / 2
    x, y, z = points.T
    lying = np.abs(normals[:, 2]) > 0.5
    rgb = np.tile([0.66, 0.49, 0.31], (len(points), 1))
    rgb *= 1 + 0.03 * np.sin(2 * np.pi * np.where(lying, y, x + y) / 0.05)[:, None]  # the flutes show through
    rgb[np.sort(np.abs(points), 1)[:, 1] > half - 0.008] = [0.50, 0.36, 0.22]
    rgb[lying & (np.abs(x) < 0.004)] = [0.35, 0.25, 0.15]
    taped = (np.abs(x) < 0.026) & (lying | ((np.abs(normals[:, 1]) > 0.5) & (np.abs(z) > half - 0.07)))
    rgb[taped] = [0.80, 0.68, 0.46]
    return rgb


def _beach_ball(points: Array, normals: Array) -> Array:
    """Six gores, every other one white, and a white cap at either end."""
    x, y, z = (points / np.linalg.norm(points, axis=1, keepdims=True) @ TILT).T
    colours = np.array([[0.86, 0.16, 0.14], [0.95, 0.95, 0.93], [0.98, 0.78, 0.10],
                        [0.95, 0.95, 0.93], [0.10, 0.40, 0.80], [0.95, 0.95, 0.93]])  # fmt: skip
    rgb = colours[(np.arctan2(y, x) // (np.pi / 3)).astype(int) % 6]
    rgb[np.abs(z) > 0.95] = [0.95, 0.95, 0.93]
    return rgb


def _speckled(colour: tuple[float, float, float], depth: float, grain: float) -> Pattern:
    """One colour, lighter and darker from grain to grain [m], edges a little paler: foam, clay, snow."""

    def pattern(points: Array, normals: Array) -> Array:
        cells = np.floor(points / grain).astype(np.int64)
        noise = np.sin(cells @ np.array([127.1, 311.7, 74.7])) * 43758.5453
        rgb = np.array(colour) * (1 + depth * (2 * (noise - np.floor(noise)) - 1))[:, None]
        edge = np.sort(np.abs(points), 1)[:, 1] > 0.47 * np.ptp(points, axis=0).max()
        rgb[edge] = 0.75 * rgb[edge] + 0.25
        return rgb.clip(0, 1)

    return pattern


def _jelly(points: Array, normals: Array) -> Array:
    """Red, paler towards the top and where it is thin, along its edges, since light gets through there as
    exp(-thickness / `JELLY_DEPTH`); on a stand of planks."""
    half = JELLY_BLOCK_EXTENT[2] / 2
    height = ((points[:, 2] / half + 1) / 2 - (1 - JELLY_SHARE)) / JELLY_SHARE
    rgb = np.array([0.62, 0.04, 0.08]) + height[:, None] * np.array([0.26, 0.10, 0.10])
    inward = np.array(JELLY_BLOCK_EXTENT) / 2 - np.abs(points)
    inward[:, 2] = half - points[:, 2]
    through = 0.75 * np.exp(-np.sort(inward, 1)[:, 1] / JELLY_DEPTH)[:, None]  # past the face itself, an edge
    rgb += through * (np.array([1.0, 0.52, 0.46]) - rgb)
    planks = np.abs(points[:, 2] / 0.12 - np.rint(points[:, 2] / 0.12)) > 0.46
    rgb[height < 0] = [0.60, 0.44, 0.28]
    rgb[(height < 0) & planks] = [0.36, 0.25, 0.15]
    return rgb


def _sand_bag(points: Array, normals: Array) -> Array:
    """Red leather in panels, two black bands and a black foot."""
    angle, z = np.arctan2(points[:, 1], points[:, 0]), points[:, 2] / SAND_BAG_EXTENT[2] + 0.5
    rgb = np.tile([0.62, 0.10, 0.09], (len(points), 1))
    seam = np.abs((angle / (np.pi / 2)) % 1 - 0.5) > 0.49
    rgb[seam] = [0.36, 0.06, 0.05]
    rgb[(np.abs(z - 0.3) < 0.02) | (np.abs(z - 0.8) < 0.02) | (z < 0.08)] = [0.08, 0.08, 0.09]
    rgb[normals[:, 2] > 0.5] = [0.30, 0.05, 0.05]
    return rgb


FILE_CABINET_EXTENT = (0.46, 0.62, 1.0)
SAND_BAG_EXTENT = (0.3, 0.3, 0.45)
CARDBOARD_BOX_EXTENT = (0.4, 0.4, 0.4)
JELLY_BLOCK_EXTENT = (0.4, 0.4, 1.2)
JELLY_DEPTH = 0.03
"""How far red light gets into it [m]."""
JELLY_SHARE = 0.3
"""Of its height; the rest is the stand."""

SHAPES = {
    "soccer_ball": Shape("ball", (0.22, 0.22, 0.22), _soccer, reliefs.soccer),
    "basketball": Shape("ball", (0.24, 0.24, 0.24), _basketball, reliefs.basketball),
    "blue_ball": Shape("ball", (0.22, 0.22, 0.22), _blue),
    "file_cabinet": Shape("box", FILE_CABINET_EXTENT, _cabinet, reliefs.cabinet(FILE_CABINET_EXTENT), front_detail=1.7),
    "cardboard_box": Shape("box", CARDBOARD_BOX_EXTENT, _cardboard, reliefs.cardboard),
    "beach_ball": Shape("ball", (0.4, 0.4, 0.4), _beach_ball),
    "foam_cube": Shape("box", (0.5, 0.5, 0.5), _speckled((0.93, 0.84, 0.45), 0.03, 0.012), reliefs.pores(0.03, 0.002)),
    "jelly_block": Shape("box", JELLY_BLOCK_EXTENT, _jelly, reliefs.jelly),
    "clay_block": Shape("box", (0.2, 0.2, 0.2), _speckled((0.58, 0.36, 0.24), 0.10, 0.025), reliefs.rough(0.05, 0.004)),
    "sand_bag": Shape("cylinder", SAND_BAG_EXTENT, _sand_bag, reliefs.sand_bag),
    "snow_block": Shape("box", (0.3, 0.3, 0.3), _speckled((0.90, 0.93, 0.97), 0.04, 0.02), reliefs.rough(0.06, 0.004)),
}
