"""What a camera has to show: the outlines of the person and the object over time, and where the middle of it moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hoi.data import Array

REACH = 0.9
"""The object has to be in the picture while it is this close to the person [m]."""
OUTLYING = 0.5
"""A frame whose middle is this far from the median of its neighbours' is not framed [m]."""
LOOK_AHEAD = 0.6
"""How far from the person the middle of the action goes after an object that leaves [m]."""
SMOOTHING_TIME = 0.3
"""Standard deviation of the Gaussian that smooths the path of a following camera [s]."""


@dataclass(frozen=True)
class Action:
    """Outlines of what moves, frame by frame; what a run does not have has no points.

    A few hundred points stand for all Gaussians: framing needs the outermost ones only.
    """

    person: Array
    """[m], (T, n, 3)."""
    thing: Array
    """The object [m], (T, m, 3)."""
    fps: float

    def points(self, frames: Sequence[int] | None = None) -> Array:
        """What a standing camera has to show in all frames, or in some [m], (N, 3): the person, the object while it is
        near where the person ever is, and their shadows straight below."""
        chosen = np.arange(len(self.person)) if frames is None else np.asarray(frames)
        steady = self._steady()[chosen]
        chosen = chosen[steady] if steady.any() else chosen
        person = self.person[chosen].reshape(-1, 3)
        near = _near(self.thing[chosen], person[None])
        points = np.concatenate([person, self.thing[chosen][near].reshape(-1, 3)])
        return np.concatenate([points, points * (1, 1, 0)])

    def path(self) -> Array:
        """The middle of the action in each frame [m], (T, 3), smoothed: what a following camera keeps still.

        Between person and object; after one that leaves it goes no further than `LOOK_AHEAD`. Outlying frames do not
        count, and steady motion, up to both ends, is left as it is.
        """
        from scipy.ndimage import gaussian_filter1d

        middle, frames = self._middle(), self._steady()
        times = np.arange(len(middle))
        path = np.stack([np.interp(times, times[frames], middle[frames, axis]) for axis in range(3)], -1)
        sigma = SMOOTHING_TIME * self.fps
        reach = min(round(4 * sigma), len(path) - 1)  # np.pad reflects a path about its ends, not beyond its length
        if reach == 0:
            return path
        padded = np.pad(path, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
        return gaussian_filter1d(padded, sigma, axis=0, radius=reach)[reach:-reach]

    def points_around_path(self) -> Array:
        """What a camera that moves along `path` has to show, seen from there [m], (N, 3): the person, the object
        while it is near the person, and their shadows."""
        steady, path = self._steady(), self.path()
        around = path[steady, None]
        person, thing = self.person[steady], self.thing[steady]
        near = _near(thing, person)
        parts = ((person, around), (thing[near], around[near]))
        seen = [shown - middle for part, middle in parts for shown in (part, part * (1, 1, 0))]
        return np.concatenate([points.reshape(-1, 3) for points in seen])

    def _middle(self) -> Array:
        """Not smoothed, (T, 3)."""
        if not self.person.shape[1] or not self.thing.shape[1]:
            return (self.person if self.person.shape[1] else self.thing).mean(1)
        person, thing = self.person.mean(1), self.thing.mean(1)
        offset = thing - person
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        return person + offset / np.sqrt(4 + (distance / LOOK_AHEAD) ** 2)  # half-way when near

    def _steady(self) -> NDArray[np.bool_]:
        """The frames in which nothing has jumped out and back, (T,)."""
        from scipy.ndimage import median_filter

        middle = self._middle()
        steady = np.linalg.norm(middle - median_filter(middle, (5, 1), mode="mirror"), axis=1) < OUTLYING
        return steady if steady.any() else ~steady  # a motion that is all jumps is framed whole


def _near(thing: Array, person: Array) -> NDArray[np.bool_]:
    """In which frames the object (T, m, 3) is within `REACH` of the box around the person (T or 1, n, 3), or as near as
    it ever comes; (T,). An object alone is always near."""
    if not thing.shape[1] or not person.shape[1]:
        return np.ones(len(thing), bool)
    centres = thing.mean(1)
    outside = np.maximum(0, np.maximum(person.min(1) - centres, centres - person.max(1)))
    gaps = np.linalg.norm(outside, axis=1)
    return gaps <= max(REACH, gaps.min())
