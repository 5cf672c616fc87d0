"""A run as pictures: its Gaussians over floor, sky and shadows, frame by frame."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hoi.data import Camera, Scene
from hoi.render import Backend, Ground
from hoi.render.cameras import ACTION, view
from hoi.render.director import directed
from hoi.render.ground import Backdrop, Shadow, beams, cast
from hoi.render.light import lit, relit
from hoi.render.look import USUAL, Look
from hoi.render.rasterise import render_frames
from hoi.render.replay import Replay
from hoi.render.shadows import key_light_left
from hoi.render.splats import Splats


def cameras_of(replay: Replay, name: str, width: int, height: int) -> list[Camera]:
    """The camera of each frame, by the names in `hoi.render.cameras.VIEWS`, or of the action; one that stands is the
    same object in all.

    Raises:
        InputError: as `hoi.render.cameras.view`.
    """
    if name == ACTION:
        return directed(replay, width, height)
    found = view(name, replay.action(), width=width, height=height)
    return found if isinstance(found, list) else [found] * replay.frames


def film(
    replay: Replay,
    cameras: Sequence[Camera],
    *,
    look: Look = USUAL,
    frames: Iterable[int] | None = None,
    sh_degree: int | None = None,
    backend: Backend = "taichi",
    device: torch.device | str = "cpu",
) -> Iterator[NDArray[np.uint8]]:
    """The picture of each frame by its camera, as it is shown: RGB, (height, width, 3).

    Args:
        cameras: one a frame; while it is the same object, what stands still is not worked out again.
        look: a light that captured Gaussians shall get too asks for a replay with `relight`.
        frames: which ones, in which order, again and again if need be (default: all).
        device: the replay's.

    Raises:
        InputError: as `hoi.render.rasterise.rasterise`.
    """
    wanted = list(range(replay.frames) if frames is None else frames)
    parts = lit_frames(replay, wanted, look)
    backdrops = _backdrops(replay, wanted, cameras, look, device)
    pictures = render_frames(parts, cameras, backdrops, sh_degree=sh_degree, backend=backend, settings=look.settings)
    for picture in pictures:
        yield (picture.colour.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def lit_frames(replay: Replay, frames: Iterable[int], look: Look) -> Iterator[list[Splats]]:
    """The parts of each frame as they are seen; where nothing has moved they are the same objects as before."""
    before: tuple[Splats, ...] = ()
    seen: list[Splats] = []
    for frame in frames:
        parts = replay.parts(frame)
        if len(before) != len(parts) or any(one is not other for one, other in zip(parts, before, strict=True)):
            before, seen = parts, lit_at(replay, parts, look)
        yield seen


@torch.no_grad()
def lit_at(replay: Replay, parts: Sequence[Splats], look: Look) -> list[Splats]:
    """The parts of one frame of a replay as they are seen."""
    light, left = look.light, [None] * len(parts)
    if light is not None and look.shadows:
        left = key_light_left(parts, light.direction)
    seen = []
    for name, part, share in zip(replay.names, parts, left, strict=True):
        if name in replay.captured and light is not None and part.surface is not None:
            seen.append(relit(part, light, part.surface[:, 0], share))
        else:
            seen.append(lit(part, light, share))
    return seen


def choose_frames(frames: int, count: int, contact: float | None) -> list[int]:
    """`count` frames of 0..frames-1, increasing, with the first, the last and the one nearest to `contact`.

    Closer together around the contact; evenly spread without one.
    """
    count = min(count, frames)
    if contact is None:
        return sorted({round(frame) for frame in np.linspace(0, frames - 1, count)})
    middle = int(np.clip(round(contact), 0, frames - 1))
    before = int(np.clip(round((count - 1) * 0.45), 0, middle))
    after = min(count - 1 - before, frames - 1 - middle)
    before = min(count - 1 - after, middle)
    offsets = [
        sign * _spread(side, steps) for sign, side, steps in ((-1, middle, before), (1, frames - 1 - middle, after))
    ]
    return sorted({middle, *(middle + offsets[0]).tolist(), *(middle + offsets[1]).tolist()})


def _spread(side: int, steps: int) -> NDArray[np.int64]:
    """`steps` different whole numbers in 1..side, the largest included, finer towards 1."""
    wanted = side * (np.arange(1, steps + 1) / max(steps, 1)) ** 1.7
    chosen = np.maximum.accumulate(np.round(wanted).astype(int))
    for i in range(steps):
        chosen[i] = max(chosen[i], i + 1, chosen[i - 1] + 1 if i else 1)
    return np.minimum(chosen, side - np.arange(steps)[::-1])


def has_floor(scene: Scene) -> bool:
    """Whether the half-space z < 0 is solid."""
    up = np.array([0.0, 0.0, 1.0])
    return any(np.allclose(plane.normal, up) and abs(plane.point[2]) < 1e-9 for plane in scene.planes)


def _backdrops(
    replay: Replay, frames: Sequence[int], cameras: Sequence[Camera], look: Look, device: torch.device | str
) -> Iterator[Tensor]:
    floor, ground = has_floor(replay.scene), look.ground or Ground(replay.scene.setting)
    lights = beams(look.light if look.shadows else None)
    backdrop, last_camera = None, None
    shadows: dict[int, tuple[Shadow, ...]] = {}
    parts: tuple[Splats, ...] = ()  # those that `shadows` belong to are kept alive, so that their ids stay theirs
    for frame, camera in zip(frames, cameras, strict=True):
        if backdrop is None or camera is not last_camera:
            backdrop, last_camera = Backdrop(camera, floor=floor, ground=ground, device=device), camera
        if floor:
            parts, before = replay.parts(frame), parts
            known = {id(part) for part in before}
            shadows = {
                id(part): shadows[id(part)]
                if id(part) in known
                else tuple(s for beam in lights for s in cast(part, beam))
                for part in parts
            }
        yield backdrop([shadow for group in shadows.values() for shadow in group])
