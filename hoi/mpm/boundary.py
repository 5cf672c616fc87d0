"""What solid things do to the velocity of a grid node: planes (ground, walls) and capsules (the striking limb).

Quadratic B-splines stop a body about a cell before a solid node, so a plane is solid from half a cell below its surface
on: with nodes in the surface, as the ground z = 0 has, the first solid ones are a cell below, and a body comes to rest
with its surface within 0.1 dx of the plane (measured with 8 and 27 particles a cell). Grains and fluids have nothing
that holds them up a cell before such a node: they would sink by 0.7 to 1.0 cells. For them the nodes in the surface
hold too, and they come to rest within 0.3 cells above it.

Friction acts at the surface, not in the nodes that hold: the velocity at the surface is that of such a node, as much
above it as the surface is. The gradient is that of the particles near the plane, which leave its component along the
normal at the node (`slope`). Without it a ball that rolls turns about the held nodes, and w R / v is 0.81 to 0.94.

A capsule may be thinner than a cell, and its surface is to be met, not a place a cell before it. So it pushes the nodes
of those particles that are in it, wherever the nodes are: a ball 8 to 16 cells across, struck at 8 m/s by capsules of
0.3 to 3 cells radius, enters them by 0.1 dx at most and leaves at the same speed within 4%. Pushing the nodes that lie
in the capsule instead, it is felt from 1.0 to 1.4 dx before its surface, and one of 1 dx radius goes right through.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from collections.abc import Sequence

from hoi.compute import ti
from hoi.data import Material
from hoi.mpm.laws import LAWS

COULOMB, SLIP, STICK = 0.0, 1.0, 2.0
"""Kinds of contact as the kernels read them."""
PLANE_DEPTH = 0.5
"""Where a plane becomes solid for a body: this far below its surface [cells]."""
LOOSE_DEPTH = -0.01
"""The same for grains and fluids: just above, so that nodes in the surface hold [cells]."""


def plane_depth(materials: Sequence[Material]) -> float:
    """Where a plane becomes solid for an object of these materials, below its surface [cells]."""
    return LOOSE_DEPTH if all(LAWS[material.model].seeps for material in materials) else PLANE_DEPTH


@ti.func
def after_contact(relative, normal, friction, kind):
    """Velocity relative to a solid whose surface has this `normal`, after touching it; vectors of 4, the last unused.

    Coulomb: the tangential impulse is at most `friction` times the normal one, and only ever brakes.
    """
    approach = relative.dot(normal)
    after = relative
    if kind == STICK:
        after *= 0.0
    elif approach < 0.0:
        after = relative - approach * normal
        if kind == COULOMB:
            slip = ti.sqrt(after.dot(after))
            after *= ti.max(0.0, 1.0 + friction * approach / ti.max(slip, 1e-20))
    return after


@ti.func
def height_above(place, surface):
    """Of a place above where a plane becomes solid [m]; `surface` as in `hold_to_planes`."""
    return surface[3] + place[0] * surface[0] + place[1] * surface[1] + place[2] * surface[2]


@ti.func
def nearest_plane(place, reach, planes: ti.template()):
    """The plane nearest to `place`, -1 where none is within `reach` [m]."""
    nearest, least = -1, reach
    for i in range(planes.shape[0] // 2):
        height = height_above(place, planes[2 * i])
        if height < least and planes[2 * i + 1][0] != SLIP:
            nearest, least = i, height
    return nearest


@ti.func
def hold_to_planes(velocity, slope, place, planes: ti.template()):
    """Velocity of a node at `place` [m, from the window's origin] held by every plane it lies in.

    Each plane is two rows: unit normal and height of the window's origin above where the plane is solid [m]; then kind,
    friction and how deep below its surface it is solid [m]. `slope` is the derivative of the velocity along it [1/s].
    Nothing is sent back: how a body bounces is its own elasticity and loss. Sending back a share of a node's velocity
    makes energy (measured: a block leaves at up to twice its speed), and sending back only what is not the stress's
    doing changes nothing.
    """
    for i in range(planes.shape[0] // 2):
        surface, contact = planes[2 * i], planes[2 * i + 1]
        height = height_above(place, surface)
        if height < 0.0:
            normal = ti.Vector([surface[0], surface[1], surface[2], 0.0])
            to_surface = (contact[2] - height) * (slope - slope.dot(normal) * normal)
            velocity = after_contact(velocity + to_surface, normal, contact[1], contact[0]) - to_surface
    return velocity


@ti.func
def from_capsule(place, i, capsules: ti.template(), now):
    """The way to `place` from the nearest point of a capsule's axis, its length, and where that is along the axis."""
    start = capsules[4 * i] + now * capsules[4 * i + 2]  # the velocities' last place is 0
    axis = capsules[4 * i + 1] + now * capsules[4 * i + 3] - start
    away = place - start
    axis[3], away[3] = 0.0, 0.0
    along = ti.max(0.0, ti.min(1.0, away.dot(axis) / ti.max(axis.dot(axis), 1e-20)))
    away = away - along * axis  # whole vectors know no -=, see `hoi.mpm.kernels`
    return away, ti.sqrt(away.dot(away)), along


@ti.func
def in_a_capsule(place, capsules: ti.template(), now):
    """Whether `place` [m, from the window's origin] lies in one of the capsules; rows as in `hold_to_capsules`."""
    inside = 0
    for i in range(capsules.shape[0] // 4):
        _, distance, _ = from_capsule(place, i, capsules, now)
        if distance < capsules[4 * i][3]:
            inside = 1
    return inside


@ti.func
def nearest_capsule(place, capsules: ti.template(), now):
    """The capsule whose surface is nearest to `place` [m, from the window's origin]; -1 where there are none."""
    nearest, gap = -1, 1e30
    for i in range(capsules.shape[0] // 4):
        _, distance, _ = from_capsule(place, i, capsules, now)
        if distance - capsules[4 * i][3] < gap:
            nearest, gap = i, distance - capsules[4 * i][3]
    return nearest


@ti.func
def hold_to_capsule(velocity, place, i, capsules: ti.template(), now):
    """Velocity of a node at `place` that capsule `i` pushes, and how fast it came nearer before [m/s]."""
    away, distance, along = from_capsule(place, i, capsules, now)
    friction, start_velocity = capsules[4 * i + 1][3], capsules[4 * i + 2]
    own = start_velocity + along * (capsules[4 * i + 3] - start_velocity)
    relative = velocity - own
    approach = ti.sqrt(relative.dot(relative))
    if distance > 1e-3 * capsules[4 * i][3]:
        approach = -relative.dot(away / distance)
        relative = after_contact(relative, away / distance, friction, COULOMB)
    else:  # on the axis every way is out: carried along
        relative *= 0.0
    return own + relative, approach


@ti.func
def hold_to_capsules(velocity, place, capsules: ti.template(), now):
    """Velocity of a node at `place` [m, from the window's origin] with a particle in a capsule: the nearest pushes it.

    Each capsule is four rows: one end of its axis and its radius; the other end and its friction; the velocities of the
    two ends. `now` is the time since the ends were there [s].
    """
    nearest = nearest_capsule(place, capsules, now)
    if nearest >= 0:
        velocity, _ = hold_to_capsule(velocity, place, nearest, capsules, now)
    return velocity
