"""Straight lines instead of the simulation (paper, w/o MPM)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from hoi.stages.contract import Draft, ObjectMover, option

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import ObjectState, Scene
    from hoi.method.object_motion import Advanced, Mover, World
    from hoi.mpm.collider import Collider, Partner
    from hoi.reports import Stage


@option("stage/object", "constant_velocity")
@dataclass
class ConstantVelocity(ObjectMover):
    """Straight lines: no gravity, no deformation."""

    stands_for: ClassVar[dict[str, str]] = {"no_mpm": "the MPM"}

    def plan(self, config: Config, draft: Draft) -> None:
        draft.without.append("no_mpm")
        saves = "the simulation" if config.render.compiles else "importing Taichi, the simulation"
        draft.omit("MPM", "stage/object is constant_velocity", saves)
        draft.run("free_motion", self.name, "straight line from the initial velocity")

    def mover(self, object_size: float, threads: int, device: str) -> Mover:
        return constant_velocity


def constant_velocity(
    scene: Scene | World,
    state: ObjectState,
    start: float,
    stops: Sequence[float],
    stage: Stage,
    collider: Collider | Partner | None = None,
) -> Advanced:
    """Straight lines: no gravity, no ground, no deformation, and nothing pushes."""
    import numpy as np

    from hoi.method.object_motion import Advanced, rigid_energy
    from hoi.mpm.state import centre_of_mass

    velocity = centre_of_mass(state.velocities, scene.thing.masses)
    states = []
    for stop in stops:
        moved = state.positions + velocity * (stop - start) / scene.fps
        states.append(replace(state, positions=moved, velocities=np.tile(velocity, (len(moved), 1))))
        stage.advance()
    energy = [rigid_energy(scene, s) for s in states]
    return Advanced(tuple(states), np.array(energy).reshape(-1, 3), ("constant_velocity",) * len(states))
