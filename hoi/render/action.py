"""What a camera has to show: the outlines of the person and the object over time, and where the middle of it moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

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

    def points(self) -> Array:
        """What a standing camera has to show [m], (N, 3): the person, the object while it is near where the person
        ever is, and their shadows straight below."""
        frames = self._steady()
        person = self.person[frames].reshape(-1, 3)
        return _with_shadows(person, *self.thing[frames][self._near(frames, person[None])])

    def path(self) -> Array:
        """The middle of the action in each frame [m], (T, 3), smoothed: what a following camera keeps still.

        Between person and object; after one that leaves it goes no further than `LOOK_AHEAD`. Outlying frames do not
        count, and steady motion, up to both ends, is left as it is.
        """
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
        path, frames = self.path(), self._steady()
        near = self._near(frames, self.person[frames])
        seen = [
            _with_shadows(self.person[frame], *self.thing[frame][None][: int(shown)]) - path[frame]
            for frame, shown in zip(np.flatnonzero(frames), near, strict=True)
        ]
        return np.concatenate(seen)

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
        middle = self._middle()
        steady = np.linalg.norm(middle - median_filter(middle, (5, 1), mode="mirror"), axis=1) < OUTLYING
        return steady if steady.any() else ~steady  # a motion that is all jumps is framed whole

    def _near(self, frames: NDArray[np.bool_], person: Array) -> NDArray[np.bool_]:
        """In which of `frames` the object is within `REACH` of the box around the person (1 or F, n, 3), or as near as
        it ever comes; (F,)."""
        things = self.thing[frames]
        if not things.shape[1] or not person.shape[1]:
            return np.full(len(things), bool(things.shape[1]))
        centres = things.mean(1)
        outside = np.maximum(0, np.maximum(person.min(1) - centres, centres - person.max(1)))
        gaps = np.linalg.norm(outside, axis=1)
        return gaps <= max(REACH, gaps.min())


def _with_shadows(*clouds: Array) -> Array:
    points = np.concatenate(clouds)
    return np.concatenate([points, points * (1, 1, 0)])
