"""The frozen types that flow from stage to stage. NumPy only, so that reading a record needs no torch.

Conventions, everywhere: SI units, Z up, right-handed, ground at z = 0, radians. Quaternions are wxyz and unit.
A person who stands is at the origin and faces +Y. `frame` is an index at the scene's frame rate (fractional between
frames), `time` is in seconds, `step` an MPM substep, `iteration` an optimiser iteration.
"""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoi.errors import InputError

Array = NDArray[np.floating[Any]]


def fields_of(owner: Any) -> dict[str, Any]:
    """The fields of a dataclass as they are, by name."""
    return {f.name: getattr(owner, f.name) for f in fields(owner)}


@dataclass(frozen=True)
class GaussianCloud:
    """3D Gaussians G_i (paper, Scene Representation)."""

    means: Array
    """Centres x_i [m], shape (N, 3)."""
    quaternions: Array
    """Unit rotations wxyz, shape (N, 4)."""
    scales: Array
    """Standard deviations along the rotated axes [m], shape (N, 3). Sigma = R diag(scales^2) R^T."""
    opacities: Array
    """Opacity in [0, 1], shape (N,)."""
    sh: Array
    """Spherical-harmonics colour coefficients, shape (N, K, 3), K in {1, 4, 9, 16}; see `hoi.gaussians`."""
    surface: Array | None = None
    """Of the surface that each lies on: its unit normal, and the mean direction of what of the sky is open, as long
    as that share, both in the frame of `means`, shape (N, 2, 3). Colours are albedo then, and light is computed
    (`hoi.render.light`); None: the light is in the colours, as it is in captures."""

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class Body:
    """A person: Gaussians in the T-pose, bound to the 24 SMPL joints.

    Rest frame as SMPL's: y up, facing +z, the body's left at +x, metres.
    """

    name: str
    cloud: GaussianCloud
    skinning_weights: Array
    """w_ik, shape (N, 24), rows sum to 1."""
    rest_joints: Array
    """T-pose joint positions [m], shape (24, 3)."""
    source: str = ""
    """Where it comes from and under which licence."""
    pose_directions: Array | None = None
    """Pose blend shapes: what each entry of R_j - I (joints 1..23, row-major) adds to the T-pose centres [m], shape
    (N, 3, 207); None where posing is skinning alone."""

    @cached_property
    def dominant_joints(self) -> NDArray[np.intp]:
        """The joint that moves each Gaussian most, argmax_k w_ik, shape (N,)."""
        return self.skinning_weights.argmax(axis=1)


@dataclass(frozen=True)
class Motion:
    """X = {(r, omega, theta)} (paper, Human Motion Score Distillation)."""

    translation: Array
    """World position of the pelvis *joint* r [m], shape (T, 3)."""
    orientation: Array
    """omega: first two rows of the pelvis rotation, which maps the rest frame to the world, shape (T, 6)."""
    body_pose: Array
    """theta: axis-angle of joints 1..23 relative to their parents [rad], shape (T, 23, 3)."""
    fps: float

    def __len__(self) -> int:
        return len(self.translation)


@dataclass(frozen=True)
class Material:
    """What the object is made of."""

    name: str
    model: str
    """Constitutive model, see `hoi.mpm`."""
    youngs_modulus: float
    """Young's modulus E [Pa]."""
    poisson_ratio: float
    """Poisson's ratio nu [-]."""
    density: float
    """Density rho [kg/m^3]."""
    restitution: float
    """Coefficient of restitution e of the impulse [-]."""
    ground_friction: float
    """Coulomb coefficient against the ground [-]."""
    yield_stress: float = math.inf
    """Stress at which a plastic solid flows [Pa]."""
    hardening: float = 0.0
    """How much flowing hardens it [-]; what it means depends on the model."""
    viscosity: float = 0.0
    """Of the plastic flow or of the fluid [Pa s]."""
    friction_angle: float = 0.0
    """Of grains against each other [rad]."""
    critical_compression: float = 0.0
    """Snow: a singular value of F below 1 minus this has broken [-]."""
    critical_stretch: float = 0.0
    """Snow: a singular value of F above 1 plus this has broken [-]."""


@dataclass(frozen=True)
class Plane:
    """A solid half-space: the ground or a wall."""

    point: Array
    """A point of its surface [m], shape (3,)."""
    normal: Array
    """Unit normal into the free side, shape (3,)."""
    contact: str = "coulomb"
    """"coulomb", "slip" (no friction) or "stick" (nothing slides)."""
    friction: float = 0.0
    """Coulomb coefficient, for contact "coulomb" [-]."""


