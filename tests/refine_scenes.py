"""A right leg that swings, and an object in its way, as deep in the foot as a test wants, which then flies off."""

import functools
import math
from dataclasses import replace

import numpy as np

from hoi.body.people import load_person
from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import posed_means, stand_motion
from hoi.data import Contact, ContactSearch, Material, Motion, ObjectTrajectory, Scene, State
from hoi.objects.load import load_builtin, place

FRAMES, FPS, HIT = 12, 20.0, 5
SPEED = 8.0
"""Of the object after the push [m/s]."""
FOOT = JOINT_NAMES.index("right_foot")
STEEL = Material("steel", "fixed_corotated", 1e7, 0.3, 1000.0, 0.5, 0.5)


def swing(body) -> Motion:
    """The hip turns the straight leg from behind to the front."""
    still = stand_motion(body, FRAMES, FPS)
    body_pose = still.body_pose.copy()
    hip, knee = (JOINT_NAMES.index(name) - 1 for name in ("right_hip", "right_knee"))
    phase = np.linspace(-1, 1, FRAMES)
    body_pose[:, hip, 0] = -0.8 * np.sin(phase * math.pi / 2)
    body_pose[:, knee, 0] = 0.4 * np.cos(phase * math.pi / 2)
    return replace(still, body_pose=body_pose)


@functools.cache
def struck(shape: str = "soccer_ball", size: float = 0.22, depth: float = 0.03) -> tuple[Scene, State]:
    """The object rests where the foot's foremost skin is `depth` in it at HIT, and leaves forwards at SPEED."""
    body = load_person("man", 6000, seed=0)
    motion = swing(body)
    foot = posed_means(body, motion, frames=[HIT], subset=np.flatnonzero(body.skinning_weights.argmax(1) == FOOT))[0]
    toe = foot[foot[:, 1].argmax()]
    loaded = load_builtin(shape, size / 25, size, 3000)
    thing = place(loaded, STEEL, position=[toe[0], toe[1] - depth + size / 2, toe[2]])
    forward = np.array([0.0, 1.0, 0.0])
    flown = np.maximum(np.arange(FRAMES) - HIT, 0)[:, None] * SPEED / FPS * forward
    positions, com = thing.particles + flown[:, None], thing.particles.mean(axis=0) + flown
    velocity = np.where(np.arange(FRAMES)[:, None] >= HIT, SPEED * forward, 0.0)
    trajectory = ObjectTrajectory(positions, com, velocity, np.zeros((FRAMES, 3)))
    scene = Scene("struck", body, thing, "a person kicks", FRAMES, FPS, np.array([0, 0, -9.81]))
    zero, fast = np.zeros(3), SPEED * forward
    push = Contact(float(HIT), FOOT, 0.1, toe, forward, fast, zero, SPEED, fast, zero, 0.0)
    return scene, State(motion=motion, trajectory=trajectory, contact=ContactSearch((push,), 0.0, float(HIT), FOOT))


def refine(scene, state, config, device: str, stage) -> Motion:
    """Stage 3 of a config."""
    return config.stage.refine.refine(scene, state, config, device, stage)
