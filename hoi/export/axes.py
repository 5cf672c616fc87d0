"""The axes of other programs, as rotations (3, 3) from the record's, which has Z up, and their colours."""

import numpy as np

from hoi.data import Array

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) -> (x, z, -y): what importers of programs with Z up, like Blender, turn back by default."""
AXES = {"z-up": np.eye(3), "y-up": Y_UP, "y-down": Y_UP * [[1], [-1], [-1]]}
"""By name; the last is COLMAP's way."""


def linear(colours: Array) -> Array:
    """Colours as they are shown (sRGB) -> linear ones (IEC 61966-2-1), which glTF's and USD's vertices have."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
