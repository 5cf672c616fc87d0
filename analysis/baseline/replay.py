"""A clip at its place, and the object that it carries on: no optimisation, no physics."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoi.body.skeleton import JOINT_COUNT, LIMBS
from hoi.body.skinning import joint_paths
from hoi.config import Approach, Config
from hoi.data import Array, Contact, ContactSearch, Motion, ObjectTrajectory, Scene, State, Target
from hoi.frames import at_frame
from hoi.method.approach import approach
from hoi.method.attraction import choose_target, reach_gap
from hoi.reports import Stages

RESTING = 1e-3
"""What is nearer to the ground than this lies on it [m]."""


def replayed(config: Config, scene: Scene, whole: Motion, stages: Stages) -> State:
    """The clip placed at the object, and the object that it moves."""
    free = free_path(scene)
    limb = LIMBS[config.scene.striking_limb] if config.scene.striking_limb else range(JOINT_COUNT)
    peak = strike_of(joint_paths(scene.body, whole), limb, free)
    motion = strike_at(whole, peak.frame, config.scene.contact_frame, scene.frames)
    target = Target(peak.joint, config.scene.contact_frame, "velocity profile")
    with stages.stage("coordinate", 1) as stage:
        if config.scene.approach is not Approach.none:
            motion, target = approach(scene, motion, free, target, config.scene.meeting_height)
        stage.numbers["reach_gap"] = reach_gap(scene, motion, free, target)
    with stages.stage("contact", 1):
        search = config.stage.contact.search(scene, motion, free)
    push = search.push
    if push is None:
        return State(motion, free, target, search)
    with stages.stage("resimulate", 1) as stage:
        trajectory = carried_on(scene, free, push)
        error = np.linalg.norm(push.v_human - push.v_formula) / np.linalg.norm(push.v_formula)
        stage.numbers["v_post_error"] = float(error)
    return State(motion, trajectory, target, _as_given(search, float(scene.thing.masses.sum())))


def _as_given(search: ContactSearch, mass: float) -> ContactSearch:
    """The search with what the object really got: V_human, and the impulse m (V_human - V_obj)."""
    push = search.push
    assert push is not None
    return search.with_push(replace(push, v_post=push.v_human, impulse=mass * (push.v_human - push.v_object)))


def strike_of(joints: Array, candidates: Sequence[int], thing: ObjectTrajectory) -> Target:
    """j* as the method chooses it, and its fastest step to a height at which the object ever is; if none, its fastest.

    A replay cannot aim: a high kick meets a ball on the ground, if at all, on its way up.

    Args:
        joints: of the whole clip [m], (T, 24, 3).
    """
    target = choose_target(joints, candidates)
    path, heights = joints[:, target.joint], thing.positions[..., 2]
    speed = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    met = (path[1:, 2] >= heights.min()) & (path[1:, 2] <= heights.max())
    return replace(target, frame=int(np.where(met, speed, -1.0).argmax())) if met.any() else target


def strike_at(motion: Motion, peak: int, frame: int, frames: int) -> Motion:
    """So many frames of a motion that what is at `peak` is at `frame`; its ends are held."""
    rows = np.clip(np.arange(frames) + peak - frame, 0, len(motion) - 1)
    return replace(
        motion,
        translation=motion.translation[rows].astype(np.float32),
        orientation=motion.orientation[rows].astype(np.float32),
        body_pose=motion.body_pose[rows].astype(np.float32),
    )


def free_path(scene: Scene) -> ObjectTrajectory:
    """The untouched object in closed form: x_0 + v t + g t^2 / 2 until it meets the ground, then along it.

    It does not turn, bounce or slow down, and sees no wall.
    """
    thing, times = scene.thing, np.arange(scene.frames)[:, None] / scene.fps
    moved = thing.velocity * times + 0.5 * scene.gravity * times**2
    velocity = thing.velocity + scene.gravity * times
    lowest = float(thing.particles[:, 2].min())
    grounded = any(not plane.point.any() and plane.normal[2] == 1 for plane in scene.planes)
    landed = (
        np.logical_or.accumulate(moved[:, 2] < RESTING - max(lowest, 0.0)) if grounded else np.zeros(len(times), bool)
    )
    landed[:1] |= grounded and lowest < RESTING and thing.velocity[2] <= 0
    moved[landed, 2], velocity[landed, 2] = -max(lowest, 0.0), 0.0
    moved[landed, :2], velocity[landed, :2] = (thing.velocity * times)[landed, :2], thing.velocity[:2]
    still = ~velocity.any(axis=1)
    phase = np.where(still, "rest", np.where(landed, "constant_velocity", "flight"))
    return _trajectory(scene, moved, velocity, phase.tolist())


def carried_on(scene: Scene, free: ObjectTrajectory, contact: Contact) -> ObjectTrajectory:
    """The object as in `free` until t_c, then on a straight line with V_human: no mass, no gravity, no ground."""
    frames = np.arange(scene.frames)
    moved = free.com - free.com[0]
    met = at_frame(moved, contact.frame)
    after = frames >= contact.frame
    since = (frames - contact.frame)[:, None] / scene.fps
    moved = np.where(after[:, None], met + contact.v_human * since, moved)
    velocity = np.where(after[:, None], contact.v_human, free.com_velocity)
    phase = np.where(after, "constant_velocity", free.phase)
    return _trajectory(scene, moved, velocity, phase.tolist())


def _trajectory(scene: Scene, moved: Array, velocity: Array, phase: Sequence[str]) -> ObjectTrajectory:
    thing = scene.thing
    mass, start = float(thing.masses.sum()), np.average(thing.particles, axis=0, weights=thing.masses)
    com = start + moved
    kinetic = 0.5 * mass * (velocity**2).sum(axis=1)
    return ObjectTrajectory(
        positions=(thing.particles + moved[:, None]).astype(np.float32),
        com=com,
        com_velocity=velocity,
        energy=np.stack([kinetic, np.zeros_like(kinetic), -mass * com @ scene.gravity], axis=-1),
        phase=tuple(phase),
    )
