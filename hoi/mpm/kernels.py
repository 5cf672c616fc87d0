"""MLS-MPM in Taichi: particle to grid, grid, grid to particle, for one window of the grid.

The scheme is Hu et al. 2018, A Moving Least Squares Material Point Method, section 4, with quadratic B-splines and
APIC transfers (Jiang et al. 2015); `hoi.mpm.reference` is the same in NumPy and is to be read first. One step is

    p2g   m_i = sum_p w_ip m_p,   (m v)_i = sum_p w_ip [m_p v_p + (m_p C_p - dt V_p 4/dx^2 tau(F_p)) (x_i - x_p)]
    grid  v_i = (m v)_i / m_i + dt g, then the ground: Coulomb contact at the nodes below z = 0
    g2p   v_p = sum_i w_ip v_i,   C_p = 4/dx^2 sum_i w_ip v_i (x_i - x_p)^T,   x_p += dt v_p,   F_p = (I + dt C_p) F_p

Float types follow default_fp, except that positions are float64 in both precisions: one step moves a particle by less
than the float32 spacing at a metre. The grid is a flat buffer of nodes (momentum, later velocity; mass) for the window
`origin`, `shape` [nodes] of the world lattice x_i = i dx, which has a plane of nodes in the ground z = 0. The first
solid plane is the next one down, z = -dx: quadratic B-splines stop a body about a cell before a solid node, so that it
comes to rest with its surface within 0.1 dx of z = 0 (measured with 8 and 27 particles a cell). Array elements are
vectors and matrices, not scalars, because only then does LLVM use vector instructions (measured: 1.3 times faster).
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import taichi as ti

DONE, AT_RIM, INVERTED, STOP = 0, 1, 2, 3
"""Places in `status`: steps done; a particle is at the rim of the window; some J <= 0; either, once a step is over."""


@ti.func
def weights(fx):
    """Quadratic B-spline of each axis (columns) at three nodes (rows); fx in [0.5, 1.5): distance to the first."""
    return ti.Matrix.rows([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2])


@ti.func
def rotation_of(f, tolerance):
    """R of F = R S for J > 0 by Newton's iteration R <- (R + R^-T)/2 (Higham 1986): 3 or 4 turns near rest."""
    r = f
    change = 1.0
    turns = 0
    while change > tolerance and turns < 40:
        half = 0.5 * (r.inverse().transpose() - r)
        r += half
        change = half.norm_sqr()
        turns += 1
    return r


@ti.func
def kirchhoff_stress(model: ti.template(), f, j, mu, lam, tolerance):
    """tau [Pa] of the model named `model`; the formulas are in `hoi.mpm.materials`."""
    identity = ti.Matrix.identity(float, 3)
    tau = ti.Matrix.zero(float, 3, 3)
    if ti.static(model == "fixed_corotated"):
        tau = 2.0 * mu * (f - rotation_of(f, tolerance)) @ f.transpose() + lam * j * (j - 1.0) * identity
    elif ti.static(model == "neo_hookean"):
        tau = mu * (f @ f.transpose() - identity) + lam * ti.log(j) * identity
    else:
        ti.static_assert(False, "no kernel for this model")
    return tau


@ti.func
def locate(x: ti.template(), p, inv_dx, origin):
    """First of the 27 nodes that particle p touches, counted in the window, and its distance from it in cells."""
    scaled = x[p] * inv_dx
    base = ti.floor(scaled - 0.5, ti.i32)
    return base - origin, ti.cast(scaled - base, float)


