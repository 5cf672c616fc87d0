"""Contacts to train the video prior on: a limb that meets an object and does not enter it, and the same gone wrong.

Motions come from the motion prior of the package, people and objects are those of the package, so that nothing else is
needed. The object is set where the striking limb's skin just touches it (compare
`hoi.method.attraction.carried_strike`) and leaves with V_post (`hoi.method.contact.impulse`). Signed distances to the
analytic shapes tell the clean from the flawed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hoi.body.interpolate import interpolate_motion
from hoi.body.people import load_person
from hoi.body.skeleton import CHAINS, JOINT_COUNT, JOINT_NAMES
from hoi.body.skeleton import LIMBS as BODY_LIMBS
from hoi.body.skinning import joint_paths
from hoi.data import Array, Body, Motion
from hoi.method.contact import impulse
from hoi.motion.diffusion import ancestral_sample
from hoi.motion.features import FEATURE_COUNT, decode
from hoi.motion.prior import MotionPrior
from hoi.objects import shapes
from hoi.refine.clip import moved_by
from hoi.render.replay import Person, person_tensors, posed
from hoi.render.splats import Splats, from_cloud
from hoi.video_prior.embedded import CLIP_FRAMES, FPS

FLAWS = ("inside", "gap")
PEOPLE = ("man", "woman", "child", "athlete", "heavy", "senior")
PERSON_GAUSSIANS = 14_000
MOTION_FRAMES, MOTION_STEPS, MOTION_BATCH, GUIDANCE = 40, 25, 32, 2.5
POSE_NOISE = 0.08
"""Standard deviation of what is added to each joint's rotation vector, the same in all frames [rad]."""
TEMPO = (0.3, 1.1)
"""How much of a motion's frame passes in a clip's frame: slow strikes as well as the prior's own."""
BETWEEN_FRAMES = 0.4
"""Share of the contacts that lie between two frames; the others lie in the middle one."""
SIZES = (0.7, 1.4)
"""Of an object, relative to its own."""
ON_GROUND = 0.7
"""Share of the objects that stand on the ground, of those that can be struck there."""
TOUCHING = 1e-3
"""Distance at which the skin touches [m]."""
CLEAN = 0.004
"""A clean clip has no skin deeper in the object in any frame, nor farther from it at t_c [m]."""
FLAW = (0.02, 0.15)
"""How deep the limb goes in, or how far from the object it stays [m]."""
LEAST_FLAW = 0.015
APART = 2.0
"""Where the object's centre starts before it is brought to the limb, beyond its own size [m]."""
MARCHES = 60


@dataclass(frozen=True)
class Limb:
    """What strikes, and what to ask the motion prior for."""

    name: str
    joint: int
    """Whose peak velocity is the strike."""
    joints: tuple[int, ...]
    """Whose skin may touch."""
    prompts: tuple[str, ...]


def _both_sides(part: str, *prompts: str) -> list[Limb]:
    """The limb that ends in the joint `part`, left and right."""
    names = [(side, f"{side}_{part}") for side in ("left", "right")]
    return [
        Limb(f"{side} {part}", JOINT_NAMES.index(name), BODY_LIMBS[name], tuple(p.format(side=side) for p in prompts))
        for side, name in names
    ]


LIMBS = (
    *_both_sides(
        "foot",
        "a person kicks a soccer ball with the {side} foot",
        "a person does a front kick with the {side} foot",
        "a person runs up and kicks a soccer ball with the {side} foot",
        "a person kicks a box with the {side} foot",
    ),
    *_both_sides("knee", "a person strikes with the {side} knee"),
    *_both_sides("hand", "a person punches with the {side} hand", "a person punches a bag with the {side} hand"),
    Limb("hands", 23, BODY_LIMBS["hands"], ("a person pushes", "a person pushes an object with both hands")),
)
LIMB_SHARES = (0.22, 0.22, 0.08, 0.08, 0.13, 0.13, 0.14)
OBJECT_SHARES = {
    "soccer_ball": 0.26, "basketball": 0.15, "blue_ball": 0.14, "cardboard_box": 0.13, "file_cabinet": 0.12,
    "beach_ball": 0.08, "foam_cube": 0.12,
}  # fmt: skip


