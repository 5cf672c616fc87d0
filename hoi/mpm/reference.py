"""MLS-MPM in plain NumPy float64: slow, and meant to be read. The Taichi kernels are tested against it.

Hu et al. 2018, A Moving Least Squares Material Point Method with Displacement Discontinuity and Two-Way Rigid Body
Coupling, with quadratic B-splines and the affine transfers of Jiang et al. 2015, The Affine Particle-In-Cell Method.
"""

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hoi.data import Array, Material, ObjectState
from hoi.mpm.materials import kirchhoff_stress


def stencil(positions: Array, dx: float) -> tuple[NDArray[np.int64], Array, Array]:
    """The 27 nodes that each particle touches.

    Returns:
        nodes (P, 27, 3), integer lattice coordinates; weights w_ip (P, 27), which sum to 1; offsets x_i - x_p [m],
        (P, 27, 3).
    """
    first = np.floor(positions / dx - 0.5).astype(np.int64)
    fx = positions / dx - first
    axis_weights = np.stack([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2], axis=1)
    steps = np.array(list(itertools.product(range(3), repeat=3)))
    nodes = first[:, None] + steps
    weights = axis_weights[:, steps, range(3)].prod(axis=-1)
    return nodes, weights, nodes * dx - positions[:, None]


def step(
    state: ObjectState, volumes: Array, material: Material, *, dx: float, dt: float, gravity: ArrayLike, ground: bool
) -> ObjectState:
    """The state dt later; arguments as in `hoi.mpm.solver.simulate`."""
    x, v, c, f = state.positions, state.velocities, state.affine, state.deformation_gradient
    masses = volumes * material.density
    nodes, w, offset = stencil(x, dx)
    origin = nodes.min(axis=(0, 1))
    shape = nodes.max(axis=(0, 1)) - origin + 1
    flat = np.ravel_multi_index(tuple(np.moveaxis(nodes - origin, -1, 0)), tuple(shape))

    # Particle to grid: mass and momentum, with the elastic force -V tau 4/dx^2 (x_i - x_p) acting for dt.
    affine = masses[:, None, None] * c - dt * (volumes * 4 / dx**2)[:, None, None] * kirchhoff_stress(material, f)
    momentum = masses[:, None, None] * v[:, None] + np.einsum("pij,pnj->pni", affine, offset)
    grid_mass = np.zeros(shape.prod())
    grid_velocity = np.zeros((shape.prod(), 3))
    np.add.at(grid_mass, flat, w * masses[:, None])
    np.add.at(grid_velocity, flat, w[..., None] * momentum)

    # Grid: velocity, gravity, ground (solid from the first plane of nodes under z = 0; why so, see hoi.mpm.kernels).
    occupied = grid_mass > 0
    grid_velocity[occupied] = grid_velocity[occupied] / grid_mass[occupied, None] + dt * np.asarray(gravity)
    if ground:
        height = np.unravel_index(np.arange(shape.prod()), tuple(shape))[2] + origin[2]
        touching = (height < 0) & (grid_velocity[:, 2] < 0)
        grid_velocity[touching] = ground_contact(grid_velocity[touching], material.ground_friction)

    # Grid to particle.
    nodal = grid_velocity[flat]
    velocity = np.einsum("pn,pni->pi", w, nodal)
    gradient = 4 / dx**2 * np.einsum("pn,pni,pnj->pij", w, nodal, offset)
    return ObjectState(x + dt * velocity, velocity, gradient, f + dt * gradient @ f)


def ground_contact(velocities: Array, friction: float) -> Array:
    """What becomes of velocities (N, 3) into the ground: none along z, the slip less `friction` times what z lost."""
    slip = np.linalg.norm(velocities[:, :2], axis=1, keepdims=True)
    lost = friction * -velocities[:, 2:]
    keep = np.where(slip > lost, 1 - lost / np.where(slip > 0, slip, 1), 0)
    return np.concatenate([keep * velocities[:, :2], np.zeros_like(slip)], axis=1)
