"""The camera of the action: where it stands is chosen by what it shows at the contact, and it moves no more than is
needed.

Many directions are tried. From each the camera stands where the whole action is in the picture: the person all the
time, the object for nearly all of it. One in whose picture the person would be small moves along: at each moment it
shows what happens shortly before and after, smoothed. Each is judged by how large the person is at t_c, how much of
the striking limb and of the object around the contact can be seen then, and how fast it moves. What leaves fast is
thus seen from where it leaves into the depth of the picture.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hoi.body.skinning import joint_paths
from hoi.data import Array, Camera
from hoi.gaussians import SH_C0
from hoi.render.cameras import VIEWS, frame_action, project
from hoi.render.rasterise import rasterise
from hoi.render.replay import Replay
from hoi.render.splats import Splats, join

AZIMUTHS, RISES = 20, (0.16, 0.34)
"""Directions around, and heights of the camera over its distance on the ground."""
SEEN = 0.94
"""Share of the clip for which the object has to be in the picture."""
LARGE = 0.40
"""Height of the person at t_c over that of the picture; from a smaller one on the camera moves along."""
AHEAD, SMOOTHING = 0.35, 0.25
"""What a moving camera shows lies this far before and after [s]; standard deviation of its smoothing [s]."""
QUICK = 3.0
"""Speed of the camera that counts half [m/s]."""
FACES = 0.15
"""What a face in full view adds, and the back of a head takes off."""
JUDGED = 10
"""Candidates whose view of the contact is drawn."""
NEAR_CONTACT = 0.12
"""What of person and object counts as the contact [m]."""
PREVIEW = 160
"""Height of the pictures that are judged [pixel]."""


@dataclass(frozen=True)
class Take:
    """A candidate."""

    cameras: Sequence[Camera]
    """One a frame."""
    size: float
    """Of the person at t_c over the picture's height."""
    framed: float
    """Share of the frames in which striking limb and object are in the picture."""
    speed: float
    """Of the camera, at most [m/s]."""
    seen: float = 1.0
    """Visible share of limb and object around the contact at t_c, the smaller of both."""
    faced: float = 0.0
    """How much the person faces the camera at t_c, from -1, which is the back, to 1."""

    @property
    def worth(self) -> float:
        """Higher is better."""
        sight = (0.1 + self.seen) * self.framed**2 * (1 + FACES * self.faced)
        return min(self.size, 0.75) ** 0.8 * sight / (1 + (self.speed / QUICK) ** 2)


def directed(replay: Replay, width: int, height: int) -> list[Camera]:
    """The camera of each frame; one that stands is the same object in all.

    Raises:
        InputError: as `hoi.render.cameras.frame_action`.
    """
    moment = contact_frame(replay)
    takes = [take for direction in _directions() for take in _takes(replay, direction, moment, width, height)]
    takes.sort(key=lambda take: -take.worth)
    best = [replace(take, seen=contact_seen(replay, take.cameras[moment], moment)) for take in takes[:JUDGED]]
    return list(max(best, key=lambda take: take.worth).cameras)


def contact_frame(replay: Replay) -> int:
    """The frame nearest to t_c; without a contact to that of the smallest gap, else the middle one."""
    search = replay.state.contact
    frame = (replay.frames - 1) / 2
    if search is not None and search.push is not None:
        frame = search.push.frame
    elif search is not None and math.isfinite(search.smallest_gap_frame):
        frame = search.smallest_gap_frame
    return int(np.clip(round(frame), 0, replay.frames - 1))


def limb_path(replay: Replay) -> Array | None:
    """The striking joint [m], (T, 3); None where there is none."""
    search, target, motion = replay.state.contact, replay.state.target, replay.state.motion
    joint = search.push.joint if search is not None and search.push is not None else target.joint if target else -1
    if motion is None or joint < 0:
        return None
    return joint_paths(replay.scene.body, motion)[:, joint].astype(np.float64)