@dataclass(frozen=True)
class SceneObject:
    """The object at t = 0, in the world frame. Its Gaussians are the first particles; the rest fill the interior."""

    name: str
    cloud: GaussianCloud
    particles: Array
    """Particle positions [m], shape (P, 3); rows 0..N-1 are `cloud.means`."""
    volumes: Array
    """Rest volume of each particle [m^3], shape (P,); they sum to the object's volume."""
    material: Material
    velocity: Array
    """Initial linear velocity of the centre of mass [m/s], shape (3,)."""
    angular_velocity: Array
    """Initial angular velocity about the centre of mass [rad/s], shape (3,)."""
    size: float
    """Largest extent [m]."""
    notes: tuple[str, ...] = ()
    """What loading did to it: Gaussians dropped, filled, and why."""
    other_materials: tuple[Material, ...] = ()
    """Materials of its other regions."""
    drawn: GaussianCloud | None = None
    """What is shown of it where that is more than `cloud`: carried by the particles, see `hoi.objects.carrying`."""
    region: NDArray[np.int32] | None = None
    """Index of each particle's material in `materials`, shape (P,); None: all of `material`."""

    @property
    def materials(self) -> tuple[Material, ...]:
        """All materials; `material` is the first, and the one whose restitution an impulse takes."""
        return (self.material, *self.other_materials)

    @property
    def masses(self) -> Array:
        """Particle masses [kg], shape (P,)."""
        densities = np.array([material.density for material in self.materials])
        return self.volumes * (densities[0] if self.region is None else densities[self.region])


@dataclass(frozen=True)
class Act:
    """A sentence of a timeline: what a person does from when to when."""

    prompt: str
    start: float
    end: float
    """[s]"""
    parts: tuple[str, ...] = ()
    """Of `hoi.motion.features.PARTS`, those that it moves; empty: all that no other act of the time moves."""
    strikes: str = ""
    """The limb that strikes the object; empty where none does."""
    at: float = math.nan
    """t* [s]; NaN: when that limb is fastest."""
    sends: tuple[float, ...] = ()
    """Unit vector along which it is to push the object, (3,); empty: along its own strike."""
    tempo: float = 1.0
    """How many times as fast as the motion prior's the strike is [-]."""
    flesh: float = math.nan
    """What the limb leaves of the material's restitution [-]: 0 gives way, as one that stops a ball; NaN: the contact
    model's."""


@dataclass(frozen=True)
class Scene:
    """Everything fixed before the first stage."""

    name: str
    body: Body
    object: SceneObject | None
    """None where a person is alone."""
    motion_prompt: str
    frames: int
    """T."""
    fps: float
    gravity: Array
    """[m/s^2], shape (3,)."""
    planes: tuple[Plane, ...] = ()
    """What the object cannot enter: the ground first, then walls."""
    setting: str = "plain"
    """What the ground looks like, see `hoi.render.places`."""
    acts: tuple[Act, ...] = ()
    """The person's timeline; empty: `motion_prompt` from the first frame to the last."""

    @property
    def strikes(self) -> tuple[Act, ...]:
        """The acts that strike the object, in the order of time."""
        return tuple(sorted((act for act in self.acts if act.strikes), key=lambda act: act.start))

    @property
    def thing(self) -> SceneObject:
        """The object of a scene that has one."""
        assert self.object is not None
        return self.object


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole. Axes as OpenCV's: x right, y down, z forward; the middle of the first pixel is (0.5, 0.5).

    Two cameras are equal only when they are the same object.

    Raises:
        InputError: a size, focal length or near plane is not positive, or the pose is not rigid.
    """

    width: int
    height: int
    fx: float
    """[pixel]"""
    fy: float
    cx: float
    """[pixel]"""
    cy: float
    world_to_camera: Array
    """Rigid, (4, 4), float64."""
    near: float = 0.01
    """What is closer is not drawn [m]."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if not isinstance(size, int) or size < 1:
                raise InputError(f"camera {name} {size!r}: a whole number of pixels from 1 is allowed")
        for name in ("fx", "fy", "near"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"camera {name} {value:g}: a positive number is allowed")
        if not (math.isfinite(self.cx) and math.isfinite(self.cy)):
            raise InputError(f"camera centre ({self.cx:g}, {self.cy:g}): finite numbers are allowed")
        pose = self.world_to_camera
        rigid = pose.shape == (4, 4) and np.isfinite(pose).all() and np.array_equal(pose[3], (0, 0, 0, 1))
        turn = pose[:3, :3]
        if not rigid or abs(turn @ turn.T - np.eye(3)).max() > 1e-6 or np.linalg.det(turn) < 0:
            raise InputError("camera world_to_camera: a rigid 4 x 4 matrix is allowed (rotation, translation, 0 0 0 1)")

    @property
    def position(self) -> Array:
        """In the world [m], (3,)."""
        return -self.world_to_camera[:3, 3] @ self.world_to_camera[:3, :3]

    @property
    def forward(self) -> Array:
        """Unit axis of view in the world, (3,)."""
        return self.world_to_camera[2, :3].copy()


