"""A step of `hoi.mpm.kernels` taken backwards, and the steps between two checkpoints taken again.

`replay` is the solver's own step, functions and all, which keeps what it starts from and what its particles bring to
the grid. `reverse` goes through what was kept, last step first. With a bar for the derivative of a number with respect
to what stands under it, y for the velocities of the nodes and h_i = v_bar + C_bar (x_i - x_p) / D

    g2p   v_bar += dt x_bar,  C_bar += dt F_bar F^T,  F_bar <- (I + dt C)^T F_bar
          y_bar_i = sum_p w_ip h_ip,   x_bar += sum_i (y_i . h_i) grad w_i - C_bar^T v / D
    grid  through the planes, last one first; P_bar = u_bar / m,  m_bar = -u_bar . (P / m) / m  for the momentum P
    p2g   B = sum_i w_i P_bar_i,  E = sum_i w_i P_bar_i (x_i - x_p)^T;   v_bar = m B,  C_bar = m E
          tau_bar = -dt V E / D
          x_bar += sum_i grad w_i (P_bar_i . P_ip + m_bar_i m_p) - A^T B,   A what stands in p2g before (x_i - x_p)

Where the step has a kink this is the derivative on the side where the step was: a node that a plane begins to hold or
lets go, one that begins to stick or to slide, a particle to which another plane becomes the nearest, and a play that
meets a bound. Which cell a particle is in makes no kink: quadratic splines are smooth once.

Sums over particles and steps are float64 in both precisions, as is what belongs to positions.
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from hoi.compute import ti
from hoi.gradient.laws import BACKWARDS, played_backwards
from hoi.mpm.boundary import COULOMB, STICK, after_contact, height_above, nearest_plane
from hoi.mpm.kernels import (
    columns,
    gather,
    inverse_inertia,
    locate,
    matrix,
    parameters_of,
    played,
    scatter,
    update_node,
    weights,
    zero,
)

ON_MU, ON_LAM, ON_LEAST, ON_STEEPNESS = 0, 1, 2, 3
"""Places of a material's four numbers in `on_material`."""
ON_TIME = 3
"""Place of what the length of the steps is worth in `on_world`, behind gravity's three."""


@ti.func
def slopes(size: ti.template(), fx):
    """The derivative of `weights` with respect to fx."""
    w = ti.Vector([0.0 for _ in range(size)])
    if ti.static(size == 3):
        w[0] = fx - 1.5
        w[1] = 2.0 - 2.0 * fx
        w[2] = fx - 0.5
    else:
        t = fx - 1.0
        w[0] = -0.5 * (1.0 - t) ** 2
        w[1] = (1.5 * t - 2.0) * t
        w[3] = 0.5 * t * t
        w[2] = 0.0 - w[0] - w[1] - w[3]
    return w


@ti.kernel
def replay(
    steps: int,
    slot: int,
    room: int,
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
    status: ti.types.ndarray(),
    kept_x: ti.types.ndarray(),
    kept_v: ti.types.ndarray(),
    kept_c: ti.types.ndarray(),
    kept_f: ti.types.ndarray(),
    kept_play: ti.types.ndarray(),
    kept_grid: ti.types.ndarray(),
    kept_slope: ti.types.ndarray(),
    gravity: ti.types.vector(4, ti.f64),
    drift: ti.types.vector(4, ti.f64),
    dt: float,
    dx: float,
    inv_dx: ti.f64,
    tolerance: float,
    origin: ti.types.vector(4, int),
    shape: ti.types.vector(4, int),
):
    """`steps` steps in one window, the states before them in the slots from `slot` on, and the last one after them.

    A slot of the grid has `room` nodes. The copy of the grid is clear before and after.
    """
    nodes, count = shape[0] * shape[1] * shape[2], x.shape[0]
    for _ in range(1):
        for step in range(steps + 1):
            at = slot + step
            for p in range(count):
                kept_x[at * count + p] = x[p]
                kept_v[at * count + p] = v[p]
                for a in ti.static(range(3)):
                    kept_c[3 * (at * count + p) + a] = c[3 * p + a]
                    kept_f[3 * (at * count + p) + a] = f[3 * p + a]
                if ti.static(damped):
                    kept_play[at * count + p] = play[p]
            if step < steps:
                for p in range(count):
                    scatter(p, nodes, False, damped, size, models, x, v, c, f, hardening, play, mass, volume, region,
                            materials, grid, slope, status, near, planes, capsules, touched, dt, dt, dx, inv_dx,
                            tolerance, origin, shape)  # fmt: skip
                for node in range(nodes):
                    kept_grid[at * room + node] = grid[nodes + node]
                    if near != 0:
                        kept_slope[at * room + node] = slope[nodes + node]
                    update_node(node, nodes, 1, near, grid, slope, planes, capsules, touched, dt, dx, gravity, dt,
                                shape)  # fmt: skip
                for p in range(count):
                    gather(p, size, models, x, v, c, f, total, hardening, region, materials, grid, status, dt, dx,
                           inv_dx, drift, origin, shape)  # fmt: skip