@dataclass(frozen=True)
class Solid:
    """A built-in object as an analytic shape, turned about its centre."""

    ball: bool
    half: Array
    """Half its bounding box before turning [m], (3,)."""
    turn: Array
    """(3, 3)."""

    def distance(self, points: Array, centre: Array) -> Array:
        """Signed distances [m], (...), of points (..., 3) to its surface; negative inside."""
        if self.ball:
            return np.linalg.norm(points - centre, axis=-1) - self.half[0]
        outside = np.abs((points - centre) @ self.turn) - self.half
        return np.linalg.norm(np.maximum(outside, 0), axis=-1) + np.minimum(outside.max(axis=-1), 0)

    @property
    def height(self) -> float:
        """Of the centre when it stands on the ground [m]; a box stands upright."""
        return float(self.half[2])


@dataclass(frozen=True)
class Contact:
    """A clean contact over the frames of a clip, ready to be spoilt and drawn."""

    limb: int
    """In `LIMBS`."""
    shape: str
    person: str
    solid: Solid
    centres: Array
    """Of the object [m], (F, 3)."""
    skin: Array
    """Centres of all the person's Gaussians [m], (F, N, 3)."""
    strike: Array
    """Unit direction in which the limb meets the object, (3,)."""
    point: Array
    """Where they touch [m], (3,)."""
    times: Array
    """Of the frames, from t_c [frame], (F,)."""
    body: list[Splats]
    """In each frame, F."""
    chain: NDArray[np.bool_]
    """Which of the person's Gaussians are of the limb that touches, (N,)."""
    thing: Splats
    """The object, turned, with its centre at the origin."""

    def distances(self, shift: Array) -> Array:
        """Of the nearest or deepest skin in each frame, with the person moved by `shift` (F, 3) [m]: (F,) [m]."""
        moved = self.skin + shift[:, None]
        return np.array([self.solid.distance(p, c).min() for p, c in zip(moved, self.centres, strict=True)])


@cache
def people() -> dict[str, tuple[Body, Person]]:
    """Those of the package, ready to be posed."""
    bodies = {name: load_person(name, PERSON_GAUSSIANS) for name in PEOPLE}
    return {name: (body, person_tensors(body)) for name, body in bodies.items()}


@cache
def of_chain(person: str, joint: int) -> NDArray[np.bool_]:
    """Which of a person's Gaussians move with the limb of a joint, as in stage 3, (N,)."""
    chain = next(joints for joints in CHAINS.values() if joint in joints)
    return moved_by(people()[person][0], [joint for joint in chain if joint > 0])


@cache
def _object(shape: str) -> Splats:
    return from_cloud(shapes.build(shapes.SHAPES[shape], max(shapes.SHAPES[shape].extent)).cloud)


def sample_motions(prior: MotionPrior, count: int, seed: int) -> list[tuple[int, Motion]]:
    """Strikes drawn from the motion prior: the limb's number in `LIMBS`, and a motion of the prior's skeleton."""
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    limbs = rng.choice(len(LIMBS), count, p=LIMB_SHARES)
    prompts = [str(rng.choice(LIMBS[limb].prompts)) for limb in limbs]
    text = prior.encode_text(prompts)
    motions: list[Motion] = []
    for rows in text.split(MOTION_BATCH):
        x0 = ancestral_sample(
            lambda x, t, rows=rows: prior.predict_x0(x, t, rows, GUIDANCE),
            (len(rows), MOTION_FRAMES, FEATURE_COUNT),
            prior.alphas_cumprod,
            generator,
            MOTION_STEPS,
        )
        parts = (part.numpy() for part in decode(prior.denormalise(x0)))
        motions += [Motion(*part, fps=prior.fps) for part in zip(*parts, strict=True)]
    return [(int(limb), motion) for limb, motion in zip(limbs, motions, strict=True)]


