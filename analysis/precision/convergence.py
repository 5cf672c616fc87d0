"""The order with which errors fall as the grid is refined and the time step with it.

What theory says of positions, dt being a fixed share of the limit and so proportional to dx: order 2.
- Space: B-splines reproduce linear functions, and the APIC transfer takes a smooth velocity to v + O(dx^4 v'''') and
  back; the stress enters through a gradient that is second order. This holds for both splines: the cubic one is
  smoother, but its gradient, with D = dx^2/3, is not of higher order. At a free face the gradient is only first
  order, in a layer a cell thick where the stress itself is O(dx): the sum stays second order.
- Time: symplectic Euler is leapfrog with velocities half a step late. A start without strain has no acceleration, so
  that the half step changes nothing and positions are second order in dt. A start under strain lacks the kick
  of half a step, an O(dt) change of the initial velocity: positions, and velocities as read, are first order.
- Both at once only: each transfer damps by O((k dx)^4), so at a fixed dx there is no limit dt -> 0. With dt ~ dx the
  damping sums to O(dx^3) over a given time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from hoi.mpm.solver import Spline

from .errors import observed_order
from .problems import Problem, waves
from .run import Variant, judge, run

TOLERANCE = 0.2
"""By how much an observed order may miss the theory's."""


@dataclass(frozen=True)
class Order:
    """One observed order of convergence."""

    series: str
    quantity: str
    cells: tuple[int, ...]
    errors: tuple[float, ...]
    expected: float | None
    """None: theory does not say."""

    @property
    def observed(self) -> float:
        """Least-squares slope of log error over log dx."""
        return observed_order([1 / cells for cells in self.cells], self.errors)

    @property
    def verdict(self) -> str:
        """Whether it is as expected."""
        if self.expected is None:
            return ""
        return "as expected" if abs(self.observed - self.expected) <= TOLERANCE else "NOT as expected"


def manufactured(quick: bool, say: Callable[[str], object] = print) -> list[Order]:
    """Orders on the finite waves, in float64: of both splines, and of a start under strain.

    The last takes steps twice as long, over a quarter of the period, so that its first order, of time, is what is seen.
    Steps are all alike: changing their length shifts the half step that velocities are late by, which is first order.
    """
    free, strained = waves(), waves(phase=np.pi / 2)
    strained = replace(strained, times=strained.times[: len(strained.times) // 4])
    cells = (16, 24, 32) if quick else (16, 32, 64)
    series: list[tuple[str, Problem, Spline, tuple[int, ...], int, float]] = [
        ("finite waves, quadratic", free, "quadratic", cells, 2, 2.0),
        ("finite waves, cubic", free, "cubic", cells, 2, 2.0),
        ("from under strain", strained, "quadratic", (32, 48, 64), 4, 1.0),
    ]
    orders = []
    for name, problem, spline, each, coarser, expected in series[:1] if quick else series:
        errors = []
        for count in each:
            dt = problem.times[0] * coarser / count  # 1/8 dx/c times `coarser`: whole steps in each interval
            done = run(problem, Variant("order", count, spline=spline, precision="float64"), dt=dt)
            errors.append(judge(problem, done.seen, None)["position"])
        orders.append(Order(name, "position", each, tuple(errors), expected))
        say(f"order    {name}: {orders[-1].observed:.2f}, {orders[-1].verdict}")
    return orders


def by_grid(table: pd.DataFrame) -> list[Order]:
    """Orders of each problem's headline error over its grids, with what else is the base's."""
    orders = []
    for problem in table["problem"].unique():
        chosen = (table["problem"] == problem) & table["kind"].isin(["base", "grid"])
        rows = pd.DataFrame(table[chosen]).sort_values("cells")
        if problem in THEORY and len(rows) > 1:
            orders.append(Order(problem, rows["headline"].iloc[0], tuple(rows["cells"]), tuple(rows["error"]),
                                THEORY[problem]))  # fmt: skip
    return orders


THEORY: dict[str, float | None] = {"bar": 2.0, "hertz": None, "bounce": None, "box": None, "punch": None}
"""Where the grid is what limits the headline error, and the order that theory gives it."""
