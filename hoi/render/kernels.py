"""The rasteriser in Taichi: Gaussians to splats, splats to tiles, and the way back.

Conventions are those of 3D Gaussian splatting (Kerbl et al. 2023) as gsplat 1.5 has them, so that pictures agree:

    t = R x + t_0                             camera axes: x right, y down, z forward
    S = M Sigma M^T + f I,  M = J R           EWA projection (Zwicker et al. 2001); x/z and y/z in J are held near the
                                              picture; f = 0.3 px^2, if antialiased a pixel's own 0.1
    p = d^T S^-1 d / 2 = (P d_x + Q d_y)^2 + (R d_y)^2    d from the splat's centre to the pixel's, which is at + 0.5
    alpha = min(0.999, o exp(-p))             left out where o exp(-p) < 1/255
    o = sqrt(det(S - f I) / det S) opacity    if antialiased (Yu et al. 2024, Mip-Splatting): fainter by as much as f
                                              widens it; the opacity itself if not
    w_i = alpha_i T_i,  T_i+1 = T_i (1 - alpha_i)   front to back; a pixel is full before the splat that would take T to
                                              1e-4 or less

A splat is a row of `splats`: centre x, y [px]; P, Q, R (with S^-1 itself p would cancel to noise in long needles);
opacity; the p at which it ends; red, green, blue; camera z [m]. How far it reaches is a row of `boxes`: left, top,
right, bottom [px], inclusive; left > right is nowhere.

Tiles are blended row by row on a CPU (`hoi.render.blend_rows`), pixel by pixel on a GPU (`hoi.render.blend_pixels`);
both add up the same in the same order.
"""

# Kernel annotations are values, not types.
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportOptionalCall=false
# pyright: reportOperatorIssue=false

from typing import TYPE_CHECKING

from hoi.compute import CPU_TASK, Precision, start_compiler, ti
from hoi.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

DILATION = 0.3
"""Added to the variances of a splat [px^2], 3DGS's."""
PIXEL = 0.1
"""The same if antialiased, Mip-Splatting's: little more than the variance of a pixel's box, 1/12."""
LEAST_SHARE = 2.5e-5
"""Of det(S - f I) in det S that antialiasing takes into account, as 3DGS has it: below it the root has no useful
slope."""
MAX_ALPHA = 0.999
"""Of a Gaussian in a pixel, so that what is behind it still counts."""
X, Y, P, Q, R, OPACITY, END, RED, GREEN, BLUE, DEPTH = range(11)
"""Places in a row of `splats`."""
COLUMNS = 11
LEFT, TOP, RIGHT, BOTTOM = range(4)
"""Places in a row of `boxes`."""
array = ti.types.ndarray()


def start_kernels(like: "Tensor") -> None:
    """The compiler where a tensor is, with its precision and as many threads as torch has.

    Raises:
        InputError: the tensor is of another type than float32 and float64.
    """
    import torch

    precisions: dict[torch.dtype, Precision] = {torch.float32: "float32", torch.float64: "float64"}
    if like.dtype not in precisions:
        raise InputError(f"splats.means: {like.dtype}; must be float32 or float64")
    start_compiler(precisions[like.dtype], torch.get_num_threads(), "cuda" if like.is_cuda else "cpu")


@ti.func
def exp_of_minus(p, exact: ti.template()):
    """exp(-p) in sums and products alone: to 4e-5 of itself for 0 <= p <= 5.6, and to 1e-13 if `exact`.

    Taichi has no exponential of a whole vector.
    """
    y = p * (-1.0 / 16.0)
    e = y * 0.0 + 1.0
    for k in ti.static(range(12 if exact else 5, 0, -1)):
        e = 1.0 + y * e * (1.0 / k)
    e = e * e
    e = e * e
    e = e * e
    return e * e


# --- Gaussians to splats ---------------------------------------------------------------------------------------------


@ti.func
def camera_point(means: array, pose: array, i):
    """t [m]."""
    x, y, z = ti.cast(means[i, 0], ti.f64), ti.cast(means[i, 1], ti.f64), ti.cast(means[i, 2], ti.f64)
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@ti.func
def held(x, z, low, high):
    """x with x / z held between low and high."""
    return ti.min(ti.max(x / z, low), high) * z


