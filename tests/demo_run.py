"""A made-up run, cheap and whole: a person of capsules kicks a ball, which flies off by formula."""

import numpy as np
import roma
import torch
from bodies import cloud_of, ground

from hoi.body.kinematics import forward_kinematics, local_rotations
from hoi.body.skeleton import JOINT_NAMES, PARENTS
from hoi.data import (
    Body,
    Check,
    Contact,
    ContactSearch,
    Material,
    Motion,
    ObjectTrajectory,
    Omission,
    Plan,
    Run,
    Scene,
    SceneObject,
    StageReport,
    State,
    Step,
    Target,
)
from hoi.gaussians import fibonacci_sphere
from hoi.record.schemas import as_recorded

LEFT = {"hip": (0.09, -0.08, 0), "knee": (0.1, -0.48, 0), "ankle": (0.1, -0.88, -0.03), "foot": (0.12, -0.94, 0.1)}
LEFT |= {"collar": (0.08, 0.40, 0), "shoulder": (0.18, 0.42, 0), "elbow": (0.45, 0.42, 0), "wrist": (0.70, 0.42, 0)}
LEFT |= {"hand": (0.79, 0.42, 0)}
MIDDLE = {"pelvis": 0, "spine1": 0.11, "spine2": 0.24, "spine3": 0.30, "neck": 0.50, "head": 0.60}
RADII = {"hip": 0.08, "knee": 0.075, "ankle": 0.055, "foot": 0.045, "collar": 0.08, "shoulder": 0.07, "elbow": 0.048}
RADII |= {"wrist": 0.04, "hand": 0.04, "spine": 0.13, "neck": 0.06, "head": 0.06}
SKIN, SHIRT, SHORTS, SHOE = (0.80, 0.60, 0.48), (0.75, 0.16, 0.16), (0.16, 0.20, 0.35), (0.1, 0.1, 0.1)
BALL_RADIUS = 0.11


def rest_joints() -> np.ndarray:
    sides = {"left": 1, "right": -1}
    rows = []
    for name in JOINT_NAMES:
        side, _, part = name.partition("_")
        rows.append((0, MIDDLE[name], 0) if not part else np.array(LEFT[part]) * (sides[side], 1, 1))
    return np.array(rows, np.float32)


