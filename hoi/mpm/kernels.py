"""MLS-MPM in Taichi: particle to grid, grid, grid to particle, for one window of the grid.

The scheme is Hu et al. 2018, A Moving Least Squares Material Point Method, section 4, with APIC transfers (Jiang et al.
2015); `tests/mpm/mpm_reference.py` is the same in NumPy and is to be read first. With D = dx^2/4 for quadratic and
dx^2/3 for cubic B-splines, one step is

    p2g   m_i = sum_p w_ip m_p,   (m v)_i = sum_p w_ip [m_p v_p + (m_p C_p - dt V_p tau(F_p) / D) (x_i - x_p)]
    grid  v_i = (m v)_i / m_i + dt g, then planes and capsules (`hoi.mpm.boundary`)
    g2p   v_p = sum_i w_ip v_i,   C_p = sum_i w_ip v_i (x_i - x_p)^T / D,   x_p += dt v_p,   F_p = (I + dt C_p) F_p,
          and where the material flows, F_p = return_map(F_p)

The grid is a flat buffer of nodes (momentum, later velocity; mass) for the window `origin`, `shape` [nodes] of the
world lattice x_i = i dx. Nothing else of the world has nodes. Float types follow default_fp, except that positions are
float64 in both precisions: one step moves a particle by less than the float32 spacing at a metre.

Vectors in memory have four places, matrices are three such columns, and on a CPU Taichi is told to keep vectors whole
(`real_matrix_scalarize=False`): each then is one vector register (measured: a step takes 0.55 of the time that it took
with vectors of three in single places). Taichi 1.7 crashes there on casts, logarithms, unary minus and -= of whole
vectors and on vectors of three in memory, so these are written place by place or another way.

With one thread many steps are one launch. With more each thread scatters its own share of the particles into its own
copy of the grid, so nothing is atomic and sums have a fixed order for a given number of threads. On a GPU each particle
is a thread and one grid takes atomics.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import functools
from collections.abc import Sequence

from hoi.compute import CPU_TASK, ti
from hoi.mpm.boundary import hold_to_capsules, hold_to_planes, in_a_capsule, nearest_plane
from hoi.mpm.damping import LEAST_ENERGY, STIFFENING
from hoi.mpm.exchange import exchange_in_turn
from hoi.mpm.law import LAM, MU, Kernels
from hoi.mpm.laws import LAWS
from hoi.mpm.tensor_kernels import epsilon

DONE, AT_RIM, INVERTED, STOP = 0, 1, 2, 3
"""Places in `status`: steps done; a particle is at the rim of the window; some J <= 0; either, once a step is over."""
NOT_FINITE = 1e30
"""Stands for infinity, which fast arithmetic takes not to exist."""


def flow(models: Sequence[str]) -> bool:
    """Whether one of the laws flows."""
    return any(LAWS[model].flows for model in models)


def keep_total(models: Sequence[str]) -> bool:
    """Whether one of the laws keeps the total F beside the elastic one."""
    return any(LAWS[model].keeps_total for model in models)


@functools.cache
def functions(model: str) -> Kernels:
    """Of the law of that name."""
    return LAWS[model].kernels()


@ti.func
def zero():
    return ti.Vector([0.0, 0.0, 0.0, 0.0])


@ti.func
def weights(size: ti.template(), fx):
    """B-spline of one axis at its `size` nodes, 3 (quadratic) or 4 (cubic); fx: distance to the first [cells]."""
    w = ti.Vector([0.0 for _ in range(size)])
    if ti.static(size == 3):
        w[0] = 0.5 * (1.5 - fx) ** 2
        w[1] = 0.75 - (fx - 1.0) ** 2
        w[2] = 0.5 * (fx - 0.5) ** 2
    else:
        t = fx - 1.0
        w[0] = (1.0 - t) ** 3 / 6.0
        w[1] = (0.5 * t - 1.0) * t**2 + 2.0 / 3.0
        w[3] = t**3 / 6.0
        w[2] = 1.0 - w[0] - w[1] - w[3]  # to float precision the sum must not be biased: it is a gain of momentum
    return w


@ti.func
def inverse_inertia(size: ti.template()):
    """dx^2 / D."""
    return ti.static(4.0 if size == 3 else 3.0)


@ti.func
def locate(size: ti.template(), position, inv_dx, origin):
    """First node of one axis that a particle touches, counted in the window, and its distance from it [cells]."""
    scaled = position * inv_dx
    first = ti.floor(scaled - 0.5 * (size - 2), ti.i32)
    return first - origin, ti.cast(scaled - first, float)


@ti.func
def columns(m):
    """The columns of a 3x3 matrix as vectors of 4."""
    return (
        ti.Vector([m[0, 0], m[1, 0], m[2, 0], 0.0]),
        ti.Vector([m[0, 1], m[1, 1], m[2, 1], 0.0]),
        ti.Vector([m[0, 2], m[1, 2], m[2, 2], 0.0]),
    )


@ti.func
def matrix(a, b, c):
    """The 3x3 matrix of these columns."""
    return ti.Matrix([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]])


@ti.func
def parameters_of(materials: ti.template(), row):
    """The `PARAMETERS` numbers of a material's law."""
    a, b = materials[3 * row], materials[3 * row + 1]
    return ti.Vector([a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]])


