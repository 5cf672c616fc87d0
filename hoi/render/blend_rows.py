"""Tiles to pixels and back on a CPU: a row of a tile is one vector.

A splat then costs one pass over the rows of a tile that it reaches, whatever its width, and each thread takes the next
tile when it is done with one. See `hoi.render.kernels` for what is computed.
"""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportOptionalCall=false
# pyright: reportOperatorIssue=false

from hoi.compute import CPU_TASK, ti
from hoi.render.kernels import (
    BLUE,
    BOTTOM,
    DEPTH,
    END,
    GREEN,
    MAX_ALPHA,
    OPACITY,
    RED,
    TOP,
    P,
    Q,
    R,
    X,
    Y,
    array,
    exp_of_minus,
)  # fmt: skip


def room(tile: int, rows: int, double: bool) -> ti.Ndarray:
    """Vectors for a tile's rows, `rows` of them for each of its rows."""
    return ti.Vector.ndarray(tile, ti.f64 if double else ti.f32, rows * tile)


@ti.func
def lanes(tile: ti.template()):
    return ti.Vector([float(k) for k in range(tile)])


@ti.func
def nothing(tile: ti.template()):
    return ti.Vector([0.0 for _ in range(tile)])


@ti.func
def vertical_reach(boxes: array, i, top, tile: ti.template()):
    """First and last row of a tile that a splat reaches, counted in the tile."""
    return ti.max(boxes[i, TOP] - top, 0), ti.min(boxes[i, BOTTOM] - top, tile - 1)


@ti.func
def is_full(kept: array, base, tile: ti.template()):
    """Whether nothing more is seen through any pixel of a tile."""
    most = kept[base]
    for row in range(1, tile):
        most = ti.max(most, kept[base + row])
    return most.max() == 0.0


@ti.kernel
def blend_rows(
    tile: ti.template(), deep: ti.template(), exact: ti.template(), tasks: ti.i32, columns: ti.i32, tiles: ti.i32,
    least: ti.f32, splats: array, boxes: array, starts: array, members: array, kept: array, queue: array, colour: array,
    alpha: array, depth: array
):  # fmt: skip
    """Blends into `colour`, which comes with the background in it.

    `kept`: 6 rows of vectors for each row of a tile and task: T (0 once full), T, red, green, blue, depth.
    """
    ti.loop_config(block_dim=CPU_TASK)
    for turn in range(tasks * CPU_TASK):
        if turn % CPU_TASK == 0:
            base = turn // CPU_TASK * 6 * tile
            here = ti.atomic_add(queue[0], 1)
            while here < tiles:
                place, stop = (starts[here - 1] if here > 0 else 0), starts[here]
                if place < stop:
                    top, left = here // columns * tile, here % columns * tile
                    for k in range(6 * tile):
                        kept[base + k] = nothing(tile) + (1.0 if k < 2 * tile else 0.0)
                    while place < stop:
                        i = members[place]
                        end, lean, rise = splats[i, END], splats[i, Q], splats[i, R]
                        opacity, red = splats[i, OPACITY], splats[i, RED]
                        green, blue = splats[i, GREEN], splats[i, BLUE]
                        dx = lanes(tile) + (left + 0.5 - splats[i, X])
                        along = splats[i, P] * dx
                        from_row, to_row = vertical_reach(boxes, i, top, tile)
                        for row in range(from_row, to_row + 1):
                            dy = top + row + 0.5 - splats[i, Y]
                            u, v = along + dy * lean, dy * rise
                            p = u * u + v * v
                            at = base + row
                            opaque = ti.min(MAX_ALPHA, opacity * exp_of_minus(p, exact))
                            through = kept[at]
                            left_over = through * (1.0 - ti.select(p <= end, opaque, 0.0))
                            full = left_over <= least
                            w = ti.select(full, 0.0, through - left_over)
                            kept[at] = ti.select(full, 0.0, left_over)
                            kept[at + tile] = ti.select(full, kept[at + tile], left_over)
                            kept[at + 2 * tile] = kept[at + 2 * tile] + w * red
                            kept[at + 3 * tile] = kept[at + 3 * tile] + w * green
                            kept[at + 4 * tile] = kept[at + 4 * tile] + w * blue
                            if ti.static(deep):
                                kept[at + 5 * tile] = kept[at + 5 * tile] + w * splats[i, DEPTH]
                        place += 1
                        if place % 16 == 0:
                            if is_full(kept, base, tile):
                                place = stop
                    for row in range(ti.min(tile, colour.shape[0] - top)):
                        at = base + row
                        behind, red, green, blue, z = (
                            kept[at + tile], kept[at + 2 * tile], kept[at + 3 * tile], kept[at + 4 * tile],
                            kept[at + 5 * tile],
                        )  # fmt: skip
                        for k in ti.static(range(tile)):
                            if left + k < colour.shape[1]:
                                y, x = top + row, left + k
                                colour[y, x, 0] = red[k] + behind[k] * colour[y, x, 0]
                                colour[y, x, 1] = green[k] + behind[k] * colour[y, x, 1]
                                colour[y, x, 2] = blue[k] + behind[k] * colour[y, x, 2]
                                alpha[y, x] = 1.0 - behind[k]
                                if ti.static(deep):
                                    depth[y, x] = z[k]
                here = ti.atomic_add(queue[0], 1)