def person(rng: np.random.Generator, points: int) -> Body:
    joints = rest_joints()
    bones = [(PARENTS[j], j) for j in range(1, 24)]
    radii = [next(r for part, r in RADII.items() if part in JOINT_NAMES[j]) for _, j in bones]
    areas = np.array([(np.linalg.norm(joints[b] - joints[a]) + r) * r for (a, b), r in zip(bones, radii, strict=True)])
    which = rng.choice(len(bones), points, p=areas / areas.sum())
    which[: points // 12] = len(bones)  # the head's ball
    along, angle = rng.uniform(-0.1, 1.1, points), rng.uniform(0, 2 * np.pi, points)
    means, weights = np.zeros((points, 3)), np.zeros((points, 24))
    rgb = np.zeros((points, 3))
    for bone in range(len(bones) + 1):
        rows = which == bone
        if bone == len(bones):
            means[rows] = joints[15] + (0, 0.06, 0.02) + fibonacci_sphere(rows.sum()) * (0.09, 0.125, 0.105)
            weights[rows, 15], rgb[rows] = 1, SKIN
            rgb[rows & (means[:, 1] > joints[15][1] + 0.10)] = (0.18, 0.12, 0.08)
            continue
        a, b = joints[bones[bone][0]], joints[bones[bone][1]]
        axis = (b - a) / np.linalg.norm(b - a)
        side = np.cross(axis, (0.31, 0.2, 0.93))
        side /= np.linalg.norm(side)
        ring = np.cos(angle[rows])[:, None] * side + np.sin(angle[rows])[:, None] * np.cross(axis, side)
        s = along[rows]
        radius = radii[bone] * np.sqrt(np.clip(1 - np.clip(np.abs(s - 0.5) - 0.5, 0, 0.1) ** 2 / 0.0101, 0.02, 1))
        means[rows] = a + s[:, None] * (b - a) + ring * radius[:, None]
        weights[rows, bones[bone][0]] = 1
        name = JOINT_NAMES[bones[bone][1]]
        shirt = any(part in name for part in ("spine", "collar", "shoulder")) or ("elbow" in name)
        shorts = any(part in name for part in ("hip", "knee"))
        rgb[rows] = SHIRT if shirt else SHORTS if shorts else SHOE if "foot" in name else SKIN
    cloud = cloud_of(means, 0.01, rgb + rng.normal(0, 0.015, (points, 1)))
    return Body("capsules", cloud, weights.astype(np.float32), joints, "made up")


def kick(frames: int, fps: float, contact_frame: float) -> Motion:
    """A step and a kick with the right leg; the foot is foremost shortly after `contact_frame`."""
    phase = (np.arange(frames) - contact_frame) / fps

    def keyed(times: tuple[float, ...], angles: tuple[float, ...]) -> np.ndarray:
        fine = np.interp(np.linspace(-2, 2, 801), times, angles)
        smooth = np.convolve(np.pad(fine, 20, "edge"), np.hanning(41) / np.hanning(41).sum(), "valid")
        return np.interp(phase, np.linspace(-2, 2, 801), smooth)

    pose = np.zeros((frames, 23, 3))
    set_x = {"right_hip": ((-0.8, -0.3, 0.12, 0.5, 1.0), (0, 0.75, -1.25, -0.9, 0))}
    set_x["right_knee"] = ((-0.8, -0.25, 0.05, 0.5, 1.0), (0.1, 1.5, 0.12, 0.4, 0.1))
    set_x["left_knee"] = ((-0.8, -0.2, 0.5), (0.1, 0.35, 0.1))
    set_x["left_hip"] = ((-0.8, -0.2, 0.5), (-0.05, -0.3, -0.05))
    set_x["spine1"] = ((-0.6, -0.2, 0.2, 0.9), (0, -0.15, 0.35, 0))
    for name, keys in set_x.items():
        pose[:, JOINT_NAMES.index(name) - 1, 0] = keyed(*keys)
    pose[:, JOINT_NAMES.index("left_shoulder") - 1] = np.stack(
        [keyed((-0.6, -0.2, 0.2, 0.9), (0, 0.5, -0.9, 0)), np.zeros(frames), np.full(frames, -1.05)], -1
    )
    pose[:, JOINT_NAMES.index("right_shoulder") - 1] = np.stack(
        [keyed((-0.6, -0.2, 0.2, 0.9), (0, -0.5, 0.8, 0)), np.zeros(frames), np.full(frames, 1.05)], -1
    )
    pose[:, [JOINT_NAMES.index("left_elbow") - 1, JOINT_NAMES.index("right_elbow") - 1], 1] = (-0.5, 0.5)
    root = np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]], np.float64)
    travel = keyed((-0.9, -0.2, 0.2, 0.8), (-0.1, 0.25, 0.4, 0.45))
    translation = np.stack([np.zeros(frames), travel, 0.94 - 0.05 * np.exp(-((phase + 0.1) ** 2) / 0.05)], -1)
    return Motion(
        translation=translation.astype(np.float32),
        orientation=np.tile(root[:2].ravel(), (frames, 1)).astype(np.float32),
        body_pose=pose.astype(np.float32),
        fps=fps,
    )


