"""Bodies for the problems, of even particles with smooth surfaces; the project's own materials and tolerance."""

from typing import Any

import numpy as np
from omegaconf import OmegaConf

from hoi.config import CONF
from hoi.data import Array, Material

PER_CELL = 2
"""Particles a cell along each axis, as in the rest of the project."""


def block(extent: tuple[float, float, float], dx: float) -> tuple[Array, Array]:
    """An even box centred at the origin: positions (P, 3) [m], at least one particle along each axis, volumes (P,)."""
    counts = [max(1, round(PER_CELL * length / dx)) for length in extent]
    axes = [((np.arange(n) + 0.5) / n - 0.5) * length for n, length in zip(counts, extent, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.full(len(points), np.prod(extent) / len(points))


def ball(radius: float, dx: float) -> tuple[Array, Array]:
    """A ball of concentric shells, round where a lattice would have steps: positions (P, 3) [m], volumes (P,).

    Each shell is a Fibonacci spiral of particles about as far apart as the shells, at the radius of its mean square.
    """
    shells = max(1, round(PER_CELL * radius / dx))
    thickness = radius / shells
    points, volumes = [], []
    for shell in range(shells):
        inner, outer = shell * thickness, (shell + 1) * thickness
        middle = np.sqrt((inner**2 + inner * outer + outer**2) / 3)
        count = max(4, round(4 * np.pi * middle**2 / thickness**2))
        index = np.arange(count) + 0.5
        height = 1 - 2 * index / count
        turn = np.pi * (1 + np.sqrt(5)) * index + shell  # each shell turned against the next, lest particles line up
        ring = np.sqrt(1 - height**2)
        points.append(middle * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height]))
        volumes.append(np.full(count, 4 / 3 * np.pi * (outer**3 - inner**3) / count))
    return np.concatenate(points), np.concatenate(volumes)


def preset(name: str) -> Material:
    """The material of `conf/material/NAME.yaml`."""
    values = _settings("material", name)
    return Material(**{key: values[key] for key in Material.__dataclass_fields__ if key in values})


def vibration_tolerance() -> float:
    """What phases leave out by default, of `conf/stage/object/mpm.yaml` [sizes of the object]."""
    return float(_settings("stage", "object", "mpm")["vibration_tolerance"])


def _settings(*name: str) -> dict[str, Any]:
    values: Any = OmegaConf.to_container(OmegaConf.load(CONF.joinpath(*name).with_suffix(".yaml")))
    return values
