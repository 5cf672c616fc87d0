"""What each part of a person weighs, and how it resists being turned: from the person's own volume.

The surface that the Gaussians cover is filled on a grid, each filled cell goes to the joint that moves the skin nearest
to it, and each part has the density that Dempster (1955) measured of it (as tabulated by Winter 2009, Biomechanics and
Motor Control of Human Movement, table 4.1). So a child is light and a heavy man heavy. People of the package weigh what
their bare bodies do; of others, clothes and hair count as body.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from hoi.body.people import MIN_GAUSSIANS, bare_skin
from hoi.body.skeleton import CHAINS, JOINT_COUNT
from hoi.data import Array, Body
from hoi.errors import RunError

DENSITY = {
    "head": (1110.0, 1110.0),
    "trunk": (1030.0,) * 6,
    "arm": (1070.0, 1130.0, 1160.0, 1160.0),
    "leg": (1050.0, 1090.0, 1100.0, 1100.0),
}
"""Of the parts that the joints of a chain move, from the body outwards [kg/m^3]."""
SMALLEST_CELL, LARGEST_CELL = 0.012, 0.15
"""Edge of the grid's cells [m]: finer tells no more, coarser nothing."""
SPACINGS = (1.7, 2.4, 3.4)
"""Cells this many times as large as the Gaussians are apart close the surface; the first that does is taken."""
PART = np.array([{10: 7, 11: 8, 22: 20, 23: 21}.get(joint, joint) for joint in range(JOINT_COUNT)])
"""The joint that each joint's skin weighs with: a foot is one piece, and a hand."""
INSIDE = CHAINS["trunk"][:4]
"""Joints that lie inside a body whose surface is closed."""


@dataclass(frozen=True)
class Masses:
    """Of the parts of a person, each moved by one joint; in the body's rest frame."""

    mass: Array
    """[kg], (24,); 0 where a joint has no part of its own."""
    centre: Array
    """Centre of mass [m], (24, 3)."""
    inertia: Array
    """About it [kg m^2], (24, 3, 3)."""


def densities() -> Array:
    """Of what each joint moves [kg/m^3], (24,)."""
    found = np.zeros(JOINT_COUNT)
    for chain, joints in CHAINS.items():
        found[list(joints)] = DENSITY[chain.split()[-1]]
    return found


def masses_of(body: Body) -> Masses:
    """The masses of a person's parts; 5% too heavy with 26,000 points on the skin, 10% with 8,000.

    Raises:
        RunError: the Gaussians are too far apart to enclose a volume.
    """
    bare = bare_skin(body) if len(body.cloud) >= MIN_GAUSSIANS else None
    skin, moved_by = (body.cloud.means, body.dominant_joints) if bare is None else bare
    skin = np.asarray(skin, dtype=np.float64)
    apart, _ = KDTree(skin).query(skin, k=2)
    spacing = float(np.percentile(apart[:, 1], 99))
    for times in SPACINGS:
        cell = max(SMALLEST_CELL, times * spacing)
        cells, volumes = _filled(skin, cell)
        depth = KDTree(cells).query(np.asarray(body.rest_joints)[list(INSIDE)])[0]
        if depth.max() < cell < LARGEST_CELL:
            break
    else:
        raise RunError(
            f"the person {body.name!r} has no volume: the surface of {len(skin)} Gaussians does not close; "
            "use stage.contact.limb=infinite, which needs none"
        )
    joint = moved_by[KDTree(skin).query(cells)[1]]
    weight, owner = densities()[joint] * volumes, PART[joint]
    mass = np.bincount(owner, weight, JOINT_COUNT).astype(np.float64)
    first = np.stack([np.bincount(owner, weight * along, JOINT_COUNT) for along in cells.T], axis=1)
    centre = np.where(mass[:, None] > 0, first / np.maximum(mass, 1e-300)[:, None], body.rest_joints)
    arms = cells - centre[owner]
    second = np.zeros((JOINT_COUNT, 3, 3))
    np.add.at(second, owner, weight[:, None, None] * (arms[:, :, None] * arms[:, None, :] + np.eye(3) * cell**2 / 12))
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    return Masses(mass, centre, inertia)


def _filled(surface: Array, cell: float) -> tuple[Array, Array]:
    """Centres (C, 3) [m] of the grid's cells in what `surface` (N, 3) encloses, and each one's volume in it [m^3].

    Of the cells that the surface goes through, half counts.
    """
    low = surface.min(axis=0) - 3 * cell
    index = np.floor((surface - low) / cell).astype(np.intp)
    wall = np.zeros(index.max(axis=0) + 4, dtype=bool)
    wall[tuple(index.T)] = True
    solid = ndimage.binary_fill_holes(ndimage.binary_closing(wall, np.ones((3, 3, 3))))
    assert solid is not None
    places = np.argwhere(solid)
    return low + (places + 0.5) * cell, cell**3 * np.where(wall[solid], 0.5, 1.0)
