"""States of the object's particles: how they begin, what a kick does, and what they add up to. NumPy only."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hoi.data import Array, Material, ObjectState
from hoi.errors import InputError
from hoi.mpm.damping import LEAST_ENERGY, Damping, recoverable, strain_energy
from hoi.mpm.materials import elastic_energy_density, lame_parameters


def initial_state(
    positions: Array, masses: Array, velocity: ArrayLike, angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
) -> ObjectState:
    """An unstressed body that moves rigidly: v_p = V + w x (x_p - com), C_p = [w]_x, F_p = I.

    Args:
        positions: particle positions [m], shape (P, 3).
        masses: particle masses [kg], shape (P,).
        velocity: V of the centre of mass [m/s], shape (3,).
        angular_velocity: w about the centre of mass [rad/s], shape (3,).
    """
    positions = np.array(positions, dtype=np.float64)
    spin = _cross(angular_velocity)
    return ObjectState(
        positions=positions,
        velocities=np.asarray(velocity) + (positions - centre_of_mass(positions, masses)) @ spin.T,
        affine=np.tile(spin, (len(positions), 1, 1)),
        deformation_gradient=np.tile(np.eye(3), (len(positions), 1, 1)),
    )


def kick(
    state: ObjectState, delta_v: ArrayLike, spin: ArrayLike = (0.0, 0.0, 0.0), centre: ArrayLike = (0.0, 0.0, 0.0)
) -> ObjectState:
    """The state after an impulse that changes its motion as that of a rigid body.

    Args:
        delta_v: added to the velocity at `centre` [m/s], (3,).
        spin: added to the angular velocity [rad/s], (3,).
        centre: about which it turns [m], (3,).
    """
    kind, turn = state.velocities.dtype, _cross(spin)
    added = np.asarray(delta_v) + (state.positions - np.asarray(centre)) @ turn.T
    return replace(
        state, velocities=state.velocities + added.astype(kind), affine=state.affine + turn.astype(state.affine.dtype)
    )


def _cross(vector: ArrayLike) -> Array:
    """[w]_x, (3, 3), of w (3,)."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def centre_of_mass(values: Array, masses: Array) -> Array:
    """Mass-weighted mean of `values` (P, 3): of positions the centre of mass, of velocities the centre's own."""
    weights = np.asarray(masses, dtype=np.float64)
    return weights @ np.asarray(values, dtype=np.float64) / weights.sum()


def energies(
    state: ObjectState,
    volumes: Array,
    material: Material | Sequence[Material],
    dx: float,
    gravity: ArrayLike,
    region: NDArray[np.integer[Any]] | None = None,
    spread: float = 0.25,
    dampings: Sequence[Damping] | None = None,
) -> Array:
    """Kinetic, elastic and potential energy [J], shape (3,); `region` is each particle's material, shape (P,).

    Kinetic is what APIC carries: sum m_p (|v_p|^2 + D |C_p|^2) / 2, D = `spread` dx^2, which is dx^2/4 for quadratic
    and dx^2/3 for cubic B-splines, the second term being the motion within a
    particle's stencil. Elastic is what can be given back; what the flow of a plastic material took is not in it.
    Potential is -sum m_p g . x_p: 0 at the origin, and for gravity along z on the ground.
    """
    materials = (material,) if isinstance(material, Material) else material
    volumes = np.asarray(volumes, dtype=np.float64)
    region = np.zeros(len(volumes), dtype=int) if region is None else region
    masses = volumes * np.array([m.density for m in materials])[region]
    x, v, c = (a.astype(np.float64) for a in (state.positions, state.velocities, state.affine))
    f = (state.deformation_gradient if state.elastic is None else state.elastic).astype(np.float64)
    hardening = np.zeros(len(f)) if state.hardening is None else state.hardening.astype(np.float64)
    kinetic = 0.5 * masses @ ((v**2).sum(-1) + spread * dx**2 * (c**2).sum((-2, -1)))
    elastic = 0.0
    for index, m in enumerate(materials):
        own = region == index
        density = elastic_energy_density(m, f[own], hardening[own])
        if dampings is not None and dampings[index].steepness and state.play is not None:
            mu, lam = lame_parameters(m)
            psi = strain_energy(f[own], mu, lam)
            density *= recoverable(dampings[index], psi, LEAST_ENERGY * mu, state.play[own].astype(np.float64))
        elastic += volumes[own] @ density
    return np.array([kinetic, elastic, -masses @ (x @ np.asarray(gravity, dtype=np.float64))])


def linear_momentum(state: ObjectState, masses: Array) -> Array:
    """sum m_p v_p [N s], shape (3,)."""
    return np.asarray(masses, dtype=np.float64) @ state.velocities.astype(np.float64)


def angular_momentum(state: ObjectState, masses: Array, dx: float, spread: float = 0.25) -> Array:
    """sum m_p (x_p x v_p + D axl(C_p)), D = `spread` dx^2 as for `energies`, about the
    origin [N m s], shape (3,), with axl(C)_i = e_ijk C_kj.

    The second term is what each particle's stencil carries (Jiang et al. 2015, The Affine Particle-In-Cell Method);
    APIC conserves the sum.
    """
    masses = np.asarray(masses, dtype=np.float64)
    c = state.affine.astype(np.float64)
    axial = np.stack([c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], axis=-1)
    return masses @ (np.cross(state.positions, state.velocities) + spread * dx**2 * axial)


def check_state(state: ObjectState, volumes: Array) -> None:
    """Raises InputError unless shapes agree, all is finite, volumes are positive and no particle is inverted."""
    count = len(state.positions)
    shapes = {
        "positions": (count, 3),
        "velocities": (count, 3),
        "affine": (count, 3, 3),
        "deformation_gradient": (count, 3, 3),
    }
    if state.elastic is not None:
        shapes["elastic"] = (count, 3, 3)
    if state.hardening is not None:
        shapes["hardening"] = (count,)
    if state.play is not None:
        shapes["play"] = (count,)
    if count == 0:
        raise InputError("object state has no particles; at least one is needed")
    for name, shape in shapes.items():
        array = np.asarray(getattr(state, name))
        if array.shape != shape:
            raise InputError(f"object state {name} must have shape {shape}, got {array.shape}")
        if not np.isfinite(array).all():
            bad = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise InputError(f"object state {name} must be finite, got {array[bad].tolist()} for particle {bad}")
    volumes = np.asarray(volumes)
    if volumes.shape != (count,) or not (np.isfinite(volumes).all() and (volumes > 0).all()):
        raise InputError(f"object volumes must be {count} positive numbers [m^3], got shape {volumes.shape}, "
                         f"smallest {volumes.min(initial=np.inf):g}")  # fmt: skip
    for name in ("deformation_gradient", "elastic")[: 1 if state.elastic is None else 2]:
        determinants = np.linalg.det(getattr(state, name))
        if not (determinants > 0).all():
            raise InputError(f"object state {name} must have det F > 0, got {determinants.min():g}")
