"""Gaussians fitted to unlit pictures of the mesh, in several poses and from near and far."""

import time
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hoi.body.skeleton import JOINT_NAMES
from hoi.body.skinning import BodyTensors, pose_gaussians, pose_means
from hoi.data import Camera
from hoi.gaussians import SH_C0
from hoi.render.cameras import look_at
from hoi.render.rasterise import Settings, rasterise
from hoi.render.splats import Splats
from scripts import bake_people as bodies
from scripts.bake_people import Array
from scripts.dress_people.makehuman import Base, Part
from scripts.dress_people.rays import Scene
from scripts.dress_people.surfels import Surfels

VIEWS, POSES, SIZE = 49, 7, 400
KINDS = 12
SETTINGS = Settings(antialiased=True)
RATES = {"means": 0.02, "scales": 0.01, "quaternions": 0.004, "opacities": 0.02, "rgb": 0.006}
LONGER, SHORTER = (0.45, 0.45, 1.6), 2.0
"""How far a scale may go from where it began, in its logarithm: along the surface, and through it, which makes the edge
of an outline."""
BACK = -0.15
"""Cosine to the camera below which a Gaussian shows its back."""

Pose = tuple[Tensor, Tensor, Tensor]
"""Translation (1, 3), orientation (1, 6) and body pose (1, 23, 3)."""
View = tuple[int, Camera, Array, Array]
"""Pose, camera, RGB over black (H, W, 3), alpha (H, W)."""


def poses(rng: np.random.Generator) -> list[Pose]:
    """The T-pose, standing, and some in motion, all upright (y up) about the origin."""
    found = []
    for index in range(POSES):
        turns = np.zeros((24, 3))
        if index:
            lowered = np.radians(70 if index == 1 else rng.uniform(0, 85))
            for side, sign in (("left", -1), ("right", 1)):
                turns[JOINT_NAMES.index(f"{side}_shoulder"), 2] = sign * lowered
        if index > 1:
            turns += rng.normal(0, 0.22, turns.shape)
            for side in ("left", "right"):
                turns[JOINT_NAMES.index(f"{side}_hip"), 0] += rng.uniform(-0.9, 0.4)
                turns[JOINT_NAMES.index(f"{side}_knee"), 0] += rng.uniform(0, 1.3)
        root = np.eye(3)[:2].reshape(1, 6)
        arrays = (np.zeros((1, 3)), root, turns[None, 1:])
        found.append(tuple(torch.tensor(array, dtype=torch.float32) for array in arrays))
    return found


def place(person: Base, parts: list[Part], pose: Pose) -> list[Array]:
    """The parts' vertices in a pose."""
    placed = []
    for part in parts:
        shares = part.weights / part.weights.sum(1, keepdims=True)
        weights = bodies.dense(*bodies.strongest(shares, bodies.INFLUENCES))
        rest = bodies.unskin(person.bend, weights, part.vertices)
        arrays = (rest, np.zeros((len(rest), 4)), weights, person.joints)
        body = BodyTensors(*(torch.tensor(array, dtype=torch.float32) for array in arrays))
        placed.append(pose_means(body, *pose)[0].numpy().astype(np.float64))
    return placed


def views(person: Base, parts: list[Part], rng: np.random.Generator) -> list[View]:
    """Pictures of the mesh: whole, halves, faces, hands and feet."""
    found = []
    for index, pose in enumerate(poses(rng)):
        placed = place(person, parts, pose)
        scene = Scene(parts, placed)
        eyes = np.concatenate([v for part, v in zip(parts, placed, strict=True) if part.kind == "eye"]).mean(0)
        low, high = scene.vertices.min(0), scene.vertices.max(0)
        for number in range(index, VIEWS, POSES):
            camera = _camera(number // POSES * KINDS // (VIEWS // POSES), number, eyes, low, high, scene, rng)
            found.append((index, camera, *(a.astype(np.float16) for a in scene.picture(camera, scene.unlit))))
    return found


def _camera(
    kind: int, number: int, eyes: Array, low: Array, high: Array, scene: Scene, rng: np.random.Generator
) -> Camera:
    turn, rise = 2 * np.pi * number * 0.6180339887, np.radians(rng.uniform(-10, 45))
    middle, span = (low + high) / 2, float((high - low)[1])
    if kind < 3:
        target, distance = middle, (2.3 + 1.6 * (kind % 3)) * span
    elif kind < 6:
        target, distance = middle + np.array([0, (kind % 3 - 1) * 0.28 * span, 0]), 1.35 * span
    elif kind < 9:
        target, distance = eyes - [0, 0.04, 0.04], 0.9 if kind % 3 else 1.4
        turn, rise = rng.normal(0, 0.9 if kind % 3 else 2.0), 0.5 * rise
    else:  # a hand or a foot
        corners = scene.vertices[
            [scene.vertices[:, 0].argmax(), scene.vertices[:, 0].argmin(), scene.vertices[:, 1].argmin()]
        ]
        target, distance = corners[number % 3], 1.1
    away = np.array([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)])
    return look_at(target + distance * away, target, width=SIZE, height=SIZE, fov_y=np.radians(28), up=(0, 1, 0))


