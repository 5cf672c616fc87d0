"""Capsules that give way: what an object in the grid gives back to whatever carries them, in the same substep.

Between p2g and the update of the nodes, in two passes over the nodes that hold particles in a capsule:

    meet  the nodes that a capsule approaches make up a cluster; as in a plastic blow, capsule and cluster are to have
          one velocity. What carries the capsules solves for that, with all that hangs on them.
    push  each such node is held to its capsule at that velocity, as by an obstacle, and the capsule gets exactly the
          opposite of what the node was given.

However heavy or stiff the object is, a capsule cannot gain speed from it: its predicted velocity lies between its own
and the cluster's.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from typing import Any

import numpy as np

from hoi.compute import ti
from hoi.data import Array
from hoi.mpm.boundary import hold_to_capsule, nearest_capsule
from hoi.mpm.collider import Partner

CLUSTER = 5
"""Rows of four that describe a cluster: mass and first moment; momentum; angular momentum; second moments xx, yy, zz;
and xy, yz, zx. All about the window's origin."""


class Coupling:
    """A partner's capsules on the device, and what goes to and fro.

    `given` (3,) [N s] is what the capsules gave the object so far.
    """

    def __init__(self, partner: Partner, real: Any, on_gpu: bool) -> None:
        self.partner, self._real, self._on_gpu = partner, real, on_gpu
        self._kind = np.float32 if real == ti.f32 else np.float64
        self._chosen = np.zeros(0, np.intp)
        self.given = np.zeros(3)

    def choose(self, low: Array, high: Array, reach: float) -> bool:
        """Takes the capsules that come within `reach` [m] of a box; whether there are any."""
        ends, radii = self.partner.ends, self.partner.radii[:, None]
        apart = np.maximum(ends.min(axis=1) - radii - high, low - ends.max(axis=1) - radii).max(axis=1)
        chosen = np.flatnonzero(apart < reach)
        if len(chosen) != len(self._chosen):
            self.capsules = ti.Vector.ndarray(4, self._real, 4 * max(len(chosen), 1))
        self._chosen = chosen
        return len(chosen) > 0

    def place(self, origin: Array) -> None:
        """Writes the capsules as `hold_to_capsules` reads them, seen from the window's origin [m], (3,)."""
        partner, chosen = self.partner, self._chosen
        rows = np.zeros((len(chosen), 4, 4), self._kind)
        rows[:, :2, :3], rows[:, 2:, :3] = partner.ends[chosen] - origin, partner.velocities[chosen]
        rows[:, 0, 3], rows[:, 1, 3] = partner.radii[chosen], partner.friction
        self.capsules.from_numpy(rows.reshape(-1, 4))

    def exchange(
        self, grid: Any, touched: Any, copies: int, dt: float, dx: float, gravity: Any, shape: Any, origin: Array
    ) -> None:
        """Between the halves of a step: partner and object push each other. `origin` is the window's [m], (3,)."""
        partner, where = self.partner, (dt, dx, gravity, shape)
        clusters, taken = (np.zeros((rows * len(self._chosen), 4), self._kind) for rows in (CLUSTER, 2))
        meet(copies, self._on_gpu, grid, touched, self.capsules, clusters, *where)
        if clusters.any():
            rows = clusters.astype(np.float64).reshape(-1, CLUSTER, 4)
            partner.meet(self._chosen, *_about_world(rows, origin))
            self.place(origin)
        push(copies, self._on_gpu, grid, touched, self.capsules, taken, *where)
        partner.ends = partner.ends + dt * partner.velocities
        if taken.any():
            linear, angular = taken.astype(np.float64).reshape(-1, 2, 4)[:, :, :3].swapaxes(0, 1)
            partner.take(self._chosen, linear, angular + np.cross(origin, linear))
            self.given = self.given + linear.sum(axis=0)


def _about_world(rows: Array, origin: Array) -> tuple[Array, ...]:
    """Mass (J,), first and second moments, (J, 3) and (J, 3, 3), and momenta (J, 3); `origin` is the window's."""
    mass, first, linear = rows[:, 0, 0], rows[:, 0, 1:], rows[:, 1, :3]
    xx, yy, zz = rows[:, 3, :3].T
    xy, yz, zx = rows[:, 4, :3].T
    second = np.stack([xx, xy, zx, xy, yy, yz, zx, yz, zz], axis=-1).reshape(-1, 3, 3)
    across = first[:, :, None] * origin
    second = second + across + across.swapaxes(1, 2) + mass[:, None, None] * np.outer(origin, origin)
    return mass, first + mass[:, None] * origin, second, linear, rows[:, 2, :3] + np.cross(origin, linear)