@ti.func
def add(grid: ti.template(), node, contribution, atomic: ti.template()):
    if ti.static(atomic):
        ti.atomic_add(grid[node], contribution)
    else:
        grid[node] = grid[node] + contribution


@ti.func
def stress_columns(model: ti.template(), f0, f1, f2, j, c0, c1, c2, p, hardening, tolerance):
    """The columns of tau."""
    t0, t1, t2 = zero(), zero(), zero()
    if ti.static(functions(model).stress_columns):
        t0, t1, t2 = ti.static(functions(model)).stress_columns(f0, f1, f2, j, p)
    else:
        t0, t1, t2 = columns(
            ti.static(functions(model)).stress(matrix(f0, f1, f2), j, matrix(c0, c1, c2), p, hardening, tolerance)
        )
    return t0, t1, t2


@ti.func
def stiffness(model: ti.template(), f, j, p, hardening):
    """M [Pa], an upper bound of rho_0 c^2 for every wave in the deformed state: the law's own and the norm of tau.

    Where a body is so strained that its stress is not small beside the law's bound, the grid is stiffer than the
    material, as forces change with where in its cell a particle is. Measured, the norm of tau is enough to make up for
    that (`hoi.mpm.stability`).
    """
    m = ti.static(functions(model)).stiffness(f, j, p, hardening)
    at_rest = ti.Matrix.zero(float, 3, 3)
    return m + ti.static(functions(model)).stress(f, j, at_rest, p, hardening, ti.static(epsilon())).norm()


@ti.func
def played(f0, f1, f2, j, p, materials: ti.template(), row, play):
    """The factor s on the stress of a solid that loses energy, and where its play is (`hoi.mpm.damping`)."""
    least, steepness = materials[3 * row + 2][2], materials[3 * row + 2][3]
    s, kept = 1.0, 0.0
    if steepness > 0.0:
        b0 = f0[0] * f0 + f1[0] * f1 + f2[0] * f2 - ti.Vector([1.0, 0.0, 0.0, 0.0])
        b1 = f0[1] * f0 + f1[1] * f1 + f2[1] * f2 - ti.Vector([0.0, 1.0, 0.0, 0.0])
        b2 = f0[2] * f0 + f1[2] * f1 + f2[2] * f2 - ti.Vector([0.0, 0.0, 1.0, 0.0])
        sheared = b0.dot(b0) + b1.dot(b1) + b2.dot(b2)
        psi = 0.25 * p[MU] * sheared + 0.5 * ti.max(p[LAM], 0.0) * (j - 1.0) ** 2
        level = steepness * ti.log(1.0 + psi / (LEAST_ENERGY * p[MU]))
        s = ti.min(ti.max(1.0 - play + level, least), 1.0)
        kept = 1.0 - s + level
    return s, kept


