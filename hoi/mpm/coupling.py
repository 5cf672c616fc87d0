"""Capsules that give way: what an object in the grid gives back to whatever carries them, in the same substep.

Between p2g and the update of the nodes, in two passes over the nodes that hold particles in a capsule
(`hoi.mpm.exchange`):

    meet  the nodes that capsules of a part approach make up a cluster; as in a plastic blow, part and cluster are to
          have one motion, with all that hangs on the part: t' = t + W (h - G t').
    push  each such node is held to its capsule at that velocity, as by an obstacle, or as far towards it as lets the
          energy of all fall, and the part gets exactly the opposite of what the node was given.

Over the steps of a launch parts answer as they would where they stood at its start, W being kept.

However heavy or stiff the object is, a capsule cannot gain speed from it: its predicted velocity lies between its own
and the cluster's.
"""

from typing import Any

import numpy as np

from hoi.compute import ti
from hoi.data import Array
from hoi.mpm import exchange
from hoi.mpm.collider import Partner


class Coupling:
    """A partner's capsules on the device, and what goes to and fro.

    Args:
        real: float type of the kernels.

    `capsules` are those near the object as `hoi.mpm.boundary.hold_to_capsules` reads them, `parts` what carries each,
    `body` see `hoi.mpm.exchange`.
    """

    def __init__(self, partner: Partner, real: Any) -> None:
        self.partner, self._real = partner, real
        self._kind = np.float32 if real == ti.f32 else np.float64
        self._chosen = np.zeros(0, np.intp)

    def choose(self, low: Array, high: Array, reach: float) -> bool:
        """Takes the capsules that come within `reach` [m] of a box; whether there are any."""
        ends, radii = self.partner.ends, self.partner.radii[:, None]
        apart = np.maximum(ends.min(axis=1) - radii - high, low - ends.max(axis=1) - radii).max(axis=1)
        chosen = np.flatnonzero(apart < reach)
        if not np.array_equal(chosen, self._chosen):
            self._chosen = chosen
            self._carriers, place = np.unique(self.partner.parts[chosen], return_inverse=True)
            count = len(self._carriers)
            self.capsules = ti.Vector.ndarray(4, self._real, 4 * max(len(chosen), 1))
            self.parts, self.body = no_parts(max(len(chosen), 1), count)
            self.parts.from_numpy(np.asarray(place if count else [0], np.int32))
        return len(chosen) > 0

    def begin(self, origin: Array) -> None:
        """Writes capsules and parts as seen from the window's origin [m], (3,)."""
        partner, chosen = self.partner, self._chosen
        twists, ends = partner.twists[partner.parts[chosen]], partner.ends[chosen]
        rows = np.zeros((len(chosen), 4, 4), self._kind)
        rows[:, :2, :3] = ends - origin
        rows[:, 2:, :3] = twists[:, None, :3] + np.cross(twists[:, None, 3:], ends)
        rows[:, 0, 3], rows[:, 1, 3] = partner.radii[chosen], partner.friction
        self.capsules.from_numpy(rows.reshape(-1, 4))
        count = len(self._carriers)
        there, body = np.kron(np.eye(count), _moved(origin)), np.zeros(self.body.shape)
        body[:, exchange.NOW] = there @ partner.twists[self._carriers].ravel()
        body[:, exchange.EASE : exchange.EASE + 6 * count] = there @ partner.ease(self._carriers) @ there.T
        self.body.from_numpy(body)

    def end(self, origin: Array) -> Array:
        """Gives the partner the opposite of what was given in a launch, which is returned [N s], (3,)."""
        wrenches = self.body.to_numpy()[:, exchange.TAKEN].reshape(-1, 6)
        if wrenches.any():
            self.partner.take(self._carriers, wrenches @ _moved(origin))
        return wrenches[:, :3].sum(axis=0)


def no_parts(capsules: int = 1, parts: int = 0) -> tuple[Any, Any]:
    """`parts` and `body` of a launch on the device, not yet filled."""
    shape = 6 * max(parts, 1), exchange.columns(max(parts, 1))
    return ti.ndarray(ti.i32, capsules), ti.ndarray(ti.f64, shape)


def _moved(by: Array) -> Array:
    """S (6, 6): a twist at the world's origin is S t at a place; a wrench p there is S^T p about the origin."""
    x, y, z = by
    moved = np.eye(6)
    moved[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return moved


def fastest(partner: Partner) -> float:
    """Speed of the fastest end of a capsule [m/s]."""
    twists = partner.twists[partner.parts]
    return float(np.linalg.norm(twists[:, None, :3] + np.cross(twists[:, None, 3:], partner.ends), axis=-1).max())