@ti.func
def scatter(p, first, atomic: ti.template(), model: ti.template(), x: ti.template(), v: ti.template(),
            c: ti.template(), f: ti.template(), mass: ti.template(), volume: ti.template(), grid: ti.template(),
            status: ti.template(), mu, lam, dt, dx, inv_dx, tolerance, origin, shape):  # fmt: skip
    """p2g of one particle into the grid copy that starts at node `first`."""
    base, fx = locate(x, p, inv_dx, origin)
    deformation = f[p]
    j = deformation.determinant()
    if j > 0.0:
        tau = kirchhoff_stress(model, deformation, j, mu, lam, tolerance)
        affine = mass[p] * c[p] * dx - (dt * volume[p] * 4.0 / dx) * tau  # momentum per cell
        momentum = mass[p] * v[p] - affine @ fx
        at_base = ti.Vector([momentum[0], momentum[1], momentum[2], mass[p]])
        slope = [ti.Vector([affine[0, a], affine[1, a], affine[2, a], 0.0]) for a in ti.static(range(3))]
        w = weights(fx)
        for a, b in ti.static(ti.ndrange(3, 3)):
            w_ab = w[a, 0] * w[b, 1]
            value = w_ab * (at_base + a * slope[0] + b * slope[1])
            change = w_ab * slope[2]
            row = first + ((base[0] + a) * shape[1] + base[1] + b) * shape[2] + base[2]
            for k in ti.static(range(3)):
                contribution = w[k, 2] * (value + k * change)
                if ti.static(atomic):
                    ti.atomic_add(grid[row + k], contribution)
                else:
                    grid[row + k] = grid[row + k] + contribution
    else:
        status[INVERTED] = 1


@ti.func
def update_node(node, nodes, copies, grid: ti.template(), dt, gravity, ground, friction, origin, shape):
    """Sums the copies of a node, divides by its mass, adds gravity and holds it to the ground."""
    total = grid[node]
    for copy in range(1, copies):
        total += grid[copy * nodes + node]
    if total[3] > 0.0:
        velocity = ti.Vector([total[0], total[1], total[2]]) / total[3] + dt * gravity
        if ground != 0 and origin[2] + node % shape[2] < 0 and velocity[2] < 0.0:
            # Coulomb: the tangential impulse is at most friction times the normal one, and only ever brakes.
            slip = ti.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
            keep = 0.0
            if slip > -friction * velocity[2]:
                keep = 1.0 + friction * velocity[2] / slip
            velocity = ti.Vector([keep * velocity[0], keep * velocity[1], 0.0])
        grid[node] = ti.Vector([velocity[0], velocity[1], velocity[2], total[3]])


@ti.func
def gather(
    p,
    x: ti.template(),
    v: ti.template(),
    c: ti.template(),
    f: ti.template(),
    grid: ti.template(),
    status: ti.template(),
    dt,
    inv_dx,
    origin,
    shape,
):
    """g2p of one particle, and its motion and deformation over the step."""
    base, fx = locate(x, p, inv_dx, origin)
    w = weights(fx)
    velocity = ti.Vector.zero(float, 4)
    by_x, by_y, by_z = ti.Vector.zero(float, 4), ti.Vector.zero(float, 4), ti.Vector.zero(float, 4)
    for a in ti.static(range(3)):
        plane, plane_y, plane_z = ti.Vector.zero(float, 4), ti.Vector.zero(float, 4), ti.Vector.zero(float, 4)
        for b in ti.static(range(3)):
            row = ((base[0] + a) * shape[1] + base[1] + b) * shape[2] + base[2]
            line, line_z = ti.Vector.zero(float, 4), ti.Vector.zero(float, 4)
            for k in ti.static(range(3)):
                g = grid[row + k]
                line += w[k, 2] * g
                line_z += (w[k, 2] * (k - fx[2])) * g
            plane += w[b, 1] * line
            plane_y += (w[b, 1] * (b - fx[1])) * line
            plane_z += w[b, 1] * line_z
        velocity += w[a, 0] * plane
        by_x += (w[a, 0] * (a - fx[0])) * plane
        by_y += w[a, 0] * plane_y
        by_z += w[a, 0] * plane_z
    gradient = 4.0 * ti.cast(inv_dx, float) * ti.Matrix.cols([by_x[:3], by_y[:3], by_z[:3]])
    deformation = f[p]
    deformation += dt * gradient @ deformation
    position = x[p] + ti.cast(dt, ti.f64) * velocity[:3]
    v[p] = velocity[:3]
    x[p] = position
    c[p] = gradient
    f[p] = deformation
    cell = position * inv_dx - 0.5 - origin
    if not ((cell >= 1.0).all() and (cell < shape - 3.0).all()):  # also when not finite
        status[AT_RIM] = 1