@ti.func
def node_of(node, nodes, copies, grid: ti.template(), dt, dx, gravity: ti.template(), shape: ti.template()):
    """Velocity of a node before anything solid holds it, its mass in the last place, and where it is in the window."""
    total = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for copy in range(1, copies + 1):
        total += grid[copy * nodes + node]
    mass = total[3]
    velocity = total * (1.0 / ti.max(mass, 1e-30))
    for a in ti.static(range(3)):
        velocity[a] += dt * ti.cast(gravity[a], float)
    velocity[3] = 0.0
    layer = shape[1] * shape[2]
    place = dx * ti.Vector([
        ti.cast(node // layer, float), ti.cast(node % layer // shape[2], float), ti.cast(node % shape[2], float), 0.0,
    ])  # fmt: skip
    return velocity, mass, place


@ti.func
def add(rows: ti.template(), row, contribution, atomic: ti.template()):
    for a in ti.static(range(4)):
        if ti.static(atomic):
            ti.atomic_add(rows[row, a], contribution[a])
        else:
            rows[row, a] = rows[row, a] + contribution[a]


@ti.func
def cross(a, b):
    return ti.Vector([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0], 0.0])


@ti.func
def meet_node(node, atomic: ti.template(), nodes, copies, grid: ti.template(), touched: ti.template(),
              capsules: ti.template(), clusters: ti.template(), dt, dx, gravity: ti.template(),
              shape: ti.template()):  # fmt: skip
    if touched[node] != 0:
        velocity, mass, r = node_of(node, nodes, copies, grid, dt, dx, gravity, shape)
        i = nearest_capsule(r, capsules, dt)
        if mass > 0.0 and i >= 0:
            _, approach = hold_to_capsule(velocity, r, i, capsules, dt)
            if approach > 0.0:
                row = 5 * i
                add(clusters, row, mass * ti.Vector([1.0, r[0], r[1], r[2]]), atomic)
                add(clusters, row + 1, mass * velocity, atomic)
                add(clusters, row + 2, mass * cross(r, velocity), atomic)
                add(clusters, row + 3, mass * ti.Vector([r[0] * r[0], r[1] * r[1], r[2] * r[2], 0.0]), atomic)
                add(clusters, row + 4, mass * ti.Vector([r[0] * r[1], r[1] * r[2], r[2] * r[0], 0.0]), atomic)


@ti.func
def push_node(node, atomic: ti.template(), nodes, copies, grid: ti.template(), touched: ti.template(),
              capsules: ti.template(), taken: ti.template(), dt, dx, gravity: ti.template(),
              shape: ti.template()):  # fmt: skip
    if touched[node] != 0:
        touched[node] = 0
        velocity, mass, r = node_of(node, nodes, copies, grid, dt, dx, gravity, shape)
        i = nearest_capsule(r, capsules, dt)
        if mass > 0.0 and i >= 0:
            pushed, _ = hold_to_capsule(velocity, r, i, capsules, dt)
            given = mass * (pushed - velocity)
            grid[nodes + node] = grid[nodes + node] + given
            add(taken, 2 * i, given, atomic)
            add(taken, 2 * i + 1, cross(r, given), atomic)


@ti.kernel
def meet(
    copies: int, atomic: ti.template(), grid: ti.types.ndarray(), touched: ti.types.ndarray(),
    capsules: ti.types.ndarray(), clusters: ti.types.ndarray(), dt: float, dx: float,
    gravity: ti.types.vector(4, ti.f64), shape: ti.types.vector(4, int),
):  # fmt: skip
    """The clusters, (CLUSTER x capsules), of the nodes that capsules approach; clear before."""
    nodes = shape[0] * shape[1] * shape[2]
    for i in range(nodes if ti.static(atomic) else 1):
        if ti.static(atomic):
            meet_node(i, True, nodes, copies, grid, touched, capsules, clusters, dt, dx, gravity, shape)
        else:
            for node in range(nodes):
                meet_node(node, False, nodes, copies, grid, touched, capsules, clusters, dt, dx, gravity, shape)


@ti.kernel
def push(
    copies: int, atomic: ti.template(), grid: ti.types.ndarray(), touched: ti.types.ndarray(),
    capsules: ti.types.ndarray(), taken: ti.types.ndarray(), dt: float, dx: float,
    gravity: ti.types.vector(4, ti.f64), shape: ti.types.vector(4, int),
):  # fmt: skip
    """Holds the nodes to their capsules. `taken` (2 a capsule), clear before: the impulse and, about the window's
    origin, the angular impulse that each gave."""
    nodes = shape[0] * shape[1] * shape[2]
    for i in range(nodes if ti.static(atomic) else 1):
        if ti.static(atomic):
            push_node(i, True, nodes, copies, grid, touched, capsules, taken, dt, dx, gravity, shape)
        else:
            for node in range(nodes):
                push_node(node, False, nodes, copies, grid, touched, capsules, taken, dt, dx, gravity, shape)
