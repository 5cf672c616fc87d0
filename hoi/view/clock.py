"""One clock for several runs, and the thread that lets it run."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hoi.render.replay import Replay


@dataclass(frozen=True)
class Clock:
    """Frames at the rate of the run with most a second, until the longest has ended."""

    frames: int
    fps: float

    def frame_of(self, replay: Replay, frame: int) -> int:
        """The frame of a run nearest to that of the clock; after the run's end its last."""
        return min(round(frame / self.fps * replay.fps), replay.frames - 1)


def common_clock(replays: Sequence[Replay]) -> Clock:
    """The clock of runs that are seen side by side."""
    fps = max(each.fps for each in replays)
    return Clock(max(math.ceil(each.frames * fps / each.fps - 1e-6) for each in replays), fps)


class Player:
    """Calls `show(frame)` as time goes by, over and over from the start. Where showing takes longer than a frame lasts,
    frames are left out, so that the clock stays right."""

    def __init__(self, clock: Clock, show: Callable[[int], None]) -> None:
        self._clock, self._show = clock, show
        self._running, self._ended = threading.Event(), threading.Event()
        self._lock = threading.Lock()
        self._frame, self._speed, self._since = 0.0, 1.0, 0.0
        self._thread = threading.Thread(target=self._run, daemon=True, name="player")

    def start(self) -> None:
        """Let the thread wait for `play`."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ended.set()
        self._running.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    @property
    def playing(self) -> bool:
        return self._running.is_set()

    def play(self) -> None:
        with self._lock:
            self._since = time.perf_counter()
        self._running.set()

    def pause(self) -> None:
        with self._lock:
            self._frame, self._since = self._now(), time.perf_counter()
        self._running.clear()

    def seek(self, frame: int) -> None:
        """Go on from this frame."""
        with self._lock:
            self._frame, self._since = float(frame), time.perf_counter()

    def set_speed(self, speed: float) -> None:
        """1 is real time."""
        with self._lock:
            self._frame, self._since, self._speed = self._now(), time.perf_counter(), speed

    def _now(self) -> float:
        if not self.playing:
            return self._frame
        return (self._frame + (time.perf_counter() - self._since) * self._clock.fps * self._speed) % self._clock.frames

    def _run(self) -> None:
        shown = -1
        while not self._ended.is_set():
            self._running.wait()
            with self._lock:
                now, rate = self._now(), self._clock.fps * self._speed
            frame = min(int(now), self._clock.frames - 1)
            if frame != shown and self.playing and not self._ended.is_set():
                self._show(frame)
                shown = frame
                continue  # that took time
            self._ended.wait(max((math.floor(now) + 1 - now) / rate - 1e-4, 0.001))
