"""When two clouds of Gaussians touch, where, and which way the touched surface faces.

The paper counts Gaussians nearer than d_contact to each other. That holds while they lie closer than that. A Gaussian
that stands alone stands for all the surface up to its neighbours, so that here it is a plate as wide as they are apart,
of its own proportions: flat Gaussians are flat plates, round ones blocks.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hoi.data import Array, GaussianCloud, SceneObject

FINE = 2.5
"""Gaussians whose neighbours are no farther off than so many d_contact are tested as points, as in the paper."""
NEIGHBOURS = 4
"""The spacing at a Gaussian is how far this many of the others are from it."""
FLAT = 0.5
"""A Gaussian whose thinnest axis is shorter than this share of its longest is a plate, not a block."""
PLATES = 8
"""Nearest plates that are looked at."""
PLANAR = 0.05
"""Gaussians lie in a plane if their variance across it is less than this share of that along it, either way."""
FEWEST = 6
"""Touched Gaussians that a plane is fitted to; where there are fewer, or they lie in a row, to their neighbours too."""
MATTER = 16
"""Particles of the filling around a touched Gaussian that say where the object's matter is."""
SHEET = 0.1
"""Where their middle is no farther in than this share of how far they are, the object is a sheet."""
AGREE = np.radians(5.0)
"""The surface's normal counts where it is farther than this from the direction of the centre of mass: it is not known
better, and a ball is not to be sent sideways by its sampling [rad]."""


@dataclass(frozen=True)
class Touch:
    """Made by `touch`."""

    fraction: float
    """Share of the limb's Gaussians that touch [-]."""
    gap: float
    """Smallest distance of the limb to the object [m]; inf where they are not near."""
    point: Array | None
    """Mean of where the object is touched [m], (3,); None where it is not."""
    points: Array
    """Where it is touched [m], (K, 3)."""
    on_limb: Array
    """Mean of what of the limb touches [m], (3,); nan where nothing does."""


@dataclass(frozen=True)
class Plates:
    """An object's Gaussians as plates, at one instant; see `plates_of`."""

    reach: Array
    """Half edges beyond d_contact, of a point 0 [m], (N, 3)."""
    axes: Array
    """Of each in the world, columns, (N, 3, 3)."""
    means: Array
    """At t = 0 [m], (N, 3)."""

    @property
    def farthest(self) -> float:
        """How far any of them goes beyond its centre [m]."""
        return float(np.linalg.norm(self.reach, axis=1).max(initial=0.0))

    def at(self, means: Array) -> "Plates":
        """Carried along with the object to where its Gaussians are (N, 3) [m]."""
        turn = Rotation.align_vectors(means - means.mean(axis=0), self.means - self.means.mean(axis=0))[0]
        return Plates(self.reach, turn.as_matrix() @ self.axes, means)

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Distance of points (M, 3) [m] to the nearest plate, (M,), and where on it that is, (M, 3)."""
        count = min(PLATES, len(self.means))
        rows = KDTree(self.means).query(points, k=count)[1].reshape(len(points), count)
        axes, reach = self.axes[rows], self.reach[rows]
        local = np.einsum("mkij,mki->mkj", axes, points[:, None] - self.means[rows])
        on_plate = np.clip(local, -reach, reach)
        distance = np.linalg.norm(local - on_plate, axis=-1)
        best = distance.argmin(axis=1)
        each = np.arange(len(points))
        row = rows[each, best]
        return distance[each, best], self.means[row] + np.einsum("mij,mj->mi", self.axes[row], on_plate[each, best])


def spacing(points: Array) -> Array:
    """How far apart neighbours are at each of points (N, 3) [m], (N,); 0 for a point without any."""
    if len(points) < 2:
        return np.zeros(len(points))
    return KDTree(points).query(points, k=min(NEIGHBOURS + 1, len(points)))[0][:, -1]


def plates_of(cloud: GaussianCloud, distance: float) -> Plates | None:
    """The plates of a cloud for d_contact = `distance` [m]; None where all its Gaussians are as good as points.

    A Gaussian without neighbours is as large as it is drawn, to one standard deviation.
    """
    means = np.asarray(cloud.means, np.float64)
    apart = spacing(means) if len(means) > 1 else 2 * np.asarray(cloud.scales).max(axis=1)
    coarse = apart > FINE * distance
    if not coarse.any():
        return None
    proportions = cloud.scales / cloud.scales.max(axis=1, keepdims=True)
    flat = proportions.min(axis=1) < FLAT
    half = np.where(coarse, np.where(flat, np.sqrt(0.5), 0.5) * apart, 0.0)  # between four flat ones is no hole
    axes = Rotation.from_quat(cloud.quaternions, scalar_first=True).as_matrix()
    return Plates(np.maximum(half[:, None] * proportions - distance, 0.0), axes, means)


def slack_of(skin: Array, distance: float) -> Array:
    """How far beyond d_contact each of a person's Gaussians (M, 3) [m] reaches, (M,) [m]: half their spacing."""
    apart = spacing(skin)
    return np.where(apart > FINE * distance, np.maximum(0.5 * apart - distance, 0.0), 0.0)


