"""Whether the video in the record shows what happens: who strikes and what is struck in the picture, the contact
unhidden."""

import numpy as np

from hoi import record as records
from hoi.data import Array, Camera
from hoi.render.cameras import project

from ..records import Record, Undefined
from .contact import striking_joint

NEAR_CONTACT = 0.12
"""Skin and object this close to the point of contact are what should be seen [m]."""
CELL, BEHIND = 4, 0.04
"""Of the depth map [pixel], and how far behind the nearest point of its cell a point counts as hidden [m]."""


def framed(record: Record) -> float:
    """Share of the frames in whose picture both the striking joint and the object's centre of mass are; where nothing
    struck, the pelvis for the joint."""
    cameras, joints, thing = _cameras(record), record.joints, record.trajectory
    if joints is None:
        raise Undefined
    joint = striking_joint(record)
    paths = (joints[:, max(joint or 0, 0)], thing.com)
    return float(np.mean([all(_inside(c, p[at]) for p in paths) for at, c in enumerate(cameras)]))


def contact_in_picture(record: Record) -> float:
    """1 when the point of contact is in the picture at t_c, 0 when it is beside it."""
    push, cameras = record.push, _cameras(record)
    return float(_inside(cameras[_frame(push.frame, len(cameras))], push.point))


def contact_seen(record: Record) -> float:
    """Share of the skin and of the object within 12 cm of the contact that nothing hides at t_c, the smaller of both:
    a point is hidden when another lies 4 cm or more before it in the same 4 x 4 pixels."""
    push, cameras, skin = record.push, _cameras(record), record.skin
    frame = _frame(push.frame, len(cameras))
    if skin is None:
        raise Undefined
    things = record.trajectory.positions[frame, : len(record.scene.thing.cloud)]
    parts = [np.asarray(part, np.float64) for part in (skin[frame], things)]
    pixels, depth = project(cameras[frame], np.concatenate(parts))
    cells = np.floor(pixels / CELL).astype(np.int64)
    index = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    nearest = np.full(index.max() + 1, np.inf)
    np.minimum.at(nearest, index, depth)
    inside = (pixels >= 0).all(1) & (pixels < (cameras[frame].width, cameras[frame].height)).all(1)
    visible = np.split(inside & (depth < nearest[index] + BEHIND), [len(parts[0])])
    near = [np.linalg.norm(part - push.point, axis=1) < NEAR_CONTACT for part in parts]
    return min(float(seen[rows].mean()) if rows.any() else 0.0 for seen, rows in zip(visible, near, strict=True))


def _cameras(record: Record) -> tuple[Camera, ...]:
    if not record.path.exists():  # it was never written
        raise Undefined
    try:
        footage = records.video(record.path)
    except records.NoVideo:
        raise Undefined from None
    if not footage.cameras:
        raise Undefined
    return footage.cameras


def _frame(frame: float, count: int) -> int:
    return int(np.clip(round(frame), 0, count - 1))


def _inside(camera: Camera, point: Array) -> bool:
    (x, y), depth = project(camera, np.asarray(point, np.float64))
    return bool(depth > camera.near and 0 <= x < camera.width and 0 <= y < camera.height)
