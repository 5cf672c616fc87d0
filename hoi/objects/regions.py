"""Parts of an object that are made of something else."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array, Material
from hoi.errors import InputError


@dataclass(frozen=True)
class Region:
    """A box, in the object's own frame and in units of its size, and what fills it."""

    centre: Array
    """[-], shape (3,); the origin is the centre of the object's bounding box."""
    half_size: Array
    """[-], shape (3,)."""
    material: Material


def region_of(points: Array, size: float, regions: Sequence[Region]) -> NDArray[np.int32] | None:
    """Which material each particle is of: 0 for the object's own, k + 1 for that of `regions[k]`; later ones win.

    Args:
        points: in the object's own frame [m], shape (P, 3).
        size: largest extent [m].
        regions: none gives None.

    Raises:
        InputError: no particle is left to a region, by its place `regions.K`.
    """
    if not regions:
        return None
    index = np.zeros(len(points), np.int32)
    for k, region in enumerate(regions):
        index[(np.abs(points / size - region.centre) <= region.half_size).all(axis=1)] = k + 1
    counts = np.bincount(index, minlength=len(regions) + 1)[1:]
    for k, region in enumerate(regions):
        if counts[k] == 0:
            low, high = points.min(axis=0) / size, points.max(axis=0) / size
            extent = ", ".join(f"[{a:.2g}, {b:.2g}]" for a, b in zip(low, high, strict=True))
            raise InputError(
                f"regions.{k}: no particle is left to {region.material.name}: its box, centre "
                f"{region.centre.tolist()} and half size {region.half_size.tolist()}, misses the object, which fills "
                f"{extent} (in units of its size), or later regions cover it"
            )
    return index
