"""What a record says about a run: one function a number, with its unit and which way is better. No torch."""

from collections.abc import Callable

import numpy as np
from omegaconf import OmegaConf

from hoi.body.skeleton import LIMBS
from hoi.data import Array, Run
from hoi.refine.fidelity import SUBFRAMES, object_at, surfaces_near

NAN = float("nan")


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
    """How far the person's skin enters the object, at most over the whole run (see `hoi.refine.fidelity`). Lower, [m].

    The skin is the record's decimated one, interpolated between frames.
    """
    state, scene = run.state, run.scene
    trajectory = state.trajectory
    if trajectory is None or scene is None:
        return NAN
    push, gaussians = state.contact and state.contact.push, len(scene.object.cloud)
    frames, skins = [], []
    for frame in np.arange(0, len(points) - 1 + 1e-9, 1 / SUBFRAMES):
        first = min(int(frame), len(points) - 2)
        skin = points[first] + (frame - first) * (points[first + 1] - points[first])
        surface = object_at(trajectory, push, scene.fps, float(frame))[:gaussians]
        near = skin[np.all((skin > surface.min(axis=0)) & (skin < surface.max(axis=0)), axis=1)]
        if len(near):
            frames.append(float(frame))
            skins.append(near)
    if not frames:
        return 0.0
    touched = np.concatenate(skins)
    box = touched.min(axis=0), touched.max(axis=0)
    surfaces = surfaces_near(scene.object, trajectory, push, scene.fps, frames, box)
    depths = (-surface.distance(skin)[0].min() for surface, skin in zip(surfaces, skins, strict=True))
    return max(0.0, float(max(depths)))


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
