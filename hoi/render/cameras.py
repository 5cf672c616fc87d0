"""Pinhole cameras: where they stand so that the picture holds the action, and their exchange as JSON. NumPy alone.

Camera axes are OpenCV's: x right, y down, z forward. The middle of the first pixel is (0.5, 0.5). The person starts
facing +Y, so that the side view sees it walk to the right.
"""

import json
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hoi.data import Array, Camera
from hoi.errors import InputError
from hoi.render.action import Action

WIDTH, HEIGHT = 720, 480
"""[pixel], the paper's."""
FOV_Y = math.radians(35)
"""Opening of the picture from top to bottom."""
MARGIN = 0.06
"""Share of the picture that stays free at each border."""
CLOSEST = 0.2
"""No framed point is nearer to the camera than this [m]."""
CIRCLE_ELEVATION = math.radians(15)
"""Of the paper's circle, which gives no number."""
VIEWS = {
    "front": (0.0, 1.0, 0.15),
    "side": (1.0, 0.0, 0.12),
    "three_quarter": (0.88, 0.47, 0.30),
    "back": (0.0, -1.0, 0.15),
    "top": (0.0, 0.0, 1.0),
    "follow": (0.80, -0.50, 0.30),
}
"""Where the camera stands, seen from the action. "follow" stands behind, so that what is kicked away stays in sight."""
ACTION = "action"
"""The name of the view that is none of these: `hoi.render.director` chooses it."""
TOP_UP = (-1.0, 0.0, 0.0)
"""What is up in the top view: the side view tipped over, so that the person still faces right."""


def look_at(
    eye: ArrayLike,
    target: ArrayLike,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
    fov_y: float = FOV_Y,
    up: ArrayLike = (0, 0, 1),
) -> Camera:
    """The camera at `eye` with `target` in the middle of its picture (both (3,) [m]); see `_axes` for straight down.

    Raises:
        InputError: `eye` and `target` are the same or not finite, or the size or `fov_y` is not allowed.
    """
    eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    return _camera(_axes(target - eye, up), eye, width, height, fov_y)


def project(camera: Camera, points: Array) -> tuple[Array, Array]:
    """World points [m] (..., 3) -> pixels (..., 2) and depths along the axis of view [m] (...).

    Pixels of points that are not in front of the camera mean nothing.
    """
    pose = camera.world_to_camera
    local = np.asarray(points) @ pose[:3, :3].T + pose[:3, 3]
    depth = local[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = local[..., :2] / depth[..., None]
    return plane * (camera.fx, camera.fy) + (camera.cx, camera.cy), depth


def frame_action(
    points: Array,
    direction: ArrayLike,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
    fov_y: float = FOV_Y,
    margin: float = MARGIN,
    up: ArrayLike = (0, 0, 1),
) -> Camera:
    """The nearest camera that looks against `direction` and has all points in its picture, `margin` off its borders.

    Exact: the points touch two opposite margins, and the camera stands midway between where they would touch either of
    the other two.

    Args:
        points: (N, 3) [m], N > 0.
        direction: from the action to the camera, (3,), of any length.

    Raises:
        InputError: as `look_at`, no points or some that are not finite, or `margin` outside [0, 0.5).
    """
    axes = _axes(-np.asarray(direction, np.float64), up)
    tangents = _tangents(width, height, fov_y, margin)
    high, low, back = np.split(_reach(points, _borders(axes, tangents)), (2, 4))
    # side - eye_side <= tangent (depth - eye_depth) for each point, and the same for the opposite side.
    eye_depth = min(*(-(high + low) / (2 * tangents)), -back[0] - CLOSEST)
    return _camera(axes, np.append((high - low) / 2, eye_depth) @ axes, width, height, fov_y)


def fitting_width(
    points: Array, direction: ArrayLike, height: int, aspects: tuple[float, float], up: ArrayLike = (0, 0, 1)
) -> int:
    """The width [pixel] at which `frame_action` fills a picture of `height` on all four sides.

    Args:
        aspects: the least and the largest width / height allowed.

    Raises:
        InputError: as `frame_action`.
    """
    axes = _axes(-np.asarray(direction, np.float64), up)
    least, most = (_tangents(round(height * aspect), height, FOV_Y, MARGIN) for aspect in aspects)
    high, low, back = np.split(_reach(points, _borders(axes, least)), (2, 4))
    eye_depth = min(-(high[1] + low[1]) / (2 * least[1]), -back[0] - CLOSEST)
    side, depth = points @ axes[0], points @ axes[2] - eye_depth
    few, many = least[0], most[0]
    for _ in range(20):  # a wider picture may also move its middle, so that its width is searched for
        tangent = (few + many) / 2
        fits = (side - tangent * depth).max() <= (side + tangent * depth).min()
        few, many = (few, tangent) if fits else (tangent, many)
    return round(height * float(many / least[1]))


def circle(
    points: Array,
    count: int = 100,
    elevation: float = CIRCLE_ELEVATION,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
) -> list[Camera]:
    """Viewpoints evenly spaced on a level circle around the action, all looking at one point from one distance: the
    smallest circle from which each of them has all points in its picture (paper, Implementation Details).

    The first stands in front of the person (+Y); the others follow counter-clockwise seen from above.

    Args:
        points: (N, 3) [m].
        elevation: of the cameras above the horizon of the point they look at, in (-pi/2, pi/2).

    Raises:
        InputError: as `frame_action`, `count` below 1 or `elevation` not allowed.
    """
    from scipy.optimize import linprog

    if count < 1:
        raise InputError(f"camera circle of {count}: at least 1 viewpoint is allowed")
    if not abs(elevation) < math.pi / 2:
        raise InputError(f"camera elevation {elevation:g} rad: between -pi/2 and pi/2 is allowed")
    tangents = _tangents(width, height, FOV_Y, MARGIN)
    turns = math.pi / 2 + 2 * math.pi / count * np.arange(count)
    away = np.column_stack([np.cos(turns), np.sin(turns), np.full(count, math.tan(elevation))])
    views = [_axes(-direction, (0, 0, 1)) for direction in away]
    # With the camera at centre - distance forward, each border is linear in (centre, distance):
    # border . (point - centre) <= tangent distance, for which the outermost point is enough.
    borders = [_borders(axes, tangents) for axes in views]
    outermost = np.concatenate([_reach(points, five) for five in borders])
    scale = np.tile([*tangents, *tangents, 1.0], count)
    rows = -np.column_stack([np.concatenate(borders), scale])
    limits = -outermost - np.tile([0, 0, 0, 0, CLOSEST], count)
    *centre, distance = linprog([0, 0, 0, 1], rows, limits, bounds=[(None, None)] * 3 + [(CLOSEST, None)]).x
    return [_camera(axes, centre - distance * axes[2], width, height) for axes in views]


def view(name: str, action: Action, *, width: int = WIDTH, height: int = HEIGHT) -> Camera | list[Camera]:
    """The camera of `VIEWS[name]` that frames the action; for "follow" one for each frame, of the same direction and
    at the same place beside `Action.path`.

    Raises:
        InputError: no such view, or as `frame_action`.
    """
    if name not in VIEWS:
        raise InputError(f"view {name}: allowed are {', '.join(VIEWS)}")
    up = TOP_UP if name == "top" else (0, 0, 1)
    points = action.points_around_path() if name == "follow" else action.points()
    camera = frame_action(points, VIEWS[name], width=width, height=height, up=up)
    if name != "follow":
        return camera
    axes, beside = camera.world_to_camera[:3, :3], camera.position
    return [_camera(axes, centre + beside, width, height) for centre in action.path()]


def to_json(cameras: Sequence[Camera]) -> str:
    """The cameras with the conventions that their numbers follow."""
    conventions = {
        "camera_axes": "x right, y down, z forward (OpenCV)",
        "world": "z up, right-handed, metres",
        "pixels": "x = fx X / Z + cx, the middle of the first pixel is (0.5, 0.5)",
    }
    rows = [
        {
            "width": camera.width,
            "height": camera.height,
            "K": [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]],
            "world_to_camera": camera.world_to_camera.tolist(),
            "near": camera.near,
        }
        for camera in cameras
    ]
    return json.dumps({"conventions": conventions, "cameras": rows}, indent=1)