@ti.kernel
def add_velocity(v: ti.types.ndarray(), change: ti.types.vector(3, ti.f64)):
    """Adds `change` [m/s] to every particle."""
    for p in range(v.shape[0]):
        v[p] += ti.cast(change, float)


@ti.kernel
def advance_serial(
    steps: int, model: ti.template(), ground: int, x: ti.types.ndarray(), v: ti.types.ndarray(),
    c: ti.types.ndarray(), f: ti.types.ndarray(), mass: ti.types.ndarray(), volume: ti.types.ndarray(),
    grid: ti.types.ndarray(), status: ti.types.ndarray(), mu: float, lam: float, friction: float,
    gravity: ti.types.vector(3, ti.f64), dt: float, dx: float, inv_dx: ti.f64, tolerance: float,
    origin: ti.types.vector(3, int), shape: ti.types.vector(3, int),
):  # fmt: skip
    """Up to `steps` steps in one launch and one serial task: no launch costs, no atomics, one order of summation."""
    nodes = shape[0] * shape[1] * shape[2]
    while status[DONE] < steps and status[STOP] == 0:
        for node in range(nodes):
            grid[node] = ti.Vector.zero(float, 4)
        for p in range(x.shape[0]):
            scatter(p, 0, False, model, x, v, c, f, mass, volume, grid, status,
                    mu, lam, dt, dx, inv_dx, tolerance, origin, shape)  # fmt: skip
        for node in range(nodes):
            update_node(node, nodes, 1, grid, dt, ti.cast(gravity, float), ground, friction, origin, shape)
        for p in range(x.shape[0]):
            gather(p, x, v, c, f, grid, status, dt, inv_dx, origin, shape)
        status[STOP] = status[AT_RIM] + status[INVERTED]
        status[DONE] += 1


@ti.kernel
def step_parallel(
    chunks: int, copies: int, atomic: ti.template(), model: ti.template(), ground: int,
    x: ti.types.ndarray(), v: ti.types.ndarray(), c: ti.types.ndarray(), f: ti.types.ndarray(),
    mass: ti.types.ndarray(), volume: ti.types.ndarray(), grid: ti.types.ndarray(), status: ti.types.ndarray(),
    mu: float, lam: float, friction: float, gravity: ti.types.vector(3, ti.f64), dt: float, dx: float, inv_dx: ti.f64,
    tolerance: float, origin: ti.types.vector(3, int), shape: ti.types.vector(3, int),
):  # fmt: skip
    """One step in parallel, or nothing once status[STOP] is set.

    On a CPU each thread takes one chunk of the particles and scatters into its own copy of the grid, so that the sums
    have a fixed order for a given number of threads; on a GPU each particle is a chunk and one grid takes atomics.
    """
    nodes = shape[0] * shape[1] * shape[2]
    size = (x.shape[0] + chunks - 1) // chunks
    for node in range(nodes * copies):
        grid[node] = ti.Vector.zero(float, 4)
    ti.loop_config(block_dim=128 if ti.static(atomic) else 1)
    for chunk in range(chunks):
        if status[STOP] == 0:
            for p in range(chunk * size, ti.min((chunk + 1) * size, x.shape[0])):
                scatter(p, (chunk % copies) * nodes, atomic, model, x, v, c, f, mass, volume, grid, status,
                        mu, lam, dt, dx, inv_dx, tolerance, origin, shape)  # fmt: skip
    for node in range(nodes):
        update_node(node, nodes, copies, grid, dt, ti.cast(gravity, float), ground, friction, origin, shape)
    ti.loop_config(block_dim=128 if ti.static(atomic) else 1)
    for chunk in range(chunks):
        if status[STOP] == 0:
            for p in range(chunk * size, ti.min((chunk + 1) * size, x.shape[0])):
                gather(p, x, v, c, f, grid, status, dt, inv_dx, origin, shape)
    if status[STOP] == 0:
        status[STOP] = status[AT_RIM] + status[INVERTED]
        status[DONE] += 1
