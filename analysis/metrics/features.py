"""The 205 features a frame that motions are judged by, in NumPy; `hoi.motion.features` is where they are explained."""

import numpy as np

from hoi.data import Array

from ..posing import forward_kinematics


def encode(local: Array, translation: Array, rest_joints: Array) -> Array:
    """Features of a motion, (T, 205), unnormalised, its lowest joint on the ground.

    Args:
        local: rotations relative to the parents, (T, 24, 3, 3). translation: of the pelvis joint [m], (T, 3), T >= 3.
        rest_joints: T-pose joints of the judge's skeleton [m], (24, 3).
    """
    frames = len(local)
    _, joints = forward_kinematics(local, translation, rest_joints)
    left = local[:, 0, :2, 0]
    square = (left**2).sum(-1, keepdims=True)
    heading = np.where(square > 1e-12, left / np.sqrt(np.maximum(square, 1e-12)), [1.0, 0.0])
    cosine, sine = heading.T
    to_heading = np.zeros((frames, 3, 3))
    to_heading[:, 0, 0] = to_heading[:, 1, 1] = cosine
    to_heading[:, 0, 1], to_heading[:, 1, 0] = sine, -sine
    to_heading[:, 2, 2] = 1

    height = translation[:, 2:] - joints[..., 2].min()
    velocity = np.einsum("tij,tj->ti", to_heading, _continued(np.diff(translation, axis=0)))[:, :2]
    before, after = heading[:-1], heading[1:]
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(-1))
    rotations = np.concatenate([(to_heading @ local[:, 0])[:, None], local[:, 1:22]], axis=1)
    positions = np.einsum("tij,tkj->tki", to_heading, joints[:, 1:] - joints[:, :1])
    parts = (height, velocity, _continued(turn[:, None]), rotations[:, :, :2].reshape(frames, -1))
    return np.concatenate([*parts, positions.reshape(frames, -1)], axis=-1)


def _continued(velocity: Array) -> Array:
    """(T-1, n) -> (T, n): the velocity after the last frame, which nobody has seen, by the last acceleration."""
    return np.concatenate([velocity, 2 * velocity[-1:] - velocity[-2:-1]])
