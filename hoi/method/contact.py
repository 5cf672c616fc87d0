"""Contact detection and the momentum it transfers (paper, Contact Detection and Re-simulation).

Whole frames are tested as in the paper. Between frames, limb and object are interpolated finely enough that no
point of a limb moves further than the contact distance between tests: a fist at 10 m/s covers 0.5 m a frame.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from hoi.body.limbs import Limbs
from hoi.body.mass import PART
from hoi.body.parts import TOGETHER, part_at
from hoi.body.skeleton import chain_of
from hoi.body.skinning import joint_frames, joint_paths
from hoi.data import Array, Body, Contact, ContactSearch, Motion, ObjectState, ObjectTrajectory, Scene, SceneObject
from hoi.frames import at_frame
from hoi.method.touch import Touch, contact_normal, plates_of, slack_of, touch
from hoi.mpm.state import centre_of_mass

SWEEP_MARGIN = 0.1
"""How far a limb may bulge out of the boxes of two neighbouring frames while it turns [m]."""
AGAIN = 0.1
"""No limb strikes twice in so short a time: its next skin and the one before it are one blow [s]."""
INSTANT = 0.01
"""Half the time over which the velocity at an instant is taken [frames]."""


def exchange(contact: Contact, thing: SceneObject, state: ObjectState, limb: float, flesh: float = 1.0) -> Contact:
    """The contact with the impulse P n that limb and object exchange, both as free to answer as they are.

    P = (1 + e) v_in / (1 / m_eff + 1 / m + (r x n) I^-1 (r x n)), r from the object's centre of mass to the point: with
    a limb of infinite mass and n through the centre of mass, the paper's m (1 + e) v_in.

    Args:
        state: the object's at t_c.
        limb: 1 / m_eff [1/kg].
        flesh: what the limb leaves of the material's restitution; e is their product [-].
    """
    masses = thing.masses
    arms = state.positions - centre_of_mass(state.positions, masses)
    inertia = np.eye(3) * (masses @ (arms**2).sum(axis=1)) - (masses[:, None] * arms).T @ arms
    arm = contact.point - centre_of_mass(state.positions, masses)
    turn = np.linalg.solve(inertia, np.cross(arm, contact.normal))
    mass = float(masses.sum())
    v_object = centre_of_mass(state.velocities, masses)
    momentum = masses @ np.cross(arms, state.velocities - v_object)
    at_point = v_object + np.cross(np.linalg.solve(inertia, momentum), arm)
    v_in = float((contact.v_human - at_point) @ contact.normal)
    give = limb + 1 / mass + float(np.cross(arm, contact.normal) @ turn)
    given = (1 + flesh * thing.material.restitution) * max(v_in, 0.0) / give
    return replace(
        contact, v_object=v_object, v_in=v_in, v_post=v_object + given / mass * contact.normal,
        impulse=given * contact.normal, spin=given * turn, limb_mass=1 / limb if limb > 0 else np.inf,
    )  # fmt: skip


def impulse(v_human: Array, v_object: Array, normal: Array, restitution: float) -> tuple[float, Array]:
    """v_in = (V_human - V_obj) . n and V_post = V_obj + (1 + e) v_in n, both [m/s].

    Separating bodies (v_in <= 0) exchange nothing.
    """
    v_in = float((v_human - v_object) @ normal)
    return v_in, v_object + (1 + restitution) * max(v_in, 0.0) * normal


def find_contact(
    scene: Scene,
    motion: Motion,
    trajectory: ObjectTrajectory,
    *,
    tau: float,
    distance: float,
    between_frames: bool,
    widened: bool = True,
    over_a_frame: bool = False,
    to_com: bool = False,
    together: Sequence[int] = (),
    last: Contact | None = None,
    until: float = np.inf,
) -> ContactSearch:
    """The first contact that pushes the object, any separating touch before it, and what pushes together with it.

    Contact of joint j at frame t_c: its box overlaps the object's, and at least `tau` of its Gaussians lie within
    `distance` of an object Gaussian. Gaussians that lie farther apart than that are plates (see `hoi.method.touch`).

    Args:
        trajectory: the object's free motion.
        tau: tau_contact [-]. distance: d_contact [m].
        between_frames: whether to look between frames too.
        widened: whether boxes that are as near as Gaussians have to be will do; the paper's have to overlap.
        over_a_frame: V_human as the paper has it, of the joint and over the frame before t_c; else that of the touched
            point at t_c.
        to_com: whether n leads to the centre of mass, as in the paper; else it is the surface's.
        together: joints that push together: of their limbs, those that touch within `TOGETHER` of the push are contacts
            too, without an impulse of their own.
        last: the contact that is answered already: the search goes on after it, and what struck is to let go of the
            object before it strikes again.
        until: the frame before which the search ends.
    """
    limbs, joints = Limbs(scene.body, motion), joint_paths(scene.body, motion)
    surface = trajectory.positions[:, : len(scene.thing.cloud)]
    plates = plates_of(scene.thing.cloud, distance)
    slack = slack_of(scene.body.cloud.means, distance)
    beyond = float(slack.max(initial=0.0)) + (plates.farthest if plates else 0.0)
    gap, gap_frame, gap_joint = _smallest_gap(limbs, surface)

    def gap_part() -> str:
        if not np.isfinite(gap):
            return ""
        skin = limbs.at(gap_joint, np.array([gap_frame]))[0]
        nearest = skin[KDTree(at_frame(surface, gap_frame)).query(skin)[0].argmin()]
        return part_at(gap_joint, nearest, at_frame(joints, gap_frame))

    contacts: list[Contact] = []
    touched_before: set[int] = set()
    push: Contact | None = None
    awaited = {chain_of(joint) for joint in together}
    since, holding = (-np.inf, None) if last is None else (last.frame, chain_of(last.joint))
    for frame, candidates in _tests(limbs, surface, distance, distance + beyond, between_frames, since, until):
        if push is not None and frame > push.frame + TOGETHER:
            break
        object_now = at_frame(surface, frame)
        plates_now = plates and plates.at(object_now)
        touching: dict[int, Touch] = {}
        for joint, limb in candidates.items():
            found = touch(limb, object_now, distance, plates_now, slack[limbs.members[joint]])
            if found.gap < gap:
                gap, gap_frame, gap_joint = found.gap, frame, joint
            meet = widened or _overlap(*box_of(limb), *box_of(object_now), 0.0)
            if found.fraction >= tau and found.point is not None and meet:
                touching[joint] = found
        if frame > since + AGAIN * motion.fps and all(chain_of(joint) != holding for joint in touching):
            holding = None
        touching = {joint: found for joint, found in touching.items() if chain_of(joint) != holding}
        for joint in sorted(touching, key=lambda j: -touching[j].fraction):
            if over_a_frame:
                v_human = _joint_velocity(joints[:, joint], frame, motion.fps)
            else:
                v_human = _point_velocity(scene.body, motion, joint, frame, touching[joint].point)
            contact = _contact(touching[joint], joint, frame, v_human, trajectory, scene.thing, to_com)
            contact = replace(contact, part=part_at(joint, touching[joint].on_limb, at_frame(joints, frame)))
            if push is None:
                recorded = contact.v_in > 0 or joint not in touched_before
                push = contact if contact.v_in > 0 else None
            else:
                recorded = chain_of(joint) in awaited
            if recorded:
                contacts.append(contact)
            if push is not None:
                awaited.discard(chain_of(joint))
        touched_before = set(touching)
        if push is not None and not awaited:
            break
    return ContactSearch(tuple(contacts), gap, gap_frame, gap_joint, gap_part())


def _contact(
    found: Touch,
    joint: int,
    frame: float,
    v_human: Array,
    trajectory: ObjectTrajectory,
    thing: SceneObject,
    to_com: bool,
) -> Contact:
    assert found.point is not None
    v_object = at_frame(trajectory.com_velocity, frame)
    particles, com = at_frame(trajectory.positions, frame), at_frame(trajectory.com, frame)
    normal = contact_normal(found, particles, thing, com, v_human - v_object, to_com)
    v_in, v_post = impulse(v_human, v_object, normal, thing.material.restitution)
    return Contact(
        frame, joint, found.fraction, found.point, normal, v_human, v_object, v_in, v_object, np.zeros(3), found.gap,
        v_formula=v_post,
    )  # fmt: skip


def _joint_velocity(path: Array, frame: float, fps: float) -> Array:
    """V_human = (p(t_c) - p(t_c - 1)) / dt [m/s]; the paper's dt = 1 is one frame. Path (T, 3) at whole frames [m]."""
    back = min(1.0, frame)
    if back == 0.0:
        return np.zeros(3)
    return (at_frame(path, frame) - at_frame(path, frame - back)) * (fps / back)