@ti.func
def scatter(p, first, atomic: ti.template(), damped: ti.template(), size: ti.template(), models: ti.template(),
            x: ti.template(), v: ti.template(), c: ti.template(), f: ti.template(), hardening: ti.template(),
            play: ti.template(), mass: ti.template(), volume: ti.template(), region: ti.template(),
            materials: ti.template(), grid: ti.template(), slope: ti.template(), status: ti.template(), near,
            planes: ti.template(), capsules: ti.template(), touched: ti.template(), now, dt, dx, inv_dx, tolerance,
            origin: ti.template(), shape: ti.template()):  # fmt: skip
    """p2g of one particle into the grid copy that starts at node `first`; marks its nodes where it is in a capsule."""
    position = x[p]
    bx, fx = locate(size, position[0], inv_dx, origin[0])
    by, fy = locate(size, position[1], inv_dx, origin[1])
    bz, fz = locate(size, position[2], inv_dx, origin[2])
    c0, c1, c2 = c[3 * p], c[3 * p + 1], c[3 * p + 2]
    f0, f1, f2 = f[3 * p], f[3 * p + 1], f[3 * p + 2]
    j = matrix(f0, f1, f2).determinant()
    if j > 0.0:  # pyright: ignore[reportOptionalOperand]
        row = region[ti.min(p, region.shape[0] - 1)]
        t0, t1, t2 = zero(), zero(), zero()
        for i in ti.static(range(len(models))):
            if ti.static(len(models) == 1) or materials[3 * row + 2][1] == i:
                t0, t1, t2 = stress_columns(
                    models[i], f0, f1, f2, j, c0, c1, c2, parameters_of(materials, row),
                    hardening[ti.min(p, hardening.shape[0] - 1)], tolerance,
                )  # fmt: skip
        if ti.static(damped):
            s, play[p] = played(f0, f1, f2, j, parameters_of(materials, row), materials, row, play[p])
            t0, t1, t2 = s * t0, s * t1, s * t2
        inertia = mass[p] * dx
        force = -dt * volume[p] * inverse_inertia(size) / dx
        # Momentum per cell along each axis, then at the first node; the last place carries the mass.
        a0, a1, a2 = inertia * c0 + force * t0, inertia * c1 + force * t1, inertia * c2 + force * t2
        at_first = mass[p] * v[p] - fx * a0 - fy * a1 - fz * a2
        a0[3], a1[3], a2[3], at_first[3] = 0.0, 0.0, 0.0, mass[p]
        wx, wy, wz = weights(size, fx), weights(size, fy), weights(size, fz)
        for a, b in ti.static(ti.ndrange(size, size)):
            w = wx[a] * wy[b]
            value, change = w * (at_first + a * a0 + b * a1), w * a2
            line = first + ((bx + a) * shape[1] + by + b) * shape[2] + bz
            for k in ti.static(range(size)):
                add(grid, line + k, wz[k] * (value + k * change), atomic)
        if near != 0:
            place = dx * ti.Vector([fx + bx, fy + by, fz + bz, 0.0])
            if in_a_capsule(place, capsules, now) != 0:
                for a, b, k in ti.ndrange(size, size, size):
                    touched[((bx + a) * shape[1] + by + b) * shape[2] + bz + k] = 1
            plane = nearest_plane(place, 0.5 * size * dx, planes)
            if plane >= 0:
                normal = planes[2 * plane]
                along = mass[p] * (normal[0] * c0 + normal[1] * c1 + normal[2] * c2)
                for a, b, k in ti.ndrange(size, size, size):
                    node = first + ((bx + a) * shape[1] + by + b) * shape[2] + bz + k
                    add(slope, node, wx[a] * wy[b] * wz[k] * along, atomic)
    else:
        status[INVERTED] = 1


