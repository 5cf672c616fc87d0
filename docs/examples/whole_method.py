"""The whole method in memory: the man of the package kicks a ball of foam that is made here."""

import numpy as np

import hoi
from hoi.gaussians import fibonacci_sphere, sh_from_colours

points, ones = fibonacci_sphere(2500), np.ones((2500, 3))
colours = sh_from_colours(0.5 + 0.5 * points)
ball = hoi.GaussianCloud(0.11 * points, np.eye(4)[[0] * 2500], 0.004 * ones, ones[:, 0], colours)
run = hoi.run(hoi.compose("scene=kick_soccer_ball", "material=foam", "experiment=smoke"), object=ball)
print(run.result["outcome"])
print("the ball ends at", run.state.trajectory.com[-1].round(2), "m")