def fit(person: Base, surfels: Surfels, seen: list[View], all_poses: list[Pose], steps: int) -> Surfels:
    """The surfels with places, shapes, opacities and colours that give the pictures (L1, Adam)."""

    def tensor(array: Array) -> Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32)

    start, first_scales = tensor(surfels.means), tensor(surfels.scales).log()
    free = {
        "means": torch.zeros_like(start),  # in units of the spacing
        "scales": first_scales.clone(),
        "quaternions": tensor(surfels.quaternions),
        "opacities": torch.logit(tensor(surfels.opacities).clamp(0.02, 0.985)),
        "rgb": tensor(np.clip(surfels.rgb, 0, 1)),
    }
    for values in free.values():
        values.requires_grad_(True)
    longer, closed = torch.tensor(LONGER), torch.tensor(surfels.closed)
    spacing, weights, joints = tensor(surfels.spacing)[:, None], tensor(surfels.weights), tensor(person.joints)
    adam = torch.optim.Adam([{"params": [free[name]], "lr": rate} for name, rate in RATES.items()], eps=1e-12)
    rng, losses, begun = np.random.default_rng(0), [], time.time()
    for step in range(steps):
        if step == int(steps * 0.7):
            for group in adam.param_groups:
                group["lr"] *= 0.3
        index, camera, shown, alpha = seen[int(rng.integers(len(seen)))]
        behind = torch.tensor(rng.random(3), dtype=torch.float32)
        cover = tensor(alpha)[..., None]
        wanted = tensor(shown) + (1 - cover) * behind
        body = BodyTensors(start + free["means"] * spacing, free["quaternions"], weights, joints)
        means, rotations = pose_gaussians(body, *all_poses[index])
        root = rotations[0] * free["scales"].exp()[:, None, :]
        # What is turned away has some other colour: where it shines through the skin before it, that is an error.
        towards = torch.as_tensor(camera.position, dtype=torch.float32) - means[0].detach()
        facing = (rotations[0, :, :, 2].detach() * towards).sum(1) / towards.norm(dim=1)
        away = (closed & (facing < BACK))[:, None]
        rgb = torch.where(away, torch.tensor(rng.random(3), dtype=torch.float32), free["rgb"])
        splats = Splats(means[0], root @ root.mT, free["opacities"].sigmoid(), ((rgb - 0.5) / SH_C0)[:, None])
        picture = rasterise(splats, camera, behind, settings=SETTINGS)
        where = ((cover > 0.01) | (picture.alpha.detach()[..., None] > 0.01)).float()
        loss = ((picture.colour - wanted).abs() * where).sum() / where.sum() / 3
        kept = 0.02 * (free["means"] ** 2).mean() + 0.002 * ((free["scales"] - first_scales) ** 2).mean()
        adam.zero_grad()
        (loss + kept).backward()
        adam.step()
        with torch.no_grad():
            free["means"].clamp_(-1, 1)
            free["scales"].copy_(free["scales"].clamp(first_scales - SHORTER, first_scales + longer))
            free["rgb"].clamp_(0, 1)
        losses.append(float(loss.detach()))
        if step % 100 == 99:
            print(f"  step {step + 1}: L1 {np.mean(losses[-100:]):.4f}, {time.time() - begun:.0f} s", flush=True)
    with torch.no_grad():
        return replace(
            surfels,
            means=(start + free["means"] * spacing).numpy().astype(np.float64),
            scales=free["scales"].exp().numpy(),
            quaternions=torch.nn.functional.normalize(free["quaternions"], dim=-1).numpy(),
            opacities=free["opacities"].sigmoid().numpy(),
            rgb=free["rgb"].numpy().astype(np.float64),
        )