def contact_seen(replay: Replay, camera: Camera, moment: int) -> float:
    """How much of limb and object around the contact can be seen at t_c, the smaller share; 1 without a contact."""
    search = replay.state.contact
    if search is None or search.push is None or len(replay.names) < 2:
        return 1.0
    small = _smaller(camera, PREVIEW)
    point = torch.as_tensor(search.push.point, dtype=torch.float32)
    parts = replay.parts(moment)
    near = [(part.means - point).norm(dim=1) < NEAR_CONTACT for part in parts]
    alone, whole = [], []
    with torch.no_grad():
        for index, (part, rows) in enumerate(zip(parts, near, strict=True)):
            colour = torch.zeros(len(part), 3)
            colour[rows, index] = 1.0
            plain = ((colour - 0.5) / SH_C0)[:, None]
            whole.append(replace(part, sh=plain, turns=None, surface=None))
            if not bool(rows.any()):
                return 0.0
            alone.append(float(rasterise(_rows(whole[-1], rows), small).alpha.sum()))
        seen = rasterise(join(whole), small, (0.0, 0.0, 0.0)).colour.sum((0, 1))
    return min(float(seen[index]) / max(area, 1e-6) for index, area in enumerate(alone))


def in_picture(camera: Camera, point: Array) -> bool:
    """Whether a point [m] (3,) is in the picture."""
    (x, y), depth = project(camera, point)
    return bool(depth > camera.near and 0 <= x < camera.width and 0 <= y < camera.height)


def _directions() -> list[tuple[float, float, float]]:
    turns = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    around = [(float(np.cos(turn)), float(np.sin(turn)), rise) for turn in turns for rise in RISES]
    return [VIEWS["three_quarter"], VIEWS["follow"], *around]


def _takes(replay: Replay, direction: Sequence[float], moment: int, width: int, height: int) -> list[Take]:
    """From one direction: standing, and where the person would be small moving along."""
    person, thing = replay.action().person, replay.action().thing
    last = max(1, math.ceil(SEEN * replay.frames))
    points = np.concatenate([person.reshape(-1, 3), thing[:last].reshape(-1, 3)])
    camera = frame_action(points, direction, width=width, height=height)
    standing = _judged(replay, [camera] * replay.frames, moment)
    if standing.size >= LARGE:
        return [standing]
    reach = round(AHEAD * replay.fps)
    eyes = []
    for frame in range(replay.frames):
        rows = slice(max(0, frame - reach), frame + reach + 1)
        parts = [person[rows].reshape(-1, 3), thing[slice(rows.start, min(rows.stop, last))].reshape(-1, 3)]
        points = np.concatenate(parts)
        eyes.append(frame_action(points, direction, width=width, height=height).position)
    path = _smooth(np.array(eyes), SMOOTHING * replay.fps)
    return [standing, _judged(replay, [_moved(camera, eye) for eye in path], moment)]


def _judged(replay: Replay, cameras: Sequence[Camera], moment: int) -> Take:
    action, limb = replay.action(), limb_path(replay)
    outline = action.person[moment] if action.person.shape[1] else action.thing[moment]
    pixels, _ = project(cameras[moment], outline)
    followed = [path for path in (limb, action.thing.mean(1) if action.thing.shape[1] else None) if path is not None]
    framed = [all(in_picture(camera, path[at]) for path in followed) for at, camera in enumerate(cameras)]
    eyes = np.array([camera.position for camera in cameras])
    speed = np.linalg.norm(np.diff(eyes, axis=0), axis=1).max(initial=0.0) * replay.fps
    size = float(np.ptp(pixels[:, 1])) / cameras[moment].height
    return Take(cameras, size, float(np.mean(framed)), float(speed), faced=_faced(replay, eyes[moment], moment))


def _faced(replay: Replay, eye: Array, moment: int) -> float:
    """The cosine, on the ground, between where the person faces and where the camera is; 0 without a person."""
    motion = replay.state.motion
    if motion is None:
        return 0.0
    first, second = motion.orientation[moment].astype(np.float64).reshape(2, 3)
    front = np.array([first[2], second[2]])  # the rest frame's z, in the world
    away = eye[:2] - motion.translation[moment, :2]
    return float(front @ away / max(np.linalg.norm(front) * np.linalg.norm(away), 1e-9))


def _smooth(path: Array, sigma: float) -> Array:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(path, sigma, axis=0, mode="nearest") if sigma > 0 else path


def _moved(camera: Camera, eye: Array) -> Camera:
    pose = camera.world_to_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ eye
    return replace(camera, world_to_camera=pose)


def _smaller(camera: Camera, height: int) -> Camera:
    scale = height / camera.height
    width = max(1, round(camera.width * scale))
    return replace(
        camera, width=width, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=camera.cx * scale,
        cy=camera.cy * scale,
    )  # fmt: skip


def _rows(splats: Splats, rows: Tensor) -> Splats:
    return replace(splats, means=splats.means[rows], covariances=splats.covariances[rows],
                   opacities=splats.opacities[rows], sh=splats.sh[rows])  # fmt: skip
