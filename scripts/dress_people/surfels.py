"""A dressed mesh -> Gaussians on it, before they are fitted to pictures of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hoi.body.people import tilt_quaternions, z_order
from scripts import bake_people as bodies
from scripts.bake_people import Array
from scripts.dress_people.makehuman import Base, Part, look_up
from scripts.dress_people.rays import Scene, albedo, smooth_normals, to_linear, to_shown

DENSITY = {
    "body": 0.7, "head": 3.0, "hand": 3.5, "ears": 4.0, "face": 10.0, "lips": 18.0, "eyelids": 26.0, "cloth": 0.8,
    "shoe": 1.8, "hair": 2.6, "brow": 70.0, "lash": 40.0, "eye": 60.0,
}  # fmt: skip
"""Samples per area: what is small and looked at gets more."""
HEM, BUSY = 2.5, 1.5
"""More along edges of clothes, and where a texture varies."""
CANDIDATES, RELAXATIONS = 6, 3
OVERLAP, FLATNESS, INSET = 0.5, 0.12, 0.0008
FAINTEST = 0.12
"""Of texture alpha; fainter hair is left out."""
RAYS = 128
LINING = 0.08
"""How far from their edges clothes show their inside [m]."""
THICKEST_LAYER = 0.025
"""What has another layer so close outside it [m], and little light, is never seen."""


@dataclass
class Surfels:
    """Gaussians in the T-pose."""

    means: Array
    quaternions: Array
    scales: Array
    opacities: Array
    rgb: Array
    """As shown, (N, 3)."""
    normals: Array
    openness: Array
    weights: Array
    spacing: Array
    """Distance to neighbours [m], (N,)."""
    closed: NDArray[np.bool_]
    """Whether its back is never to be seen: skin, and clothes away from their edges, (N,)."""


def sample(person: Base, parts: list[Part], count: int, rng: np.random.Generator) -> Surfels:
    """About `count` of them."""
    scene = Scene(parts)
    normals = [smooth_normals(part, part.vertices) for part in parts]
    seen = [_seen(scene, part, own, rng) for part, own in zip(parts, normals, strict=True)]
    weights = [_density(part, rng) for part in parts]
    mass = np.array(
        [(_areas(part) * weight)[keep].sum() for part, weight, keep in zip(parts, weights, seen, strict=True)]
    )
    # A fifth of the samples falls to what hides below another layer.
    counts = np.maximum(1.18 * count * mass / mass.sum(), 30).astype(int)
    rows = [_of_part(scene, *each, rng) for each in zip(parts, normals, seen, weights, counts, strict=True)]
    whole = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
    return _to_t_pose(person, whole)


def _of_part(
    scene: Scene, part: Part, normals: Array, seen: Array, weight: Array, count: int, rng: np.random.Generator
) -> dict[str, Array]:
    """Points in the A-pose and what is known of the surface around each."""
    face, bary, points, chosen, cell = _spread(part, seen, weight, count, rng)
    uv = np.einsum("nc,ncd->nd", bary, part.uv[face])
    linear, alpha = to_linear(albedo(part, uv)), look_up(part.texture[..., 3:4], uv)[:, 0]
    members = np.maximum(np.bincount(cell, minlength=count), 1)
    by_alpha = np.bincount(cell, alpha + 1e-4, count)
    rgb = np.stack([np.bincount(cell, (alpha + 1e-4) * channel, count) for channel in linear.T], 1)
    rgb, alpha = rgb / np.maximum(by_alpha, 1e-9)[:, None], np.bincount(cell, alpha, count) / members
    face, bary, points = face[chosen], bary[chosen], points[chosen]
    normal, shading, along = _frame(part, normals, face, bary, uv[chosen])
    spacing = _spacing(points, normal)
    edge, edge_direction = _edge(part, points)
    openness = scene.openness(points, shading, RAYS, rng)
    if part.kind in ("hair", "brow", "lash"):  # cards have two sides; the lighter one is out
        other = scene.openness(points, -shading, RAYS // 2, rng)
        inside = (other**2).sum(1) > (openness**2).sum(1)
        openness[inside], normal[inside], shading[inside] = other[inside], -normal[inside], -shading[inside]
    open_share = np.linalg.norm(openness, axis=1)
    keep = (alpha > FAINTEST) & (open_share > (0.03 if part.kind in ("skin", "cloth", "shoe") else 0.002))
    if part.kind in ("skin", "cloth", "shoe"):
        above = scene.hits(points + normal * 1e-3, normal)
        keep &= ~((above["primID"] >= 0) & (above["tfar"] < THICKEST_LAYER) & (open_share < 0.25))
    row = {
        "points": points, "normals": normal, "shading": shading, "along": along, "rgb": rgb, "alpha": alpha,
        "spacing": spacing, "openness": openness, "edge": edge, "edge_direction": edge_direction,
        "weights": np.einsum("nc,nck->nk", bary, part.weights[part.faces[face]]),
        "kind": np.full(count, part.kind, "<U5"),
    }  # fmt: skip
    return {key: values[keep] for key, values in row.items()}


def _to_t_pose(person: Base, row: dict[str, Array]) -> Surfels:
    shares = row["weights"] / row["weights"].sum(1, keepdims=True)
    weights = bodies.dense(*bodies.strongest(shares, bodies.INFLUENCES))
    kind, spacing = row["kind"], row["spacing"]
    solid = np.isin(kind, ("skin", "cloth", "shoe"))
    means = bodies.unskin(person.bend, weights, row["points"] - INSET * solid[:, None] * row["normals"])
    turns = np.einsum("nk,kij->nij", weights, person.bend[:, :, :3])

    def back(vectors: Array, rows: Array | slice = slice(None)) -> Array:
        turned = np.einsum("nji,nj->ni", turns[rows], vectors[rows])
        return turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)

    normals, size = back(row["normals"]), OVERLAP * spacing
    quaternions, scales = tilt_quaternions(normals), np.stack([size, size, FLATNESS * size], 1)
    hem = solid & (row["edge"] < 1.5 * spacing)
    quaternions[hem] = _aligned(back(row["edge_direction"], hem), normals[hem])
    across = np.clip(0.55 * row["edge"][hem], 0.22 * size[hem], size[hem])
    scales[hem] = np.stack([1.15 * size[hem], across, FLATNESS * size[hem]], 1)
    strands = np.isin(kind, ("hair", "brow"))
    quaternions[strands] = _aligned(back(row["along"], strands), normals[strands])
    scales[strands] = size[strands, None] * np.array([1.5, 0.85, FLATNESS])
    opacities = np.clip(row["alpha"], 0.03, 0.98)
    thin = np.isin(kind, ("brow", "lash"))
    scales[thin, :2] *= 0.75
    opacities[thin] *= 0.6
    closed = (kind == "skin") | (solid & (row["edge"] > LINING))
    openness = back(row["openness"]) * np.linalg.norm(row["openness"], axis=1, keepdims=True)
    return Surfels(
        means,
        quaternions,
        scales,
        opacities,
        to_shown(row["rgb"]),
        back(row["shading"]),
        openness,
        weights,
        spacing,
        closed,
    )


def _aligned(along: Array, normals: Array) -> Array:
    """Quaternions (N, 4) whose first axis is along a direction in the surface and whose third is its normal."""
    along = along - normals * (along * normals).sum(1, keepdims=True)
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-12
    axes = np.stack([along, np.cross(normals, along), normals], 2)
    broken = np.abs(np.linalg.det(axes) - 1) > 1e-3
    axes[broken] = (
        Rotation.from_quat(tilt_quaternions(normals[broken]), scalar_first=True).as_matrix() if broken.any() else 0
    )
    return Rotation.from_matrix(axes).as_quat(scalar_first=True)


def _seen(scene: Scene, part: Part, normals: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which faces some light gets to, (F,)."""
    best = np.zeros(len(part.faces))
    for _ in range(3):
        bary = rng.dirichlet((1, 1, 1), len(part.faces))
        points = np.einsum("nc,ncd->nd", bary, part.vertices[part.faces])
        normal = np.einsum("nc,ncd->nd", bary, normals[part.faces])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
        for side in (1, -1) if part.kind in ("hair", "brow", "lash") else (1,):
            best = np.maximum(best, np.linalg.norm(scene.openness(points, side * normal, 40, rng), axis=1))
    return best > 0.004


