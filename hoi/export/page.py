"""A run as one HTML file that plays it: Gaussians, bones, contacts, trail, ground. No server, no network.

The page (`page.html`) draws with WebGL 2. In it lies, as gzip in base64, one block of bytes: for each part (person,
object) opacities (N,) u1 and radii r_i [m] (N,) f4, and for each frame origins (T, 3) f4, positions x, factors L of the
covariances and colours in that frame's light as steps from the frame before, in planes of one byte, so that they pack
well:

    mean_i = origin + STEP x_i,  x_i 3 u2,       Sigma_i = (r_i / 127)^2 L_i L_i^T,  L_i 6 i1, lower triangle.
"""

import base64
import gzip
import html
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hoi.data import Array, Run
from hoi.files import whole_file
from hoi.gaussians import SH_C0
from hoi.render.cameras import FOV_Y, VIEWS, frame_action
from hoi.render.film import lit_frames
from hoi.render.look import Look
from hoi.render.marks import Marks, impulse_arrow, largest_impulse, marks_of, normal_arrow, plane_axes
from hoi.render.replay import Replay, replay
from hoi.render.splats import Splats

STEP = 1e-4
"""Least step of a position [m]."""
LEVELS = 65_535
TEMPLATE = Path(__file__).with_name("page.html")


@dataclass(frozen=True)
class Part:
    """Gaussians over time, rounded."""

    step: float
    """[m]"""
    origins: NDArray[np.float32]
    """[m], (T, 3)."""
    positions: NDArray[np.uint16]
    """(T, N, 3)."""
    factors: NDArray[np.int8]
    """Of Sigma = L L^T: L00, L10, L11, L20, L21, L22 in 127ths of the radius, (T, N, 6)."""
    radii: NDArray[np.float32]
    """[m], (N,)."""
    opacities: NDArray[np.uint8]
    """(N,)."""
    colours: NDArray[np.uint8]
    """RGB, (T, N, 3)."""

    def to_bytes(self) -> bytes:
        """opacities, radii, origins, then the low and high bytes of the positions' steps in time, the factors', the
        colours'."""
        moves = np.diff(self.positions, axis=0, prepend=np.zeros_like(self.positions[:1]))
        turns = np.diff(self.factors.view(np.uint8), axis=0, prepend=np.zeros_like(self.factors[:1].view(np.uint8)))
        low, high = (moves & 255).astype(np.uint8), (moves >> 8).astype(np.uint8)
        # Component by component, so that equal bytes lie beside each other.
        shades = np.diff(self.colours, axis=0, prepend=np.zeros_like(self.colours[:1]))
        planes = [np.ascontiguousarray(each.transpose(0, 2, 1)).tobytes() for each in (low, high, turns, shades)]
        return b"".join([self.opacities.tobytes(), self.radii.tobytes(), self.origins.tobytes(), *planes])


def write_page(run: Run, path: Path) -> None:
    """Write the page of a run.

    Raises:
        InputError: the run has nothing to show, or the path cannot be written to.
        RunError: the disk is full or broken.
    """
    text = page(run)
    with whole_file(Path(path)) as part:
        part.write_text(text, encoding="utf-8")


