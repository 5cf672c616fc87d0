"""The loss that geometry alone gives for a good contact, and stage 3 by it (no counterpart in the paper).

In the window the limb is out of the object, at t_c the striking joint's skin touches it, the pose stays near stage 2's.
The object is `hoi.refine.surface.Surface`; gradients go through its signed distance, the skinning and the kinematics.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from hoi.body.interpolate import interpolate_pose
from hoi.body.skinning import body_tensors, pose_means
from hoi.data import Array
from hoi.errors import RefineStopped
from hoi.refine.meeting import Meeting
from hoi.refine.surface import Surface
from hoi.refine.window import WindowedPose, bones_apart
from hoi.reports import Stage

UNIT = 0.01
"""Depths and gaps count in this [m], so that the terms are of the order of 1 where there is something to do."""
TOUCHABLE = 0.05
"""A gap wider than this is not closed: the frames of the window would tear away from the others [m]."""
SKIN = 600
"""So many Gaussians of the limb, those nearest to the object, say how deep it is; more would lie on each other."""
TINY = 1e-12
"""Keeps the square root of no depth at all differentiable."""
STIFFER = 4.0
"""How many times as stiff as the next joint outwards a joint of the limb is."""
STEP = 0.02
"""Turns of the striking joint count in this [rad], so that a first step of L-BFGS is no leap."""
TOGETHER = 1.5
"""Standard deviation with which a frame of the window takes its neighbours along [frames]."""
SETTLED = 1e-3
"""An iteration that lowers the loss by a smaller share of it, or of 1, is the last."""


@dataclass(frozen=True)
class Weights:
    """Of the terms of the loss [-]."""

    penetration: float
    """Of the depth of the limb in the object."""
    touch: float
    """Of the distance between the skin of j_c and the object at t_c."""
    pose: float
    """Of leaving stage 2's pose."""
    smooth: float
    """Of changing accelerations."""


class SignedDistance(torch.autograd.Function):
    """Signed distances (F, M) [m] of points (F, M, 3) to the object at each of F instants; see `Surface.distance`."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, surfaces: Sequence[Surface]) -> Tensor:
        found = [s.distance(p) for s, p in zip(surfaces, points.detach().cpu().double().numpy(), strict=True)]
        distances, gradients = (torch.from_numpy(np.stack(part)).to(points) for part in zip(*found, strict=True))
        ctx.save_for_backward(gradients)
        return distances

    @staticmethod
    def backward(ctx: Any, *outputs: Tensor) -> tuple[Tensor, None]:
        (gradients,) = ctx.saved_tensors
        return outputs[0][..., None] * gradients, None


class Geometry:
    """The loss, made ready for one meeting of limb and object."""

    def __init__(
        self,
        meeting: Meeting,
        weights: Weights,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self._meeting = meeting
        signed = meeting.signed_distances(meeting.motion)
        nearest = _spread(signed.min(axis=0))
        self._body = body_tensors(meeting.body, meeting.rows[nearest], dtype=dtype, device=device)
        striking = np.flatnonzero(meeting.striking[nearest])
        self._striking = torch.from_numpy(striking).to(device)
        self._touches = len(striking) > 0 and signed[meeting.at_contact, nearest[striking]].min() <= TOUCHABLE
        bones = bones_apart(meeting.window.joint)[list(meeting.window.moving)]
        self.stiffness = torch.tensor(STIFFER**bones, dtype=dtype, device=device)
        """k of each joint that moves, (J,)."""
        self.weights = weights

    def terms(self, pose: WindowedPose) -> dict[str, Tensor]:
        """Penetration, touch and pose prior, each weighted as the config says; their sum is the loss.

        penetration: the mean over the window's instants of sqrt(sum_i depth_i^4) / UNIT^2, near the greatest depth's
        square: one Gaussian that is deep counts more than many that are not. touch: (gap at t_c / UNIT)^2, 0 inside.
        pose: mean over frames of sum_j k_j |change of theta_j|^2, k_j = STIFFER^bones between j and the striking joint.
        """
        weights, meeting = self.weights, self._meeting
        signed = SignedDistance.apply(self.skin(pose), meeting.surfaces)
        assert isinstance(signed, Tensor)
        depth = (-signed / UNIT).clamp(min=0)
        terms = {
            "penetration": weights.penetration * ((depth**4).sum(-1) + TINY).sqrt().mean(),
            "pose": weights.pose * (self.stiffness * pose.change.square().sum(-1)).sum(-1).mean(),
        }
        if self._touches:
            gap = signed[meeting.at_contact, self._striking].min().clamp(min=0) / UNIT
            terms["touch"] = weights.touch * gap.square()
        return terms

    def skin(self, pose: WindowedPose) -> Tensor:
        """The limb's Gaussians at the meeting's instants [m], (F, M, 3)."""
        first = max(pose.window.frames[0] - 1, 0)  # how a motion goes between two frames depends on their neighbours
        span = slice(first, pose.window.frames[-1] + 2)
        parts = (pose.translation[span], pose.orientation[span], pose.body_pose[span])
        return pose_means(self._body, *interpolate_pose(*parts, self._meeting.frames - first))


def _spread(distances: Array) -> NDArray[np.intp]:
    """Indices of at most SKIN Gaussians: the nearest, or as many evenly of all that come near, in order."""
    near = max(SKIN, np.count_nonzero(distances < TOUCHABLE))
    rows = np.sort(distances.argsort(kind="stable")[:near])
    return rows[np.linspace(0, len(rows) - 1, min(SKIN, len(rows))).astype(int)]


def minimise(pose: WindowedPose, geometry: Geometry, iterations: int, stage: Stage) -> None:
    """L-BFGS on theta in the window, in place, until the loss no longer falls or the iterations are spent.

    There are few variables and no noise: where Adam trembles about the surface this settles on it.

    Raises:
        RefineStopped: the loss is not finite.
    """
    terms: dict[str, float] = {}
    # In these variables all joints are equally stiff and neighbouring frames go together, so that each step of the
    # descent turns joints near the body least and leaves no frame behind.
    frames = torch.tensor(pose.window.frames).to(pose.offset)
    together = torch.exp(-0.5 * ((frames[:, None] - frames) / TOGETHER) ** 2)
    units = (STEP / geometry.stiffness.sqrt())[:, None]

    def loss(scaled: Array) -> tuple[float, Array]:
        with torch.no_grad():
            variables = torch.from_numpy(scaled).to(pose.offset).view_as(pose.offset)
            pose.offset.copy_(torch.einsum("ef,fjd->ejd", together, units * variables))
        found = geometry.terms(pose) | {"smooth": geometry.weights.smooth * pose.roughness()}
        total = torch.stack(list(found.values())).sum()
        (gradient,) = torch.autograd.grad(total, pose.offset)
        if not (bool(total.isfinite()) and bool(gradient.isfinite().all())):
            raise RefineStopped(f"the geometric loss is not finite after {stage.iterations} iterations")
        terms.update({name: float(value.detach()) for name, value in found.items()})
        slopes = units * torch.einsum("ef,ejd->fjd", together, gradient)
        return float(total.detach()), slopes.cpu().double().numpy().ravel()

    start = np.zeros(pose.offset.numel())
    best = minimize(
        loss,
        start,
        jac=True,
        method="L-BFGS-B",
        callback=lambda _: stage.iteration(stage.iterations, dict(terms)),
        options={"maxiter": iterations, "ftol": SETTLED},
    )
    loss(best.x)
