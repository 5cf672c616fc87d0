"""Which joint should strike, when and where, and the loss that pulls it there (paper, Windowed Attraction Loss)."""

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array, Target

ENDS = 0.2
"""No strike is aimed nearer to the upper and lower ends of an object than this [m]: balls are struck at the centre."""


def choose_target(joints: Array, candidates: Sequence[int] = range(JOINT_COUNT)) -> Target:
    """j*: the joint with the highest cumulative velocity; t*: the frame of its peak velocity.

    Args:
        joints: world joint positions p_j(t) [m], (T, 24, 3).
        candidates: the joints to choose from. The paper takes all; in a kick with a wide follow-through the free hand
            may travel further than the foot.
    """
    velocity = np.linalg.norm(np.diff(joints, axis=0), axis=-1)
    joint = max(candidates, key=lambda j: velocity[:, j].sum())
    return Target(joint, int(velocity[:, joint].argmax()), "velocity profile")


def window(frames: int, target: Target, sigma: float, half_width: int) -> Array:
    """g(t) = exp(-(t - t*)^2 / (2 sigma^2)), zero beyond `half_width` frames, (T,)."""
    offset = np.arange(frames) - target.frame
    return np.exp(-(offset**2) / (2 * sigma**2)) * (np.abs(offset) <= half_width)


def attraction_loss(positions: Tensor, goal: Tensor, weights: Tensor) -> Tensor:
    """L_attr = sum_t g(t) |p_j*(t) - c(t)|^2 / sum_t g(t) [m^2], (...).

    Args:
        positions: p_j*(t) [m], (..., T, 3).
        goal: c(t) [m], (..., T, 3).
        weights: g(t), (..., T).
    """
    return (weights * ((positions - goal) ** 2).sum(dim=-1)).sum(dim=-1) / weights.sum(dim=-1)


def meeting_frame(frames: int, target: Target) -> int:
    """The end of the strike's fastest step: v_j*(t*) is the step from t* to t* + 1, and V_human looks one step back."""
    return min(target.frame + 1, frames - 1)


def carried_strike(com: Array, object_means: Array, limb_means: Array, path: Array, meeting: int) -> Array:
    """The joint's own strike, carried to where the limb's skin meets the object.

    The paper's goal, the centre of mass, asks the limb to be inside the object, and to be there for the whole window,
    which stops the strike. This goal meets the object's nearest point along the strike and keeps the swing; and what is
    tall is struck at the strike's own height, as far as it reaches up and down (see `ENDS`).

    Args:
        com: centre of mass at the meeting [m], (3,).
        object_means: the object's Gaussians at the meeting [m], (N, 3).
        limb_means: the joint's Gaussians at the meeting [m], (M, 3).
        path: p_j*(t) before stage 2 [m], (T, 3).
        meeting: the frame, see `meeting_frame`.

    Returns:
        c(t) [m], (T, 3): `path`, shifted.
    """
    joint = path[meeting]
    direction = joint - path[max(meeting - 1, 0)]
    if np.linalg.norm(direction) < 1e-3:  # a still limb has no strike: come from where it is
        direction = com - joint
    direction = direction / np.linalg.norm(direction)
    slack = max(0.5 * float(np.ptp(object_means[:, 2])) - ENDS, 0.0)
    aim = com + np.array([0.0, 0.0, np.clip(joint[2] - com[2], -slack, slack)])
    from_aim = object_means - aim
    along = -from_aim @ direction
    aside = np.linalg.norm(from_aim + along[:, None] * direction, axis=1)
    near_axis = aside <= max(np.quantile(aside, 0.05), 1e-6)
    depth = float(along[near_axis].max())
    reach = float(((limb_means - joint) @ direction).max())
    return path + (aim - direction * (depth + reach) - joint)