def page(run: Run) -> str:
    """The page's text; the same for the same run.

    Raises:
        InputError: as `hoi.render.replay.replay`.
    """
    shown = replay(run)
    frames = list(lit_frames(shown, range(shown.frames), Look()))
    parts = [part_of(part) for part in zip(*frames, strict=True)]
    blob = gzip.compress(b"".join(part.to_bytes() for part in parts), 6, mtime=0)
    facts = _facts(run, shown, marks_of(run))
    each = zip(shown.names, parts, strict=True)
    facts["parts"] = [{"name": name, "count": len(part.radii), "step": part.step} for name, part in each]
    text = TEMPLATE.read_text(encoding="utf-8")
    pieces = {
        "TITLE": html.escape(str(facts["title"])),
        "FACTS": json.dumps(facts, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "DATA": base64.b64encode(blob).decode(),
    }
    return "".join(_filled(text, pieces))


def _filled(text: str, pieces: dict[str, str]) -> Iterator[str]:
    """The template with its {{NAME}}s; what is put in is not looked at again."""
    head, *rest = text.split("{{")
    yield head
    for piece in rest:
        name, _, tail = piece.partition("}}")
        yield pieces[name]
        yield tail


def part_of(frames: Sequence[Splats]) -> Part:
    """Round a part's Gaussians, one Splats a frame. What is not finite becomes transparent, in all frames."""
    means = np.stack([splats.means.numpy() for splats in frames]).astype(np.float32)
    count = means.shape[1]
    opacities = frames[-1].opacities.numpy()
    colours = np.stack([0.5 + SH_C0 * splats.sh[:, 0].numpy() for splats in frames])
    good = np.isfinite(means).all((0, 2)) & np.isfinite(colours).all((0, 2)) & np.isfinite(opacities)
    factors = np.zeros((len(frames), count, 6), np.float32)
    rows, columns = np.tril_indices(3)
    for frame, splats in enumerate(frames):
        if frame and splats is frames[frame - 1]:
            factors[frame] = factors[frame - 1]
            continue
        sigma = splats.covariances.double()
        good &= sigma.isfinite().all(-1).all(-1).numpy()
        sigma = torch.where(sigma.isfinite(), sigma, 0.0)
        floor = 1e-8 * sigma.diagonal(dim1=-2, dim2=-1).sum(-1) + 1e-16  # flat ones are as good as these
        root = torch.linalg.cholesky_ex(sigma + floor[:, None, None] * torch.eye(3, dtype=sigma.dtype))[0]
        factors[frame] = root.numpy()[:, rows, columns]
    means[:, ~good] = means[0, good][0] if good.any() else 0
    factors[:, ~good] = 0
    radii = np.maximum(np.abs(factors).max((0, 2)), 1e-9)
    origins = means.min(1)
    step = max(STEP, float((means - origins[:, None]).max()) / LEVELS)
    return Part(
        step=step,
        origins=origins,
        positions=np.rint((means - origins[:, None]) / step).astype(np.uint16),
        factors=np.rint(factors / radii[:, None] * 127).astype(np.int8),
        radii=radii,
        opacities=np.rint(np.clip(np.where(good, opacities, 0), 0, 1) * 255).astype(np.uint8),
        colours=np.rint(np.clip(np.where(good[:, None], colours, 0), 0, 1) * 255).astype(np.uint8),
    )


def _facts(run: Run, shown: Replay, marks: Marks) -> dict[str, Any]:
    """All but the Gaussians."""
    scene = run.scene
    assert scene is not None  # checked by `replay`
    action = shown.action().points()
    camera = frame_action(action, VIEWS["three_quarter"], margin=0.12)
    distance = float(((action - camera.position) @ camera.forward).mean())
    largest = largest_impulse(marks.contacts)
    return {
        "title": f"{scene.name} · {run.plan.variant}",
        "prompt": scene.motion_prompt,
        "outcome": run.result.get("outcome", ""),
        "frames": shown.frames,
        "fps": shown.fps,
        "fov": FOV_Y,
        "eye": _short(camera.position),
        "target": _short(camera.position + distance * camera.forward),
        "joints": None if marks.joints is None else _short(marks.joints.reshape(shown.frames, -1)),
        "com": None if marks.com is None else _short(marks.com),
        "speed": None if marks.speed is None else _short(marks.speed),
        "planes": [
            {"point": _short(plane.point), "axes": _short(plane_axes(plane.normal).T.ravel(), 6)}
            for plane in marks.planes
        ],
        "contacts": [
            {
                "frame": round(contact.frame, 3),
                "normal": _short(normal_arrow(contact).ravel()),
                "impulse": _short(impulse_arrow(contact, largest).ravel()),
                "strength": float(f"{np.linalg.norm(contact.impulse):.3g}"),
            }
            for contact in marks.contacts
        ],
    }


def _short(values: Array, digits: int = 4) -> list[Any]:
    """For JSON: rounded, and 0 where it is not finite."""
    return np.round(np.nan_to_num(values.astype(np.float64), posinf=0, neginf=0), digits).tolist()
