"""Tiles to pixels and back on a GPU: each pixel is a thread. See `hoi.render.kernels` for what is computed."""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportOptionalCall=false
# pyright: reportOperatorIssue=false

from hoi.compute import ti
from hoi.render.kernels import (
    BLUE,
    DEPTH,
    END,
    GREEN,
    MAX_ALPHA,
    OPACITY,
    RED,
    P,
    Q,
    R,
    X,
    Y,
    array,
    exp_of_minus,
)  # fmt: skip


@ti.func
def pixel_of(k, tile: ti.template(), columns):
    """Tile, row and column of the k-th pixel, tile by tile."""
    here, within = k // (tile * tile), k % (tile * tile)
    return here, here // columns * tile + within // tile, here % columns * tile + within % tile


@ti.func
def opacity_at(splats: array, i, x, y, exact: ti.template()):
    """o exp(-p), 0 beyond the splat's end; the offsets from its centre; P d_x + Q d_y."""
    dx, dy = x + 0.5 - splats[i, X], y + 0.5 - splats[i, Y]
    u, v = splats[i, P] * dx + splats[i, Q] * dy, splats[i, R] * dy
    p = u * u + v * v
    opaque = 0.0
    if p <= splats[i, END]:
        opaque = splats[i, OPACITY] * exp_of_minus(p, exact)
    return opaque, dx, dy, u


@ti.kernel
def blend_pixels(
    tile: ti.template(), deep: ti.template(), exact: ti.template(), columns: ti.i32, tiles: ti.i32, least: ti.f32,
    splats: array, starts: array, members: array, colour: array, alpha: array, depth: array
):  # fmt: skip
    """As `blend_rows`."""
    ti.loop_config(block_dim=tile * tile)
    for k in range(tiles * tile * tile):
        here, y, x = pixel_of(k, tile, columns)
        place, stop = (starts[here - 1] if here > 0 else 0), starts[here]
        if place < stop and y < colour.shape[0] and x < colour.shape[1]:
            through, red, green, blue, z = 1.0, 0.0, 0.0, 0.0, 0.0
            while place < stop:
                i = members[place]
                place += 1
                opaque, _dx, _dy, _u = opacity_at(splats, i, x, y, exact)
                if opaque > 0.0:
                    left_over = through * (1.0 - ti.min(MAX_ALPHA, opaque))
                    if left_over <= least:
                        place = stop
                    else:
                        w = through - left_over
                        through = left_over
                        red += w * splats[i, RED]
                        green += w * splats[i, GREEN]
                        blue += w * splats[i, BLUE]
                        if ti.static(deep):
                            z += w * splats[i, DEPTH]
            colour[y, x, 0] = red + through * colour[y, x, 0]
            colour[y, x, 1] = green + through * colour[y, x, 1]
            colour[y, x, 2] = blue + through * colour[y, x, 2]
            alpha[y, x] = 1.0 - through
            if ti.static(deep):
                depth[y, x] = z


@ti.kernel
def blend_pixels_back(
    tile: ti.template(), deep: ti.template(), exact: ti.template(), columns: ti.i32, tiles: ti.i32, least: ti.f32,
    splats: array, starts: array, members: array, entries: array, to_colour: array, to_alpha: array, to_depth: array,
    rest: array, given: array
):  # fmt: skip
    """As `blend_rows_back`; the pixels of a tile add to its rows of `given`, which must be zero, in any order."""
    ti.loop_config(block_dim=tile * tile)
    for k in range(tiles * tile * tile):
        here, y, x = pixel_of(k, tile, columns)
        if y < to_colour.shape[0] and x < to_colour.shape[1]:
            through, behind = 1.0, rest[y, x]
            red, green, blue = to_colour[y, x, 0], to_colour[y, x, 1], to_colour[y, x, 2]
            place, stop = (starts[here - 1] if here > 0 else 0), starts[here]
            while place < stop:
                i, entry = members[place], entries[place]
                place += 1
                unclamped, dx, dy, u = opacity_at(splats, i, x, y, exact)
                if unclamped > 0.0:
                    opaque = ti.min(MAX_ALPHA, unclamped)
                    left_over = through * (1.0 - opaque)
                    if left_over <= least:
                        place = stop
                    else:
                        w = through - left_over
                        gain = red * splats[i, RED] + green * splats[i, GREEN] + blue * splats[i, BLUE] + to_alpha[y, x]
                        if ti.static(deep):
                            gain += to_depth[y, x] * splats[i, DEPTH]
                            given[entry, DEPTH] += w * to_depth[y, x]
                        behind -= w * gain
                        given[entry, RED] += w * red
                        given[entry, GREEN] += w * green
                        given[entry, BLUE] += w * blue
                        if unclamped < MAX_ALPHA:
                            to_p = (behind / (1.0 - opaque) - through * gain) * opaque
                            to_u, to_v = 2.0 * u * to_p, 2.0 * splats[i, R] * dy * to_p
                            given[entry, X] -= splats[i, P] * to_u
                            given[entry, Y] -= splats[i, Q] * to_u + splats[i, R] * to_v
                            given[entry, P] += dx * to_u
                            given[entry, Q] += dy * to_u
                            given[entry, R] += dy * to_v
                            given[entry, OPACITY] -= to_p / splats[i, OPACITY]
                        through = left_over
