"""Whether, when and how well the person meets the object, and what that gives it."""

import math
from functools import lru_cache

import numpy as np

from hoi.body.parts import is_with, part_at
from hoi.body.skeleton import LIMBS
from hoi.data import Array, Contact
from hoi.frames import at_frame
from hoi.refine.fidelity import object_at

from ..records import Record, Undefined
from .meeting import Meeting, Shape, d_contact, meeting
from .metric import NAN


def push_of(record: Record) -> Contact | None:
    """The contact that gave an impulse; None when nothing did."""
    search = record.run.state.contact
    return None if search is None else search.push


def striking_joint(record: Record) -> int | None:
    """j_c; where no contact was looked for, the joint whose skin touches first. None where nothing struck."""
    if record.run.state.contact is not None:
        push = push_of(record)
        return None if push is None else push.joint
    met = meeting(record)
    return None if met is None or met.first is None else int(met.joint[met.first])


def touched(record: Record) -> float:
    """1 when a contact pushed the object, or any of the person's skin comes within d_contact of its surface; 0 when
    neither is so."""
    met = meeting(record)
    if push_of(record) is not None:
        return 1.0
    return NAN if met is None else float(met.first is not None)


def expected_limb(record: Record) -> float:
    """1 when the limb that struck is the one that the scene expects, 0 when another did or nothing struck. What struck
    is the contact that pushed the object; where none was looked for (w/o Contact, other systems), the first touch."""
    expected, search = str(record.conf("scene", "expected_limb", default="")), record.run.state.contact
    met = meeting(record) if search is None else None
    if expected not in LIMBS or (search is None and met is None):
        return NAN
    joint = striking_joint(record)
    if joint is None or joint == -1:
        return 0.0 if joint is None else NAN
    if search is not None and search.push is not None:
        return float(is_with(expected, joint, search.push.part))
    assert met is not None and met.first is not None
    joints, frame = record.joints, met.frames[met.first]
    part = "" if joints is None else part_at(joint, met.skin[met.first], at_frame(joints, frame))
    return float(is_with(expected, joint, part))


def contact_gap(record: Record) -> float:
    """Distance of the striking joint's skin from the object's surface at t_c; 0 where it touches or enters. Where
    nothing struck, the smallest distance between person and object over the whole run."""
    struck = _at_contact(record)
    if struck is not None:
        return max(0.0, float(struck.min()))
    search, met = record.run.state.contact, meeting(record)
    if met is not None and np.isfinite(met.gap).any():
        return float(met.gap.min())
    if search is not None:
        return search.smallest_gap if np.isfinite(search.smallest_gap) else NAN
    return _smallest_distance(record)


def touching_fraction(record: Record) -> float:
    """Share of the striking joint's skin that is no farther than d_contact from the object's surface at t_c, in or
    out."""
    struck = _at_contact(record)
    return NAN if struck is None else float((np.abs(struck) <= d_contact(record)).mean())


def timing_error(record: Record) -> float:
    """|t_c - t*|: how far the contact is from the time at which the attraction wants it."""
    target = record.run.state.target
    return NAN if target is None else abs(record.push.frame - target.frame) / record.scene.fps


def closing_speed(record: Record) -> float:
    """v_in = (V_human - V_obj) . n at contact."""
    return record.push.v_in


def formula_error(record: Record) -> float:
    """Deviation of an impulse's recorded V_post from V_obj + (1 + e) v_in n mu / m, relative to it (paper, Contact
    Detection and Re-simulation). mu is the reduced mass of limb and object along n, 1 / mu = 1 / m_eff + 1 / m + what
    the recorded spin adds; without either, as in the paper, m. e is the material's, less what a limb of flesh takes.
    All from the record; empty for a push that lasts."""
    push, scene = record.push, record.scene
    if push.duration > 0:
        return NAN
    mass, given = float(scene.thing.masses.sum()), float(np.linalg.norm(push.impulse))
    arm = push.point - at_frame(record.trajectory.com, push.frame)
    spin = float(np.cross(arm, push.normal) @ push.spin) / given if given > 0 else 0.0
    share = 1 / mass / (1 / push.limb_mass + 1 / mass + spin)
    flesh = 1.0 if push.limb_mass == math.inf else float(record.conf("stage", "contact", "flesh", default=1.0))
    restitution = flesh * scene.thing.material.restitution
    expected = push.v_object + (1 + restitution) * max(push.v_in, 0.0) * share * push.normal
    size = float(np.linalg.norm(expected))
    return NAN if size == 0 else float(np.linalg.norm(push.v_post - expected)) / size


