"""A descent whose steps are counted in metres of the limb: SDS's gradient has a direction, but no length.

How deep a limb is and how far off is told along the normal of the contact. So the skin that strikes moves along that,
as a whole, by the change of theta that does so best; the gradient says which way and in which frames. Left to itself it
bends and turns what it pulls at: a fist that is to be drawn back turns, and its fingers go deeper.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hoi.body.skinning import body_tensors, pose_means, posed_means
from hoi.data import Body
from hoi.refine.window import WindowedPose

INERTIA = 0.8
"""Share of the steps before in each direction: noises and viewpoints are averaged over about five iterations."""
TOGETHER = 0.5
"""Standard deviation with which a frame of the window takes its neighbours along [frames]."""
AROUND, SKIN = 0.08, 64
"""Of the limb's Gaussians no farther than this from the contact [m], so many say how the skin that strikes moves."""
STIFF = 0.02
"""A turn of a joint weighs as much as skin that is off by it times this arm [m]."""
TURN = 1e-3
"""Of the difference quotients of the skin in theta [rad]."""
TINY = 1e-30
"""Keeps a gradient of nothing from being divided by."""


class LimbSteps:
    """Follows the running mean of the gradient of a `WindowedPose`."""

    def __init__(self, pose: WindowedPose, body: Body) -> None:
        self._pose, push = pose, pose.window.push
        self.skin = _striking(body, pose)
        """Gaussians that say how far the limb goes, (M,)."""
        self._body = body_tensors(body, self.skin, dtype=pose.offset.dtype, device=pose.offset.device)
        axes = np.eye(3) if push is None else np.asarray(push.normal)[None]
        self._axes = torch.from_numpy(axes / np.linalg.norm(axes, axis=1, keepdims=True)).to(pose.offset)
        frames = torch.tensor(pose.window.frames).to(pose.offset)
        self._together = torch.exp(-0.5 * ((frames[:, None] - frames) / TOGETHER) ** 2)
        self._mean = torch.zeros(len(frames), len(axes)).to(pose.offset)

    @torch.no_grad()
    def follow(self, length: float) -> None:
        """One step down the gradient that `pose.offset` has: `length` [m], in the frame that goes farthest."""
        pose = self._pose
        assert pose.offset.grad is not None
        moves = self.moves()
        # Of theta rather than of the offset, so that the taper does not count twice.
        slope = torch.einsum("fav,fv->fa", moves, pose.offset.grad.flatten(1)) / pose.taper[:, None]
        self._mean.lerp_(self._together @ slope, 1 - INERTIA)
        way = self._together @ self._mean
        farthest = (pose.taper[:, None] * way).norm(dim=1).max()
        change = torch.einsum("fav,fa->fv", moves, way)
        pose.offset -= change.view_as(pose.offset) * (length / (farthest + TINY))

    def moves(self) -> Tensor:
        """Changes of theta that move the striking skin by 1 m along each axis, to first order, (F, A, 3 J) [rad/m]."""
        arms = self.arms()
        points = arms.shape[-1] // 3
        wanted = self._axes.repeat(1, points)  # every point alike
        weight = arms @ arms.mT / points + STIFF**2 * torch.eye(arms.shape[1]).to(arms)
        return torch.linalg.solve(weight, arms @ wanted.T / points).mT

    def arms(self) -> Tensor:
        """How the skin goes with theta of the joints that move, (F, 3 J, 3 M) [m/rad]."""
        pose, window = self._pose, self._pose.window
        rows, joints = list(window.frames), torch.tensor(window.moving) - 1
        count = 3 * len(joints)
        turns = torch.zeros(1 + count, *pose.start.shape[1:]).to(pose.offset)
        for variable in range(count):
            turns[1 + variable, joints[variable // 3], variable % 3] = TURN
        theta = pose.body_pose[rows][:, None] + turns
        translation, orientation = (
            part[rows][:, None].expand(-1, 1 + count, -1).flatten(0, 1) for part in (pose.translation, pose.orientation)
        )
        skin = pose_means(self._body, translation, orientation, theta.flatten(0, 1))
        skin = skin.unflatten(0, (len(rows), -1)).flatten(2)
        return (skin[:, 1:] - skin[:, :1]) / TURN


def _striking(body: Body, pose: WindowedPose) -> NDArray[np.intp]:
    """Some Gaussians of the limb near the contact at t_c; of the striking joint where that is not known, (M,)."""
    window = pose.window
    limb = np.flatnonzero(np.isin(body.dominant_joints, window.limb))
    if window.push is None:
        own = np.flatnonzero(body.dominant_joints == window.joint)
        skin = own if len(own) else limb
    else:
        placed = posed_means(body, pose.before, frames=np.array([window.t_c]), subset=limb)[0]
        apart = np.linalg.norm(placed - window.push.point, axis=1)
        near = limb[apart <= AROUND]
        skin = near if len(near) else limb[np.sort(apart.argsort(kind="stable")[:SKIN])]
    return skin[np.linspace(0, len(skin) - 1, min(SKIN, len(skin))).astype(int)]