def _axes(forward: ArrayLike, up: ArrayLike) -> Array:
    """Unit right, down and forward as rows (3, 3).

    Looking straight along `up`, the picture is that of a camera that faced +Y (or +Z where `up` is that) and tipped.
    """
    forward, up = np.asarray(forward, np.float64), np.asarray(up, np.float64)
    length, height = np.linalg.norm(forward), np.linalg.norm(up)
    if not (np.isfinite(length) and length > 0 and np.isfinite(height) and height > 0):
        raise InputError(f"camera looking along {forward} with {up} up: finite directions other than 0 are allowed")
    forward, up = forward / length, up / height
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        level = np.array((0.0, 1.0, 0.0)) if abs(up[1]) < 0.9 else np.array((0.0, 0.0, 1.0))
        right = np.cross(level, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _camera(axes: Array, eye: Array, width: int, height: int, fov_y: float = FOV_Y) -> Camera:
    if not 0 < fov_y < math.pi:
        raise InputError(f"camera fov_y {fov_y:g} rad: between 0 and pi is allowed")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ eye
    focal = height / 2 / math.tan(fov_y / 2)
    return Camera(width, height, focal, focal, width / 2, height / 2, pose)


def _tangents(width: int, height: int, fov_y: float, margin: float) -> Array:
    """Half of the picture within its margins at depth 1, (2,)."""
    if not 0 <= margin < 0.5:
        raise InputError(f"camera margin {margin:g}: 0 to below 0.5 of the picture is allowed")
    if width < 1 or height < 1:
        raise InputError(f"picture of {width} x {height}: whole numbers of pixels from 1 are allowed")
    if not 0 < fov_y < math.pi:
        raise InputError(f"camera fov_y {fov_y:g} rad: between 0 and pi is allowed")
    return (1 - 2 * margin) * math.tan(fov_y / 2) * np.array([width / height, 1.0])


def _borders(axes: Array, tangents: Array) -> Array:
    """Outward normals (5, 3) of the right, lower, left and upper border of the picture and of the plane through the
    eye, such that a point p is within the picture of a camera at e when normal . (p - e) <= 0; not of unit length."""
    side, forward = axes[:2], axes[2]
    return np.concatenate([side, -side, [-forward]]) - np.append(np.tile(tangents, 2), 0)[:, None] * forward


def _reach(points: Array, normals: Array) -> Array:
    """max_p normal . p over the points (N, 3), for each of the normals."""
    if not len(points) or not np.isfinite(points).all():
        raise InputError(f"camera framing of {len(points)} points: at least one, and finite ones, are allowed")
    return (normals @ np.asarray(points, np.float64).T).max(1)
