"""What passes in a substep between a grid and rigid parts that carry capsules: the kernels of `hoi.mpm.coupling`.

`body` (6 K, columns(K)), in float64, is what they know of K parts, six rows each: a velocity at the window's origin and
a turning, or an impulse and an angular impulse about it.

    NOW, TOLD  the part's twist t, and t' that is foreseen, then what the exchange takes from t
    GIVEN      what its capsules give in this substep
    TAKEN      and in this launch
    ROW        rows of the equations
    ENERGY     A, B, and a of `settle`
    MOMENTUM   h of the cluster of nodes that its capsules approach
    INERTIA    six columns: G, what that cluster's momentum G t' is once it moves as one with the part
    EASE       6 K columns: W, how wrenches on all parts change this one's twist
    then       room for the equations
"""

# Kernel annotations are values, not types, and vectors can be sliced.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from hoi.compute import ti
from hoi.mpm.boundary import hold_to_capsule, nearest_capsule

NOW, TOLD, GIVEN, TAKEN, MOMENTUM, ROW, ENERGY = 0, 1, 2, 3, 4, 5, 6
INERTIA, EASE = 7, 13


def columns(parts: int) -> int:
    """Of `body`."""
    return EASE + 12 * parts + 1


@ti.func
def node_of(node, nodes, copies, grid: ti.template(), dt, dx, gravity: ti.template(), shape: ti.template()):
    """Velocity of a node before anything solid holds it, its mass in the last place, and where it is in the window."""
    total = ti.Vector([0.0, 0.0, 0.0, 0.0])
    for copy in range(1, copies + 1):
        total += grid[copy * nodes + node]
    mass = total[3]
    velocity = total * (1.0 / ti.max(mass, 1e-30))
    for a in ti.static(range(3)):
        velocity[a] += dt * ti.cast(gravity[a], float)
    velocity[3] = 0.0
    layer = shape[1] * shape[2]
    place = dx * ti.Vector([
        ti.cast(node // layer, float), ti.cast(node % layer // shape[2], float), ti.cast(node % shape[2], float), 0.0,
    ])  # fmt: skip
    return velocity, mass, place


@ti.func
def add(body: ti.template(), row, column, value, atomic: ti.template()):
    if ti.static(atomic):
        ti.atomic_add(body[row, column], ti.cast(value, ti.f64))
    else:
        body[row, column] = body[row, column] + ti.cast(value, ti.f64)


@ti.func
def add_wrench(body: ti.template(), row, column, place, impulse, atomic: ti.template()):
    """Adds an impulse at a place, and what it turns."""
    for a in ti.static(range(3)):
        b, c = ti.static((a + 1) % 3), ti.static((a + 2) % 3)
        add(body, row + a, column, impulse[a], atomic)
        add(body, row + 3 + a, column, place[b] * impulse[c] - place[c] * impulse[b], atomic)


@ti.func
def add_mass(body: ti.template(), row, place, mass, atomic: ti.template()):
    """Adds a mass at a place to G = [[m, -[f]x], [[f]x, tr(s) - s]], f and s its first and second moment."""
    square = place.dot(place)
    for a in ti.static(range(3)):
        b, c = ti.static((a + 1) % 3), ti.static((a + 2) % 3)
        add(body, row + a, INERTIA + a, mass, atomic)
        add(body, row + 3 + a, INERTIA + 3 + a, mass * (square - place[a] * place[a]), atomic)
        for p, q, sign in ti.static(((b, c, 1.0), (c, b, -1.0))):
            add(body, row + p, INERTIA + 3 + q, sign * mass * place[a], atomic)
            add(body, row + 3 + p, INERTIA + q, -sign * mass * place[a], atomic)
            add(body, row + 3 + p, INERTIA + 3 + q, -mass * place[b] * place[c], atomic)


@ti.func
def meet_node(node, atomic: ti.template(), nodes, copies, grid: ti.template(), touched: ti.template(),
              capsules: ti.template(), parts: ti.template(), body: ti.template(), dt, dx, gravity: ti.template(),
              shape: ti.template()):  # fmt: skip
    """Adds a node that a capsule approaches to the cluster of the capsule's part."""
    if touched[node] != 0:
        velocity, mass, place = node_of(node, nodes, copies, grid, dt, dx, gravity, shape)
        i = nearest_capsule(place, capsules, dt)
        if mass > 0.0 and i >= 0:
            _, approach = hold_to_capsule(velocity, place, i, capsules, dt)
            if approach > 0.0:
                add_mass(body, 6 * parts[i], place, mass, atomic)
                add_wrench(body, 6 * parts[i], MOMENTUM, place, mass * velocity, atomic)


@ti.func
def push_node(node, atomic: ti.template(), nodes, copies, grid: ti.template(), touched: ti.template(),
              capsules: ti.template(), parts: ti.template(), body: ti.template(), dt, dx, gravity: ti.template(),
              shape: ti.template()):  # fmt: skip
    """What holds a node to its capsule, whose part is to give it, and how that changes the energy of the nodes."""
    if touched[node] != 0:
        grid[node] = ti.Vector([0.0, 0.0, 0.0, 0.0])
        velocity, mass, place = node_of(node, nodes, copies, grid, dt, dx, gravity, shape)
        i = nearest_capsule(place, capsules, dt)
        if mass > 0.0 and i >= 0:
            pushed, _ = hold_to_capsule(velocity, place, i, capsules, dt)
            given = mass * (pushed - velocity)
            grid[node] = given  # the velocities of the last step are needed no more
            add_wrench(body, 6 * parts[i], GIVEN, place, given, atomic)
            add(body, 0, ENERGY, velocity.dot(given), atomic)
            add(body, 1, ENERGY, given.dot(given) / mass, atomic)


@ti.func
def give_node(node, nodes, grid: ti.template(), touched: ti.template(), body: ti.template()):
    if touched[node] != 0:
        touched[node] = 0
        grid[nodes + node] = grid[nodes + node] + ti.cast(body[2, ENERGY], float) * grid[node]


@ti.func
def foresee(body: ti.template()):
    """t' = t + W (h - G t'), the twists once the parts that met nodes move as one with them; clears h and G."""
    rows, met = body.shape[0], 0
    system, right = EASE + rows, EASE + 2 * rows
    for row in range(rows):
        body[row, TOLD] = body[row, NOW]
        if body[row - row % 6, INERTIA] > 0.0:
            body[met, ROW] = ti.cast(row, ti.f64)
            met += 1
    for i in range(met):
        row = ti.cast(body[i, ROW], int)
        body[i, right] = body[row, NOW]
        for j in range(met):
            along = ti.cast(body[j, ROW], int)
            first = along - along % 6
            value = ti.cast(i == j, ti.f64)
            for a in range(6):
                value += body[row, EASE + first + a] * body[first + a, INERTIA + along % 6]
            body[i, system + j] = value
            body[i, right] = body[i, right] + body[row, EASE + along] * body[along, MOMENTUM]
    eliminate(body, met, system, right)
    for i in range(met):
        row = ti.cast(body[i, ROW], int)
        for a in range(6):
            body[row, MOMENTUM] = body[row, MOMENTUM] - body[row, INERTIA + a] * body[i - row % 6 + a, right]
    for row, j in ti.ndrange(rows, met):
        along = ti.cast(body[j, ROW], int)
        body[row, TOLD] = body[row, TOLD] + body[row, EASE + along] * body[along, MOMENTUM]
    for i in range(met):
        row = ti.cast(body[i, ROW], int)
        for a in range(6):
            body[row, INERTIA + a] = 0.0
        body[row, MOMENTUM] = 0.0


@ti.func
def eliminate(body: ti.template(), count, system, right):
    """Solves `count` linear equations in place, by Gauss with a search for the pivot; the unknowns come to `right`."""
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if ti.abs(body[i, system + k]) > ti.abs(body[pivot, system + k]):
                pivot = i
        for j in range(k, count + 1):
            column = system + j if j < count else right
            own = body[pivot, column]
            body[pivot, column] = body[k, column]
            body[k, column] = own
        scale = body[k, system + k]
        for j in range(k + 1, count + 1):
            column = system + j if j < count else right
            body[k, column] = body[k, column] / scale
        for i in range(count):
            factor = body[i, system + k]
            if i != k and factor != 0.0:
                for j in range(k + 1, count + 1):
                    column = system + j if j < count else right
                    body[i, column] = body[i, column] - factor * body[k, column]


@ti.func
def move_with(body: ti.template(), column, capsules: ti.template(), parts: ti.template()):
    """Gives the ends of the capsules the velocities of their parts' twists."""
    for i in range(capsules.shape[0] // 4):
        row = 6 * parts[i]
        for end in ti.static(range(2)):
            place = capsules[4 * i + end]
            for a in ti.static(range(3)):
                b, c = ti.static((a + 1) % 3), ti.static((a + 2) % 3)
                turned = body[row + 3 + b, column] * place[c] - body[row + 3 + c, column] * place[b]
                capsules[4 * i + 2 + end][a] = ti.cast(body[row + a, column] + turned, float)


@ti.func
def settle(body: ti.template()):
    """Cuts what is given down to the share a <= 1 at which A a + B a^2 / 2, the energy of all together, is least.

    What a part gives along surfaces that it slides on is not all that was foreseen of it; against something heavy that
    little can throw it back faster than it came. With this no exchange adds energy, as in no plastic blow.
    """
    rows = body.shape[0]
    first, second = body[0, ENERGY], body[1, ENERGY]
    for row in range(rows):
        eased = body[row, EASE] * body[0, GIVEN]
        for along in range(1, rows):
            eased += body[row, EASE + along] * body[along, GIVEN]
        body[row, TOLD] = eased
        first -= body[row, NOW] * body[row, GIVEN]
        second += eased * body[row, GIVEN]
    share = ti.max(0.0, ti.min(1.0, -first / ti.max(second, 1e-300)))
    for row in range(rows):
        body[row, GIVEN] = share * body[row, GIVEN]
        body[row, TOLD] = share * body[row, TOLD]
    body[0, ENERGY], body[1, ENERGY], body[2, ENERGY] = 0.0, 0.0, share


@ti.func
def take(body: ti.template(), capsules: ti.template(), parts: ti.template(), dt):
    """Moves the capsules on, and gives their parts the opposite of what they gave."""
    rows = body.shape[0]
    for i in range(capsules.shape[0] // 4):
        for end in ti.static(range(2)):  # the last place of a velocity is 0
            capsules[4 * i + end] = capsules[4 * i + end] + dt * capsules[4 * i + 2 + end]
    for row in range(rows):
        body[row, NOW] = body[row, NOW] - body[row, TOLD]
        body[row, TAKEN] = body[row, TAKEN] + body[row, GIVEN]
        body[row, GIVEN] = 0.0
    move_with(body, NOW, capsules, parts)


@ti.func
def exchange_in_turn(nodes, copies, grid: ti.template(), touched: ti.template(), capsules: ti.template(),
                     parts: ti.template(), body: ti.template(), dt, dx, gravity: ti.template(),
                     shape: ti.template()):  # fmt: skip
    """All of a substep's exchange, one node after the other."""
    for node in range(nodes):
        meet_node(node, False, nodes, copies, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
    foresee(body)
    move_with(body, TOLD, capsules, parts)
    for node in range(nodes):
        push_node(node, False, nodes, copies, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
    settle(body)
    for node in range(nodes):
        give_node(node, nodes, grid, touched, body)
    take(body, capsules, parts, dt)


@ti.kernel
def exchange(
    copies: int, atomic: ti.template(), grid: ti.types.ndarray(), touched: ti.types.ndarray(),
    capsules: ti.types.ndarray(), parts: ti.types.ndarray(), body: ti.types.ndarray(), dt: float, dx: float,
    gravity: ti.types.vector(4, ti.f64), shape: ti.types.vector(4, int),
):  # fmt: skip
    """Between the halves of a step in parallel."""
    nodes = shape[0] * shape[1] * shape[2]
    if ti.static(atomic):
        for node in range(nodes):
            meet_node(node, True, nodes, copies, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
        for _ in range(1):
            foresee(body)
            move_with(body, TOLD, capsules, parts)
        for node in range(nodes):
            push_node(node, True, nodes, copies, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
        for _ in range(1):
            settle(body)
        for node in range(nodes):
            give_node(node, nodes, grid, touched, body)
        for _ in range(1):
            take(body, capsules, parts, dt)
    else:
        for _ in range(1):
            exchange_in_turn(nodes, copies, grid, touched, capsules, parts, body, dt, dx, gravity, shape)
