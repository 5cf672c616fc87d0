"""MLS-MPM in plain NumPy float64: slow, and meant to be read. The Taichi kernels are tested against it.

Hu et al. 2018, A Moving Least Squares Material Point Method with Displacement Discontinuity and Two-Way Rigid Body
Coupling, with the affine transfers of Jiang et al. 2015, The Affine Particle-In-Cell Method.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hoi.data import Array, Material, ObjectState, Plane
from hoi.mpm.boundary import plane_depth
from hoi.mpm.laws import LAWS
from hoi.mpm.materials import kirchhoff_stress, return_map

SPREAD = {"quadratic": 1 / 4, "cubic": 1 / 3}
"""D / dx^2, where sum_i w_ip (x_i - x_p)(x_i - x_p)^T = D I."""


def stencil(positions: Array, dx: float, spline: str = "quadratic") -> tuple[NDArray[np.int64], Array, Array]:
    """The S = 27 nodes (quadratic) or 64 (cubic) that each particle touches.

    Returns:
        nodes (P, S, 3), integer lattice coordinates; weights w_ip (P, S), which sum to 1; offsets x_i - x_p [m],
        (P, S, 3).
    """
    size = 3 if spline == "quadratic" else 4
    first = np.floor(positions / dx - 0.5 * (size - 2)).astype(np.int64)
    steps = np.array(list(itertools.product(range(size), repeat=3)))
    nodes = first[:, None] + steps
    offset = nodes * dx - positions[:, None]
    return nodes, _spline(np.abs(offset) / dx, spline).prod(axis=-1), offset


def _spline(distance: Array, spline: str) -> Array:
    """The B-spline at a distance from its node [cells]."""
    if spline == "quadratic":
        return np.where(distance < 0.5, 0.75 - distance**2, 0.5 * np.maximum(1.5 - distance, 0) ** 2)
    return np.where(distance < 1, (0.5 * distance - 1) * distance**2 + 2 / 3, np.maximum(2 - distance, 0) ** 3 / 6)


def step(
    state: ObjectState,
    volumes: Array,
    material: Material,
    *,
    dx: float,
    dt: float,
    gravity: ArrayLike,
    planes: Sequence[Plane] = (),
    spline: str = "quadratic",
) -> ObjectState:
    """The state dt later; arguments as in `hoi.mpm.solver.Simulation`."""
    x, v, c, total = state.positions, state.velocities, state.affine, state.deformation_gradient
    f = total if state.elastic is None else state.elastic
    hardening = np.zeros(len(f)) if state.hardening is None else state.hardening
    masses = volumes * material.density
    nodes, w, offset = stencil(x, dx, spline)
    inertia = SPREAD[spline] * dx**2
    origin = nodes.min(axis=(0, 1))
    shape = nodes.max(axis=(0, 1)) - origin + 1
    flat = np.ravel_multi_index(tuple(np.moveaxis(nodes - origin, -1, 0)), tuple(shape))

    # Particle to grid: mass and momentum, with the elastic force -V tau (x_i - x_p) / D acting for dt.
    tau = kirchhoff_stress(material, f, c, hardening)
    affine = masses[:, None, None] * c - dt * (volumes / inertia)[:, None, None] * tau
    momentum = masses[:, None, None] * v[:, None] + np.einsum("pij,pnj->pni", affine, offset)
    grid_mass = np.zeros(shape.prod())
    grid_velocity = np.zeros((shape.prod(), 3))
    np.add.at(grid_mass, flat, w * masses[:, None])
    np.add.at(grid_velocity, flat, w[..., None] * momentum)
    slope = np.zeros_like(grid_velocity)
    np.add.at(
        slope,
        flat,
        w[..., None] * (masses[:, None] * along_normal(x, c, planes, plane_depth([material]), dx, spline))[:, None],
    )

    # Grid: velocity, gravity, planes (where they become solid: `hoi.mpm.boundary`).
    occupied = grid_mass > 0
    slope[occupied] /= grid_mass[occupied, None]
    grid_velocity[occupied] = grid_velocity[occupied] / grid_mass[occupied, None] + dt * np.asarray(gravity)
    places = (np.stack(np.unravel_index(np.arange(shape.prod()), tuple(shape)), axis=-1) + origin) * dx
    depth = plane_depth([material])
    for plane in planes:
        height = (places - plane.point) @ plane.normal
        solid = height < -depth * dx
        tangential = slope - (slope @ plane.normal)[:, None] * plane.normal
        to_surface = (-height[:, None] * tangential)[solid]
        grid_velocity[solid] = after_contact(grid_velocity[solid] + to_surface, plane) - to_surface

    # Grid to particle.
    nodal = grid_velocity[flat]
    velocity = np.einsum("pn,pni->pi", w, nodal)
    gradient = np.einsum("pn,pni,pnj->pij", w, nodal, offset) / inertia
    f, hardening = return_map(material, f + dt * gradient @ f, hardening, dt)
    keeps = LAWS[material.model].keeps_total
    total = total + dt * gradient @ total if keeps else f
    return ObjectState(x + dt * velocity, velocity, gradient, total, f if keeps else None, hardening)


def along_normal(x: Array, c: Array, planes: Sequence[Plane], depth: float, dx: float, spline: str) -> Array:
    """C n of each particle, n the normal of the nearest plane that rubs, 0 where none is near, (P, 3)."""
    slope, nearest = np.zeros_like(x), np.full(len(x), (1.5 if spline == "quadratic" else 2.0) * dx)
    for plane in planes:
        height = (x - plane.point) @ plane.normal + depth * dx
        nearer = (height < nearest) & (plane.contact != "slip")
        slope[nearer], nearest[nearer] = c[nearer] @ plane.normal, height[nearer]
    return slope


def after_contact(velocities: Array, plane: Plane) -> Array:
    """What becomes of velocities (N, 3) in a plane that sends nothing back.

    Along the normal nothing into it is left, and the slip loses up to `friction` times what that lost.
    """
    if plane.contact == "stick":
        return np.zeros_like(velocities)
    approach = np.minimum(velocities @ plane.normal, 0)[:, None]
    tangential = velocities - (velocities @ plane.normal)[:, None] * plane.normal
    slip = np.linalg.norm(tangential, axis=1, keepdims=True)
    lost = plane.friction * -approach if plane.contact == "coulomb" else 0 * slip
    keep = np.where(slip > lost, 1 - lost / np.where(slip > 0, slip, 1), 0)
    return np.where(approach < 0, keep * tangential, velocities)
