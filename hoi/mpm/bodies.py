"""Several bodies that may touch: each is walked alone as long as it is, and what may touch is simulated together.

Every body has its own walk (`hoi.mpm.phases`). The one whose time is least goes on, by some steps or to the end of its
flight, if nothing can come near it meanwhile:

| pair | told apart by |
| --- | --- |
| two that fly, roll or rest | conservative advancement of their convex hulls, as for planes |
| one that is simulated | boxes around both, grown by what they can move in twice the time that it goes on for |

What may touch is brought to one time, woken, and stepped together (`hoi.mpm.fields`) until it is apart again. A body at
rest costs a look at its box, but no step, and the others step as if it were not there, until one of them comes near.
What lies on each other rests together, once all of it is still, and is woken together.
"""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hoi.data import Array, ObjectState
from hoi.mpm import rigid
from hoi.mpm.fields import CLOSE, Fields, apart
from hoi.mpm.phases import RESOLUTION, ROUND_OFF, Tally, Walk, time_to_close
from hoi.mpm.solver import STEPS_A_LOOK

MOST_ADVANCES = 1000
"""Of conservative advancement; then the time found so far is taken, which is never late."""


class Bodies:
    """The trajectories of N bodies, walked from one time to the next.

    Args:
        walks: of each body, all at time 0; their simulations have one cell size, spline, precision and device.
        friction: Coulomb coefficient between each pair [-], (N, N), symmetric.
        dx: the cell size [m].
    """

    def __init__(self, walks: Sequence[Walk], friction: Array, dx: float) -> None:
        self.walks, self.friction, self.dx = list(walks), np.asarray(friction, dtype=np.float64), dx
        self._groups = [[i] for i in range(len(walks))]
        """Bodies that are stepped together; one alone if it is not in the MPM."""
        self._since = [0.0] * len(walks)
        """When each began its phase [s]."""
        self._moved_by = [walk.phase for walk in walks]
        self.fields: Fields | None = None
        self._hull_of, self._meeting_of = lru_cache(None)(self._find_hull), lru_cache(None)(self._find_meeting)

    def advance(self, until: float) -> list[tuple[ObjectState, str]]:
        """The state of each body at time `until` [s], and the phase that led it there."""
        self._moved_by = [walk.phase for walk in self.walks]
        while (due := self._next(until)) is not None:
            self._go(*due, until)
        for walk in self.walks:
            if walk.time < until:  # at rest
                walk.advance(until)
        return [(walk.advance(until)[0], phase) for walk, phase in zip(self.walks, self._moved_by, strict=True)]

    def finish(self) -> list[Tally]:
        """The tally of each body's whole walk."""
        return [walk.finish() for walk in self.walks]

    def _next(self, until: float) -> tuple[float, list[int]] | None:
        """The group whose turn it is, and when something happens to it; None when all that moves is at `until`."""
        due = []
        for group in self._groups:
            walk = self.walks[group[0]]
            if walk.time < until and walk.phase != "rest":
                rank = 0 if walk.phase == "mpm" else 1
                event = walk.time if walk.phase == "mpm" else min(walk.path_ends, self._meeting(group[0])[0], until)
                due.append((event, rank, group))
        if not due:
            return None
        event, _, group = min(due, key=lambda each: each[:2])
        return event, group

    def _go(self, event: float, group: list[int], until: float) -> None:
        """One piece of a group's way."""
        first = self.walks[group[0]]
        if first.phase != "mpm":
            meeting, other = self._meeting(group[0])
            if meeting <= event and event < first.path_ends:
                self._join(group, self._group_of(other), event)
            else:
                self._follow(group[0], event)
            return
        ahead = 2 * self._look_ahead(group)
        near = [other for other in self._groups if other is not group and self._near(group, other, ahead)]
        behind = [other for other in near if self.walks[other[0]].phase != "mpm"]
        if behind:
            self._join(group, behind[0], first.time)
            return
        now = min((self.walks[other[0]].time for other in near), default=math.inf)
        if now <= first.time + ROUND_OFF:
            other = next(each for each in near if self.walks[each[0]].time == now)
            self._join(group, other, now)
        elif len(group) == 1:
            self._moved_by[group[0]] = "mpm"
            first.simulate(min(until, now))
            self._note(group[0])
        else:
            self._step(group, min(until, now))

    def _follow(self, i: int, until: float) -> None:
        walk = self.walks[i]
        self._moved_by[i] = walk.phase
        walk.advance(until)
        self._note(i)

    def _note(self, i: int) -> None:
        """Remembers since when a body has been in its phase."""
        self._since[i] = self.walks[i].time

    def _join(self, group: list[int], other: list[int], now: float) -> None:
        """Wakes what is not simulated at time `now`, and makes two groups one."""
        for i in (*group, *other):
            walk = self.walks[i]
            if walk.phase != "mpm":
                self._moved_by[i] = walk.phase
                walk.advance(now)
                walk.wake()
            walk.forget()
        self._groups = [each for each in self._groups if each is not group and each is not other]
        self._groups.append(sorted([*group, *other]))

    def _step(self, group: list[int], until: float) -> None:
        """Some steps of bodies that may touch, and what they are to each other then."""
        walks = [self.walks[i] for i in group]
        simulations = [walk.simulation for walk in walks]
        if self.fields is None:
            self.fields = Fields(simulations[0])
        span = min(walk.between_looks for walk in walks)
        self.fields.step_towards(simulations, until - walks[0].time, self.friction[np.ix_(group, group)], span)
        now = walks[0].began + simulations[0].time
        now = until if until - now < ROUND_OFF else now
        for i, walk in zip(group, walks, strict=True):
            self._moved_by[i] = "mpm"
            walk.count_steps(now)
        self._groups.remove(group)
        ahead = 2 * self._look_ahead(group)
        for part in self._parts(group, ahead):
            self._groups.append(part)
            members = [self.walks[i] for i in part]
            if len(part) == 1:
                members[0].forget()
            elif all([walk.rests() for walk in members]):
                for i, walk in zip(part, members, strict=True):
                    walk.take_state()
                    walk.hold()
                    self._note(i)
                self._groups.remove(part)
                self._groups += [[i] for i in part]
                continue
            if now == until:
                for walk in members:
                    walk.take_state()

    def _parts(self, group: list[int], ahead: float) -> list[list[int]]:
        """A group, split into what may touch within the next `ahead` [s]."""
        parts: list[list[int]] = []
        for i in group:
            touching = [part for part in parts if self._near([i], part, ahead)]
            parts = [part for part in parts if part not in touching]
            parts.append(sorted([i, *itertools.chain(*touching)]))
        return parts

    def _group_of(self, i: int) -> list[int]:
        return next(group for group in self._groups if i in group)

    def _look_ahead(self, group: list[int]) -> float:
        """How long a group in the MPM goes on for at once, at the most [s]."""
        return STEPS_A_LOOK * min(self.walks[i].simulation.time_step() for i in group)

    def _near(self, group: list[int], other: list[int], ahead: float) -> bool:
        """Whether a body of one may come within reach of a body of the other in the time `ahead` [s]."""
        now = self.walks[group[0]].time
        boxes = [[self._box(i, now, now + ahead) for i in each] for each in (group, other)]
        return any(apart(a, b) <= CLOSE * self.dx for a, b in itertools.product(*boxes))

    def _box(self, i: int, start: float, end: float) -> Array:
        """Two corners of a box that a body does not leave from `start` to `end` [s]."""
        walk = self.walks[i]
        fall = float(np.linalg.norm(walk.gravity))
        if walk.phase == "rest":
            hull = self._hull_of(i, walk.tally.changes)
            return np.array([hull.min(axis=0), hull.max(axis=0)])
        if walk.phase == "mpm":
            corners, speed = walk.simulation.bounds()
            for_long = max(abs(end - walk.time), abs(start - walk.time))
        else:
            path, since = walk.path, max(start, self._since[i]) - walk.departure
            hull = self._hull_of(i, walk.tally.changes)
            corners = path.com(since) + hull @ path.rotation(since).T
            speed = float(np.linalg.norm(path.velocity(since))) + path.fastest * float(
                np.linalg.norm(hull, axis=1).max()
            )
            fall, for_long = fall + path.unsteadiness(since), end - start
        moved = (speed + fall * for_long) * for_long
        return np.array([corners.min(axis=0) - moved, corners.max(axis=0) + moved])

    def _find_hull(self, i: int, _: int) -> Array:
        """Vertices of a body's convex hull [m]: about its centre of mass where it follows a path, else in the world."""
        walk = self.walks[i]
        if walk.phase == "rest":
            return rigid.hull(walk.here.positions)
        return rigid.hull(walk.departed.positions - walk.path.motion.com)

    def _meeting(self, i: int) -> tuple[float, int]:
        """When a body that follows a path may first touch one that follows one or rests, and which."""
        changes = self.walks[i].tally.changes
        met = [
            (self._meeting_of(min(i, j), max(i, j), *sorted_by(i, j, changes, other.tally.changes)), j)
            for j, other in enumerate(self.walks) if j != i and other.phase != "mpm"
        ]  # fmt: skip
        return min(met, default=(math.inf, -1))

    def _find_meeting(self, i: int, j: int, _: int, __: int) -> float:
        """The first time at which two bodies, neither of them simulated, may be in reach of each other [s].

        Conservative advancement as in `hoi.mpm.phases.first_contact`, of the distance along whichever of a few
        directions tells them apart for longest.
        """
        a, b = _Course(self, i), _Course(self, j)
        time, ends = max(self._since[i], self._since[j]), min(a.ends, b.ends)
        for _step in range(MOST_ADVANCES):
            if time >= ends:
                return math.inf
            of_a, of_b = a.at(time), b.at(time)
            between = of_b.centre - of_a.centre
            axes = np.vstack([between / max(float(np.linalg.norm(between)), 1e-12), np.eye(3), -np.eye(3)])
            gaps = (of_b.hull @ axes.T).min(axis=0) - (of_a.hull @ axes.T).max(axis=0) - CLOSE * self.dx
            rates = (of_b.velocity - of_a.velocity) @ axes.T - of_a.turning - of_b.turning
            slowing = -float(np.linalg.norm(a.gravity - b.gravity)) - of_a.unsteady - of_b.unsteady
            sure = max(time_to_close(float(gap), float(rate), slowing) for gap, rate in zip(gaps, rates, strict=True))
            if sure < RESOLUTION:
                return time
            time += sure
        return time


