"""Whether the laws of motion hold: what a person's motion and a contact take that nothing there could have given."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hoi.body.mass import PART, masses_of
from hoi.body.strength import torque_limits
from hoi.data import Array
from hoi.errors import RunError

from ..records import Record, Undefined
from .contact import push_of, pushes_of
from .flight import NEAR
from .inverse import acting, cone_of, from_ground, nearest, needed
from .penetration import ground_of, height_above


@dataclass(frozen=True)
class Loads:
    """At the frames 1 .. T - 2."""

    force: Array
    """From nowhere [N], (F, 3)."""
    torque: Array
    """From nowhere, about the pelvis [N m], (F, 3)."""
    strain: Array
    """Of each joint with a part of its own, its torque over what muscles give [-], (F, J)."""


def momentum_gap(record: Record) -> float:
    """Momentum from nowhere while person and object push each other. Off the changes of momentum of both are taken
    their weight, the recorded impulse (the person gets the opposite of what it gives), and as much as the ground under
    the feet and planes near the object can give by Coulomb's law; what is left is added over the frames that the push
    reaches. A motion that nobody can make does not close without a push either."""
    return float(np.linalg.norm(_gap(record)))


def momentum_gap_share(record: Record) -> float:
    """The momentum from nowhere over that which the pushes gave the object."""
    given = float(np.linalg.norm(_given(record).sum(axis=0)))
    return 100 * momentum_gap(record) / given if given > 0 else math.nan


def root_force(record: Record) -> float:
    """The force that would have to pull at the pelvis from nowhere for the recorded motion to happen: what weight, push
    and ground leave, mean over frames. The ground pushes under feet that are low, with a friction of 0.8 and no further
    than 10 cm beyond their ankles and toe joints; in flight there is gravity alone. Empty for a person without joints,
    or whose surface encloses no volume and so no mass."""
    return float(np.linalg.norm(_loads(record).force, axis=1).mean())


def root_force_high(record: Record) -> float:
    """The force from nowhere that one frame in twenty exceeds."""
    return float(np.percentile(np.linalg.norm(_loads(record).force, axis=1), 95))


def root_torque(record: Record) -> float:
    """The torque about the pelvis that would have to come from nowhere beside that force, mean over frames."""
    return float(np.linalg.norm(_loads(record).torque, axis=1).mean())


def root_torque_high(record: Record) -> float:
    """The torque from nowhere that one frame in twenty exceeds."""
    return float(np.percentile(np.linalg.norm(_loads(record).torque, axis=1), 95))


def beyond_strength(record: Record) -> float:
    """Share of the joints' torques, over all joints and frames, that are beyond what muscles give there: 3.3 N m per kg
    of body at the hips, 3.2 at the knees, 1.0 at the elbows, ... (`hoi.body.strength`). What comes from nowhere acts on
    the pelvis and spares them."""
    return float((_loads(record).strain > 1).mean())


def greatest_strain(record: Record) -> float:
    """The largest torque of a joint over what muscles give there, over all joints and frames."""
    return float(_loads(record).strain.max())


@lru_cache(maxsize=2)
def _loads(record: Record) -> Loads:
    scene, motion = record.scene, record.motion
    body = scene.body
    if len(motion) < 3 or len(body.cloud) < 2 or not np.ptp(body.rest_joints):
        raise Undefined
    ground_of(record)
    try:
        masses = masses_of(body)
    except RunError:
        raise Undefined from None
    need = needed(body, masses, motion, scene.gravity)
    force, moment = _reaction(record, need.joints)
    pelvis = need.joints[:, 0]
    left, turn = (need.force - force).sum(axis=1), (need.moment - moment).sum(axis=1)
    held, turned = from_ground(need, np.concatenate([left, turn - np.cross(pelvis, left)], axis=1))
    left, turn = left - held.sum(axis=1), turn - turned.sum(axis=1)
    links = [joint for joint in np.flatnonzero(masses.mass).tolist() if joint]
    torques = np.linalg.norm(need.torques(force + held, moment + turned)[:, links], axis=-1)
    return Loads(left, turn - np.cross(pelvis, left), torques / (masses.mass.sum() * torque_limits(links)))


def _given(record: Record) -> Array:
    """What the pushes give the object at the frames 1 .. T - 2, over a frame's time [N s], (F, 3)."""
    frames = len(record.motion)
    each = [acting(first, last, frames)[:, None] * impulse for first, last, impulse in pushes_of(record)]
    return np.sum([np.zeros((frames - 2, 3)), *each], axis=0)


def _reaction(record: Record, joints: Array) -> tuple[Array, Array]:
    """What the object gives back, force [N] and moment about the world's origin [N m] on each part, (F, 24, 3) each:
    evenly to all joints that are to push together, at the recorded point as each carries it along."""
    force, moment, push = np.zeros_like(joints), np.zeros_like(joints), push_of(record)
    if push is None or push.joint < 0:
        return force, moment
    target = record.run.state.target
    pushing = target.striking if target is not None and push.joint in target.striking else (push.joint,)
    at = min(max(round(push.frame) - 1, 0), len(joints) - 1)
    for joint in pushing:
        given = -_given(record) * record.scene.fps / len(pushing)
        arm = push.point - joints[at, joint] if joint == push.joint else np.zeros(3)
        force[:, PART[joint]] += given
        moment[:, PART[joint]] += np.cross(joints[:, joint] + arm, given)
    return force, moment


def _gap(record: Record) -> Array:
    """Momentum from nowhere, of person and object together, over the pushes [N s], (3,)."""
    scene, path, given = record.scene, record.trajectory.com.astype(np.float64), _given(record)
    shares = np.array([acting(first, last, len(record.motion)) for first, last, _ in pushes_of(record)])
    reached = np.flatnonzero(shares.any(axis=0)) if len(shares) else []
    if not len(reached) or (abs(shares.sum(axis=1) - 1) > 1e-6).any():
        raise Undefined  # the run begins or ends within one
    gap = _loads(record).force[reached].sum(axis=0) / scene.fps
    mass = float(scene.thing.masses.sum())
    change = mass * (scene.fps * np.diff(path, n=2, axis=0) - scene.gravity / scene.fps)
    for frame in reached:
        near = record.trajectory.positions[frame : frame + 3]
        held = [cone_of(p) for p in scene.planes if height_above(p, near).min() < NEAR * scene.thing.size]
        columns = np.concatenate([np.zeros((0, 3)), *held]).T
        left = change[frame] - given[frame]
        gap = gap + left - columns @ nearest(columns, left)
    return gap
