"""What Gaussians leave of the key light for each other: a soft shadow map, made anew each frame.

Seen from the light, each cell of a grid holds how near to the light its foremost Gaussian is. What lies further off
than that by more than a limb's skin is in its shadow; the share of the cells around that are in front of it makes
soft edges. The map knows no gradient: a prior that moves the person sees no cast shadows.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from hoi.render.splats import Splats

CELL = 0.018
"""Of the grid [m]: no wider gaps between the Gaussians of one skin."""
SKIN = (0.03, 0.07)
"""Distances behind the foremost one [m] from which a shadow begins and from which it is full."""
FAINTEST = 0.3
"""Opacity below which a Gaussian casts none."""
_WIDEST = 1200  # cells along a side; a scene that is larger gets coarser ones


@torch.no_grad()
def key_light_left(parts: Sequence[Splats], direction: Sequence[float]) -> list[Tensor]:
    """S of each part's Gaussians, (N,) in [0, 1], for a light far off in a unit direction."""
    towards = parts[0].means.new_tensor(direction)
    aside = torch.linalg.cross(towards, towards.new_tensor([0.0, 1.0, 0.0] if abs(direction[1]) < 0.9 else [1.0, 0, 0]))
    aside = aside / aside.norm()
    axes = torch.stack([aside, torch.linalg.cross(towards, aside), towards], 1)
    placed = torch.cat([part.means for part in parts]) @ axes
    opaque = torch.cat([part.opacities for part in parts]) > FAINTEST
    opaque &= placed.sum(1).isfinite()
    if not bool(opaque.any()):
        return [part.opacities.new_ones(len(part)) for part in parts]
    casters = placed[opaque]
    low = casters[:, :2].amin(0)
    extent = casters[:, :2].amax(0) - low
    cell = max(CELL, float(extent.max()) / _WIDEST)
    columns, rows = ((extent / cell).int() + 4).tolist()
    front = placed.new_full((rows * columns,), -torch.inf)
    front.scatter_reduce_(0, _cells(casters[:, :2] - low, cell, 1.5, columns, rows)[0], casters[:, 2], "amax")
    # The four cells around a place, each as far as it reaches there.
    corner, inside = _cells(placed[:, :2] - low, cell, 1.0, columns, rows)
    right, down = inside.unbind(1)
    across = right * down
    shares = (1 - right - down + across, right - across, down - across, across)
    offset, gain = placed[:, 2] + SKIN[0], 1 / (SKIN[1] - SKIN[0])
    left = torch.ones_like(offset)
    for step, share in zip((0, 1, columns, columns + 1), shares, strict=True):
        left -= share * front[corner + step].sub_(offset).mul_(gain).clamp_(0, 1)
    return list(left.clamp_(0, 1).split([len(part) for part in parts]))


def _cells(places: Tensor, cell: float, origin: float, columns: int, rows: int) -> tuple[Tensor, Tensor]:
    """The cells that places (N, 2) [m] lie in, (N,), with a neighbour to the right and below each, and how far in (N,
    2)."""
    steps = places / cell + origin
    whole = steps.floor()
    x, y = whole.unbind(1)
    index = y.clamp(0, rows - 2) * columns + x.clamp(0, columns - 2)
    return index.nan_to_num().long(), steps - whole
