"""The Gaussians of each limb of a person in motion."""

import numpy as np

from hoi.body.skeleton import JOINT_COUNT
from hoi.body.skinning import posed_means
from hoi.data import Array, Body, Motion


class Limbs:
    """The Gaussians of each joint: i belongs to argmax_k w_ik."""

    def __init__(self, body: Body, motion: Motion) -> None:
        self._body, self._motion = body, motion
        dominant = body.dominant_joints
        self.members = [np.flatnonzero(dominant == joint) for joint in range(JOINT_COUNT)]
        self.joints = [joint for joint in range(JOINT_COUNT) if len(self.members[joint])]
        means = posed_means(body, motion)
        self.at_frames = {joint: means[:, self.members[joint]] for joint in self.joints}
        """World means at whole frames [m], (T, M, 3) a joint."""
        self.boxes = {joint: (path.min(axis=1), path.max(axis=1)) for joint, path in self.at_frames.items()}
        """Corners of the boxes of these [m], (T, 3) each."""

    def at(self, joint: int, frames: Array) -> Array:
        """World means of a joint's Gaussians at fractional frames [m], (F, M, 3)."""
        return posed_means(self._body, self._motion, frames=frames, subset=self.members[joint])
