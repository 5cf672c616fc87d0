"""The object on its own: what moves it before and without contact, how it flies after, and what it keeps."""

from functools import lru_cache

import numpy as np

from hoi.data import Array

from ..records import Record, Undefined
from .contact import first_touch, frames_around, push_of, pushes_of
from .metric import NAN
from .penetration import height_above

NEAR = 0.125
"""An object whose lowest point is nearer to a plane than this, in its sizes, may be held by it: two cells of the MPM's
grid."""
FEWEST = 4
"""Whole frames in a row that a flight is fitted to."""
AFTER = 3
"""Frames after t_c in which the impact's deformation is looked for."""
ANSWER, WITHIN = 0.02, 2
"""A change of velocity that answers a touch, in shares of v_in, and within how many frames."""
LOOKED_AT = 5000
"""Particles whose deformation is looked at, evenly chosen."""
STILL = 0.05
"""A path shorter than this has no shape [m]."""


def ghosting(record: Record) -> float:
    """How far the object strays before the first touch (in all of the run where nothing touches it) from the motion
    that its initial velocity, gravity and what it lies on allow. The ground may stop, hold, slow or throw back what
    comes near it, but adds no speed."""
    return float(np.linalg.norm(_strayed(record)[1], axis=1).max(initial=0.0))


def causality_error(record: Record) -> float:
    """Effect without cause plus cause without effect: the largest speed that the object gets before anything touches it
    and that neither gravity nor ground explains; and v_in of the first touch in which a limb comes nearer, where the
    object's velocity answers it, within two frames, by less than 2% of v_in."""
    return float(np.linalg.norm(_strayed(record)[0], axis=1).max(initial=0.0)) + _missing_effect(record)


def energy_gain(record: Record) -> float:
    """Energy of the object (kinetic, elastic and potential) that no push gave it, relative to its largest kinetic
    energy: what it has more right after an impulse than that gave, and the largest rise after the last push. Of a limb
    that pushes for a while the work is not recorded, and only the rise after it counts."""
    push, scene, energy = push_of(record), record.scene, record.trajectory.energy
    total, kinetic = energy.sum(axis=1), energy[:, 0]
    largest = float(kinetic.max(initial=0.0))
    start, gained = 0, 0.0
    if push is not None:
        before, start = frames_around(record)
        if push.duration == 0:
            mass = float(scene.thing.masses.sum())
            work = 0.5 * mass * float(push.v_post @ push.v_post - push.v_object @ push.v_object)
            gained = max(0.0, float(total[start] - total[before]) - work)
    after = total[start:]
    gained += float((after - np.minimum.accumulate(after)).max(initial=0.0))
    if largest <= 0:
        return 0.0 if gained <= 0 else NAN
    return gained / largest


def ballistic_residual(record: Record) -> float:
    """Root mean square distance of the centre of mass from the parabola x0 + v0 t + g t^2 / 2 fitted to it, over each
    stretch of four or more frames in which neither ground, wall nor person is near; g is the scene's."""
    scene, trajectory = record.scene, record.trajectory
    squares, frames = 0.0, 0
    for first, last in _flights(record):
        time = np.arange(last - first + 1) / scene.fps
        path = trajectory.com[first : last + 1].astype(np.float64) - 0.5 * scene.gravity * time[:, None] ** 2
        basis = np.stack([np.ones_like(time), time], axis=1)
        fitted = basis @ np.linalg.lstsq(basis, path, rcond=None)[0]
        squares += float(((path - fitted) ** 2).sum())
        frames += len(time)
    return float(np.sqrt(squares / frames)) if frames else NAN


def bend(record: Record) -> float:
    """How far the path of the centre of mass after contact leaves the straight line between its ends, relative to the
    line's length: 0 is a straight path, which the constant velocity of w/o MPM gives."""
    path = record.trajectory.com[frames_around(record)[1] :].astype(np.float64)
    chord = path[-1] - path[0]
    length = float(np.linalg.norm(chord))
    if length < STILL:
        return NAN
    away = path - path[0]
    across = away - np.outer(away @ chord / length, chord / length)
    return float(np.linalg.norm(across, axis=1).max()) / length


