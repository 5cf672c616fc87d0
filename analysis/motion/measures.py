"""Numbers of motions: of their joints over 40 frames, and of their embeddings by `hoi.motion.evaluator`."""

import torch
from torch import Tensor

TOES, FEET, KNEES, HANDS = (10, 11), (10, 11), (4, 5), (22, 23)
STANDING_HEIGHT = 0.05
"""A toe joint below this is taken to touch the ground [m]; standing, it is at about 0.02."""
LIMBS = {
    **dict.fromkeys(("kick_soccer", "kick_front", "kick_high", "kick_side", "kick_spin"), FEET),
    "karate_knee": KNEES,
    **dict.fromkeys(("karate_strike", "punch", "punch_slow", "punch_jab", "punch_cross", "punch_hook"), HANDS),
    **dict.fromkeys(("push_one_hand", "push"), HANDS),
}
"""Label of a strike -> its joints, left and right."""


def speeds(joints: Tensor, fps: float) -> Tensor:
    """Joints (..., T, 24, 3) -> speeds from frame to frame [m/s], (..., T-1, 24)."""
    return fps * joints.diff(dim=-3).norm(dim=-1)


def skating(joints: Tensor, fps: float) -> Tensor:
    """Mean horizontal speed of toes on the ground [m/s], (B,); nan where none ever is."""
    toes = joints[..., list(TOES), :]
    slide = fps * toes[..., :2].diff(dim=-3).norm(dim=-1)
    down = (torch.maximum(toes[..., 1:, :, 2], toes[..., :-1, :, 2]) < STANDING_HEIGHT).to(slide)
    return (slide * down).sum((-1, -2)) / down.sum((-1, -2))


def ground_error(joints: Tensor) -> Tensor:
    """Mean distance of the lowest joint from the ground over the frames [m], (B,)."""
    return joints[..., 2].amin(-1).abs().mean(-1)


def jerk(joints: Tensor, fps: float) -> Tensor:
    """Mean size of the joints' third derivative [m/s^3], (B,)."""
    return fps**3 * joints.diff(n=3, dim=-3).norm(dim=-1).mean((-1, -2))


def strike_speed(joints: Tensor, label: str, side: str, fps: float) -> Tensor:
    """Peak speed of the striking limb [m/s], (B,); of both hands' mean where no side is named."""
    both = speeds(joints, fps)[..., list(LIMBS[label])]
    chosen = both.mean(-1) if side not in SIDES else both[..., SIDES.index(side)]
    return chosen.amax(-1)


SIDES = ("left", "right")
ONE_SIDED, BOTH_MOVE = 1.2, 1.7
KNEE_LIFT = 0.1


def strikes_as_named(joints: Tensor, label: str, side: str, fps: float) -> Tensor:
    """Whether the named limb is the one that strikes, (B,).

    A foot: faster than the other foot, by a fifth. A knee: higher than the other by 10 cm, the foot less than twice as
    fast, as it is in a kick. A hand: faster than the other by a fifth, and than both feet. Both hands: neither more
    than 1.7 times as fast as the other, and both faster than both feet.
    """
    peak = speeds(joints, fps).amax(-2)
    left, right = (peak[..., joint] for joint in LIMBS[label])
    feet = peak[..., list(FEET)].amax(-1)
    if side not in SIDES:
        slow, fast = torch.minimum(left, right), torch.maximum(left, right)
        return (fast < BOTH_MOVE * slow) & (slow > feet)
    named, other = (left, right) if side == "left" else (right, left)
    if LIMBS[label] is KNEES:
        height = joints[..., list(KNEES), 2].amax(-2)
        lift = height[..., SIDES.index(side)] - height[..., 1 - SIDES.index(side)]
        return (lift > KNEE_LIFT) & (feet < 2 * named)
    faster = named > ONE_SIDED * other
    return faster & (named > feet) if LIMBS[label] is HANDS else faster


def frechet_distance(first: Tensor, second: Tensor) -> float:
    """FID of two sets of embeddings (N, D): |m1 - m2|^2 + tr(C1 + C2 - 2 sqrt(C1 C2))."""
    means = [rows.double().mean(0) for rows in (first, second)]
    covariances = [torch.cov(rows.double().T) for rows in (first, second)]
    roots = torch.linalg.eigvals(covariances[0] @ covariances[1]).real.clamp(min=0).sqrt().sum()
    gap = (means[0] - means[1]).square().sum()
    return float(gap + covariances[0].trace() + covariances[1].trace() - 2 * roots)


def diversity(embeddings: Tensor, generator: torch.Generator) -> float:
    """Mean distance of randomly paired embeddings (N, D)."""
    order = torch.randperm(len(embeddings), generator=generator)
    return float((embeddings[order] - embeddings[order.roll(1)]).norm(dim=-1).mean())


def ranks(motions: Tensor, pools: Tensor) -> Tensor:
    """How many sentences of its pool a motion is closer to than to its own, (N,).

    Args:
        motions: embeddings (N, D).
        pools: embeddings of each motion's own sentence, then of the others, (N, P, D).
    """
    likeness = torch.einsum("nd,npd->np", motions, pools)
    return (likeness[:, 1:] > likeness[:, :1]).sum(-1)
