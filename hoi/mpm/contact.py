"""Bodies that meet on one grid: the kernel that lets two velocity fields exchange momentum where they touch.

Each body has its own velocity field, on nodes of one lattice (Bardenhagen, Brackbill & Sulsky 2000, The material-point
method for granular materials; Bardenhagen et al. 2001, An improved contact algorithm for the material point method).
Between p2g and the grid's update each node that both fields a and b have, gets

    n    = -g_a |g_a|^3 + g_b |g_b|^3, normalised: the normal from a to b. g = grad V, V the volume of a body at nodes
    gap  = min over b's particles q near the node of (x_q . n - r_q) - max over a's particles p of (x_p . n + r_p)
    v    = v_b - v_a, to be at least -max(gap, 0) / dt along n: two bodies come together within this step at the most
    J    = m (what is missing) n - friction, m = m_a m_b / (m_a + m_b); friction is at most mu |J_n|, and only brakes

and b gets J, a gets -J: momentum is exchanged exactly, and so is angular momentum, as both act at one place. Nothing
pulls: bodies separate as they like. No exchange adds energy.

The normal is a mean over the nodes around, each counting as V_a V_b: those in the surface where both have half their
volume count most. At a node it weighs the bodies by how flat they are there. Under the edge of a box that lies on a
larger one, the box's own gradient leans out by 45 degrees, but is smaller than that of the flat face: the face wins, as
it does among rigid bodies. Where edge meets edge, both lean to opposite sides, and the sum does not. A block 4 cells
across that slides on a slab without friction is slowed by 0.02 g, with the normal of each node alone by 0.03 to 0.04.

The gap is that of the surfaces, not of the fields, which overlap two cells before (Nairn, Hammerquist & Smith 2020, New
material point method contact algorithms): r is half the width of a particle's cube, as stretched along n. Two balls 8
cells across come apart with 0.86 to 0.90 of their speed where one leaves a wall with 0.95, at 16 cells 0.91 to 0.93
where it is 0.98. Holding only nodes half a cell inside the other body, as planes do, loses up to 0.7 of it once the
surfaces move through the grid; sending back what a penalty stores makes energy.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from hoi.compute import ti
from hoi.mpm.kernels import locate

NOWHERE = -1e30
"""An extent of no particle."""
SMOOTH = 3
"""Nodes to each side over which the normal is a mean."""
NEAR = 1.5
"""Particles so far from a node along each axis tell it where a surface is [cells]."""


@ti.func
def index_of(i, low: ti.template(), count: ti.template(), origin: ti.template(), shape: ti.template()):
    """The node of a window that is number `i` of the shared ones."""
    a = i // (count[1] * count[2]) + low[0] - origin[0]
    b = i % (count[1] * count[2]) // count[2] + low[1] - origin[1]
    k = i % count[2] + low[2] - origin[2]
    return (a * shape[1] + b) * shape[2] + k


@ti.func
def momentum_of(node, nodes, copies, grid: ti.template()):
    """Momentum and mass of a node, from the copies behind the first grid."""
    total = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for copy in range(1, copies + 1):
        total += grid[copy * nodes + node]
    return total


@ti.func
def weighed_gradient(node, nodes, copies, grid: ti.template(), dx, per_mass, shape: ti.template()):
    """g |g|^3 of the volume of a body at a node, by central differences; `per_mass` is its volume over its mass."""
    g = ti.Vector([0.0, 0.0, 0.0, 0.0])
    layer, row = shape[1] * shape[2], shape[2]
    g[0] = momentum_of(node + layer, nodes, copies, grid)[3] - momentum_of(node - layer, nodes, copies, grid)[3]
    g[1] = momentum_of(node + row, nodes, copies, grid)[3] - momentum_of(node - row, nodes, copies, grid)[3]
    g[2] = momentum_of(node + 1, nodes, copies, grid)[3] - momentum_of(node - 1, nodes, copies, grid)[3]
    g *= per_mass / dx**3
    square = g.dot(g)
    return square * ti.sqrt(square) * g


@ti.func
def sum_along(i, values: ti.template(), stride, length):
    """The sum over `SMOOTH` nodes to either side along one axis, which has `length` nodes `stride` apart."""
    place, total = i // stride % length, ti.Vector([0.0, 0.0, 0.0, 0.0])
    for step in range(ti.max(-SMOOTH, -place), ti.min(SMOOTH, length - 1 - place) + 1):
        total += values[i + step * stride]
    return total


@ti.func
def reach_out(p, side: ti.template(), size: ti.template(), x: ti.template(), f: ti.template(), volume: ti.template(),
              normals: ti.template(), extents: ti.template(), low: ti.template(), count: ti.template(), dx,
              inv_dx):  # fmt: skip
    """Moves the extents of a body at the nodes near particle p, along `side` times the normal."""
    position = x[p]
    bx, fx = locate(size, position[0], inv_dx, low[0])
    by, fy = locate(size, position[1], inv_dx, low[1])
    bz, fz = locate(size, position[2], inv_dx, low[2])
    if bx > -size and by > -size and bz > -size and bx < count[0] and by < count[1] and bz < count[2]:
        f0, f1, f2 = f[3 * p], f[3 * p + 1], f[3 * p + 2]
        half = 0.5 * ti.pow(volume[p], 1.0 / 3.0)
        for a, b, k in ti.ndrange(size, size, size):
            i, j, m = bx + a, by + b, bz + k
            far = ti.max(ti.abs(fx - a), ti.abs(fy - b), ti.abs(fz - k))
            if i >= 0 and j >= 0 and m >= 0 and i < count[0] and j < count[1] and m < count[2] and far < NEAR:
                node = (i * count[1] + j) * count[2] + m
                n = normals[node]
                if n[3] != 0.0:
                    along = dx * (n[0] * (fx - a) + n[1] * (fy - b) + n[2] * (fz - k))
                    n[3] = 0.0
                    wide = ti.sqrt(n.dot(f0) ** 2 + n.dot(f1) ** 2 + n.dot(f2) ** 2)
                    ti.atomic_max(extents[2 * node + ti.static(0 if side > 0 else 1)], side * along + half * wide)


@ti.kernel
def meet(
    copies: int, size: ti.template(), x_a: ti.types.ndarray(), f_a: ti.types.ndarray(), volume_a: ti.types.ndarray(),
    grid_a: ti.types.ndarray(), x_b: ti.types.ndarray(), f_b: ti.types.ndarray(), volume_b: ti.types.ndarray(),
    grid_b: ti.types.ndarray(), leaning: ti.types.ndarray(), normals: ti.types.ndarray(),
    extents: ti.types.ndarray(), origin_a: ti.types.vector(4, int), shape_a: ti.types.vector(4, int), per_mass_a: float,
    origin_b: ti.types.vector(4, int), shape_b: ti.types.vector(4, int), per_mass_b: float,
    low: ti.types.vector(4, int), count: ti.types.vector(4, int), friction: float, dt: float, dx: float,
    inv_dx: ti.f64,
):  # fmt: skip
    """What two bodies give each other in a step, at the nodes from `low` on, `count` along each axis.

    `normals` (nodes) and `extents` (2 nodes) are room to work in: n, or zeros where the two do not meet; how far a and
    b reach along n and against it, from the node.
    """
    shared = count[0] * count[1] * count[2]
    nodes_a, nodes_b = shape_a[0] * shape_a[1] * shape_a[2], shape_b[0] * shape_b[1] * shape_b[2]
    for i in range(shared):
        a, b = index_of(i, low, count, origin_a, shape_a), index_of(i, low, count, origin_b, shape_b)
        n = ti.Vector([0.0, 0.0, 0.0, 0.0])
        mass_a = momentum_of(a, nodes_a, copies, grid_a)[3]
        mass_b = momentum_of(b, nodes_b, copies, grid_b)[3]
        if mass_a > 0.0 and mass_b > 0.0:
            n = weighed_gradient(b, nodes_b, copies, grid_b, dx, per_mass_b, shape_b)
            n += -1.0 * weighed_gradient(a, nodes_a, copies, grid_a, dx, per_mass_a, shape_a)
            both = per_mass_a * mass_a * per_mass_b * mass_b / dx**6
            n *= both / ti.max(ti.sqrt(n.dot(n)), 1e-30)
        leaning[i] = n
        extents[2 * i], extents[2 * i + 1] = NOWHERE, NOWHERE
    for i in range(shared):
        normals[i] = sum_along(i, leaning, 1, count[2])
    for i in range(shared):
        leaning[i] = sum_along(i, normals, count[2], count[1])
    for i in range(shared):
        n = sum_along(i, leaning, count[1] * count[2], count[0])
        a, b = index_of(i, low, count, origin_a, shape_a), index_of(i, low, count, origin_b, shape_b)
        mass_a = momentum_of(a, nodes_a, copies, grid_a)[3]
        mass_b = momentum_of(b, nodes_b, copies, grid_b)[3]
        length = ti.sqrt(n.dot(n))
        n *= 1.0 / ti.max(length, 1e-30)
        n[3] = ti.cast(mass_a > 0.0 and mass_b > 0.0 and length > 1e-20, float)
        normals[i] = n
    for p in range(x_a.shape[0]):
        reach_out(p, 1.0, size, x_a, f_a, volume_a, normals, extents, low, count, dx, inv_dx)
    for p in range(x_b.shape[0]):
        reach_out(p, -1.0, size, x_b, f_b, volume_b, normals, extents, low, count, dx, inv_dx)
    for i in range(shared):
        n = normals[i]
        ahead, back = extents[2 * i], extents[2 * i + 1]
        if n[3] != 0.0 and ti.min(ahead, back) > 0.5 * NOWHERE:
            n[3] = 0.0
            a, b = index_of(i, low, count, origin_a, shape_a), index_of(i, low, count, origin_b, shape_b)
            of_a, of_b = momentum_of(a, nodes_a, copies, grid_a), momentum_of(b, nodes_b, copies, grid_b)
            mass_a, mass_b = of_a[3], of_b[3]
            relative = of_b * (1.0 / mass_b) - of_a * (1.0 / mass_a)
            relative[3] = 0.0
            apart = relative.dot(n)
            missing = -ti.max(-ahead - back, 0.0) / dt - apart
            if missing > 0.0:
                slip = relative - apart * n
                speed = ti.sqrt(slip.dot(slip))
                change = missing * n - ti.min(friction * missing / ti.max(speed, 1e-20), 1.0) * slip
                given = mass_a * (mass_b / (mass_a + mass_b)) * change
                grid_a[nodes_a + a] = grid_a[nodes_a + a] - given
                grid_b[nodes_b + b] = grid_b[nodes_b + b] + given