def _point_velocity(body: Body, motion: Motion, joint: int, frame: float, point: Array | None) -> Array:
    """Velocity J q' [m/s], (3,), at an instant, of the point [m] of the part that the joint moves."""
    assert point is not None
    at = np.clip([frame - INSTANT, frame, frame + INSTANT], 0, len(motion) - 1)
    rotations, positions = (path[:, PART[joint]] for path in joint_frames(body, motion, at))
    paths = rotations @ rotations[1].T @ (point - positions[1]) + positions
    return (paths[2] - paths[0]) * motion.fps / (at[2] - at[0])


def _smallest_gap(limbs: Limbs, surface: Array) -> tuple[float, float, int]:
    """Smallest distance [m] between person and object at whole frames, its frame and joint.

    The nearest boxes are looked into first, and no farther than to where something has been found.
    """
    low, high = surface.min(axis=1), surface.max(axis=1)
    apart: list[tuple[float, int, int]] = []
    for joint, (limb_low, limb_high) in limbs.boxes.items():
        between = np.maximum(0, np.maximum(limb_low - high, low - limb_high))
        apart += [(float(gap), frame, joint) for frame, gap in enumerate(np.linalg.norm(between, axis=1))]
    best, trees = (np.inf, 0, 0), {}
    for least, frame, joint in sorted(apart):
        if least > best[0]:
            break
        if frame not in trees:
            trees[frame] = KDTree(surface[frame])
        found = trees[frame].query(limbs.at_frames[joint][frame], distance_upper_bound=np.nextafter(best[0], np.inf))
        best = min(best, (float(found[0].min()), frame, joint))
    return best[0], float(best[1]), best[2]


