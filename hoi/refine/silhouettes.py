"""Silhouettes: how much of each pixel the striking limb, the rest of the person and the object cover, as RGB.

Each is drawn as if the others were not there. Nothing hides a limb that is inside the object, and colours, light and
floor cannot matter, so that a small video prior need only know how limb and object lie to each other. Around a contact
the object is a section through it: the silhouette of a dented cube hides the limb in its dent, that of a large one
whatever is before it.
"""

import numpy as np
import torch
from torch import Tensor

from hoi.data import Array
from hoi.refine.surface import Surface
from hoi.render.cameras import Camera
from hoi.render.rasterise import rasterise
from hoi.render.splats import Splats

BORDER = 0.05
"""How far outside the picture a Gaussian may lie and still reach into it [m]."""


def coverage(splats: Splats, camera: Camera) -> Tensor:
    """In [0, 1], (height, width); differentiable in the Gaussians' places.

    Raises:
        InputError: as `hoi.render.rasterise.rasterise`.
    """
    near = _in_view(splats, camera)
    if not len(near):
        return splats.means.new_zeros(camera.height, camera.width)
    return rasterise(near, camera).alpha


def silhouettes(limb: Splats, rest: Splats, thing: Splats, camera: Camera) -> Tensor:
    """(3, height, width)."""
    return torch.stack([coverage(part, camera) for part in (limb, rest, thing)])


def section(surface: Surface, through: Array, camera: Camera) -> Tensor:
    """How much of each pixel is object in the plane that faces the camera through a point (3,) [m], (height, width)."""
    to_world = camera.world_to_camera[:3, :3].T
    depth = float((through - camera.position) @ camera.forward)
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], -1).reshape(-1, 3)
    signed, _ = surface.distance(camera.position + depth * rays @ to_world.T)
    share = np.clip(0.5 - signed * camera.fx / depth, 0, 1)
    return torch.from_numpy(share.reshape(camera.height, camera.width).astype(np.float32))


def _in_view(splats: Splats, camera: Camera) -> Splats:
    """Without what no pixel shows, which is most of a person, and without colours."""
    pose = torch.from_numpy(camera.world_to_camera).to(splats.means)
    with torch.no_grad():
        x, y, z = (splats.means @ pose[:3, :3].T + pose[:3, 3]).T
        reach = (z * (camera.width / 2 / camera.fx) + BORDER, z * (camera.height / 2 / camera.fy) + BORDER)
        seen = torch.nonzero((z > camera.near) & (x.abs() < reach[0]) & (y.abs() < reach[1]))[:, 0]
    black = splats.means.new_zeros(len(seen), 1, 3)
    return Splats(splats.means[seen], splats.covariances[seen], splats.opacities[seen], black)
