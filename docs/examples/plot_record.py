"""A record, read and plotted: how fast the ball is, and when it is touched."""

import numpy as np
from matplotlib.figure import Figure

import hoi

hoi.run(hoi.compose("scene=kick_soccer_ball", "experiment=smoke"), out="kick")  # records it, unless it is there
run = hoi.read("kick/run.mcap")
axes = Figure(figsize=(7, 3), layout="constrained").subplots()
speed = np.linalg.norm(run.state.trajectory.com_velocity, axis=1)
axes.plot(np.arange(run.scene.frames) / run.scene.fps, speed)
axes.axvline(run.state.contact.push.frame / run.scene.fps, linestyle=":")
axes.set(title=run.result["outcome"], xlabel="time [s]", ylabel="speed of the ball [m/s]")
axes.figure.savefig("kick.png", dpi=100)
