"""Pushes with several joints: the face of the object that the push goes through, and a place on it for each joint.

The paper strikes with one joint, j*. Who pushes with both hands stands square to a face and puts a palm on each side of
the line that leads through them and the object's centre of mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.data import Array, SceneObject, Target
from hoi.method.touch import Touch, plane_normal, surface_normal

HIGHEST = 0.75
"""No palm is put higher than this share of the object: what is tall is pushed over from its upper end."""
MARGIN = 0.12
"""No palm is put nearer to a side or the foot of the face than this [m], unless the face is too small."""
NARROWEST = 0.1
"""Joints that push together are at least this far from the middle line [m]."""
PATCHES = (0.15, 0.1, 0.05)
"""Shares of the object's size around the middle of a face; the largest that is flat says which way it faces."""
UPRIGHT = 0.3
"""A face that is so nearly level has no way through it: it is pushed the way the person comes [-]."""
PUSH = 0.3
"""How far a person pushes from where they stand: what their arms have left, and a lean [m]."""
TILT = np.radians(20.0)
"""A hand that pushes leans so far from upright towards the face, fingers first [rad]."""
HANDS = (JOINT_NAMES.index("left_hand"), JOINT_NAMES.index("right_hand"))
_SHOULDERS = JOINT_NAMES.index("left_shoulder"), JOINT_NAMES.index("right_shoulder")


@dataclass(frozen=True)
class Face:
    """Where a push goes through."""

    through: Array
    """A point of the middle line, the centre of mass [m], (3,)."""
    direction: Array
    """Unit, level, into the face, (3,)."""

    @property
    def left(self) -> Array:
        """To the left of who pushes, unit, (3,)."""
        return np.array([-self.direction[1], self.direction[0], 0.0])


