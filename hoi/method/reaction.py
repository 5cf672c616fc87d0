"""The person answers what it strikes. The paper leaves that out: "the human does not respond to reaction forces"."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hoi.body.dynamics import Person
from hoi.body.limb_collider import Ready
from hoi.body.pushing import Pushing
from hoi.data import Contact, Motion, Scene
from hoi.reports import Stage

UNMOVED = 0.001
"""Where no part of a person is moved by more than this, its answer is left out [m]."""


@dataclass(frozen=True)
class Muscles:
    """How a person takes a blow."""

    one_piece: float
    """s: share of a blow that a limb takes in one piece [-], see `hoi.body.articulated.Articulated.mobility`."""
    recovery: float
    """Time to make good 95% of a small push [s]."""


def person_at(scene: Scene, motion: Motion, time: float, muscles: Muscles) -> Person:
    """The person of a scene, from `time` [s] of its motion on.

    Raises:
        RunError: it has no volume.
    """
    gravity = max(-float(scene.gravity[2]), 0.0)
    return Person(scene.body, motion, start=time, gravity=gravity, **vars(muscles))


def pushing(scene: Scene, motion: Motion, ready: Ready, muscles: Muscles, friction: float) -> Pushing:
    """The person from where capsules are ready on, which take the opposite of what they give.

    Args:
        friction: Coulomb coefficient between limbs and object [-].

    Raises:
        RunError: it has no volume.
    """
    person = person_at(scene, motion, float(ready.times[0]), muscles)
    return Pushing(person, ready.capsules, ready.radii, friction)


def react(person: Person, contacts: Sequence[Contact], stage: Stage) -> Motion:
    """The person's motion after it took the opposite of what each contact gave the object, at the person's time."""
    parts, before = person.parts, person.rates
    energy = person.kinetic_energy()
    for contact in contacts:
        person.push(contact.joint, contact.point, -contact.impulse)
    stage.numbers["person_energy"] = person.kinetic_energy() - energy
    fastest = max(
        np.linalg.norm(parts.jacobian(j, parts.data.xpos[i])[:3] @ (person.rates - before))
        for j, i in parts.part.items()
    )
    # A critically damped deviation that starts at a speed v goes no further than v / (e omega).
    moved = float(fastest) / (np.e * person.frequency)
    stage.numbers["person_moved"] = moved
    if moved < UNMOVED:
        stage.notes.append(f"the person's answer is left out: it would move by {1000 * moved:.2f} mm at most")
        return person.motion
    return follow(person, stage)


def follow(person: Person, stage: Stage) -> Motion:
    """The motion from the person's time on, frame by frame until it is back on what it was told."""
    fps = person.motion.fps
    for frame in range(int(person.time * fps + 1e-9) + 1, len(person.motion)):
        person.advance(frame / fps - person.time)
        if person.settled:
            break
    return _made(person, stage)


def pushed_back(
    scene: Scene, motion: Motion, pushing: Pushing, contact: Contact, muscles: Muscles, stage: Stage
) -> tuple[Motion, Contact]:
    """The motion after a push that the person took part in, and the contact with the mass that the object met."""
    person = pushing.person
    struck = person_at(scene, motion, contact.frame / scene.fps, muscles)
    limb = 1 / struck.inverse_mass(contact.joint, contact.point, contact.normal)
    return _made(person, stage), replace(contact, limb_mass=limb)


def _made(person: Person, stage: Stage) -> Motion:
    stage.numbers["person_work"] = person.work
    stage.numbers["person_back"] = person.time * person.motion.fps
    stage.numbers.update(zip(("ground_x", "ground_y", "ground_z"), person.ground_impulse.tolist(), strict=True))
    return person.motion_made()
