"""Values over frames, between the frames."""

from hoi.data import Array


def at_frame(over_frames: Array, frame: float) -> Array:
    """(T, ...) at a fractional frame in [0, T - 1], linearly; the last stays after that."""
    last = len(over_frames) - 1
    first = min(int(frame), last)
    return over_frames[first] + (frame - first) * (over_frames[min(first + 1, last)] - over_frames[first])