def deformation(record: Record) -> float:
    """Largest |principal stretch - 1| of the deformation gradient that one particle in a hundred exceeds, in the three
    whole frames after t_c. 0 where the mover knows no deformation (w/o MPM)."""
    first, trajectory = int(np.ceil(record.push.frame)), record.trajectory
    if trajectory.deformation_gradient is None:
        return 0.0
    stride = -(-trajectory.deformation_gradient.shape[1] // LOOKED_AT)
    gradients = trajectory.deformation_gradient[first : first + AFTER, ::stride].astype(np.float64)
    if not gradients.size:
        return NAN
    squared = np.linalg.eigvalsh(gradients.swapaxes(-1, -2) @ gradients)  # principal stretches, squared
    strain = np.abs(np.sqrt(squared.clip(min=0)) - 1).max(axis=-1)
    return float(np.percentile(strain, 99, axis=1).max())


def object_path(record: Record) -> float:
    """Length of the path of the object's centre of mass."""
    return float(np.linalg.norm(np.diff(record.trajectory.com, axis=0), axis=1).sum())


@lru_cache(maxsize=2)
def _heights(record: Record) -> tuple[Array, ...]:
    """The object's lowest point over each plane [m], (T,) each."""
    positions = record.trajectory.positions
    return tuple(height_above(plane, positions).min(axis=1).astype(np.float64) for plane in record.scene.planes)


@lru_cache(maxsize=2)
def _strayed(record: Record) -> tuple[Array, Array]:
    """Velocity [m/s] and way [m] that nothing explains, (K, 3) each, at the frames before the first touch."""
    scene, trajectory = record.scene, record.trajectory
    if not len(scene.thing.particles) or len(trajectory.com) < 2:
        raise Undefined
    touch = first_touch(record)[0]
    path, dt = trajectory.com.astype(np.float64), 1 / scene.fps
    last = len(path) - 1 if touch == float("inf") else min(int(touch), len(path) - 1)
    steps = np.diff(path[: last + 1], axis=0) / dt
    if not len(steps):
        return np.zeros((0, 3)), np.zeros((0, 3))
    # Mean velocities of the frames; before the first, what the initial velocity has been half a frame earlier.
    before = np.concatenate([(scene.thing.velocity - 0.5 * dt * scene.gravity)[None], steps[:-1]])
    reach, weight = NEAR * scene.thing.size, float(np.linalg.norm(scene.gravity)) * dt
    coming = before + scene.gravity * dt
    strayed = np.zeros_like(steps)
    for index, (old, new) in enumerate(zip(coming, steps, strict=True)):
        if trajectory.phase and trajectory.phase[index + 1] == "rest" and not new.any():
            continue  # held by what it lies on, also in records that do not say what that is
        change = new - old
        for plane, heights in zip(scene.planes, _heights(record), strict=True):
            # A bounce between two frames shows in two changes of their mean velocities.
            inward = max(0.0, -float((coming[max(index - 1, 0) : index + 1] @ plane.normal).min()))
            if heights[max(index - 1, 0) : index + 2].min() - inward * dt <= reach:
                change = _unexplained(change, old, plane.normal, inward + weight)
        strayed[index] = change
    velocity = strayed.cumsum(axis=0)
    return velocity, velocity.cumsum(axis=0) * dt


def _unexplained(change: Array, coming: Array, normal: Array, fastest: float) -> Array:
    """What of a change of velocity a plane cannot have made: it pushes outwards, gives back no more speed than came in,
    and its friction only slows.

    Args:
        change: (3,) [m/s]. coming: the velocity without the change, (3,) [m/s]. fastest: what it may leave with [m/s].
    """
    inward, out = float(coming @ normal), float(change @ normal)
    along = change - out * normal
    normal_part = (out - min(max(out, 0.0), max(fastest - inward, 0.0))) * normal
    slide = coming - inward * normal
    after, before = float(np.linalg.norm(slide + along)), float(np.linalg.norm(slide))
    if after <= before:
        return normal_part
    return normal_part + (slide + along) * (1 - before / after)


def _missing_effect(record: Record) -> float:
    """v_in of the first touch in which a limb comes nearer, where the object does not answer it; else 0 [m/s]."""
    scene, trajectory, joints, (_, met) = record.scene, record.trajectory, record.joints, first_touch(record)
    if joints is None or met is None or push_of(record) is not None:
        return 0.0  # a push has its effect by definition; how much of it is what `momentum_error` says
    frames = min(len(joints), len(trajectory.com))
    for frame, joint in zip(met.frames[met.touching], met.joint[met.touching], strict=True):
        first = max(int(np.ceil(frame)) - 1, 0)
        if joint < 0 or first + 1 >= frames:
            continue
        v_human = (joints[first + 1, joint] - joints[first, joint]) * scene.fps
        towards = trajectory.com[first] - joints[first, joint]
        v_in = float((v_human - trajectory.com_velocity[first]) @ towards) / max(float(np.linalg.norm(towards)), 1e-6)
        if v_in <= 0:
            continue
        after = min(first + 1 + WITHIN, frames - 1)
        change = trajectory.com_velocity[after] - trajectory.com_velocity[first]
        fallen = scene.gravity * (after - first) / scene.fps
        answer = min(float(np.linalg.norm(change)), float(np.linalg.norm(change - fallen)))
        return v_in if answer < ANSWER * v_in else 0.0
    return 0.0


def _flights(record: Record) -> list[tuple[int, int]]:
    """First and last frames of the stretches in which nothing but gravity can move the object."""
    scene, trajectory = record.scene, record.trajectory
    if not len(scene.thing.particles):
        return []
    free, breaks, reach, dt = np.ones(len(trajectory.com), bool), set[int](), NEAR * scene.thing.size, 1 / scene.fps
    for plane, heights in zip(scene.planes, _heights(record), strict=True):
        free &= heights > reach
        way = (trajectory.com_velocity @ plane.normal) * dt + min(0.0, float(scene.gravity @ plane.normal)) * dt**2
        breaks |= set((np.flatnonzero(heights + np.minimum(way, 0) <= reach) + 1).tolist())  # it may bounce on the way
    _, met = first_touch(record)
    held = [] if met is None else [float(frame) for frame in met.frames[met.touching]]
    for first, last, _ in pushes_of(record):
        free[int(np.ceil(first)) : int(np.ceil(last))] = False
        held += [first, last]
    for frame in held:  # a touch between frames ends one flight and begins another
        if frame == int(frame) and int(frame) < len(free):
            free[int(frame)] = False
        breaks.add(int(np.ceil(frame)))
    found, start = [], None
    for frame in range(len(free) + 1):
        ends = frame == len(free) or not free[frame] or frame in breaks
        if ends and start is not None:
            if frame - start >= FEWEST:
                found.append((start, frame - 1))
            start = None
        if frame < len(free) and free[frame] and start is None:
            start = frame
    return found
