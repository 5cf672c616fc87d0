"""What a record says about a run: one documented function a number, with its unit and which way is better. No torch.

All come from the record alone. Geometry (gaps, depths, volumes, touches) is measured on the recorded motion and
particles in the same way for every system; what a run says of itself is used only where nothing else knows it
(t_c, j_c, V_post, seconds). A number that a run does not define is NaN, never 0.
"""

from .contact import (
    closing_speed,
    contact_gap,
    expected_limb,
    formula_error,
    momentum_error,
    post_impact_error,
    timing_error,
    touched,
    touching_fraction,
)
from .cost import STAGES, left_out, peak_memory, seconds, stage_seconds
from .evaluator import naturalness, text_alignment
from .flight import (
    ballistic_residual,
    bend,
    causality_error,
    deformation,
    energy_gain,
    ghosting,
    object_path,
)
from .metric import Metric
from .penetration import (
    feet_ground_depth,
    feet_ground_volume,
    object_ground_depth,
    object_ground_volume,
    person_object_depth,
    person_object_volume,
)
from .person import foot_skating, jerk, joint_limits

CONTACT, OBJECT, PERSON, COST = "Contact", "Object", "Person", "Cost"

_ALL = (
    Metric("contact_any", "contact, any limb", "-", "higher", touched, CONTACT),
    Metric("contact_expected", "contact, expected limb", "-", "higher", expected_limb, CONTACT),
    Metric("gap", "gap at t_c", "m", "lower", contact_gap, CONTACT),
    Metric("touching", "touching at t_c", "-", "higher", touching_fraction, CONTACT),
    Metric("timing", "|t_c - t*|", "s", "lower", timing_error, CONTACT),
    Metric("depth", "person in object, deepest", "m", "lower", person_object_depth, CONTACT),
    Metric("volume", "person in object, volume", "L", "lower", person_object_volume, CONTACT),
    Metric("causality", "causality error", "m/s", "lower", causality_error, CONTACT),
    Metric("v_in", "v_in", "m/s", "", closing_speed, CONTACT),
    Metric("ghosting", "strays before contact", "m", "lower", ghosting, OBJECT),
    Metric("v_post_formula", "V_post off the formula", "-", "lower", formula_error, OBJECT),
    Metric("v_post", "velocity off V_post", "-", "lower", post_impact_error, OBJECT),
    Metric("momentum", "momentum given vs taken", "-", "lower", momentum_error, OBJECT),
    Metric("energy_gain", "energy from nowhere", "-", "lower", energy_gain, OBJECT),
    Metric("ballistic", "ballistic residual", "m", "lower", ballistic_residual, OBJECT),
    Metric("bend", "bend of the path", "-", "", bend, OBJECT),
    Metric("deformation", "deformation at impact", "-", "", deformation, OBJECT),
    Metric("object_ground_depth", "object in ground, deepest", "m", "lower", object_ground_depth, OBJECT),
    Metric("object_ground_volume", "object in ground, volume", "L", "lower", object_ground_volume, OBJECT),
    Metric("object_path", "object's path", "m", "", object_path, OBJECT),
    Metric("naturalness", "distance to real motion", "-", "lower", naturalness, PERSON),
    Metric("alignment", "text alignment", "-", "higher", text_alignment, PERSON),
    Metric("skating", "foot skating", "m/s", "lower", foot_skating, PERSON),
    Metric("jerk", "jerk", "m/s^3", "lower", jerk, PERSON),
    Metric("joint_limits", "beyond joint limits", "-", "lower", joint_limits, PERSON),
    Metric("feet_depth", "feet in ground, deepest", "m", "lower", feet_ground_depth, PERSON),
    Metric("feet_volume", "feet in ground, volume", "L", "lower", feet_ground_volume, PERSON),
    Metric("seconds", "run", "s", "lower", seconds, COST),
    Metric("memory", "peak memory", "MB", "lower", peak_memory, COST),
    Metric("left_out", "MPM steps left out", "-", "higher", left_out, COST),
    *(
        Metric(f"seconds_{stage.replace(' ', '_')}", stage, "s", "lower", stage_seconds(stage), COST)
        for stage in STAGES
    ),
)

METRICS: dict[str, Metric] = {metric.key: metric for metric in _ALL}

GROUPS = (CONTACT, OBJECT, PERSON, COST)
"""The tables that the metrics stand in."""

__all__ = [
    "GROUPS",
    "METRICS",
    "Metric",
    "ballistic_residual",
    "bend",
    "causality_error",
    "closing_speed",
    "contact_gap",
    "deformation",
    "energy_gain",
    "expected_limb",
    "feet_ground_depth",
    "feet_ground_volume",
    "foot_skating",
    "formula_error",
    "ghosting",
    "jerk",
    "joint_limits",
    "left_out",
    "momentum_error",
    "naturalness",
    "object_ground_depth",
    "object_ground_volume",
    "object_path",
    "peak_memory",
    "person_object_depth",
    "person_object_volume",
    "post_impact_error",
    "seconds",
    "text_alignment",
    "timing_error",
    "touched",
    "touching_fraction",
]