def stage_contact(
    motions: Sequence[tuple[int, Motion]], prior: MotionPrior, rng: np.random.Generator
) -> Contact | None:
    """A random contact; None where this draw has none that is clean."""
    limb, motion = motions[int(rng.integers(len(motions)))]
    name = str(rng.choice(PEOPLE))
    body, person = people()[name]
    motion = _perturbed(prior.on_body(motion, body), rng)
    path = joint_paths(body, motion)[:, LIMBS[limb].joint]
    # At t_c the limb is about where it is fastest. The clip's frames, in frames of the motion:
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1)
    peak = int(speed[:-2].argmax()) + rng.uniform(0.0, 1.5)
    phase = rng.uniform(0, 1) if rng.uniform() < BETWEEN_FRAMES else 0.0
    tempo = rng.uniform(*TEMPO)
    times = np.arange(CLIP_FRAMES) - CLIP_FRAMES // 2 - phase
    at = np.append(peak + tempo * times, [peak, peak - tempo])
    if at.min() < 0 or at.max() > len(motion) - 1:
        return None
    moved = interpolate_motion(motion, at)
    parameters = (torch.from_numpy(p).float() for p in (moved.translation, moved.orientation, moved.body_pose))
    with torch.no_grad():
        splats = posed(person, *parameters)
    skin = np.stack([frame.means.numpy() for frame in splats]).astype(np.float64)
    dominant = body.dominant_joints
    striking = np.isin(dominant, LIMBS[limb].joints)
    touching, before = skin[CLIP_FRAMES], skin[CLIP_FRAMES + 1]
    velocity = (touching - before)[dominant == LIMBS[limb].joint].mean(axis=0) * FPS
    if np.linalg.norm(velocity) < 0.1:
        return None
    shape = str(rng.choice(list(OBJECT_SHARES), p=list(OBJECT_SHARES.values())))
    solid, thing = _solid(shape, rng)
    strike, centre = _meet(touching, striking, velocity, solid, rng)
    if strike is None or centre is None:
        return None
    gaps = solid.distance(touching, centre)
    nearest = int(gaps.argmin())
    if not striking[nearest] or abs(gaps[nearest]) > CLEAN:
        return None
    point = touching[nearest]
    centres = _trajectory(point, centre, velocity, solid, times, rng)
    chain = of_chain(name, int(dominant[nearest]))
    skin, splats = skin[:CLIP_FRAMES], splats[:CLIP_FRAMES]
    contact = Contact(limb, shape, name, solid, centres, skin, strike, point, times, splats, chain, thing)
    clean = contact.distances(np.zeros((CLIP_FRAMES, 3))).min() >= -CLEAN
    return contact if clean and centres[:, 2].min() >= solid.height - CLEAN else None


def spoil(contact: Contact, flaw: str, rng: np.random.Generator) -> tuple[Array, float] | None:
    """How the person has to move for the contact to have one of `FLAWS`.

    Returns:
        shift (F, 3) [m], and the depth of the deepest skin over the clip, or minus the gap at the middle frame [m];
        None where that comes out too small or too large to be the flaw that it is called.
    """
    width = rng.choice([0.6, 1.0, 2.0, 6.0])
    # As an optimiser of few frames around t_c leaves it, or as a motion that misses as a whole.
    near = np.exp(-(contact.times**2) / (2 * width**2))[:, None]
    way = near * contact.strike * (1 if flaw == "inside" else -1)
    amount = FLAW[0] + (FLAW[1] - FLAW[0]) * rng.uniform() ** 1.5  # small ones are the more frequent in use
    if flaw == "gap":
        gap = contact.distances(way * amount)[np.abs(contact.times).argmin()]
        return (way * amount, -float(gap)) if LEAST_FLAW <= gap else None
    most = min(FLAW[1], 0.8 * float(contact.solid.half.min()) * 2)
    depth = -float(contact.distances(way * min(amount, most)).min())
    return (way * min(amount, most), depth) if LEAST_FLAW <= depth <= most else None


