"""The motion prior alone: a sentence, and how fast it moves each part of the body."""

import numpy as np

import hoi
from hoi.body.people import load_person
from hoi.body.skeleton import CHAINS
from hoi.body.skinning import joint_paths

motion = hoi.sample_motion("a person kicks with the right foot", "woman", seed=3)
joints = joint_paths(load_person("woman"), motion)  # (40, 24, 3) [m]
speed = np.linalg.norm(np.diff(joints, axis=0), axis=2) * motion.fps
for part, members in CHAINS.items():
    print(f"{part}: up to {speed[:, members].max():.1f} m/s, at frame {speed[:, members].max(axis=1).argmax()}")
