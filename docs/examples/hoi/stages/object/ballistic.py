"""Parabolas instead of the simulation: for what flies and never lands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import Draft, ObjectMover, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import ObjectState, Scene
    from hoi.method.object_motion import Advanced, Mover, World
    from hoi.mpm.collider import Collider
    from hoi.reports import Stage


@option("stage/object", "ballistic")
@dataclass
class Ballistic(ObjectMover):
    """Parabolas: gravity, but no ground and no deformation."""

    stands_for: ClassVar[dict[str, str]] = {"ballistic": "the MPM"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("ballistic")
        draft.run("free_motion", self.name, "a parabola from the initial velocity")

    def mover(self, object_size: float, threads: int, device: str) -> Mover:
        return ballistic


def ballistic(
    scene: Scene | World,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | None = None,
) -> Advanced:
    """All of the object flies with the velocity of its centre of mass, and nothing stops it."""
    import numpy as np

    from hoi.method.object_motion import Advanced, rigid_energy
    from hoi.mpm.state import centre_of_mass

    velocity = centre_of_mass(state.velocities, scene.thing.masses)
    states = []
    for stop in stops:
        time = (stop - start) / scene.fps
        moved = state.positions + velocity * time + 0.5 * scene.gravity * time**2
        velocities = np.tile(velocity + scene.gravity * time, (len(moved), 1))
        states.append(replace(state, positions=moved, velocities=velocities))
        stage.advance()
    energy = [rigid_energy(scene, s) for s in states]
    return Advanced(tuple(states), np.array(energy).reshape(-1, 3), ("ballistic",) * len(states))