@dataclass(frozen=True)
class ObjectState:
    """The MPM state of all particles at one instant."""

    positions: Array
    """x_p [m], shape (P, 3)."""
    velocities: Array
    """v_p [m/s], shape (P, 3)."""
    affine: Array
    """APIC velocity gradient C_p [1/s], shape (P, 3, 3)."""
    deformation_gradient: Array
    """F_p [-], shape (P, 3, 3): total for solids that flow, elastic for all others."""
    elastic: Array | None = None
    """F_E [-], shape (P, 3, 3), where it is not `deformation_gradient`: metal, clay, foam, snow."""
    hardening: Array | None = None
    """What the flow has left behind in each particle [-], shape (P,); see `hoi.mpm.laws`."""
    play: Array | None = None
    """Where each particle is in its hysteresis [-], shape (P,), where the solid loses energy; see `hoi.mpm.damping`."""


@dataclass(frozen=True)
class ObjectTrajectory:
    """The object over the frames 0..T-1 (frame t is time t / fps)."""

    positions: Array
    """All particles [m], shape (T, P, 3)."""
    com: Array
    """Centre of mass [m], shape (T, 3)."""
    com_velocity: Array
    """Velocity of the centre of mass [m/s], shape (T, 3)."""
    energy: Array
    """Kinetic, elastic and potential energy [J], shape (T, 3); potential is 0 at z = 0."""
    deformation_gradient: Array | None = None
    """F_p, shape (T, P, 3, 3); None where the mover has none (constant velocity)."""
    phase: tuple[str, ...] = ()
    """What moved the object in each frame: "rest", "mpm", "constant_velocity", ..."""


@dataclass(frozen=True)
class Target:
    """Where and when contact should happen: j*, t* (paper, Windowed Attraction Loss)."""

    joint: int
    frame: int
    chosen_by: str
    """"velocity profile" or "scene"."""
    joints: tuple[int, ...] = ()
    """Those that push together, j* among them; empty where j* strikes alone."""
    hold: int = 0
    """How long after t* they stay on the object [frames]."""
    way: tuple[float, ...] = ()
    """Unit vector along which j* is to push, (3,): it meets the object's other side; empty: along its own strike."""

    @property
    def striking(self) -> tuple[int, ...]:
        """All joints that should meet the object."""
        return self.joints or (self.joint,)

    def meeting_frame(self, frames: int) -> int:
        """The end of the strike's fastest step in a scene of `frames` frames.

        v_j*(t*) is the step from t* to t* + 1, and V_human looks one step back.
        """
        return min(self.frame + 1, frames - 1)


@dataclass(frozen=True)
class Contact:
    """One contact and the momentum transfer it causes (paper, Contact Detection and Re-simulation)."""

    frame: float
    """t_c, fractional when found between frames."""
    joint: int
    """j_c; -1 where the person has no joints (a mesh of another system)."""
    fraction: float
    """Share of the joint's Gaussians within d_contact of the object [-]."""
    point: Array
    """Mean position of the touching object Gaussians [m], shape (3,)."""
    normal: Array
    """n: unit, into the object, the touched surface's or towards the centre of mass, shape (3,)."""
    v_human: Array
    """V_human [m/s], shape (3,)."""
    v_object: Array
    """V_obj just before [m/s], of the centre of mass, shape (3,)."""
    v_in: float
    """(V_human - V_obj) . n [m/s]; not positive when separating."""
    v_post: Array
    """V_post [m/s], of the centre of mass, shape (3,): right after the impulse, or when the push is over; equal to
    `v_object` when nothing is given."""
    impulse: Array
    """Momentum given to the object [N s], shape (3,)."""
    gap: float
    """Smallest distance between the joint's Gaussians and the object's at t_c [m]."""
    duration: float = 0.0
    """From the first to the last push of the moving limb [s]; 0 for an impulse, which takes no time."""
    limb_mass: float = math.inf
    """m_eff, the effective mass of the struck point of the person along n [kg]; infinite where nothing stops it."""
    spin: Array = field(default_factory=lambda: np.zeros(3))
    """What an impulse off the centre of mass added to the object's angular velocity [rad/s], shape (3,)."""
    v_formula: Array = field(default_factory=lambda: np.full(3, math.nan))
    """The paper's V_post = V_obj + (1 + e) v_in n, of a limb that nothing stops [m/s], shape (3,)."""
    part: str = ""
    """What people call the skin that touches, such as "right_knee" where the skin above the kneecap goes with the hip
    j_c; empty where nothing says."""