def touch(
    limb: Array, surface: Array, distance: float, plates: Plates | None = None, slack: Array | float = 0.0
) -> Touch:
    """How a joint's Gaussians touch the object's.

    Args:
        limb: (M, 3) [m]. surface: (N, 3) [m]. distance: d_contact [m].
        plates: of the object, now, where its Gaussians are too far apart to be points.
        slack: by how much each of the limb's Gaussians may be farther off, see `slack_of` [m], (M,).
    """
    beyond = distance + float(np.max(slack, initial=0.0)) + (0.0 if plates is None else plates.farthest)
    low, high = limb.min(axis=0) - beyond, limb.max(axis=0) + beyond
    near = np.all((surface >= low) & (surface <= high), axis=1)
    if not near.any():  # the boxes do not overlap
        return Touch(0.0, np.inf, None, np.zeros((0, 3)), np.full(3, np.nan))
    found = surface[near]
    if plates is None and not np.any(slack):
        to_object, _ = KDTree(found).query(limb)
        touches = to_object <= distance
        to_limb, _ = KDTree(limb).query(found, distance_upper_bound=distance)
        points = found[np.isfinite(to_limb)]
    else:
        everywhere = np.zeros_like(found)
        here = Plates(everywhere, np.broadcast_to(np.eye(3), (len(found), 3, 3)), found)
        if plates is not None:
            here = Plates(plates.reach[near], plates.axes[near], found)
        to_object, closest = here.nearest(limb)
        to_object = np.maximum(to_object - slack, 0.0)
        touches = to_object <= distance
        points = closest[touches]
    return Touch(
        float(touches.mean()),
        float(to_object.min()),
        points.mean(axis=0) if len(points) else None,
        points,
        limb[touches].mean(axis=0) if touches.any() else np.full(3, np.nan),
    )


def contact_normal(
    found: Touch, particles: Array, thing: SceneObject, com: Array, closing: Array, to_com: bool
) -> Array:
    """n: unit, into the object, (3,).

    The surface's is that of the plane through the touched Gaussians; where they lie in none (an edge, a corner), away
    from the object's matter around them. A sheet has no matter behind its surface: there n leads away from the limb.

    Args:
        particles: all of the object's, now [m], (P, 3).
        com: its centre of mass, now [m], (3,).
        closing: V_human - V_obj [m/s], (3,): the way of a limb that touches the centre of mass itself.
        to_com: n leads to the centre of mass whatever the surface, as in the paper.
    """
    assert found.point is not None
    towards_com = com - found.point
    length = float(np.linalg.norm(towards_com))
    if length < 1e-6:
        towards_com, length = closing, max(float(np.linalg.norm(closing)), 1e-12)
    towards_com = towards_com / length
    if to_com:
        return towards_com
    normal = surface_normal(found, particles, thing)
    return towards_com if normal @ towards_com >= np.cos(AGREE) else normal


def surface_normal(found: Touch, particles: Array, thing: SceneObject) -> Array:
    """The touched surface's normal, into the object, (3,)."""
    assert found.point is not None
    count = len(thing.cloud)
    gaussians, matter = particles[:count], particles[count:] if len(particles) > count else particles
    apart, rows = KDTree(matter).query(found.points, k=min(MATTER, len(matter)))
    inwards = (matter[rows.reshape(len(found.points), -1)].mean(axis=1) - found.points).mean(axis=0)
    least = SHEET * float(apart.mean())
    from_limb = found.point - found.on_limb

    from_point = np.linalg.norm(gaussians - found.point, axis=1)
    wide = max(float(np.linalg.norm(found.points - found.point, axis=1).max()), np.sort(from_point)[: 2 * FEWEST][-1])
    normal = plane_normal(found.points)
    if normal is None:  # too few of them, or in a row
        normal = plane_normal(gaussians[from_point <= wide])
    if normal is None:
        normal = inwards if np.linalg.norm(inwards) > least else from_limb
    side = normal @ inwards if abs(normal @ inwards) > least else normal @ from_limb
    return normal * np.sign(side or 1.0) / max(float(np.linalg.norm(normal)), 1e-12)


def plane_normal(points: Array) -> Array | None:
    """Normal of the plane in which points (K, 3) lie, of either sign; None where they lie in none, or in many."""
    if len(points) < FEWEST:
        return None
    spread, axes = np.linalg.eigh(np.cov(points.T, bias=True))
    planar = spread[0] < PLANAR * spread[1] and spread[1] > PLANAR * spread[2]
    return axes[:, 0] if planar else None