def _density(part: Part, rng: np.random.Generator) -> Array:
    """Samples per area of each face, (F,)."""
    weight = np.array([DENSITY[region] for region in part.regions])
    uv = np.einsum("fsc,fcd->fsd", rng.dirichlet((1, 1, 1), (len(part.faces), 16)), part.uv)
    texels = look_up(part.texture, uv)
    if part.kind in ("skin", "cloth", "shoe"):
        weight *= 1 + BUSY * np.clip(texels[..., :3].std(1).mean(1) / 0.08, 0, 1)
    else:
        weight *= np.maximum((texels[..., 3] > FAINTEST).mean(1), 1e-4)
    if part.kind == "skin":  # the neck as fine as the head
        neck = part.weights[part.faces].mean(1)[:, [12, 15]].sum(1) > 0.25
        weight = np.where((part.regions == "body") & neck, np.maximum(weight, DENSITY["head"]), weight)
    if part.kind in ("cloth", "shoe"):
        at_hem = np.zeros(len(part.vertices), bool)
        at_hem[_boundary(part).ravel()] = True
        weight *= np.where(at_hem[part.faces].any(1), HEM, 1.0)
    return weight


def _areas(part: Part) -> Array:
    corners = part.vertices[part.faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def _spread(part: Part, seen: Array, weight: Array, count: int, rng: np.random.Generator):
    """Candidates on the part (face, barycentric, place), which of them are chosen, (count,), and whose cell each is in.

    As `hoi.body.people.sample_surface`; cells do not reach through thin layers.
    """
    faces = np.flatnonzero(seen)
    corners = part.vertices[part.faces[faces]]
    areas = (_areas(part) * weight)[faces]
    walk = z_order(corners.mean(1))
    ends, total = np.cumsum(areas[walk]), count * CANDIDATES
    at = (np.arange(total) + rng.uniform(size=total)) * ends[-1] / total
    step = np.minimum(np.searchsorted(ends, at, side="right"), len(walk) - 1)
    row = walk[step]
    along = np.clip((ends[step] - at) / np.maximum(areas[row], 1e-30), 0, 1)
    side, root = (rng.uniform() + np.arange(total) * 0.6180339887498949) % 1, np.sqrt(along)
    bary = np.stack([1 - root, root * (1 - side), root * side], 1)
    points = np.einsum("nc,ncd->nd", bary, corners[row])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[row]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    key = np.concatenate([points, 0.01 * normals], 1)
    chosen = np.arange(count) * CANDIDATES + CANDIDATES // 2
    for _ in range(RELAXATIONS):
        cell = KDTree(key[chosen]).query(key)[1]
        members = np.maximum(np.bincount(cell, minlength=count), 1)
        centres = np.stack([np.bincount(cell, axis, count) for axis in key.T], 1) / members[:, None]
        order = np.lexsort((np.linalg.norm(key - centres[cell], axis=1), cell))
        first, place = np.unique(cell[order], return_index=True)
        chosen[first] = order[place]
    return faces[row], bary, points, chosen, KDTree(key[chosen]).query(key)[1]


def _frame(part: Part, normals: Array, face: Array, bary: Array, uv: Array) -> tuple[Array, Array, Array]:
    """Normal of the surface, that of its normal map, and the direction of v, unit, (N, 3) each."""
    normal = np.einsum("nc,ncd->nd", bary, normals[part.faces[face]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    corners, texture = part.vertices[part.faces[face]], part.uv[face]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d1, d2 = texture[:, 1] - texture[:, 0], texture[:, 2] - texture[:, 0]
    determinant = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    determinant = np.where(np.abs(determinant) < 1e-12, 1e-12, determinant)[:, None]
    u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) / determinant
    v = (e2 * d1[:, :1] - e1 * d2[:, :1]) / determinant
    u -= normal * (u * normal).sum(1, keepdims=True)
    u, v = (axis / (np.linalg.norm(axis, axis=1, keepdims=True) + 1e-12) for axis in (u, v))
    if part.normal_map is None:
        return normal, normal, v
    tilt = look_up(part.normal_map, uv)[:, :3] * 2 - 1
    shading = tilt[:, :1] * u + tilt[:, 1:2] * v + tilt[:, 2:] * normal
    return normal, shading / (np.linalg.norm(shading, axis=1, keepdims=True) + 1e-12), v


def _spacing(points: Array, normals: Array) -> Array:
    """Mean distance to the nearest on the same side of the surface [m], (N,)."""
    distance, near = KDTree(points).query(points, k=min(16, len(points)))
    same = np.einsum("nkd,nd->nk", normals[near], normals) > 0.2
    same[:, 0] = False
    usable = np.sort(np.where(same, distance, np.inf), axis=1)[:, :6]
    some = np.isfinite(usable)
    mean = np.where(some, usable, 0).sum(1) / np.maximum(some.sum(1), 1)
    return np.where(some.sum(1) < 3, distance[:, 1], mean)


def _boundary(part: Part) -> NDArray[np.integer]:
    """Edges of one face alone, as vertices (E, 2), where vertices of the same place are one."""
    welded = np.unique(np.round(part.vertices, 6), axis=0, return_inverse=True)[1].ravel()[part.faces]
    edges = [np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]) for f in (welded, part.faces)]
    _, first, count = np.unique(np.sort(edges[0], 1), axis=0, return_index=True, return_counts=True)
    return edges[1][first[count == 1]]


def _edge(part: Part, points: Array) -> tuple[Array, Array]:
    """Distance to the mesh's edge [m], (N,), and its direction there, (N, 3)."""
    ends = part.vertices[_boundary(part)]
    if not len(ends):
        return np.full(len(points), np.inf), np.zeros((len(points), 3))
    across = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(across, axis=1)
    steps = np.maximum((length / 0.0015).astype(int), 1)
    row = np.repeat(np.arange(len(ends)), steps)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(steps) - steps, steps) + 0.5) / steps[row]
    distance, near = KDTree(ends[row, 0] + share[:, None] * across[row]).query(points)
    return distance, (across / (length[:, None] + 1e-12))[row[near]]
