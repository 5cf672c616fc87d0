"""What Gaussians leave of the key light for each other: a soft shadow map, made anew each frame.

Seen from the light, each cell of a grid holds how near to the light its foremost Gaussian is. What lies further off
than that by more than a limb's skin is in its shadow; the share of the cells around that are in front of it makes
soft edges. The map knows no gradient: a prior that moves the person sees no cast shadows.
"""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportOptionalCall=false
# pyright: reportOperatorIssue=false

from collections.abc import Sequence

import torch
from torch import Tensor

from hoi.compute import CPU_TASK, ti
from hoi.render.kernels import array, start_kernels
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
    opacities = torch.cat([part.opacities for part in parts])
    opacities = torch.where(placed.sum(1).isfinite(), opacities, 0)
    casters = placed[opacities > FAINTEST, :2]
    if not len(casters):
        return [part.opacities.new_ones(len(part)) for part in parts]
    placed = placed.nan_to_num()
    low, high = (corner.tolist() for corner in (casters.amin(0), casters.amax(0)))
    cell = max(CELL, max(high[0] - low[0], high[1] - low[1]) / _WIDEST)
    columns, rows = (int((last - first) / cell) + 4 for first, last in zip(low, high, strict=True))
    front, left = placed.new_full((rows * columns,), -torch.inf), torch.empty_like(opacities)
    start_kernels(placed)
    foremost(placed, opacities, FAINTEST, *low, cell, columns, front)
    not_hidden(placed, *low, cell, columns, rows, *SKIN, front, left)
    return list(left.split([len(part) for part in parts]))


@ti.kernel
def foremost(placed: array, opacities: array, faintest: ti.f32, low_x: ti.f32, low_y: ti.f32, cell: ti.f32,
             columns: ti.i32, front: array):  # fmt: skip
    """How near to the light the foremost opaque Gaussian of each cell is."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(placed.shape[0]):
        if opacities[i] > faintest:
            column = ti.cast((placed[i, 0] - low_x) / cell + 1.5, ti.i32)
            row = ti.cast((placed[i, 1] - low_y) / cell + 1.5, ti.i32)
            ti.atomic_max(front[row * columns + column], placed[i, 2])


@ti.kernel
def not_hidden(placed: array, low_x: ti.f32, low_y: ti.f32, cell: ti.f32, columns: ti.i32, rows: ti.i32, begin: ti.f32,
               full: ti.f32, front: array, left: array):  # fmt: skip
    """Share of the light that gets past what is in front, over the four cells around each Gaussian."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(placed.shape[0]):
        x, y = (placed[i, 0] - low_x) / cell + 1.0, (placed[i, 1] - low_y) / cell + 1.0
        column = ti.min(ti.max(ti.cast(ti.floor(x), ti.i32), 0), columns - 2)
        row = ti.min(ti.max(ti.cast(ti.floor(y), ti.i32), 0), rows - 2)
        right, down = x - ti.floor(x), y - ti.floor(y)
        here, light = row * columns + column, 1.0
        for k in ti.static(range(4)):
            across, along = ti.static(k % 2), ti.static(k // 2)
            weight = (right if across else 1.0 - right) * (down if along else 1.0 - down)
            behind = (front[here + across + along * columns] - placed[i, 2] - begin) / (full - begin)
            light -= weight * ti.min(ti.max(behind, 0.0), 1.0)
        left[i] = ti.min(ti.max(light, 0.0), 1.0)