def post_impact_error(record: Record) -> float:
    """Deviation of the velocity of the object's centre of mass from V_post, 1 ms into the re-simulation, relative to
    V_post: what the physics makes of the impulse it is given."""
    reports = record.run.reports
    numbers = next((report.numbers for report in reports if report.stage == "resimulate"), {})
    return numbers.get("v_post_error", NAN)


def momentum_error(record: Record) -> float:
    """Momentum that the contact gave the object against what the object has more, from the last whole frame before the
    push to the first after it, gravity taken off: |given - taken| / |given|. Ground and friction take their share."""
    push, scene, (before, after) = record.push, record.scene, frames_around(record)
    given = float(np.linalg.norm(push.impulse))
    if given == 0:
        return NAN
    velocity, weight = record.trajectory.com_velocity, scene.gravity * (after - before) / scene.fps
    taken = float(scene.thing.masses.sum()) * (velocity[after] - velocity[before] - weight)
    return float(np.linalg.norm(push.impulse - taken)) / given


def pushes_of(record: Record) -> list[tuple[float, float, Array]]:
    """First and last frame of each push, fractional, and what it gave the object [N s], (3,)."""
    search, scene, span = record.run.state.contact, record.run.scene, push_span(record)
    if search is None or search.push is None or scene is None or span is None:
        return []
    several = [(push.start * scene.fps, push.end * scene.fps, push.impulse) for push in search.pushes]
    return several or [(*span, search.push.impulse)]


def push_span(record: Record) -> tuple[float, float] | None:
    """First and last frame of the push, fractional; equal for an impulse, None where nothing pushed. A limb that pushes
    for a while begins before t_c, when its capsules first touch."""
    push, scene = push_of(record), record.run.scene
    if push is None or scene is None:
        return None
    for report in record.run.reports:
        if {"pushed_from", "pushed_until"} <= report.numbers.keys():
            return report.numbers["pushed_from"], report.numbers["pushed_until"]
    return push.frame, push.frame + push.duration * scene.fps


def frames_around(record: Record) -> tuple[int, int]:
    """The last whole frame before the push and the first after it; undefined without a push, or when the run ends
    before."""
    span = push_span(record)
    if span is None:
        raise Undefined
    before, after = max(math.ceil(span[0]) - 1, 0), math.ceil(span[1])
    if after >= len(record.trajectory.com) or after <= before:
        raise Undefined
    return before, after


def first_touch(record: Record) -> tuple[float, Meeting | None]:
    """The frame at which the person may first move the object, the push or the first touch, whichever is earlier;
    infinity when there is neither. And how they meet."""
    met, span = meeting(record), push_span(record)
    found = [] if span is None else [span[0]]
    if met is not None and met.first is not None:
        found.append(float(met.frames[met.first]))
    return min(found, default=math.inf), met


@lru_cache(maxsize=2)
def _at_contact(record: Record) -> Array | None:
    """Signed distances of the striking joint's skin to the object at t_c [m], (M,); None where nothing struck."""
    run, skin, joints = record.run, record.skin, record.skin_joints
    scene, trajectory, push = run.scene, run.state.trajectory, push_of(record)
    if push is None or scene is None or trajectory is None or skin is None or joints is None:
        return None
    rows, frame = joints == push.joint, min(push.frame, len(trajectory.positions) - 1.0)
    if not rows.any() or len(trajectory.positions) < 2:
        return None
    return Shape(scene.thing).distance(object_at(trajectory, push, scene.fps, frame), at_frame(skin, frame)[rows])


def _smallest_distance(record: Record) -> float:
    """Between skin and object Gaussians at whole frames [m], of every eighth of each: for systems that never touch."""
    from scipy.spatial import KDTree

    scene, trajectory, skin = record.run.scene, record.run.state.trajectory, record.skin
    if scene is None or trajectory is None or skin is None or not len(scene.thing.cloud):
        return NAN
    surface = trajectory.positions[:, : len(scene.thing.cloud) : 8]
    return min(float(KDTree(now).query(person[::8])[0].min()) for now, person in zip(surface, skin, strict=False))
