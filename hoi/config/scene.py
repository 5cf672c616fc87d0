"""Who does what to what, and where: placement, walls, prompts."""

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from hoi.config.choices import Approach, PlaneContact
from hoi.render import Ground


@dataclass
class PlacementConf:
    """The object at t = 0."""

    position: list[float | None] = MISSING
    """Centre of the object's bounding box [m]; a z of null puts it on the ground."""
    yaw: float = 0.0
    """Turn about Z [rad]."""
    orientation: list[float] = field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])
    """Turn before that: quaternion wxyz of any length [-]."""
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """Of the centre of mass [m/s]."""
    angular_velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """About the centre of mass [rad/s]."""


@dataclass
class PlaneConf:
    """A wall that the object cannot enter; see `hoi.data.Plane`."""

    point: list[float] = MISSING
    normal: list[float] = MISSING
    """Into the free side, of any length [-]."""
    contact: PlaneContact = PlaneContact.coulomb
    friction: float | None = None
    """Coulomb coefficient [-]; null takes material.ground_friction."""


@dataclass
class ActConf:
    """A sentence of the person's timeline."""

    prompt: str = MISSING
    """What they do."""
    start: float = MISSING
    """From when [s] ..."""
    end: float = MISSING
    """... to when [s]."""
    parts: list[str] = field(default_factory=list)
    """Body parts that do it: left_arm, right_arm, legs, head, spine; empty: all that no other act of the time has."""
    strikes: str | None = None
    """The limb that strikes the object; auto: the one that the sentence names; null: none does."""
    at: float | None = None
    """t*: when it strikes [s]; null: when it is fastest, and the object comes."""
    sends: list[float] | None = None
    """Which way it pushes the object, a vector of any length: it meets the other side of it [-]; null: along the
    strike."""
    tempo: float = 1.0
    """How many times as fast as the motion prior's the strike is, beside scene.tempo [-]."""
    flesh: float | None = None
    """What the limb leaves of the material's restitution: 0 gives way, as a foot that stops a ball [-]; null:
    stage.contact.flesh."""


@dataclass
class SceneConf:
    """Who does what to what, and where."""

    name: str = MISSING
    """Of the folder and the row in tables."""
    motion_prompt: str = MISSING
    """p_motion: what the person does."""
    acts: list[Any] = field(default_factory=list)
    """The person's timeline: sentences with times, put together as one motion, each as `hoi.config.scene.ActConf`;
    motion_prompt then only names it. Empty: motion_prompt from the first frame to the last."""
    scene_prompt: str = MISSING
    """p_scene, for the video prior."""
    negative_prompt: str = MISSING
    """What the video prior is guided away from."""
    frames: int = MISSING
    """T."""
    fps: float = MISSING
    """Frame rate [1/s]."""
    gravity: list[float] = MISSING
    """Acceleration [m/s^2]."""
    ground: bool = True
    """Whether the half-space z < 0 is solid, with the material's ground_friction."""
    planes: list[PlaneConf] | None = None
    """Walls beside the ground."""
    setting: Ground = Ground.gym
    """What the ground looks like in pictures."""
    placement: PlacementConf = field(default_factory=PlacementConf)
    approach: Approach = Approach.step
    """The person is placed and turned such that the strike ends at the object, and steps in (step) or stays where they
    are (stand); none: they start at the origin facing +Y, wherever the object is. Who has no motion prior and so does
    not move yet faces the object, within reach of it."""
    meeting_height: float | None = None
    """At which the strike waits to meet an object that rises or falls [m]; null: at which it ends by itself."""
    contacts: int | None = None
    """How many contacts that push are answered, one after the other; null: one, as in the paper, with acts all of them
    up to T."""
    tempo: float = 1.0
    """How many times as fast as the motion prior's the strike is, by a time warp around t* [-]."""
    striking_limb: str | None = None
    """The limb that j* is chosen from; auto: the one that the sentence names, or that strikes in a motion file; null:
    all joints, as the paper has it."""
    striking_joints: list[str] | None = None
    """Joints that push together, such as [left_hand, right_hand]: each has a place of its own on the face that the push
    goes through, and the person stands square to it; null: j* strikes alone, as in the paper."""
    hold: float = 0.0
    """How long after t* these stay on the object [s]."""
    expected_limb: str = MISSING
    """What a person should see strike; reported against what did. auto: what the sentence names; any: none named."""
    contact_joint: str = MISSING
    """j* where no motion shows it (w/o MDM); auto: of the limb that the sentence names."""
    contact_frame: int = MISSING
    """t* where no motion shows it (w/o MDM)."""