class _Instant:
    """A rigid body at one time: its centre, its hull, and how fast it moves and turns its farthest point."""

    def __init__(
        self, centre: Array, hull: Array, velocity: Array, turning: float = 0.0, unsteady: float = 0.0
    ) -> None:
        self.centre, self.hull, self.velocity = centre, hull, velocity
        self.turning, self.unsteady = turning, unsteady


class _Course:
    """How a body that is not simulated goes on."""

    def __init__(self, bodies: Bodies, i: int) -> None:
        self.walk, self.hull = bodies.walks[i], bodies._hull_of(i, bodies.walks[i].tally.changes)
        self.rests = self.walk.phase == "rest"
        self.ends = math.inf if self.rests else self.walk.path_ends
        self.gravity = np.zeros(3) if self.rests else self.walk.path.gravity

    def at(self, time: float) -> _Instant:
        if self.rests:
            return _Instant(self.hull.mean(axis=0), self.hull, np.zeros(3))
        path, since = self.walk.path, time - self.walk.departure
        turning = path.fastest * float(np.linalg.norm(self.hull, axis=1).max())
        com = path.com(since)
        return _Instant(com, com + self.hull @ path.rotation(since).T, path.velocity(since), turning,
                        path.unsteadiness(since))  # fmt: skip


def sorted_by(i: int, j: int, of_i: int, of_j: int) -> tuple[int, int]:
    """What belongs to two bodies, in the order of their numbers."""
    return (of_i, of_j) if i < j else (of_j, of_i)