@dataclass(frozen=True)
class Push:
    """What moving limbs gave the object while they stayed in touch."""

    start: float
    end: float
    """[s]"""
    impulse: Array
    """[N s], shape (3,)."""


@dataclass(frozen=True)
class ContactSearch:
    """The outcome of looking for contact, also when none is found."""

    contacts: tuple[Contact, ...]
    smallest_gap: float
    """Over all joints and frames [m]."""
    smallest_gap_frame: float
    smallest_gap_joint: int
    smallest_gap_part: str = ""
    """What people call the skin there, as `Contact.part`."""
    pushes: tuple[Push, ...] = ()
    """In the order of time, where limbs push for a while: that of `push`, and others."""

    @property
    def push(self) -> Contact | None:
        """The contact that gave an impulse; None when nothing did."""
        return next((contact for contact in self.contacts if contact.v_in > 0), None)

    @property
    def given(self) -> tuple[Contact, ...]:
        """The contacts that gave an impulse, in the order of time: `push` is the first."""
        return tuple(contact for contact in self.contacts if contact.v_in > 0 and contact.impulse.any())

    def with_push(self, contact: Contact, pushes: tuple[Push, ...] = ()) -> "ContactSearch":
        """The same with that contact in the place of its `push`."""
        contacts = tuple(contact if each is self.push else each for each in self.contacts)
        return replace(self, contacts=contacts, pushes=pushes)


@dataclass(frozen=True)
class State:
    """What the stages write, one after the other."""

    motion: Motion | None = None
    trajectory: ObjectTrajectory | None = None
    target: Target | None = None
    contact: ContactSearch | None = None
    later: tuple[Target, ...] = ()
    """Of the strikes after the first, in the order of time."""


@dataclass(frozen=True)
class Step:
    """One kept step of a plan."""

    name: str
    implementation: str
    reason: str


@dataclass(frozen=True)
class Omission:
    """One thing a plan leaves out, and what that saves."""

    what: str
    because: str
    saves: str


@dataclass(frozen=True)
class Check:
    """A number the plan worked out before the run (CFL, memory, ...)."""

    name: str
    value: str
    detail: str


@dataclass(frozen=True)
class Missing:
    """A file, folder, package or device that a kept step needs and that is not there."""

    key: str
    """Of the config, which asks for it."""
    what: str
    path: str
    """Where it was looked for; empty of a package or device."""
    size: str
    """Of the download; empty where it is none."""
    remedy: str
    """Where to get it, or what runs without it."""
    needed: bool = True
    """Whether nothing runs without it; else what is done instead stands in `remedy`."""

    def __str__(self) -> str:
        size = f" ({self.size})" if self.size else ""
        wanted = "" if self.needed else ", not necessary"
        where = f" at {self.path}" if self.path else ""
        return f"{self.key}: no {self.what}{size}{where}{wanted}; {self.remedy}"


@dataclass(frozen=True)
class Plan:
    variant: str
    """Label for tables, derived from the steps: "full", "no_mpm", "no_mpm+no_video_sds", ..."""
    steps: tuple[Step, ...]
    omissions: tuple[Omission, ...]
    checks: tuple[Check, ...]
    uses: tuple[str, ...] = ()
    """What the kept steps work with: "motion_prior"; before stage 2 "approach", which lets the object's place decide
    where the person starts; in stage 2 "hmsd" and "attraction"."""
    missing: tuple[Missing, ...] = ()
    """What the kept steps need and do not find."""

    def keeps(self, name: str) -> bool:
        """Whether the step of this name is kept."""
        return self.implementation(name) is not None

    def implementation(self, name: str) -> str | None:
        """What does the step of this name; None where it is left out."""
        return next((step.implementation for step in self.steps if step.name == name), None)


@dataclass(frozen=True)
class StageReport:
    """How one step went."""

    stage: str
    seconds: float
    iterations: int = 0
    numbers: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Run:
    """A whole run: exactly what `hoi.record` writes and reads."""

    config_yaml: str
    provenance: dict[str, str]
    """Seed, config hash, git commit, versions, device, threads, input hashes, command line, start time."""
    result: dict[str, str]
    """status ("done" | "failed"), outcome, total seconds, peak memory, ..."""
    plan: Plan
    reports: tuple[StageReport, ...]
    history: tuple[dict[str, float | str], ...]
    """One row an optimiser iteration: stage, iteration, losses."""
    scene: Scene | None
    state: State