def fk(body: Body, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (T, 24, 3, 3) and positions (T, 24, 3)."""
    local = local_rotations(*(torch.from_numpy(a).double() for a in (motion.orientation, motion.body_pose)))
    places = torch.from_numpy(motion.translation).double(), torch.from_numpy(body.rest_joints).double()
    rotations, positions = forward_kinematics(local, *places)
    return rotations.numpy(), positions.numpy()


def posed_means(body: Body, motion: Motion) -> np.ndarray:
    rotations, positions = fk(body, motion)
    joint = body.skinning_weights.argmax(1)
    local = body.cloud.means - body.rest_joints[joint]
    return np.einsum("tnij,nj->tni", rotations[:, joint], local) + positions[:, joint]


def ball(rng: np.random.Generator, gaussians: int, particles: int, centre: np.ndarray) -> SceneObject:
    surface = fibonacci_sphere(gaussians)
    poles = fibonacci_sphere(12)
    dark = (surface @ poles.T).max(1) > 0.93
    rgb = np.where(dark[:, None], (0.08, 0.08, 0.1), (0.93, 0.93, 0.9))
    inside = rng.normal(size=(particles - gaussians, 3))
    inside *= (rng.uniform(0, 0.9, (len(inside), 1)) ** (1 / 3)) / np.linalg.norm(inside, axis=1, keepdims=True)
    points = np.concatenate([surface, inside]) * BALL_RADIUS + centre
    material = Material("football", "neo_hookean", 2e5, 0.4, 77.0, 0.8, 0.5)
    volume = 4 / 3 * np.pi * BALL_RADIUS**3 / particles
    return SceneObject(
        name="ball",
        cloud=cloud_of(points[:gaussians], 0.006, rgb),
        particles=points.astype(np.float32),
        volumes=np.full(particles, volume, np.float32),
        material=material,
        velocity=np.zeros(3),
        angular_velocity=np.zeros(3),
        size=2 * BALL_RADIUS,
        notes=("made up", "filled"),
    )


def make_run(
    frames: int = 5,
    points: int = 400,
    gaussians: int = 60,
    particles: int = 100,
    contact_frame: float = 1.5,
    seed: int = 0,
) -> tuple[Run, np.ndarray, np.ndarray]:
    """The run, the person's posed points (T, M, 3) and their colours (M, 3)."""
    rng, fps = np.random.default_rng(seed), 20.0
    body, motion = person(rng, points), kick(frames, fps, contact_frame)
    _, positions = fk(body, kick(2, fps, 0.0))
    toes = positions[0, JOINT_NAMES.index("right_foot")]
    centre = np.array([toes[0], toes[1] + BALL_RADIUS + 0.06, BALL_RADIUS])
    thing = ball(rng, gaussians, particles, centre)

    velocity = np.array([0.3, 7.0, 3.4])
    time = np.maximum(np.arange(frames) - contact_frame, 0)[:, None] / fps
    com = centre + velocity * time - (0, 0, 0.5 * 9.81) * time**2
    com[:, 2] = BALL_RADIUS + np.abs(com[:, 2] - BALL_RADIUS) * np.where(com[:, 2] < BALL_RADIUS, 0.6, 1)
    speed = np.where(time > 0, velocity - (0, 0, 9.81) * time, 0)
    spin = roma.rotvec_to_rotmat(torch.tensor(np.concatenate([-12 * time, 0 * time, 0 * time], 1))).numpy()
    squash = np.eye(3) - 0.2 * np.exp(-6 * time)[:, :, None] * (time > 0)[:, :, None] * np.diag([-0.4, 1.0, -0.4])
    gradient = squash @ spin
    moved = np.einsum("tij,pj->tpi", gradient, thing.particles - centre) + com[:, None]
    mass = float(thing.masses.sum())
    kinetic = 0.5 * mass * (speed**2).sum(1)
    energy = np.stack([kinetic, 0.05 * kinetic, mass * 9.81 * com[:, 2]], -1)
    trajectory = as_recorded(
        ObjectTrajectory(
            positions=moved.astype(np.float32),
            com=com.astype(np.float32),
            com_velocity=speed.astype(np.float32),
            energy=energy,
            deformation_gradient=np.repeat(gradient[:, None], particles, 1).astype(np.float32),
            phase=tuple("rest" if t <= 0 else "mpm" for t in time[:, 0]),
        )
    )
    normal = np.array([0.05, 0.93, 0.36])
    normal /= np.linalg.norm(normal)
    contact = Contact(
        frame=contact_frame,
        joint=JOINT_NAMES.index("right_foot"),
        fraction=0.31,
        point=centre - BALL_RADIUS * normal,
        normal=normal,
        v_human=np.array([0.1, 6.1, 1.3]),
        v_object=np.zeros(3),
        v_in=6.1,
        v_post=velocity,
        impulse=mass * velocity,
        gap=0.004,
    )
    run = Run(
        config_yaml="seed: 0\nscene:\n  name: kick_ball\n",
        provenance={"seed": str(seed), "config_hash": "00ff", "started": "2026-01-01T00:00:00"},
        result={"status": "done", "outcome": "contact", "seconds": "1.25"},
        plan=Plan(
            variant="full",
            steps=(Step("free_motion", "mpm", "the object falls"), Step("motion", "hmsd", "a prompt is given")),
            omissions=(Omission("refine", "stage.refine is none", "the video prior"),),
            checks=(Check("CFL", "0.31", "dt 4e-5 s"),),
        ),
        reports=(StageReport("motion", 1.0, 50, {"loss": 0.25, "gap": float("inf")}, ("converged",)),),
        history=({"stage": "motion", "iteration": 0.0, "loss": 0.1 + 0.2}, {"stage": "coordinate", "attraction": 1e-9}),
        scene=Scene("kick_ball", body, thing, "a person kicks", frames, fps, np.array([0, 0, -9.81]), (ground(),)),
        state=State(
            motion=motion,
            trajectory=trajectory,
            target=Target(11, 2, "velocity profile"),
            contact=ContactSearch((contact,), 0.004, contact_frame, 11),
        ),
    )
    rgb = np.clip(0.5 + 0.28209479177387814 * body.cloud.sh[:, 0], 0, 1)
    return run, posed_means(body, motion).astype(np.float32), rgb
