import numpy as np

from hoi.frames import at_frame


def test_between_frames_values_are_linear_and_the_last_stays():
    over_frames = np.array([[0.0, 1.0], [2.0, 1.0], [2.0, 5.0]], np.float32)
    assert at_frame(over_frames, 0).tolist() == [0, 1]
    assert at_frame(over_frames, 0.25).tolist() == [0.5, 1]
    assert at_frame(over_frames, 1.5).tolist() == [2, 3]
    assert at_frame(over_frames, 2.0).tolist() == [2, 5]
    assert at_frame(over_frames, 0.25).dtype == np.float32
    assert at_frame(np.array([3.0]), 0.0) == 3