@ti.func
def projected_axis(pose: array, axis, focal, t, z):
    """A row of M = J R [px / m]: axis 0 of x, 1 of y."""
    along, across = focal / z, -focal * t / (z * z)
    return (
        along * pose[axis, 0] + across * pose[2, 0],
        along * pose[axis, 1] + across * pose[2, 1],
        along * pose[axis, 2] + across * pose[2, 2],
    )


@ti.func
def covariance_times(covariances: array, i, x, y, z):
    """Sigma (x, y, z)^T, of the symmetric part of what is in memory."""
    xx, yy, zz = covariances[i, 0, 0], covariances[i, 1, 1], covariances[i, 2, 2]
    xy = 0.5 * (ti.cast(covariances[i, 0, 1], ti.f64) + covariances[i, 1, 0])
    xz = 0.5 * (ti.cast(covariances[i, 0, 2], ti.f64) + covariances[i, 2, 0])
    yz = 0.5 * (ti.cast(covariances[i, 1, 2], ti.f64) + covariances[i, 2, 1])
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@ti.func
def within(edge, first, last):
    """An edge of a splat, counted in the middles of pixels, no further out than `first` and `last`."""
    return ti.min(ti.max(edge - 0.5, ti.cast(first, ti.f64)), ti.cast(last, ti.f64))


@ti.func
def filter_of(antialiased: ti.template()):
    """f [px^2]."""
    return ti.static(PIXEL if antialiased else DILATION)


@ti.func
def projected_covariance(covariances: array, i, wider, m00, m01, m02, m10, m11, m12):
    """S: xx, xy, yy [px^2]; and Sigma M^T, x before y."""
    u0, u1, u2 = covariance_times(covariances, i, m00, m01, m02)
    v0, v1, v2 = covariance_times(covariances, i, m10, m11, m12)
    xx, xy = m00 * u0 + m01 * u1 + m02 * u2 + wider, m10 * u0 + m11 * u1 + m12 * u2
    return xx, xy, m10 * v0 + m11 * v1 + m12 * v2 + wider, u0, u1, u2, v0, v1, v2


@ti.func
def kept_share(xx, xy, yy, wider):
    """det(S - f I) / det S."""
    return ((xx - wider) * (yy - wider) - xy * xy) / (xx * yy - xy * xy)


