"""What a record says about a run: one function a number, with its unit and which way is better. No torch."""

import math
from collections.abc import Callable

import numpy as np
from omegaconf import OmegaConf
from scipy.spatial import KDTree

from hoi.body.skeleton import LIMBS
from hoi.data import Array, Run

NAN = float("nan")
SUBFRAMES = 10
"""Times between two frames at which limbs and object are compared."""


def contact_gap(run: Run, points: Array) -> float:
    """Smallest distance between person and object at contact, or over the whole run where there is none. Lower, [m]."""
    search = run.state.contact
    if search is None:
        return NAN
    return search.push.gap if search.push else search.smallest_gap


def expected_limb(run: Run, points: Array) -> float:
    """1 when the limb that struck is the one that should, 0 when not or when nothing struck. Higher."""
    search = run.state.contact
    expected = OmegaConf.create(run.config_yaml).scene.expected_limb
    return float(search is not None and search.push is not None and search.push.joint in LIMBS[expected])


def deepest_penetration(run: Run, points: Array) -> float:
    """How far the person's skin enters the object, at most over the whole run. Lower, [m].

    Inside is behind the nearest Gaussian of the object, seen from its centre of mass: exact for star-shaped objects.
    The skin is the record's decimated one, interpolated between frames.
    """
    trajectory, scene = run.state.trajectory, run.scene
    if trajectory is None or scene is None:
        return NAN
    deepest = 0.0
    for frame in np.arange(0, len(points) - 1 + 1e-9, 1 / SUBFRAMES):
        first = min(int(frame), len(points) - 2)
        skin = points[first] + (frame - first) * (points[first + 1] - points[first])
        particles = object_at(run, float(frame))
        surface = particles[: len(scene.object.cloud)]
        near = skin[np.all((skin > surface.min(axis=0)) & (skin < surface.max(axis=0)), axis=1)]
        if len(near) == 0:
            continue
        com = particles.mean(axis=0)
        depth, nearest = KDTree(surface).query(near)
        behind = ((near - surface[nearest]) * (surface[nearest] - com)).sum(axis=1) < 0
        deepest = max(deepest, float((depth * behind).max()))
    return deepest


def object_at(run: Run, frame: float) -> Array:
    """The object's particles at a fractional frame [m], (P, 3): linear, but for the velocity's jump at the impulse.

    A push of a limb that is over within the frame is taken as one speed between the speeds before and after.
    """
    trajectory, push = run.state.trajectory, run.state.contact and run.state.contact.push
    assert trajectory is not None
    first = min(int(frame), len(trajectory.positions) - 2)
    before, after = trajectory.positions[first], trajectory.positions[first + 1]
    over = math.inf if push is None or run.scene is None else push.frame + push.duration * run.scene.fps
    if push is not None and first < push.frame and over < first + 1:
        velocity = trajectory.com_velocity / run.scene.fps if run.scene else trajectory.com_velocity
        coming = before + (min(frame, push.frame) - first) * velocity[first]
        leaving = after - (first + 1 - max(frame, over)) * velocity[first + 1]
        if frame <= push.frame:
            return coming
        return leaving if frame >= over else coming + (frame - push.frame) / (over - push.frame) * (leaving - coming)
    return before + (frame - first) * (after - before)


def post_impact_error(run: Run, points: Array) -> float:
    """Relative deviation of the centre of mass's velocity from V_post, 1 ms into the re-simulation. Lower, [-]."""
    numbers = next((report.numbers for report in run.reports if report.stage == "resimulate"), {})
    return numbers.get("v_post_error", NAN)


def closing_speed(run: Run, points: Array) -> float:
    """v_in at contact [m/s]."""
    push = run.state.contact.push if run.state.contact else None
    return push.v_in if push else NAN


def object_path(run: Run, points: Array) -> float:
    """Length of the path of the object's centre of mass [m]."""
    trajectory = run.state.trajectory
    return NAN if trajectory is None else float(np.linalg.norm(np.diff(trajectory.com, axis=0), axis=1).sum())


def seconds(run: Run, points: Array) -> float:
    """Wall-clock time of the run. Lower, [s]."""
    return float(run.result["seconds"])


METRICS: dict[str, Callable[[Run, Array], float]] = {
    "limb as expected": expected_limb,
    "gap [m]": contact_gap,
    "penetration [m]": deepest_penetration,
    "v_in [m/s]": closing_speed,
    "v_post error": post_impact_error,
    "object path [m]": object_path,
    "seconds": seconds,
}
