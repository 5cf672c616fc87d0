"""Experiments with people of which the world knows the outcome: what they weigh, kick, punch and push.

The rows of people on the page against reality (`analysis.reality`); runs of the scenes as they are, without stage 3.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from hoi import api
from hoi.body.mass import masses_of
from hoi.body.people import load_person
from hoi.body.skeleton import CHAINS
from hoi.body.skinning import posed_means, stand_motion
from hoi.body.strength import SOLE_FRICTION
from hoi.data import Array, Contact, Run
from hoi.errors import RunError

from .experiments import GRAVITY, Experiment
from .posing import joint_frames

KICK = "scene=kick_soccer_ball"


@cache
def struck(*overrides: str) -> tuple[Run, Contact]:
    """A run, and the contact that gave the object an impulse.

    Raises:
        RunError: nothing did.
    """
    run = api.run(api.compose("render=none", "stage/refine=none", *overrides))
    contact = None if run.state.contact is None else run.state.contact.push
    if contact is None:
        raise RunError(f"{' '.join(overrides)}: nothing was struck")
    return run, contact


def share_of(limb: str, name: str = "man") -> float:
    """A limb's share of a person's weight [-]."""
    mass = masses_of(load_person(name)).mass
    return float(mass[list(CHAINS[limb])].sum() / mass.sum())


def height_of_centre(name: str = "man") -> float:
    """Of the centre of mass of a person who stands, over the person's height [-]."""
    body = load_person(name)
    masses, stand = masses_of(body), stand_motion(body, 1, 20.0)
    turns, joints = joint_frames(body, stand)
    centres = joints[0] + np.einsum("kij,kj->ki", turns[0], masses.centre - np.asarray(body.rest_joints, np.float64))
    skin = posed_means(body, stand)[0, :, 2]
    return float((masses.mass @ centres[:, 2] / masses.mass.sum() - skin.min()) / np.ptp(skin))


def ball_over_foot(*overrides: str) -> float:
    """Speed of the ball after a kick over that of the foot before it [-]."""
    _, contact = struck(*overrides)
    return _size(contact.v_post) / _size(contact.v_human)


def contact_time(*overrides: str) -> float:
    """From the first to the last push [ms]."""
    return 1e3 * struck(*overrides)[1].duration


def effective_mass(*overrides: str) -> float:
    """Of the struck point of the person [kg]."""
    return struck(*overrides)[1].limb_mass


def push_force(*overrides: str) -> float:
    """The mean force of a push along the ground [N]."""
    _, contact = struck(*overrides)
    return _size(contact.impulse[:2]) / contact.duration


def push_over_friction(*overrides: str) -> float:
    """The same over what the soles could hold of the person's weight [-]."""
    scene = struck(*overrides)[0].scene
    assert scene is not None
    return push_force(*overrides) / (SOLE_FRICTION * float(masses_of(scene.body).mass.sum()) * GRAVITY)


def _size(vector: Array) -> float:
    return float(np.linalg.norm(vector))


SEGMENTS = "Dempster 1955 (in Winter 2009) and de Leva 1996, J. Biomech. 29"
RATIO = "Kellis and Katis 2007, J. Sports Sci. Med. 6, Biomechanical characteristics of the instep soccer kick"
EXPERIMENTS: Sequence[Experiment] = (
    Experiment("a man's leg over his weight", "-", (0.161, 0.199), SEGMENTS, lambda: share_of("right leg"), 0.05),
    Experiment("a man's arm over his weight", "-", (0.049, 0.050), SEGMENTS, lambda: share_of("right arm"), 0.05),
    Experiment("height of a standing man's centre of mass over his own", "-", (0.55, 0.58),
               "Winter 2009, Biomechanics and Motor Control of Human Movement", height_of_centre),
    Experiment("football kick as an impulse, ball over foot speed", "-", (1.2, 1.35), RATIO,
               lambda: ball_over_foot(KICK)),
    Experiment("football kick by the limb's capsules, ball over foot speed", "-", (1.2, 1.35), RATIO,
               lambda: ball_over_foot(KICK, "stage/contact=collider")),
    Experiment("football kick by the limb's capsules, contact time", "ms", (9.0, 10.0),
               "Shinkai et al. 2009, Med. Sci. Sports Exerc. 41, Ball impact dynamics of instep soccer kicking",
               lambda: contact_time(KICK, "stage/contact=collider"), 0.1),
    Experiment("effective mass of a man's kicking foot", "kg", (1.1, 4.5),
               "between his foot alone and foot and shank, de Leva 1996", lambda: effective_mass(KICK)),
    Experiment("effective mass of a straight punch", "kg", (0.9, 4.9),
               "Walilko, Viano and Bir 2005, Br. J. Sports Med. 39: 2.9 (SD 2.0) kg",
               lambda: effective_mass("scene=punch_jelly")),
    Experiment("mean force of a standing man's push on a cabinet", "N", (200.0, 490.0),
               "MIL-STD-1472, horizontal push: 200 N at a friction of 0.6 to 490 N braced",
               lambda: push_force("scene=push_file_cabinet")),
    Experiment("the same over what his soles can hold", "-", (0.0, 1.0), "Coulomb friction of 0.8",
               lambda: push_over_friction("scene=push_file_cabinet")),
)  # fmt: skip