@ti.kernel
def project(
    antialiased: ti.template(), means: array, covariances: array, opacities: array, colours: array, pose: array,
    lens: array, cut: ti.f64, width: ti.i32, height: ti.i32, splats: array, boxes: array
):  # fmt: skip
    """One splat a Gaussian; `lens`: focal lengths and centre [px], bounds of x/z and y/z in J, near [m]."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(means.shape[0]):
        x, y, z = camera_point(means, pose, i)
        opacity = ti.cast(opacities[i], ti.f64)
        boxes[i, LEFT], boxes[i, TOP], boxes[i, RIGHT], boxes[i, BOTTOM] = 0, 0, -1, -1
        if z >= lens[8] and opacity >= cut:
            m00, m01, m02 = projected_axis(pose, 0, lens[0], held(x, z, lens[4], lens[5]), z)
            m10, m11, m12 = projected_axis(pose, 1, lens[1], held(y, z, lens[6], lens[7]), z)
            wider = filter_of(antialiased)
            xx, xy, yy, _0, _1, _2, _3, _4, _5 = projected_covariance(
                covariances, i, wider, m00, m01, m02, m10, m11, m12
            )
            determinant = xx * yy - xy * xy
            if ti.static(antialiased):
                opacity *= ti.sqrt(ti.max(kept_share(xx, xy, yy, wider), LEAST_SHARE))
            end = ti.log(opacity / cut)
            if determinant > 0.0 and end >= 0.0:
                centre_x, centre_y = lens[0] * x / z + lens[2], lens[1] * y / z + lens[3]
                reach_x, reach_y = ti.sqrt(2.0 * end * xx), ti.sqrt(2.0 * end * yy)
                boxes[i, LEFT] = ti.cast(ti.ceil(within(centre_x - reach_x, 0, width)), ti.i32)
                boxes[i, TOP] = ti.cast(ti.ceil(within(centre_y - reach_y, 0, height)), ti.i32)
                boxes[i, RIGHT] = ti.cast(ti.floor(within(centre_x + reach_x, -1, width - 1)), ti.i32)
                boxes[i, BOTTOM] = ti.cast(ti.floor(within(centre_y + reach_y, -1, height - 1)), ti.i32)
                if boxes[i, TOP] > boxes[i, BOTTOM]:
                    boxes[i, RIGHT] = -1
                splats[i, X], splats[i, Y] = centre_x, centre_y
                splats[i, P] = ti.sqrt(0.5 * yy / determinant)
                splats[i, Q], splats[i, R] = -xy / ti.sqrt(2.0 * determinant * yy), 1.0 / ti.sqrt(2.0 * yy)
                splats[i, OPACITY], splats[i, END], splats[i, DEPTH] = opacity, end, z
                splats[i, RED], splats[i, GREEN], splats[i, BLUE] = colours[i, 0], colours[i, 1], colours[i, 2]


@ti.kernel
def project_back(
    antialiased: ti.template(), means: array, covariances: array, opacities: array, pose: array, lens: array,
    boxes: array, given: array, to_means: array, to_covariances: array
):  # fmt: skip
    """Gradients of means and covariances from those of the splats, `given`, laid out as they are."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(means.shape[0]):
        if boxes[i, LEFT] <= boxes[i, RIGHT]:
            x, y, z = camera_point(means, pose, i)
            tx, ty = held(x, z, lens[4], lens[5]), held(y, z, lens[6], lens[7])
            m00, m01, m02 = projected_axis(pose, 0, lens[0], tx, z)
            m10, m11, m12 = projected_axis(pose, 1, lens[1], ty, z)
            wider = filter_of(antialiased)
            xx, xy, yy, u0, u1, u2, v0, v1, v2 = projected_covariance(
                covariances, i, wider, m00, m01, m02, m10, m11, m12
            )
            # dL/dS, as a full symmetric matrix, by way of the determinant
            determinant = xx * yy - xy * xy
            to_q = given[i, Q] / ti.sqrt(2.0 * determinant * yy)
            by_p, by_q = given[i, P] * ti.sqrt(0.5 * yy / determinant), -to_q * xy
            by_r = given[i, R] / ti.sqrt(2.0 * yy)
            share = -0.5 * (by_p + by_q) / determinant
            sxx = share * yy
            sxy = -share * xy - 0.5 * to_q
            syy = share * xx + 0.5 * (by_p - by_q - by_r) / yy
            if ti.static(antialiased):
                kept = kept_share(xx, xy, yy, wider)
                if kept > LEAST_SHARE:
                    by_kept = 0.5 * given[i, OPACITY] * opacities[i] / ti.sqrt(kept) / determinant
                    sxx += by_kept * (yy - wider - kept * yy)
                    sxy += by_kept * xy * (kept - 1.0)
                    syy += by_kept * (xx - wider - kept * xx)
            # dL/dSigma = M^T (dL/dS) M
            for k, n0, n1 in ti.static(((0, m00, m10), (1, m01, m11), (2, m02, m12))):
                for_x, for_y = sxx * n0 + sxy * n1, sxy * n0 + syy * n1
                to_covariances[i, k, 0] = for_x * m00 + for_y * m10
                to_covariances[i, k, 1] = for_x * m01 + for_y * m11
                to_covariances[i, k, 2] = for_x * m02 + for_y * m12
            # dL/dM = 2 (dL/dS) M Sigma, and dL/dJ = (dL/dM) R^T
            h00, h01, h02 = 2.0 * (sxx * u0 + sxy * v0), 2.0 * (sxx * u1 + sxy * v1), 2.0 * (sxx * u2 + sxy * v2)
            h10, h11, h12 = 2.0 * (sxy * u0 + syy * v0), 2.0 * (sxy * u1 + syy * v1), 2.0 * (sxy * u2 + syy * v2)
            jx = h00 * pose[0, 0] + h01 * pose[0, 1] + h02 * pose[0, 2]
            jxz = h00 * pose[2, 0] + h01 * pose[2, 1] + h02 * pose[2, 2]
            jy = h10 * pose[1, 0] + h11 * pose[1, 1] + h12 * pose[1, 2]
            jyz = h10 * pose[2, 0] + h11 * pose[2, 1] + h12 * pose[2, 2]
            to_x, to_y = given[i, X] * lens[0] / z, given[i, Y] * lens[1] / z
            to_z = given[i, DEPTH] - (to_x * x + to_y * y) / z - (jx * lens[0] + jy * lens[1]) / (z * z)
            across_x, across_y = -jxz * lens[0] / (z * z), -jyz * lens[1] / (z * z)
            to_z += -2.0 * (across_x * tx + across_y * ty) / z
            if lens[4] <= x / z and x / z <= lens[5]:
                to_x += across_x
            else:
                to_z += across_x * tx / z
            if lens[6] <= y / z and y / z <= lens[7]:
                to_y += across_y
            else:
                to_z += across_y * ty / z
            for k in ti.static(range(3)):
                to_means[i, k] = to_x * pose[0, k] + to_y * pose[1, k] + to_z * pose[2, k]


