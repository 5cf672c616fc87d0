"""The striking limb as a moving obstacle: which capsules push the object, from when on, and along which paths."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from hoi.body.capsules import Capsules, carry, fit_capsules
from hoi.body.limbs import Limbs
from hoi.body.parts import struck_with
from hoi.body.segments import segment_distances
from hoi.body.skeleton import CHAINS, chain_of
from hoi.body.skinning import joint_frames
from hoi.data import Array, Contact, Motion, ObjectTrajectory, Scene
from hoi.errors import RunError
from hoi.frames import at_frame
from hoi.mpm.collider import Collider

NEAR = 0.1
"""A limb that comes this near to where the object would be, box to box, may push it too [m]."""
NEAR_IN_ANSWER = 0.4
"""The same for a person who gives way, and goes where it was not told to [m]."""


def limb_collider(
    scene: Scene, motion: Motion, free: ObjectTrajectory, contact: Contact, *, samples: int, friction: float
) -> tuple[Collider, tuple[str, ...]]:
    """The capsules of the striking limb, and of others that come near, from their last moment outside the object on.

    Each joint's capsules are fitted once and carried along by the joint, `samples` times a frame, with the motion
    interpolated as everywhere else. Limbs go on as they were told to, whatever they meet.

    Args:
        free: the object's free motion, in which `contact` was found.
        friction: Coulomb coefficient between limb and object [-].

    Returns:
        the collider, its times those of the scene [s], and notes on what was left out.

    Raises:
        RunError: the striking limb is in the object from the first frame on.
    """
    ready = ready_to_push(scene, motion, free, contact, samples, NEAR)
    starts, ends = carry(ready.capsules, np.asarray(scene.body.rest_joints, np.float64), *ready.frames_from)
    return Collider(ready.times, starts, ends, ready.radii, friction), ready.notes


@dataclass(frozen=True)
class Ready:
    """Capsules about to push."""

    capsules: Capsules
    radii: Array
    times: Array
    """From the last moment at which all are outside the object on [s], (K,)."""
    frames_from: tuple[Array, Array]
    """The joints' rotations and positions at those times."""
    notes: tuple[str, ...]


def ready_to_push(
    scene: Scene, motion: Motion, free: ObjectTrajectory, contact: Contact, samples: int, near: float
) -> Ready:
    """The striking limb's capsules, and those of what else of the person comes `near` [m] to the object.

    A limb other than the one that strikes pushes only if it is outside the object by then too. No capsule is thinner
    than the object's Gaussians are apart: it would slip in between them.

    Raises:
        RunError: the striking limb is in the object from the first frame on.
    """
    frames = np.arange((scene.frames - 1) * samples + 1) / samples
    rotations, positions = joint_frames(scene.body, motion, frames)
    rest_joints = np.asarray(scene.body.rest_joints, np.float64)

    def clear(capsules: Capsules, at: int) -> bool:
        starts, ends = carry(capsules, rest_joints, rotations[at : at + 1], positions[at : at + 1])
        return outside(at_frame(free.positions, frames[at]), starts[0], ends[0], capsules.radii)

    striker = chain_of(contact.joint)
    limbs = [fit_capsules(scene.body, CHAINS[striker])]
    before = range(math.floor(contact.frame * samples), -1, -1)
    first = next((at for at in before if clear(limbs[0], at)), None)
    if first is None or first == len(frames) - 1:
        raise RunError(
            f"the {striker} is in the object from the first frame to its contact at frame {contact.frame:.2f} "
            f"({struck_with(contact)})"
        )
    notes = []
    for chain in _near(scene, motion, free, int(frames[first]), near):
        if chain == striker:
            continue
        limb = fit_capsules(scene.body, CHAINS[chain])
        if len(limb.joints) and clear(limb, first):
            limbs.append(limb)
        elif len(limb.joints):
            notes.append(f"the {chain} is in the object when the {striker} comes to push it: it pushes nothing")
    parts = (np.concatenate([getattr(limb, name) for limb in limbs]) for name in ("joints", "starts", "ends", "radii"))
    capsules, least = Capsules(*parts), spacing(scene.thing.cloud.means)
    if capsules.radii.min() < least:
        notes.append(f"limbs thinner than the object's Gaussians are apart push as if of radius {least:.3f} m")
    return Ready(
        capsules,
        np.maximum(capsules.radii, least),
        frames[first:] / scene.fps,
        (rotations[first:], positions[first:]),
        tuple(notes),
    )


def spacing(points: Array) -> float:
    """How far apart neighbours among points (N, 3) are [m]: the 90th percentile."""
    apart, _ = KDTree(points).query(points, k=2)
    return float(np.percentile(apart[:, 1], 90))


def outside(points: Array, starts: Array, ends: Array, radii: Array) -> bool:
    """Whether none of the points (P, 3) is in any of the capsules, (C, 3), (C, 3), (C,)."""
    low = (np.minimum(starts, ends) - radii[:, None]).min(axis=0)
    high = (np.maximum(starts, ends) + radii[:, None]).max(axis=0)
    near = points[np.all((points > low) & (points < high), axis=1)]
    return bool((segment_distances(near, starts, ends) >= radii).all())


def _near(scene: Scene, motion: Motion, free: ObjectTrajectory, first: int, near: float) -> list[str]:
    """The chains with a joint whose Gaussians' box comes near the object's at a whole frame from `first` on."""
    limbs = Limbs(scene.body, motion)
    low, high = (bound(free.positions[first:], axis=1) for bound in (np.min, np.max))

    def comes_near(joint: int) -> bool:
        points = limbs.at_frames[joint][first:]
        apart = np.maximum(points.min(axis=1) - high, low - points.max(axis=1)).max(axis=1)
        return bool((apart <= near).any())

    return [chain for chain, joints in CHAINS.items() if any(comes_near(j) for j in joints if j in limbs.joints)]