def facing(joints: Array) -> Array:
    """Which way the chest faces, level and unit, (..., 3), of joints (..., 24, 3) [m]."""
    left, right = _SHOULDERS
    ahead = np.cross((joints[..., left, :] - joints[..., right, :]) * [1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    return ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-12)


def choose_push(joints: Array, striking: Sequence[int], hold: int) -> Target:
    """j* of those that push together, and t*: the step in which they go forward fastest, together.

    Their highest speed may be that with which they are drawn back.

    Args:
        joints: world joint positions p_j(t) [m], (T, 24, 3). hold: how long they stay on the object [frames].
    """
    velocity = np.diff(joints[:, list(striking)], axis=0)
    forward = (velocity.mean(axis=1) * facing(joints)[:-1]).sum(axis=-1)
    joint = striking[int(np.linalg.norm(velocity, axis=-1).sum(axis=0).argmax())]
    return Target(joint, int(forward.argmax()), "velocity profile", tuple(striking), hold)


def face_of(thing: SceneObject, particles: Array, com: Array, place: Array, height: float) -> Face:
    """The face that a person sees ahead of them who stands at `place` and looks at the centre of mass.

    Args:
        particles: the object's [m], (P, 3). com: its centre of mass [m], (3,).
        place: of the person [m], (3,). height: of the push [m].
    """
    level = np.array([1.0, 1.0, 0.0])
    ahead = (com - place) * level
    if np.linalg.norm(ahead) < 1e-6:  # on the object: as a person who stands at the origin faces
        ahead = np.array([0.0, 1.0, 0.0])
    ahead = ahead / np.linalg.norm(ahead)
    gaussians = particles[: len(thing.cloud)]
    from_line = gaussians - np.array([com[0], com[1], height])
    along = from_line @ ahead
    aside = np.linalg.norm(from_line - along[:, None] * ahead, axis=1)
    middle = gaussians[np.where(along < np.median(along), aside, np.inf).argmin()]
    from_middle = np.linalg.norm(gaussians - middle, axis=1)
    patches = [gaussians[from_middle <= share * thing.size] for share in PATCHES]
    around = next((points for points in patches if plane_normal(points) is not None), patches[0])
    patch = Touch(1.0, 0.0, middle, around, middle - ahead)
    through = surface_normal(patch, particles, thing) * level
    steep = float(np.linalg.norm(through))
    direction = through / steep if steep > UPRIGHT and through @ ahead > 0 else ahead
    return Face(com, direction)


def depth_along(means: Array, aim: Array, direction: Array) -> float:
    """How far before `aim`, (3,), points (N, 3) begin along a line through it in a unit `direction` [m]."""
    from_aim = means - aim
    along = -from_aim @ direction
    aside = np.linalg.norm(from_aim + along[:, None] * direction, axis=1)
    near_axis = aside <= max(np.quantile(aside, 0.05), 1e-6)
    return float(along[near_axis].max())


def places(face: Face, means: Array, joints: Array, rest_joints: Array) -> Array:
    """A place on the face for each joint of a push, alike on both sides of the middle line [m], (K, 3).

    They stay at their heights and as far apart as they are, as far as the face allows.

    Args:
        means: the object's Gaussians [m], (N, 3). joints: where those that push are now [m], (K, 3).
        rest_joints: the same in the T-pose, whose x says which side each belongs to [m], (K, 3).
    """
    across, up = (means - face.through) @ face.left, means[:, 2]
    least = max(min(float(across.max()), -float(across.min())), 0.0)
    widest = max(least - MARGIN, 0.5 * least)
    low, high = _within(float(up.min()), float(up.max()))
    side = rest_joints[:, 0] / max(float(np.abs(rest_joints[:, 0]).max()), 1e-12)
    apart = (joints - joints.mean(axis=0)) @ face.left
    half = min(max(float(np.abs(apart).mean()), NARROWEST), widest)
    aims = face.through + half * side[:, None] * face.left
    aims[:, 2] = np.clip(joints[:, 2], low, high)
    return np.stack([aim - face.direction * depth_along(means, aim, face.direction) for aim in aims])


def _within(low: float, high: float) -> tuple[float, float]:
    """The heights of the span at which palms are put; its middle where there is no room for the margin below."""
    return min(low + MARGIN, 0.5 * (low + high)), low + HIGHEST * (high - low)


def wrists(striking: Sequence[int]) -> list[int]:
    """Of the hands among joints that push: with them, a hand has a direction."""
    return [PARENTS[joint] for joint in striking if joint in HANDS]


def palms(striking: Sequence[int], rest_joints: Array, direction: Array) -> Array:
    """From each hand to its wrist when the palm lies on a face that is pushed in a `direction`, (3,), [m], (W, 3)."""
    down = -np.cos(TILT) * np.array([0.0, 0.0, 1.0]) - np.sin(TILT) * direction
    hands = [joint for joint in striking if joint in HANDS]
    lengths = np.linalg.norm(rest_joints[hands] - rest_joints[wrists(striking)], axis=-1)
    return lengths[:, None] * down


def held(paths: Array, meeting: int, hold: int, direction: Array) -> Array:
    """Paths (K, T, 3) [m] that go on together through the face from the meeting, for `hold` frames and evenly.

    A push is no blow: the joints arrive at the speed at which they go on. That is their own, but for how far a person
    can push from where they stand. Before and after they keep their own paths, carried along.
    """
    if not hold:
        return paths
    frames = np.arange(paths.shape[1])
    arrive, leave = max(meeting - 1, 0), min(meeting + hold, paths.shape[1] - 1)
    own = float((paths[:, meeting] - paths[:, arrive]).mean(axis=0) @ direction)
    step = min(max(own, 0.0), PUSH / hold)
    pushed = paths[:, meeting, None] + (step * (frames - meeting))[:, None] * direction
    before, after = (pushed[:, at] - paths[:, at] for at in (arrive, leave))
    carried = np.where((frames < arrive)[:, None], before[:, None], after[:, None])
    return np.where(((frames >= arrive) & (frames <= leave))[:, None], pushed, paths + carried)