@ti.func
def update_node(node, nodes, copies, near, grid: ti.template(), slope: ti.template(), planes: ti.template(),
                capsules: ti.template(), touched: ti.template(), dt, dx, gravity: ti.template(), now,
                shape: ti.template()):  # fmt: skip
    """Sums and clears the copies of a node, divides by its mass, adds gravity and holds it to what is solid.

    The velocity goes to the first grid, the copies lie behind it. Returns the momentum that capsules gave.
    """
    total = zero()
    for copy in range(1, copies + 1):
        total += grid[copy * nodes + node]
        grid[copy * nodes + node] = zero()
    turning = zero()
    if near != 0:
        for copy in range(1, copies + 1):
            turning += slope[copy * nodes + node]
            slope[copy * nodes + node] = zero()
    given = zero()
    mass = total[3]
    if mass > 0.0:
        velocity = total * (1.0 / mass)
        velocity[3] = 0.0
        for a in ti.static(range(3)):
            velocity[a] += dt * ti.cast(gravity[a], float)
        if near != 0:
            layer = shape[1] * shape[2]
            place = dx * ti.Vector([
                ti.cast(node // layer, float), ti.cast(node % layer // shape[2], float),
                ti.cast(node % shape[2], float), 0.0,
            ])  # fmt: skip
            pushed = velocity
            if touched[node] != 0:
                touched[node] = 0
                pushed = hold_to_capsules(velocity, place, capsules, now)
                given = mass * (pushed - velocity)
            velocity = hold_to_planes(pushed, turning * (1.0 / mass), place, planes)
        total = velocity
    grid[node] = total
    return given


@ti.func
def gather(p, size: ti.template(), models: ti.template(), x: ti.template(), v: ti.template(), c: ti.template(),
           f: ti.template(), total: ti.template(), hardening: ti.template(), region: ti.template(),
           materials: ti.template(), grid: ti.template(), status: ti.template(), dt, dx, inv_dx, drift: ti.template(),
           origin: ti.template(), shape: ti.template()):  # fmt: skip
    """g2p of one particle, and its motion and deformation over the step."""
    position = x[p]
    bx, fx = locate(size, position[0], inv_dx, origin[0])
    by, fy = locate(size, position[1], inv_dx, origin[1])
    bz, fz = locate(size, position[2], inv_dx, origin[2])
    wx, wy, wz = weights(size, fx), weights(size, fy), weights(size, fz)
    velocity, c0, c1, c2 = zero(), zero(), zero(), zero()
    for a in ti.static(range(size)):
        plane, plane_y, plane_z = zero(), zero(), zero()
        for b in ti.static(range(size)):
            row = ((bx + a) * shape[1] + by + b) * shape[2] + bz
            line, line_z = zero(), zero()
            for k in ti.static(range(size)):
                node = grid[row + k]
                line += wz[k] * node
                line_z += (wz[k] * (k - fz)) * node
            plane += wy[b] * line
            plane_y += (wy[b] * (b - fy)) * line
            plane_z += wy[b] * line_z
        velocity += wx[a] * plane
        c0 += (wx[a] * (a - fx)) * plane
        c1 += wx[a] * plane_y
        c2 += wx[a] * plane_z
    scale = inverse_inertia(size) / dx
    c0 *= scale
    c1 *= scale
    c2 *= scale
    f0, f1, f2 = f[3 * p], f[3 * p + 1], f[3 * p + 2]
    f0 += dt * (f0[0] * c0 + f0[1] * c1 + f0[2] * c2)
    f1 += dt * (f1[0] * c0 + f1[1] * c1 + f1[2] * c2)
    f2 += dt * (f2[0] * c0 + f2[1] * c1 + f2[2] * c2)
    if ti.static(flow(models)):
        row = region[ti.min(p, region.shape[0] - 1)]
        for i in ti.static(range(len(models))):
            if ti.static(LAWS[models[i]].flows):
                if ti.static(len(models) == 1) or materials[3 * row + 2][1] == i:
                    elastic, hard = ti.static(functions(models[i])).return_map(
                        matrix(f0, f1, f2), hardening[p], parameters_of(materials, row), dt
                    )
                    hardening[p] = hard
                    f0, f1, f2 = columns(elastic)
    if ti.static(keep_total(models)):
        for a in ti.static(range(3)):
            g = total[3 * p + a]
            total[3 * p + a] = g + dt * (g[0] * c0 + g[1] * c1 + g[2] * c2)
    f[3 * p], f[3 * p + 1], f[3 * p + 2] = f0, f1, f2
    c[3 * p], c[3 * p + 1], c[3 * p + 2] = c0, c1, c2
    v[p] = velocity
    step = ti.cast(dt, ti.f64)
    px = position[0] + step * velocity[0] - drift[0]
    py = position[1] + step * velocity[1] - drift[1]
    pz = position[2] + step * velocity[2] - drift[2]
    x[p] = ti.Vector([px, py, pz, 0.0])
    ix, iy, iz = px * inv_dx - origin[0], py * inv_dx - origin[1], pz * inv_dx - origin[2]
    least, greatest = ti.min(ix, iy, iz), ti.max(ix - shape[0], iy - shape[1], iz - shape[2])
    if not (least > 0.5 * size and greatest < -0.5 * size - 1.0):  # also when not finite
        status[AT_RIM] = 1


@ti.kernel
def advance_serial(
    steps: int,
    near: int,
    damped: ti.template(),
    size: ti.template(),
    models: ti.template(),
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    c: ti.types.ndarray(),
    f: ti.types.ndarray(),
    total: ti.types.ndarray(),
    hardening: ti.types.ndarray(),
    play: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    region: ti.types.ndarray(),
    materials: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    planes: ti.types.ndarray(),
    capsules: ti.types.ndarray(),
    touched: ti.types.ndarray(),
    given: ti.types.ndarray(),
    status: ti.types.ndarray(),
    gravity: ti.types.vector(4, ti.f64),
    drift: ti.types.vector(4, ti.f64),
    dt: float,
    dx: float,
    inv_dx: ti.f64,
    tolerance: float,
    origin: ti.types.vector(4, int),
    shape: ti.types.vector(4, int),
    coupled: ti.template(),
    parts: ti.types.ndarray(),
    body: ti.types.ndarray(),
):
    """Up to `steps` steps in one launch and one serial task; fewer when a particle comes to the rim or is inverted.

    `given` (1) gets the momentum that capsules gave [N s]; where they are `coupled` to parts it is in `body`, see
    `hoi.mpm.exchange`, and they have moved on with each step. The copy of the grid is clear before, and after unless a
    particle is inverted.
    """
    nodes = shape[0] * shape[1] * shape[2]
    for _ in range(1):
        done, now = 0, dt
        pushed = zero()
        while done < steps and status[AT_RIM] == 0 and status[INVERTED] == 0:
            if ti.static(not coupled):
                now = (done + 1.0) * dt
            for p in range(x.shape[0]):
                scatter(p, nodes, False, damped, size, models, x, v, c, f, hardening, play, mass, volume, region,
                        materials, grid, slope, status, near, planes, capsules, touched, now, dt, dx, inv_dx, tolerance,
                        origin, shape)  # fmt: skip
            if ti.static(coupled):
                exchange_in_turn(nodes, 1, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
            for node in range(nodes):
                pushed += update_node(node, nodes, 1, near, grid, slope, planes, capsules, touched, dt, dx, gravity,
                                      now, shape)  # fmt: skip
            for p in range(x.shape[0]):
                gather(p, size, models, x, v, c, f, total, hardening, region, materials, grid, status, dt, dx, inv_dx,
                       drift, origin, shape)  # fmt: skip
            done += 1
        given[0] = pushed
        status[DONE] = done


@ti.kernel
def begin_step(
    number: int,
    near: int,
    shares: int,
    copies: int,
    atomic: ti.template(),
    damped: ti.template(),
    size: ti.template(),
    models: ti.template(),
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    c: ti.types.ndarray(),
    f: ti.types.ndarray(),
    total: ti.types.ndarray(),
    hardening: ti.types.ndarray(),
    play: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    region: ti.types.ndarray(),
    materials: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    planes: ti.types.ndarray(),
    capsules: ti.types.ndarray(),
    touched: ti.types.ndarray(),
    given: ti.types.ndarray(),
    status: ti.types.ndarray(),
    gravity: ti.types.vector(4, ti.f64),
    drift: ti.types.vector(4, ti.f64),
    dt: float,
    dx: float,
    inv_dx: ti.f64,
    tolerance: float,
    origin: ti.types.vector(4, int),
    shape: ti.types.vector(4, int),
):
    """The first half of step `number` of a launch in parallel, or nothing once status[STOP] is set: p2g.

    On a CPU each thread takes one share of the particles and scatters into its own copy of the grid; on a GPU each
    particle is a share and one copy takes atomics. Copies of the grid are clear before.
    """
    nodes = shape[0] * shape[1] * shape[2]
    share_size = (x.shape[0] + shares - 1) // shares
    ti.loop_config(block_dim=128 if ti.static(atomic) else CPU_TASK)
    for i in range(shares if ti.static(atomic) else shares * CPU_TASK):
        share = i if ti.static(atomic) else i // CPU_TASK
        if (ti.static(atomic) or i % CPU_TASK == 0) and status[STOP] == 0:
            for p in range(share * share_size, ti.min((share + 1) * share_size, x.shape[0])):
                scatter(p, (1 + share % copies) * nodes, atomic, damped, size, models, x, v, c, f, hardening, play,
                        mass, volume, region, materials, grid, slope, status, near, planes, capsules, touched,
                        (number + 1.0) * dt, dt, dx, inv_dx, tolerance, origin, shape)  # fmt: skip


@ti.kernel
def end_step(
    last: int,
    number: int,
    near: int,
    shares: int,
    copies: int,
    atomic: ti.template(),
    damped: ti.template(),
    size: ti.template(),
    models: ti.template(),
    x: ti.types.ndarray(),
    v: ti.types.ndarray(),
    c: ti.types.ndarray(),
    f: ti.types.ndarray(),
    total: ti.types.ndarray(),
    hardening: ti.types.ndarray(),
    play: ti.types.ndarray(),
    mass: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    region: ti.types.ndarray(),
    materials: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    slope: ti.types.ndarray(),
    planes: ti.types.ndarray(),
    capsules: ti.types.ndarray(),
    touched: ti.types.ndarray(),
    given: ti.types.ndarray(),
    status: ti.types.ndarray(),
    gravity: ti.types.vector(4, ti.f64),
    drift: ti.types.vector(4, ti.f64),
    dt: float,
    dx: float,
    inv_dx: ti.f64,
    tolerance: float,
    origin: ti.types.vector(4, int),
    shape: ti.types.vector(4, int),
):
    """The second half: the grid, and g2p. `given` (copies) sums the momentum that capsules gave [N s]; copies of the
    grid are clear after. The step is over with the `last` of the objects that share a status."""
    nodes = shape[0] * shape[1] * shape[2]
    share_size, slab = (x.shape[0] + shares - 1) // shares, (nodes + shares - 1) // shares
    ti.loop_config(block_dim=128 if ti.static(atomic) else CPU_TASK)
    for i in range(nodes if ti.static(atomic) else shares * CPU_TASK):
        if ti.static(atomic):
            pushed = update_node(i, nodes, copies, near, grid, slope, planes, capsules, touched, dt, dx, gravity,
                                 (number + 1.0) * dt, shape)  # fmt: skip
            if near != 0:
                ti.atomic_add(given[0], pushed)
        elif i % CPU_TASK == 0:
            share = i // CPU_TASK
            pushed = given[share]
            for node in range(share * slab, ti.min((share + 1) * slab, nodes)):
                pushed += update_node(node, nodes, copies, near, grid, slope, planes, capsules, touched, dt, dx,
                                      gravity, (number + 1.0) * dt, shape)  # fmt: skip
            given[share] = pushed
    ti.loop_config(block_dim=128 if ti.static(atomic) else CPU_TASK)
    for i in range(shares if ti.static(atomic) else shares * CPU_TASK):
        share = i if ti.static(atomic) else i // CPU_TASK
        if (ti.static(atomic) or i % CPU_TASK == 0) and status[STOP] == 0:
            for p in range(share * share_size, ti.min((share + 1) * share_size, x.shape[0])):
                gather(p, size, models, x, v, c, f, total, hardening, region, materials, grid, status, dt, dx,
                       inv_dx, drift, origin, shape)  # fmt: skip
    if last != 0 and status[STOP] == 0:
        status[STOP] = status[AT_RIM] + status[INVERTED]
        status[DONE] += 1


@ti.kernel
def look(
    shares: int, models: ti.template(), x: ti.types.ndarray(), v: ti.types.ndarray(), c: ti.types.ndarray(),
    f: ti.types.ndarray(), hardening: ti.types.ndarray(), region: ti.types.ndarray(), materials: ti.types.ndarray(),
    seen: ti.types.ndarray(), dx: float,
):  # fmt: skip
    """What the next time step and window depend on, a pair of rows of `seen` (2 shares) for each share of particles.

    (least x, y, z; greatest speed^2) and (greatest x, y, z; greatest stiffness / density); a speed^2 of NOT_FINITE says
    that something is not finite. The speed is that of a particle's nodes, |v| + dx/2 |C|: after a crash C alone may
    turn a particle inside out within a step.
    """
    size = (x.shape[0] + shares - 1) // shares
    ti.loop_config(block_dim=1)
    for share in range(shares):
        low = ti.Vector([1e300, 1e300, 1e300, 0.0], ti.f64)
        high = ti.Vector([-1e300, -1e300, -1e300, 0.0], ti.f64)
        for p in range(share * size, ti.min((share + 1) * size, x.shape[0])):
            position, velocity = x[p], v[p]
            deformation = matrix(f[3 * p], f[3 * p + 1], f[3 * p + 2])
            row = region[ti.min(p, region.shape[0] - 1)]
            stiff = 0.0
            for i in ti.static(range(len(models))):
                if ti.static(len(models) == 1) or materials[3 * row + 2][1] == i:
                    stiff = stiffness(
                        models[i], deformation, deformation.determinant(), parameters_of(materials, row),
                        hardening[ti.min(p, hardening.shape[0] - 1)],
                    ) / materials[3 * row + 2][0]  # fmt: skip
            stiff *= 1.0 + STIFFENING * materials[3 * row + 2][3]
            c0, c1, c2 = c[3 * p], c[3 * p + 1], c[3 * p + 2]
            spread = 0.5 * dx * ti.sqrt(c0.dot(c0) + c1.dot(c1) + c2.dot(c2))
            speed = (ti.sqrt(velocity.dot(velocity)) + spread) ** 2
            sum = ti.cast(speed + stiff, ti.f64) + position[0] + position[1] + position[2]
            if not (ti.abs(sum) < NOT_FINITE):
                low[3] = NOT_FINITE
            for a in ti.static(range(3)):
                low[a] = ti.min(low[a], position[a])
                high[a] = ti.max(high[a], position[a])
            low[3] = ti.max(low[3], ti.cast(speed, ti.f64))
            high[3] = ti.max(high[3], ti.cast(stiff, ti.f64))
        seen[2 * share], seen[2 * share + 1] = low, high
