"""Simulations of several bodies stepped as one: each in its own window of one lattice, exchanging momentum where the
windows' nodes hold both (`hoi.mpm.contact`).

A body costs what it costs alone, and a pair what its common nodes cost: nothing has a field where its body is not.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hoi.compute import ti
from hoi.data import Array
from hoi.errors import InputError, RunError
from hoi.mpm import contact
from hoi.mpm.solver import STEPS_A_LOOK, Launch, Simulation, set_status

CLOSE = 1.5
"""Particles of two bodies within this may touch [cells]."""


class Fields:
    """Room to work in, for any bodies on one lattice.

    Args:
        first: any of the simulations; all others must be on its cells, with its spline, precision, threads and device.
    """

    def __init__(self, first: Simulation) -> None:
        self._like = _kind(first)
        self.real = first.real
        self.status = ti.ndarray(ti.i32, 4)
        self.meetings = 0
        """Pairs of fields looked at for contact, a step each."""
        self._new_room(1)

    def step_towards(
        self, simulations: Sequence[Simulation], seconds: float, friction: Array, span: float = math.inf
    ) -> None:
        """Some steps of equal length together, `seconds` [s] at the most and about `span` [s].

        Args:
            friction: Coulomb coefficient of each pair [-], (N, N).

        Raises:
            RunError: one of them diverged, or `seconds` cannot be stepped.
        """
        for simulation in simulations:
            self._check(simulation)
        left = min([seconds, *(each.next_stop(each.time + seconds) - each.time for each in simulations)])
        dt = min(each.longest_step() for each in simulations)
        steps = max(math.ceil(left / dt * (1 - 1e-9)), 1)
        dt = left / steps
        at_once = min(steps, STEPS_A_LOOK, max(math.ceil(span / dt), 1) if span < left else steps)
        touching = _touching([each.bounds()[0] for each in simulations], CLOSE * simulations[0].dx)
        launches = [each.prepare(at_once, dt, touches) for each, touches in zip(simulations, touching, strict=True)]
        pairs = self._pairs(simulations, launches, friction)
        for each in simulations:
            each.given.fill(0.0)
        set_status(self.status)
        for number in range(min(launch.steps for launch in launches)):
            for each, launch in zip(simulations, launches, strict=True):
                each.begin_step(launch, number, self.status)
            for arguments in pairs:
                contact.meet(*arguments)
            self.meetings += len(pairs)
            for each, launch in zip(simulations, launches, strict=True):
                each.end_step(launch, number, self.status, last=each is simulations[-1])
        done = self._done(simulations)
        for each, launch in zip(simulations, launches, strict=True):
            each.close(launch, done, each.time + (left if done == steps else left - (steps - done) * dt))

    def _done(self, simulations: Sequence[Simulation]) -> int:
        try:
            return simulations[0].check_status(self.status)
        except RunError:
            for each in simulations:
                each.state()  # the one that it is about says more
            raise

    def _pairs(
        self, simulations: Sequence[Simulation], launches: Sequence[Launch], friction: Array
    ) -> list[tuple[Any, ...]]:
        """What `hoi.mpm.contact.meet` takes, of each pair whose windows have nodes in common."""
        found = []
        for i, j in itertools.combinations(range(len(simulations)), 2):
            a, b = launches[i], launches[j]
            low = np.maximum(a.origin, b.origin) + 1  # the gradient wants a node on either side
            count = np.minimum(a.origin + a.shape, b.origin + b.shape) - 1 - low
            if (count > 0).all():
                found.append((i, j, low, count))
        most = max((int(count.prod()) for *_, count in found), default=0)
        if most > self.normals.shape[0]:
            self._new_room(int(1.2 * most))
        return [self._arguments(simulations, launches, friction, *pair) for pair in found]

    def _arguments(
        self, simulations: Sequence[Simulation], launches: Sequence[Launch], friction: Array, i: int, j: int,
        low: Array, count: Array,
    ) -> tuple[Any, ...]:  # fmt: skip
        particles, windows = [], []
        for each, launch in ((simulations[i], launches[i]), (simulations[j], launches[j])):
            particles += [each.x, each.f, each.volume, each.grid]
            windows += [*launch.numbers[-2:], float(each.volumes.sum() / each.masses.sum())]
        a = simulations[i]
        copies = 1 if a.on_gpu else a.threads
        return (copies, a.size, *particles, self.leaning, self.normals, self.extents, *windows, _vector(low),
                _vector(count), float(friction[i, j]), launches[i].dt, a.dx, 1 / a.dx)  # fmt: skip

    def _new_room(self, nodes: int) -> None:
        self.leaning = ti.Vector.ndarray(4, self.real, nodes)
        self.normals = ti.Vector.ndarray(4, self.real, nodes)
        self.extents = ti.ndarray(self.real, 2 * nodes)

    def _check(self, simulation: Simulation) -> None:
        for name, value in _kind(simulation).items():
            if value != self._like[name]:
                raise InputError(f"bodies on one grid must have the same {name}, got {value} beside {self._like[name]}")


def apart(a: Array, b: Array) -> float:
    """How far the boxes around two sets of points (P, 3) and (Q, 3) are from each other, at the least [m]."""
    return float(np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0)).max())


def _touching(boxes: Sequence[Array], reach: float) -> list[bool]:
    """Which boxes, their corners (8, 3), have another within `reach` [m]."""
    return [any(apart(a, b) <= reach for b in boxes if b is not a) for a in boxes]


def _kind(simulation: Simulation) -> dict[str, Any]:
    return {
        "dx": simulation.dx, "spline": "quadratic" if simulation.size == 3 else "cubic",
        "precision": "float32" if simulation.real == ti.f32 else "float64", "threads": simulation.threads,
        "device": "cuda" if simulation.on_gpu else "cpu", "gravity": tuple(simulation.gravity),
    }  # fmt: skip


def _vector(values: Array) -> Any:
    return ti.Vector([*(int(value) for value in values), 0])