def _perturbed(motion: Motion, rng: np.random.Generator) -> Motion:
    """Every joint turned a little, the same in all frames."""
    noise = rng.normal(0, POSE_NOISE, (JOINT_COUNT - 1, 3)).astype(np.float32)
    return Motion(motion.translation, motion.orientation, motion.body_pose + noise, motion.fps)


def _solid(shape: str, rng: np.random.Generator) -> tuple[Solid, Splats]:
    kind, rest = shapes.SHAPES[shape], _object(shape)
    scale, ball = rng.uniform(*SIZES), kind.kind == "ball"
    rotation = Rotation.random(rng=rng) if ball else Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    turn = rotation.as_matrix()
    tensor = torch.from_numpy(turn).float()
    turned = Splats(
        scale * rest.means @ tensor.T, scale**2 * (tensor @ rest.covariances @ tensor.T), rest.opacities, rest.sh
    )
    return Solid(ball, scale * np.array(kind.extent) / 2, turn), turned


def _meet(
    skin: Array, striking: NDArray[np.bool_], velocity: Array, solid: Solid, rng: np.random.Generator
) -> tuple[Array | None, Array | None]:
    """The direction of the strike, and the centre of the object where the striking skin (N, 3) first touches it.

    An object that stands on the ground is met level; one that does not, along the strike.
    """
    tip = skin[striking][(skin[striking] @ velocity).argmax()]
    level = velocity * (1, 1, 0)
    if np.linalg.norm(level) < 0.3 * np.linalg.norm(velocity):
        return None, None
    reachable = tip[2] < 1.9 * solid.height
    on_ground = reachable and (rng.uniform() < ON_GROUND or tip[2] < 1.1 * solid.height)
    direction = level if on_ground else velocity * (1, 1, rng.uniform(0, 1))
    direction = direction / np.linalg.norm(direction)
    side = np.cross(direction, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    aside = rng.uniform(-0.5, 0.5) * solid.half[:2].min()
    centre = tip + aside * side + (APART + np.linalg.norm(solid.half)) * direction
    if on_ground:
        centre[2] = solid.height
    elif not solid.ball:
        centre[2] += rng.uniform(-0.5, 0.5) * solid.height
    # Sphere tracing: nothing is entered by moving no farther than the nearest skin is away.
    near = skin[striking]
    for _ in range(MARCHES):
        gap = float(solid.distance(near, centre).min())
        if gap < TOUCHING:
            break
        centre = centre - gap * direction
        if (centre - tip) @ direction < -0.5 * np.linalg.norm(solid.half):
            return None, None  # it has passed beside
    return (direction, centre) if gap < TOUCHING and centre[2] >= solid.height - CLEAN else (None, None)


def _trajectory(
    point: Array, centre: Array, velocity: Array, solid: Solid, times: Array, rng: np.random.Generator
) -> Array:
    """Centres of the object (F, 3) [m]: at rest or slow before t_c, off with V_post afterwards."""
    slow = rng.uniform(-0.5, 0.5, 3) * (1, 1, 0) if rng.uniform() < 0.3 else np.zeros(3)
    normal = centre - point
    normal = normal / np.linalg.norm(normal)
    _, post = impulse(velocity, slow, normal, rng.uniform(0.2, 0.9))
    if centre[2] <= solid.height + CLEAN:
        post[2] = max(post[2], 0.0)
    seconds = times[:, None] / FPS
    return centre + np.where(seconds > 0, post, slow) * seconds