@ti.kernel
def blend_rows_back(
    tile: ti.template(), deep: ti.template(), exact: ti.template(), tasks: ti.i32, columns: ti.i32, tiles: ti.i32,
    least: ti.f32, splats: array, boxes: array, starts: array, members: array, entries: array, kept: array,
    queue: array, to_colour: array, to_alpha: array, to_depth: array, rest: array, given: array
):  # fmt: skip
    """Gradients of the splats, tile by tile: a row of `given`, laid out as `splats`, for each entry.

    The tiles are blended again, front to back. With f_i = dL/dw_i, dL/dalpha_i = T_i f_i - (sum_{j>i} w_j f_j + what
    the background gives) / (1 - alpha_i); that sum is what is left of the whole, `rest`. `kept` has 7 rows of vectors
    for each row of a tile and task: T, the gradients of red, green, blue, alpha, depth, and the rest.
    """
    ti.loop_config(block_dim=CPU_TASK)
    for turn in range(tasks * CPU_TASK):
        if turn % CPU_TASK == 0:
            base = turn // CPU_TASK * 7 * tile
            here = ti.atomic_add(queue[0], 1)
            while here < tiles:
                place, stop = (starts[here - 1] if here > 0 else 0), starts[here]
                if place < stop:
                    top, left = here // columns * tile, here % columns * tile
                    for k in range(7 * tile):
                        kept[base + k] = nothing(tile)
                    for row in range(ti.min(tile, to_colour.shape[0] - top)):
                        through, red, green, blue = nothing(tile), nothing(tile), nothing(tile), nothing(tile)
                        w, z, left_over = nothing(tile), nothing(tile), nothing(tile)
                        for k in ti.static(range(tile)):
                            if left + k < to_colour.shape[1]:
                                y, x = top + row, left + k
                                through[k] = 1.0
                                red[k], green[k], blue[k] = to_colour[y, x, 0], to_colour[y, x, 1], to_colour[y, x, 2]
                                w[k], left_over[k] = to_alpha[y, x], rest[y, x]
                                if ti.static(deep):
                                    z[k] = to_depth[y, x]
                        at = base + row
                        kept[at], kept[at + tile], kept[at + 2 * tile], kept[at + 3 * tile] = through, red, green, blue
                        kept[at + 4 * tile], kept[at + 5 * tile], kept[at + 6 * tile] = w, z, left_over
                    while place < stop:
                        i, entry = members[place], entries[place]
                        end, lean, rise = splats[i, END], splats[i, Q], splats[i, R]
                        opacity, red = splats[i, OPACITY], splats[i, RED]
                        green, blue = splats[i, GREEN], splats[i, BLUE]
                        dx = lanes(tile) + (left + 0.5 - splats[i, X])
                        along = splats[i, P] * dx
                        to_p, to_p_dy, to_p_dyy = nothing(tile), nothing(tile), nothing(tile)
                        to_u, to_u_dy = nothing(tile), nothing(tile)
                        to_red, to_green, to_blue, to_z = nothing(tile), nothing(tile), nothing(tile), nothing(tile)
                        from_row, to_row = vertical_reach(boxes, i, top, tile)
                        for row in range(from_row, to_row + 1):
                            dy = top + row + 0.5 - splats[i, Y]
                            u, v = along + dy * lean, dy * rise
                            p = u * u + v * v
                            at = base + row
                            unclamped = opacity * exp_of_minus(p, exact)
                            opaque = ti.select(p <= end, ti.min(MAX_ALPHA, unclamped), 0.0)
                            through = kept[at]
                            left_over = through * (1.0 - opaque)
                            full = left_over <= least
                            w = ti.select(full, 0.0, through - left_over)
                            kept[at] = ti.select(full, 0.0, left_over)
                            gain = kept[at + tile] * red + kept[at + 2 * tile] * green + kept[at + 3 * tile] * blue
                            gain = gain + kept[at + 4 * tile]
                            if ti.static(deep):
                                gain = gain + kept[at + 5 * tile] * splats[i, DEPTH]
                                to_z = to_z + w * kept[at + 5 * tile]
                            behind = kept[at + 6 * tile] - w * gain
                            kept[at + 6 * tile] = behind
                            to_red = to_red + w * kept[at + tile]
                            to_green = to_green + w * kept[at + 2 * tile]
                            to_blue = to_blue + w * kept[at + 3 * tile]
                            step = (behind / (1.0 - opaque) - through * gain) * opaque  # dL/dp
                            step = ti.select(full, 0.0, ti.select(unclamped < MAX_ALPHA, step, 0.0))
                            to_p = to_p + step
                            to_p_dy = to_p_dy + dy * step
                            to_p_dyy = to_p_dyy + dy * dy * step
                            to_u = to_u + u * step
                            to_u_dy = to_u_dy + dy * u * step
                        by_u = 2.0 * to_u.sum()
                        given[entry, X] = -by_u * splats[i, P]
                        given[entry, Y] = -by_u * lean - 2.0 * rise * rise * to_p_dy.sum()
                        given[entry, P] = 2.0 * (dx * to_u).sum()
                        given[entry, Q] = 2.0 * to_u_dy.sum()
                        given[entry, R] = 2.0 * rise * to_p_dyy.sum()
                        given[entry, OPACITY] = -to_p.sum() / opacity
                        given[entry, RED], given[entry, GREEN] = to_red.sum(), to_green.sum()
                        given[entry, BLUE], given[entry, DEPTH] = to_blue.sum(), to_z.sum()
                        place += 1
                        if place % 16 == 0:
                            if is_full(kept, base, tile):
                                place = stop
                here = ti.atomic_add(queue[0], 1)
