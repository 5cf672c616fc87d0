"""Benchmark scenes without a closed answer: each is held against itself, twice as fine as its finest variant."""

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.data import Array, Material, ObjectState, Plane
from hoi.mpm.state import initial_state

from .bodies import ball, block, preset
from .problems import Problem

CELLS = (6, 8, 12)


def ground(material: Material) -> Plane:
    """z = 0 with the material's own friction."""
    return Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "coulomb", material.ground_friction)


def bounce() -> Problem:
    """A football comes down hard at a slant, is flattened, bounces off spinning and flies on."""
    material, size = preset("soccer_ball"), 0.22

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = ball(size / 2, dx)
        return initial_state(points + np.array([0, 0, size / 2 + 0.05]), volumes, (4, 0, -6)), volumes

    times = np.linspace(0, 0.08, 31)[1:]
    return Problem(
        "bounce", "football bounces", "position", size, material, body, times, CELLS, planes=(ground(material),)
    )


def box() -> Problem:
    """A cardboard box is thrown, lands on an edge, tips over and slides."""
    material, extent = preset("cardboard"), np.array([0.4, 0.3, 0.2])
    tilt = Rotation.from_euler("xyz", (8, 25, 0), degrees=True).as_matrix()
    corners = np.stack(np.meshgrid(*([[-0.5, 0.5]] * 3), indexing="ij"), axis=-1).reshape(-1, 3) * extent @ tilt.T

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = block((extent[0], extent[1], extent[2]), dx)
        placed = points @ tilt.T + [0, 0, 0.02 - corners[:, 2].min()]
        return initial_state(placed, volumes, (2.5, 0, -1.5), (0, 1, 0)), volumes

    times = np.linspace(0, 0.15, 31)[1:]
    return Problem("box", "box on its edge", "position", 0.4, material, body, times, CELLS, planes=(ground(material),))


def punch() -> Problem:
    """A foam cube on the ground is hit: the layers near one face start at 6 m/s into it, over a smooth bell."""
    material, size = preset("foam"), 0.3

    def body(dx: float) -> tuple[ObjectState, Array]:
        points, volumes = block((size, size, size), dx)
        rest = initial_state(points + np.array([0, 0, size / 2]), volumes, (0, 0, 0))
        reach = 0.4 * size
        away = points + np.array([size / 2, 0, 0])
        bell = np.exp(-((away / reach) ** 2).sum(axis=1))
        speed = np.array([6.0, 0.0, 0.0])
        affine = speed[:, None] * (-2 * away / reach**2 * bell[:, None])[:, None, :]
        return ObjectState(rest.positions, bell[:, None] * speed, affine, rest.deformation_gradient), volumes

    times = np.linspace(0, 0.08, 31)[1:]
    return Problem(
        "punch", "foam cube punched", "position", size, material, body, times, CELLS, planes=(ground(material),)
    )


SCENES = (bounce, box, punch)