def _tests(
    limbs: Limbs,
    surface: Array,
    distance: float,
    reach: float,
    between_frames: bool,
    since: float = -np.inf,
    until: float = np.inf,
) -> Iterator[tuple[float, dict[int, Array]]]:
    """(frame, {joint: world means}) in the order of time, after `since` and before `until`, for the joints whose boxes
    come within `reach` of its box."""
    first = int(max(since, 0.0))
    for frame, candidates in _tests_from(first, limbs, surface, distance, reach, between_frames):
        if frame >= until:
            return
        if frame > since:
            yield frame, candidates


def _tests_from(
    first: int, limbs: Limbs, surface: Array, distance: float, reach: float, between_frames: bool
) -> Iterator[tuple[float, dict[int, Array]]]:
    """The same from the whole frame `first` on."""
    frames = len(surface)
    low, high = surface.min(axis=1), surface.max(axis=1)
    for frame in range(first, frames):
        following = min(frame + 1, frames - 1)
        both = [frame, following]
        object_span = low[both].min(axis=0), high[both].max(axis=0)
        swept: list[int] = []
        now: dict[int, Array] = {}
        for joint, (limb_low, limb_high) in limbs.boxes.items():
            if _overlap(limb_low[frame], limb_high[frame], low[frame], high[frame], reach):
                now[joint] = limbs.at_frames[joint][frame]
            span = limb_low[both].min(axis=0), limb_high[both].max(axis=0)
            if _overlap(*span, *object_span, reach + SWEEP_MARGIN):
                swept.append(joint)
        if now:
            yield float(frame), now
        if not between_frames or following == frame or not swept:
            continue
        object_path = np.linalg.norm(surface[following] - surface[frame], axis=1).max()
        ways = [np.diff(limbs.at_frames[joint][both], axis=0)[0] for joint in swept]
        limb_path = max(np.linalg.norm(way, axis=1).max() for way in ways)
        tests = int(np.ceil((limb_path + object_path) / distance))
        between = frame + np.arange(1, tests) / max(tests, 1)
        if len(between) == 0:
            continue
        paths = {joint: limbs.at(joint, between) for joint in swept}
        for i, time in enumerate(between):
            yield float(time), {joint: path[i] for joint, path in paths.items()}


def box_of(points: Array) -> tuple[Array, Array]:
    """The corners of the axis-aligned box of points (N, 3) [m], (3,) each."""
    return points.min(axis=0), points.max(axis=0)


def _overlap(low: Array, high: Array, other_low: Array, other_high: Array, margin: float) -> bool:
    return bool(np.all(low - margin <= other_high) and np.all(other_low <= high + margin))