# --- splats to tiles -------------------------------------------------------------------------------------------------


@ti.func
def tile_box(boxes: array, i, tile: ti.template()):
    """First and last column and row of tiles that a splat reaches."""
    return boxes[i, LEFT] // tile, boxes[i, RIGHT] // tile, boxes[i, TOP] // tile, boxes[i, BOTTOM] // tile


@ti.kernel
def count_tiles(tile: ti.template(), boxes: array, counts: array):
    """How many tiles each splat reaches."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(boxes.shape[0]):
        counts[i] = 0
        if boxes[i, LEFT] <= boxes[i, RIGHT]:
            left, right, top, bottom = tile_box(boxes, i, tile)
            counts[i] = (right - left + 1) * (bottom - top + 1)


@ti.kernel
def fill_tiles(
    tile: ti.template(), filling: ti.template(), tasks: ti.i32, columns: ti.i32, rows: ti.i32, order: array,
    boxes: array, first: array, starts: array, members: array, entries: array
):  # fmt: skip
    """A counting sort: each task goes through all splats from front to back and deals with its own rows of tiles.

    Without `filling` it counts, in starts[tile + 1]. With it `starts` holds where each tile's members begin, and ends
    as where they end. members: the splats of each tile, front to back; entries: which of its own tiles that is to each.
    """
    ti.loop_config(block_dim=CPU_TASK)
    for turn in range(tasks * CPU_TASK):
        if turn % CPU_TASK == 0:
            task = turn // CPU_TASK
            low, high = task * rows // tasks, (task + 1) * rows // tasks
            for k in range(order.shape[0]):
                i = order[k]
                left, right, top, bottom = tile_box(boxes, i, tile)
                if boxes[i, LEFT] <= boxes[i, RIGHT]:
                    for row in range(ti.max(top, low), ti.min(bottom + 1, high)):
                        for column in range(left, right + 1):
                            here = row * columns + column
                            if ti.static(filling):
                                place = starts[here]
                                members[place] = i
                                entries[place] = first[i] + (row - top) * (right - left + 1) + column - left
                                starts[here] = place + 1
                            else:
                                starts[here + 1] = starts[here + 1] + 1  # += would be atomic


@ti.kernel
def gather(counts: array, first: array, entries: array, splats: array):
    """Sum of each splat's rows."""
    ti.loop_config(block_dim=CPU_TASK)
    for i in range(counts.shape[0]):
        for column in ti.static(range(COLUMNS)):
            total = 0.0
            for entry in range(first[i], first[i] + counts[i]):
                total = total + entries[entry, column]
            splats[i, column] = total
