"""What a record says about a run: one documented function a number, with its unit and which way is better. No torch.

All come from the record alone. Geometry (gaps, depths, volumes, touches) is measured on the recorded motion and
particles in the same way for every system; what a run says of itself is used only where nothing else knows it
(t_c, j_c, V_post, seconds). A number that a run does not define is NaN, never 0.
"""

from . import camera, contact, cost, dynamics, evaluator, flight, penetration, person
from .metric import Metric

CONTACT, OBJECT, PERSON, DYNAMICS, CAMERA, COST = "Contact", "Object", "Person", "Dynamics", "Camera", "Cost"

_ALL = (
    Metric("contact_any", "contact, any limb", "-", "higher", contact.touched, CONTACT),
    Metric("contact_expected", "contact, expected limb", "-", "higher", contact.expected_limb, CONTACT),
    Metric("gap", "gap at t_c", "m", "lower", contact.contact_gap, CONTACT),
    Metric("touching", "touching at t_c", "-", "higher", contact.touching_fraction, CONTACT),
    Metric("timing", "|t_c - t*|", "s", "lower", contact.timing_error, CONTACT),
    Metric("depth", "person in object, deepest", "m", "lower", penetration.person_object_depth, CONTACT),
    Metric("volume", "person in object, volume", "L", "lower", penetration.person_object_volume, CONTACT),
    Metric("causality", "causality error", "m/s", "lower", flight.causality_error, CONTACT),
    Metric("v_in", "v_in", "m/s", "", contact.closing_speed, CONTACT),
    Metric("ghosting", "strays before contact", "m", "lower", flight.ghosting, OBJECT),
    Metric("v_post_formula", "V_post off the formula", "-", "lower", contact.formula_error, OBJECT),
    Metric("v_post", "velocity off V_post", "-", "lower", contact.post_impact_error, OBJECT),
    Metric("momentum", "momentum given vs taken", "-", "lower", contact.momentum_error, OBJECT),
    Metric("energy_gain", "energy from nowhere", "-", "lower", flight.energy_gain, OBJECT),
    Metric("ballistic", "ballistic residual", "m", "lower", flight.ballistic_residual, OBJECT),
    Metric("bend", "bend of the path", "-", "", flight.bend, OBJECT),
    Metric("deformation", "deformation at impact", "-", "", flight.deformation, OBJECT),
    Metric("object_ground_depth", "object in ground, deepest", "m", "lower", penetration.object_ground_depth, OBJECT),
    Metric("object_ground_volume", "object in ground, volume", "L", "lower", penetration.object_ground_volume, OBJECT),
    Metric("object_path", "object's path", "m", "", flight.object_path, OBJECT),
    Metric("naturalness", "distance to real motion", "-", "lower", evaluator.naturalness, PERSON),
    Metric("alignment", "text alignment", "-", "higher", evaluator.text_alignment, PERSON),
    Metric("skating", "foot skating", "m/s", "lower", person.foot_skating, PERSON),
    Metric("jerk", "jerk", "m/s^3", "lower", person.jerk, PERSON),
    Metric("joint_limits", "beyond joint limits", "-", "lower", person.joint_limits, PERSON),
    Metric("feet_depth", "feet in ground, deepest", "m", "lower", penetration.feet_ground_depth, PERSON),
    Metric("feet_volume", "feet in ground, volume", "L", "lower", penetration.feet_ground_volume, PERSON),
    Metric("momentum_gap", "momentum from nowhere", "N s", "lower", dynamics.momentum_gap, DYNAMICS),
    Metric("momentum_gap_share", "momentum from nowhere", "%", "lower", dynamics.momentum_gap_share, DYNAMICS),
    Metric("root_force", "force from nowhere", "N", "lower", dynamics.root_force, DYNAMICS),
    Metric("root_force_95", "force from nowhere, 95%", "N", "lower", dynamics.root_force_high, DYNAMICS),
    Metric("root_torque", "torque from nowhere", "N m", "lower", dynamics.root_torque, DYNAMICS),
    Metric("root_torque_95", "torque from nowhere, 95%", "N m", "lower", dynamics.root_torque_high, DYNAMICS),
    Metric("beyond_strength", "joints beyond strength", "-", "lower", dynamics.beyond_strength, DYNAMICS),
    Metric("strain", "largest torque over strength", "-", "lower", dynamics.greatest_strain, DYNAMICS),
    Metric("framed", "limb and object in the picture", "-", "higher", camera.framed, CAMERA),
    Metric("contact_in_picture", "contact in the picture at t_c", "-", "higher", camera.contact_in_picture, CAMERA),
    Metric("contact_seen", "contact not hidden at t_c", "-", "higher", camera.contact_seen, CAMERA),
    Metric("seconds", "run", "s", "lower", cost.seconds, COST),
    Metric("memory", "peak memory", "MB", "lower", cost.peak_memory, COST),
    Metric("left_out", "MPM steps left out", "-", "higher", cost.left_out, COST),
    *(
        Metric(f"seconds_{stage.replace(' ', '_')}", stage, "s", "lower", cost.stage_seconds(stage), COST)
        for stage in cost.STAGES
    ),
)

METRICS: dict[str, Metric] = {metric.key: metric for metric in _ALL}

GROUPS = (CONTACT, OBJECT, PERSON, DYNAMICS, CAMERA, COST)
"""The tables that the metrics stand in."""
