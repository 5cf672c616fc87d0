"""The MPM alone: a cube of foam and a basketball, thrown, for a second."""

import numpy as np

import hoi
from hoi.gaussians import transform
from hoi.objects.shapes import SHAPES, build

for shape, material in (("foam_cube", "foam"), ("basketball", "basketball")):
    cloud = transform(build(SHAPES[shape], size=0.24).cloud, np.eye(3), 1, [0, 0, 0.6])
    moved = hoi.simulate(cloud, material, seconds=1, fps=50, velocity=[0, 2, 0], cells_across=8)
    print(f"{shape}: {moved.phase.count('flight')} of {len(moved.phase)} frames in flight, exactly")
    print(f"  its centre at the end {moved.com[-1].round(2)} m, lowest {moved.com[:, 2].min():.2f} m")
