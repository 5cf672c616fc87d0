"""Whether somebody can move like that: what tells a wrong unit, frame rate or up axis from how people walk and turn."""

import numpy as np
import roma
import torch

from hoi.body.kinematics import forward_kinematics
from hoi.body.skeleton import JOINT_NAMES
from hoi.data import Array

SLOWEST, FASTEST = 1.0, 2000.0
"""Frame rates of motions [1/s]."""
WHOLE = 0.005
"""Rates are whole numbers, by so much."""
RUN = 13.0
"""No person goes so fast for a second [m/s]."""
TURN = 20.0
"""Nor turns the limbs so fast, their mean in all but a twentieth of frames [rad/s]: the fastest of 772 clips: 10.8."""
LIMBS = [
    JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee", "shoulder", "elbow")
]
FEET = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
UNITS = {"centimetres": 1e-2, "millimetres": 1e-3}
HEIGHTS = (0.3, 1.5)
"""Of a pelvis above the origin [m]."""
HIGH = 30.0
"""No pelvis is so high above the origin [m]."""
SLIDES, LESS, FAR_AWAY = 1.0, 0.35, 50.0
"""Feet that slide so fast [m/s], and this much less in another unit, so far from the origin [m], tell that unit."""
CAMERAS = (0.6, 12.0)
"""How far people are from cameras [m]."""
STANDS, SLOPE, FAR_ENOUGH, ENOUGH = 0.3, 10.0, 1.0, 10
"""A foot so slow stands [m/s]; a floor steeper than this [degrees] is said, told by so many steps over so far [m]."""


def rate_of(frame_time: float) -> tuple[float, tuple[str, ...]]:
    """Frames a second where a frame is said to last so long [s]; one of a second or more is a rate, or milliseconds."""
    if not SLOWEST < 1 / frame_time < FASTEST:
        rate = 1000 / frame_time
        if abs(frame_time - round(frame_time)) > WHOLE and abs(rate - round(rate)) < WHOLE * rate:
            return rate, (f"a frame time of {frame_time:g} read as milliseconds: {rate:g} Hz",)
        if SLOWEST < frame_time < FASTEST:
            return frame_time, (f"a frame time of {frame_time:g} read as the rate: {frame_time:g} Hz",)
    return 1 / frame_time, ()


def speed_of(path: Array, rate: float) -> float:
    """The fastest second of a path (F, 3) [m/s]."""
    step = min(max(round(rate), 1), len(path) - 1)
    return float(np.linalg.norm(path[step:] - path[:-step], axis=1).max()) * rate / step if step else 0.0


def turning(local: Array, rate: float) -> float:
    """How fast the limbs turn in local rotations (F, J, 3, 3): their mean, in all but one in twenty frames [rad/s]."""
    if len(local) < 2:
        return 0.0
    limbs = torch.from_numpy(np.ascontiguousarray(local[:, LIMBS]))
    angles = roma.rotmat_geodesic_distance(limbs[:-1], limbs[1:]).numpy()
    return float(np.percentile(angles.mean(axis=1), 95)) * rate


def is_possible(path: Array, local: Array, rate: float) -> bool:
    return speed_of(path, rate) <= RUN and turning(local, rate) <= TURN


def unit_of(path: Array, local: Array, rate: float, rest_joints: Array) -> tuple[str, float, str]:
    """The unit of a pelvis' path (F, 3) that a person can go in, its size [m], and why not metres; "" where nobody can.

    In another unit the person would run too fast, be too high, or slide on feet that stand.
    """
    turns, rest = (torch.from_numpy(np.asarray(array, np.float64)) for array in (local, rest_joints))
    feet = forward_kinematics(turns, torch.zeros(len(path), 3, dtype=torch.float64), rest)[1][:, FEET].numpy()

    def sliding(size: float) -> float:
        """Half of the time the foot that stands is slower [m/s]."""
        if len(path) < 2:
            return 0.0
        moved = np.linalg.norm(np.diff(feet + size * path[:, None], axis=0), axis=-1).min(axis=1)
        return float(np.median(moved)) * rate

    up = local[:, 0, :, 1].mean(axis=0)
    height = float(np.abs(path @ (up / max(np.linalg.norm(up), 1e-9))).mean())
    speed = speed_of(path, rate)
    possible = {unit: size for unit, size in UNITS.items() if speed * size <= RUN}
    fits = {unit: size for unit, size in possible.items() if HEIGHTS[0] < height * size < HEIGHTS[1]}
    unit, size = min((fits or possible).items(), key=lambda each: sliding(each[1]), default=("", 1.0))
    if speed > RUN:
        return unit, size, f"in metres the person would go at {speed:.0f} m/s"
    if height > HIGH and fits:
        return unit, size, f"in metres the pelvis would be {height:.0f} m from the origin, along the body"
    away = float(np.linalg.norm(path, axis=1).mean())
    if away > FAR_AWAY and (slides := sliding(1.0)) > SLIDES:
        near = {unit: size for unit, size in UNITS.items() if CAMERAS[0] < away * size < CAMERAS[1]}
        unit, size = min((near or UNITS).items(), key=lambda each: sliding(each[1]))
        if sliding(size) < LESS * slides:
            return unit, size, f"in metres the feet would slide at {slides:.1f} m/s"
    return "metres", 1.0, ""


def doubts(joints: Array, local: Array, rate: float) -> tuple[str, ...]:
    """What nobody does in places of joints (F, 24, 3), z up, and their local rotations."""
    said = []
    if (speed := speed_of(joints[:, 0], rate)) > RUN:
        said.append(f"the person goes at {speed:.0f} m/s, which nobody can: is {rate:g} Hz its rate?")
    if (fast := turning(local, rate)) > TURN:
        said.append(f"the limbs turn at {fast:.0f} rad/s, which nobody's do: is {rate:g} Hz its rate?")
    if abs(slope := _slope(joints, rate)) > SLOPE:
        said.append(f"its floor slopes by {abs(slope):.0f} degrees: are its axes a tilted camera's?")
    return tuple(said)


def _slope(joints: Array, rate: float) -> float:
    """Of the floor along the way over which feet stand [degrees]; 0 where they do not tell."""
    feet = joints[1:, FEET]
    stands = np.linalg.norm(np.diff(joints[:, FEET], axis=0), axis=-1) * rate < STANDS
    lowest = feet[..., 2].argmin(axis=1)
    rows = np.arange(len(feet))
    places = feet[rows, lowest][stands[rows, lowest]]
    if len(places) < ENOUGH:
        return 0.0
    centred = places - places.mean(axis=0)
    way = np.linalg.svd(centred[:, :2], full_matrices=False)[2][0]
    along = centred[:, :2] @ way
    if np.ptp(along) < FAR_ENOUGH:
        return 0.0
    return float(np.degrees(np.arctan(along @ centred[:, 2] / (along @ along))))
