"""Bodies that meet, for the tests of contact between them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpm_bodies import DX, RUBBER, block

from hoi.data import Array, Material, ObjectState, Plane
from hoi.mpm.bodies import Bodies
from hoi.mpm.fields import Fields
from hoi.mpm.phases import Surroundings, Walk, lowest_frequency, reach_of
from hoi.mpm.solver import Simulation
from hoi.mpm.state import centre_of_mass, initial_state

STIFF = replace(RUBBER, youngs_modulus=1e6)
NOWHERE = np.zeros(3)


def ball(radius: float, centre: Sequence[float], spacing: float = DX / 2) -> tuple[Array, Array]:
    """Positions (P, 3) and volumes (P,) of a ball."""
    x, volumes = block((2 * radius,) * 3, spacing)
    x -= radius
    inside = np.linalg.norm(x, axis=1) <= radius
    return x[inside] + centre, volumes[inside]


class Meeting:
    """Simulations of bodies (positions, volumes, velocity, material) stepped together."""

    def __init__(self, *bodies, dx: float = DX, friction: float = 0.4, gravity=NOWHERE, planes=(), **options) -> None:
        self.dx, self.masses, self.simulations = dx, [], []
        for position, (x, volumes, velocity, material) in enumerate(bodies):
            self.masses.append(volumes * material.density)
            own = planes if position == 0 else ()  # what carries the others
            self.simulations.append(
                Simulation(initial_state(x, self.masses[-1], velocity), volumes, material, dx=dx, gravity=gravity,
                           planes=own, **options)
            )  # fmt: skip
        self.friction = np.full((len(bodies), len(bodies)), friction)
        self.fields = Fields(self.simulations[0])

    @property
    def time(self) -> float:
        return self.simulations[0].time

    def advance(self, until: float) -> None:
        while self.time < until - 1e-12:
            self.fields.step_towards(self.simulations, until - self.time, self.friction)

    def states(self) -> list[ObjectState]:
        return [each.state() for each in self.simulations]

    def velocities(self) -> Array:
        """Of the centres of mass, (N, 3)."""
        return np.array([
            centre_of_mass(state.velocities, mass) for state, mass in zip(self.states(), self.masses, strict=True)
        ])  # fmt: skip


def walk(x: Array, volumes: Array, velocity, *, end: float, planes: Sequence[Plane] = (), gravity=NOWHERE,
         material: Material = STIFF, dx: float = DX, tolerance: float | None = 0.003, held: bool = False,
         spin=NOWHERE, **options) -> Walk:  # fmt: skip
    """The walk of one body among `planes`."""
    masses = volumes * material.density

    def start(state: ObjectState, _: float) -> Simulation:
        return Simulation(state, volumes, material, dx=dx, planes=planes, gravity=gravity, **options)

    return Walk(
        initial_state(x, masses, velocity, spin), masses, start, end=end, gravity=np.asarray(gravity),
        surroundings=Surroundings(planes, [reach_of(plane, dx) for plane in planes]),
        size=float(np.ptp(x, axis=0).max()), moment=dx**2 / 4,
        frequency=lowest_frequency(x, masses, [material]), tolerance=tolerance, held=held,
    )  # fmt: skip


def together(*walks: Walk, friction: float = 0.4, dx: float = DX) -> Bodies:
    return Bodies(walks, np.full((len(walks), len(walks)), friction), dx)