@ti.func
def place_of(node, dx, shape: ti.template()):
    """Of a node, from the window's origin [m]."""
    layer = shape[1] * shape[2]
    return dx * ti.Vector([
        ti.cast(node // layer, float), ti.cast(node % layer // shape[2], float), ti.cast(node % shape[2], float), 0.0,
    ])  # fmt: skip


@ti.func
def unheld(total, dt, gravity: ti.template()):
    """Velocity of a node before anything holds it."""
    velocity = total * (1.0 / total[3])
    velocity[3] = 0.0
    for a in ti.static(range(3)):
        velocity[a] += dt * ti.cast(gravity[a], float)
    return velocity


@ti.func
def to_surface(slope, place, i, planes: ti.template()):
    """What the velocity at a plane's surface is more than at a node, how far above it that is, and whether it holds."""
    height = height_above(place, planes[2 * i])
    normal = normal_of(i, planes)
    above = planes[2 * i + 1][2] - height
    return above * (slope - slope.dot(normal) * normal), above, height < 0.0


@ti.func
def normal_of(i, planes: ti.template()):
    surface = planes[2 * i]
    return ti.Vector([surface[0], surface[1], surface[2], 0.0])


@ti.func
def held(velocity, slope, place, planes: ti.template(), last):
    """`hoi.mpm.boundary.hold_to_planes` by the first `last` of them."""
    for i in range(last):
        more, _, holds = to_surface(slope, place, i, planes)
        if holds:
            contact = planes[2 * i + 1]
            velocity = after_contact(velocity + more, normal_of(i, planes), contact[1], contact[0]) - more
    return velocity


@ti.func
def contact_backwards(back, relative, normal, friction, kind):
    """Derivatives with respect to the relative velocity and the friction of `hoi.mpm.boundary.after_contact`."""
    approach = relative.dot(normal)
    on, on_friction = back, 0.0
    if kind == STICK:
        on *= 0.0
    elif approach < 0.0:
        along = relative - approach * normal
        slip = ti.max(ti.sqrt(along.dot(along)), 1e-20)
        on_along, on_approach = back, 0.0
        if kind == COULOMB:
            share = 1.0 + friction * approach / slip
            if share <= 0.0:
                on_along *= 0.0
            else:
                way = along / slip
                on_approach = friction * way.dot(back)
                on_friction = approach * way.dot(back)
                on_along = share * back - (friction * approach / slip * way.dot(back)) * way
        on = on_along + (on_approach - on_along.dot(normal)) * normal
    return on, on_friction


@ti.func
def grid_backwards(node, near, kept, turning, on_velocity: ti.template(), on_slope: ti.template(),
                   planes: ti.template(), on_friction: ti.template(), on_world: ti.template(), dt, dx,
                   gravity: ti.template(), shape: ti.template()):  # fmt: skip
    """Turns what a node's velocity is worth into what its momentum, mass (last place) and slope are."""
    back, on_mass = on_velocity[node], 0.0
    inverse = 1.0 / kept[3]  # its square may be infinite: a node at the rim can be as light as 1e-20 kg
    if near != 0:
        place, slope = place_of(node, dx, shape), turning * inverse
        on_turning = zero()
        count = planes.shape[0] // 2
        for turn in range(count):
            i = count - 1 - turn
            more, above, holds = to_surface(slope, place, i, planes)
            if holds:
                normal, contact = normal_of(i, planes), planes[2 * i + 1]
                before = held(unheld(kept, dt, gravity), slope, place, planes, i) + more
                on, rubbed = contact_backwards(back, before, normal, contact[1], contact[0])
                on_more = on - back
                on_turning += above * (on_more - on_more.dot(normal) * normal)
                on_friction[i] += ti.cast(rubbed, ti.f64)
                back = on
        on_turning *= inverse
        on_turning[3] = 0.0
        on_mass -= on_turning.dot(slope)
        on_slope[node] = on_turning
    for a in ti.static(range(3)):
        on_world[a] += ti.cast(dt * back[a], ti.f64)
        on_world[ON_TIME] += ti.cast(back[a], ti.f64) * gravity[a]
    back *= inverse
    for a in ti.static(range(3)):
        on_mass -= back[a] * (kept[a] * inverse)
    back[3] = on_mass
    on_velocity[node] = back


@ti.func
def gather_backwards(p, at, count, size: ti.template(), on_x: ti.template(), on_v: ti.template(),
                     on_c: ti.template(), on_f: ti.template(), kept_x: ti.template(), kept_v: ti.template(),
                     kept_c: ti.template(), kept_f: ti.template(), grid: ti.template(), on_velocity: ti.template(),
                     on_world: ti.template(), dt, dx, inv_dx, gravity: ti.template(), falls,
                     origin: ti.template(), shape: ti.template()):  # fmt: skip
    """g2p of one particle backwards: adds to what the nodes' velocities are worth."""
    q = at * count + p
    position = kept_x[q]
    bx, fx = locate(size, position[0], inv_dx, origin[0])
    by, fy = locate(size, position[1], inv_dx, origin[1])
    bz, fz = locate(size, position[2], inv_dx, origin[2])
    f0, f1, f2 = kept_f[3 * q], kept_f[3 * q + 1], kept_f[3 * q + 2]
    after = q + count
    velocity, c = kept_v[after], matrix(kept_c[3 * after], kept_c[3 * after + 1], kept_c[3 * after + 2])
    back_f, f = matrix(on_f[3 * p], on_f[3 * p + 1], on_f[3 * p + 2]), matrix(f0, f1, f2)
    on_position = on_x[p]
    stretching = back_f @ f.transpose()
    late = ti.cast(0.0, ti.f64)  # what a longer step is worth
    for a, b in ti.static(ti.ndrange(3, 3)):
        late += ti.cast(stretching[a, b] * c[a, b], ti.f64)
    for a in ti.static(range(3)):
        late += on_position[a] * velocity[a]
        if falls != 0:
            late -= on_position[a] * gravity[a] * dt
            on_world[a] -= 0.5 * on_position[a] * dt * dt
    on_world[ON_TIME] += late
    s0, s1, s2 = columns(stretching)
    c0, c1, c2 = on_c[3 * p] + dt * s0, on_c[3 * p + 1] + dt * s1, on_c[3 * p + 2] + dt * s2
    on_f[3 * p], on_f[3 * p + 1], on_f[3 * p + 2] = columns(back_f + dt * (c.transpose() @ back_f))
    scale = inverse_inertia(size) / dx
    c0, c1, c2 = scale * c0, scale * c1, scale * c2
    back_v = on_v[p]
    for a in ti.static(range(3)):
        back_v[a] += dt * ti.cast(on_position[a], float)
    at_first = back_v - fx * c0 - fy * c1 - fz * c2
    wx, wy, wz = weights(size, fx), weights(size, fy), weights(size, fz)
    sx, sy, sz = slopes(size, fx), slopes(size, fy), slopes(size, fz)
    gx, gy, gz = 0.0 - c0.dot(velocity), 0.0 - c1.dot(velocity), 0.0 - c2.dot(velocity)
    for a, b in ti.static(ti.ndrange(size, size)):
        line = ((bx + a) * shape[1] + by + b) * shape[2] + bz
        value, w = at_first + a * c0 + b * c1, wx[a] * wy[b]
        worth, worth_z = 0.0, 0.0
        for k in ti.static(range(size)):
            h = value + k * c2
            each = h.dot(grid[line + k])
            worth += wz[k] * each
            worth_z += sz[k] * each
            on_velocity[line + k] = on_velocity[line + k] + (w * wz[k]) * h
        gx += sx[a] * wy[b] * worth
        gy += wx[a] * sy[b] * worth
        gz += w * worth_z
    on_x[p] = on_position + inv_dx * ti.Vector([ti.cast(gx, ti.f64), ti.cast(gy, ti.f64), ti.cast(gz, ti.f64), 0.0])


@ti.func
def scatter_backwards(p, at, count, near, damped: ti.template(), size: ti.template(), models: ti.template(),
                      on_x: ti.template(), on_v: ti.template(), on_c: ti.template(), on_f: ti.template(),
                      on_play: ti.template(), on_mass: ti.template(), on_material: ti.template(),
                      kept_x: ti.template(), kept_v: ti.template(), kept_c: ti.template(), kept_f: ti.template(),
                      kept_play: ti.template(), mass: ti.template(), volume: ti.template(), region: ti.template(),
                      materials: ti.template(), on_momentum: ti.template(), on_slope: ti.template(),
                      planes: ti.template(), on_world: ti.template(), dt, dx, inv_dx, tolerance,
                      origin: ti.template(), shape: ti.template()):  # fmt: skip
    """p2g of one particle backwards: what its state before the step is worth, and its material."""
    q = at * count + p
    position, velocity, m = kept_x[q], kept_v[q], mass[p]
    bx, fx = locate(size, position[0], inv_dx, origin[0])
    by, fy = locate(size, position[1], inv_dx, origin[1])
    bz, fz = locate(size, position[2], inv_dx, origin[2])
    c0, c1, c2 = kept_c[3 * q], kept_c[3 * q + 1], kept_c[3 * q + 2]
    f0, f1, f2 = kept_f[3 * q], kept_f[3 * q + 1], kept_f[3 * q + 2]
    f = matrix(f0, f1, f2)
    j = f.determinant()
    row = region[ti.min(p, region.shape[0] - 1)]
    numbers = parameters_of(materials, row)
    tau, half = ti.Matrix.zero(float, 3, 3), ti.Matrix.zero(float, 3, 3)
    for i in ti.static(range(len(models))):
        if ti.static(len(models) == 1) or materials[3 * row + 2][1] == i:
            tau, half = ti.static(BACKWARDS[models[i]]).stress(f, j, numbers, tolerance)
    t0, t1, t2 = columns(tau)
    s = 1.0
    if ti.static(damped):
        s, _ = played(f0, f1, f2, j, numbers, materials, row, kept_play[q])
    force = -dt * volume[p] * inverse_inertia(size) / dx
    a0, a1, a2 = m * dx * c0 + force * s * t0, m * dx * c1 + force * s * t1, m * dx * c2 + force * s * t2
    at_first = m * velocity - fx * a0 - fy * a1 - fz * a2
    a0[3], a1[3], a2[3], at_first[3] = 0.0, 0.0, 0.0, m
    wx, wy, wz = weights(size, fx), weights(size, fy), weights(size, fz)
    sx, sy, sz = slopes(size, fx), slopes(size, fy), slopes(size, fz)
    gx, gy, gz = 0.0, 0.0, 0.0
    b, e0, e1, e2 = zero(), zero(), zero(), zero()
    for ia in ti.static(range(size)):
        plane, plane_y, plane_z = zero(), zero(), zero()
        for ib in ti.static(range(size)):
            line = ((bx + ia) * shape[1] + by + ib) * shape[2] + bz
            value = at_first + ia * a0 + ib * a1
            sum, sum_z = zero(), zero()
            worth, worth_z = 0.0, 0.0
            for k in ti.static(range(size)):
                node = on_momentum[line + k]
                each = node.dot(value + k * a2)
                worth += wz[k] * each
                worth_z += sz[k] * each
                sum += wz[k] * node
                sum_z += (wz[k] * (k - fz)) * node
            plane += wy[ib] * sum
            plane_y += (wy[ib] * (ib - fy)) * sum
            plane_z += wy[ib] * sum_z
            gx += sx[ia] * wy[ib] * worth
            gy += wx[ia] * sy[ib] * worth
            gz += wx[ia] * wy[ib] * worth_z
        b += wx[ia] * plane
        e0 += (wx[ia] * (ia - fx)) * plane
        e1 += wx[ia] * plane_y
        e2 += wx[ia] * plane_z
    gx -= a0.dot(b)
    gy -= a1.dot(b)
    gz -= a2.dot(b)
    weight = (
        velocity.dot(b) + dx * (c0.dot(e0) + c1.dot(e1) + c2.dot(e2)) + b[3]
    )  # the last place of the nodes' is mass
    b[3], e0[3], e1[3], e2[3] = 0.0, 0.0, 0.0, 0.0
    on_world[ON_TIME] += ti.cast(s * force / dt * (t0.dot(e0) + t1.dot(e1) + t2.dot(e2)), ti.f64)
    back_c0, back_c1, back_c2 = m * dx * e0, m * dx * e1, m * dx * e2
    if near != 0:
        place = dx * ti.Vector([fx + bx, fy + by, fz + bz, 0.0])
        i = nearest_plane(place, 0.5 * size * dx, planes)
        if i >= 0:
            n = normal_of(i, planes)
            turn = n[0] * c0 + n[1] * c1 + n[2] * c2
            along = m * turn
            sum = zero()
            for ka, kb, kc in ti.ndrange(size, size, size):
                node = on_slope[((bx + ka) * shape[1] + by + kb) * shape[2] + bz + kc]
                node[3] = 0.0
                each = node.dot(along)
                sum += (wx[ka] * wy[kb] * wz[kc]) * node
                gx += sx[ka] * wy[kb] * wz[kc] * each
                gy += wx[ka] * sy[kb] * wz[kc] * each
                gz += wx[ka] * wy[kb] * sz[kc] * each
            back_c0 += m * n[0] * sum
            back_c1 += m * n[1] * sum
            back_c2 += m * n[2] * sum
            weight += turn.dot(sum)
    on_mass[p] += ti.cast(weight, ti.f64)
    on_c[3 * p], on_c[3 * p + 1], on_c[3 * p + 2] = back_c0, back_c1, back_c2
    on_v[p] = m * b
    on_x[p] = on_x[p] + inv_dx * ti.Vector([ti.cast(gx, ti.f64), ti.cast(gy, ti.f64), ti.cast(gz, ti.f64), 0.0])
    t = matrix(force * e0, force * e1, force * e2)
    back, mu, lam, least, steepness = ti.Matrix.zero(float, 3, 3), 0.0, 0.0, 0.0, 0.0
    for i in ti.static(range(len(models))):
        if ti.static(len(models) == 1) or materials[3 * row + 2][1] == i:
            back, mu, lam = ti.static(BACKWARDS[models[i]]).backwards(s * t, f, j, half, numbers)
    if ti.static(damped):
        if materials[3 * row + 2][3] > 0.0:
            given = force * (t0.dot(e0) + t1.dot(e1) + t2.dot(e2))
            on, by_mu, by_lam, least, steepness, on_play[p] = played_backwards(
                s, given, on_play[p], f, j, numbers, materials[3 * row + 2][2], materials[3 * row + 2][3], kept_play[q]
            )
            back, mu, lam = back + on, mu + by_mu, lam + by_lam
    o0, o1, o2 = columns(back)
    on_f[3 * p], on_f[3 * p + 1], on_f[3 * p + 2] = on_f[3 * p] + o0, on_f[3 * p + 1] + o1, on_f[3 * p + 2] + o2
    on_material[4 * row + ON_MU] += ti.cast(mu, ti.f64)
    on_material[4 * row + ON_LAM] += ti.cast(lam, ti.f64)
    on_material[4 * row + ON_LEAST] += ti.cast(least, ti.f64)
    on_material[4 * row + ON_STEEPNESS] += ti.cast(steepness, ti.f64)


@ti.kernel
def reverse(
    steps: int,
    slot: int,
    room: int,
    near: int,
    damped: ti.template(),
    size: ti.template(),
    models: ti.template(),
    mass: ti.types.ndarray(),
    volume: ti.types.ndarray(),
    region: ti.types.ndarray(),
    materials: ti.types.ndarray(),
    planes: ti.types.ndarray(),
    kept_x: ti.types.ndarray(),
    kept_v: ti.types.ndarray(),
    kept_c: ti.types.ndarray(),
    kept_f: ti.types.ndarray(),
    kept_play: ti.types.ndarray(),
    kept_grid: ti.types.ndarray(),
    kept_slope: ti.types.ndarray(),
    grid: ti.types.ndarray(),
    on_velocity: ti.types.ndarray(),
    on_slope: ti.types.ndarray(),
    on_x: ti.types.ndarray(),
    on_v: ti.types.ndarray(),
    on_c: ti.types.ndarray(),
    on_f: ti.types.ndarray(),
    on_play: ti.types.ndarray(),
    on_mass: ti.types.ndarray(),
    on_material: ti.types.ndarray(),
    on_friction: ti.types.ndarray(),
    on_world: ti.types.ndarray(),
    gravity: ti.types.vector(4, ti.f64),
    falls: int,
    dt: float,
    dx: float,
    inv_dx: ti.f64,
    tolerance: float,
    origin: ti.types.vector(4, int),
    shape: ti.types.vector(4, int),
):
    """The steps that `replay` took with these arguments, backwards: `on_...` from after them to before them.

    `falls`: gravity's half step is taken out of each move, as where nothing is touched (`hoi.mpm.solver`). The sums
    `on_mass`, `on_material`, `on_friction` and `on_world` go on from what is in them.
    """
    nodes, count = shape[0] * shape[1] * shape[2], mass.shape[0]
    for _ in range(1):
        for step in range(steps):
            at = slot + steps - 1 - step
            for node in range(nodes):
                kept = kept_grid[at * room + node]
                velocity = zero()
                if kept[3] > 0.0:
                    velocity = unheld(kept, dt, gravity)
                    if near != 0:
                        turning = kept_slope[at * room + node] * (1.0 / kept[3])
                        velocity = held(velocity, turning, place_of(node, dx, shape), planes, planes.shape[0] // 2)
                grid[node] = velocity
                on_velocity[node] = zero()
            for p in range(count):
                gather_backwards(p, at, count, size, on_x, on_v, on_c, on_f, kept_x, kept_v, kept_c, kept_f, grid,
                                 on_velocity, on_world, dt, dx, inv_dx, gravity, falls, origin, shape)  # fmt: skip
            for node in range(nodes):
                kept = kept_grid[at * room + node]
                if kept[3] > 0.0:
                    grid_backwards(node, near, kept, kept_slope[(at * room + node) * near], on_velocity, on_slope,
                                   planes, on_friction, on_world, dt, dx, gravity, shape)  # fmt: skip
            for p in range(count):
                scatter_backwards(p, at, count, near, damped, size, models, on_x, on_v, on_c, on_f, on_play, on_mass,
                                  on_material, kept_x, kept_v, kept_c, kept_f, kept_play, mass, volume, region,
                                  materials, on_velocity, on_slope, planes, on_world, dt, dx, inv_dx, tolerance,
                                  origin, shape)  # fmt: skip
