"""Gaussians to pictures, differentiably: `rasterise` for one, `render_frames` for a film.

The Taichi backend projects Gaussians to splats, sorts them by depth and into tiles, and blends the tiles
(`hoi.render.kernels`); gradients go back the same way. Memory is linear in Gaussians and pixels.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from hoi.data import Camera
from hoi.errors import InputError
from hoi.render import Backend, blend_pixels, blend_rows, kernels
from hoi.render.splats import Picture, Splats, check, join, shade

Colour = Sequence[float] | Tensor
WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Settings:
    """What a picture may leave out. The defaults are 3D Gaussian splatting's own."""

    least_alpha: float = 1 / 255
    """A Gaussian that covers less of a pixel than this is left out there."""
    least_transmittance: float = 1e-4
    """A pixel through which less than this would be seen is full."""
    tile: int = 16
    """Pixels across a tile."""
    exact: bool = False
    """The exponential function to the last digit rather than to 4e-5. Always in float64."""
    antialiased: bool = False
    """Widen each splat by a pixel's own 0.1 px^2 instead of 0.3, and make up for it in its opacity: small ones far away
    stay as thin as they are."""
    by_pixel: bool | None = None
    """Blend pixel by pixel rather than row by row; None: on a GPU."""


def rasterise(
    splats: Splats,
    camera: Camera,
    background: Colour = WHITE,
    *,
    depth: bool = False,
    sh_degree: int | None = None,
    backend: Backend = "taichi",
    settings: Settings = Settings(),
) -> Picture:
    """A picture of the Gaussians, differentiable in all tensors of `splats` and in the background.

    Args:
        background: RGB (3,), or of each pixel (height, width, 3).
        depth: whether to accumulate depth too.
        sh_degree: highest degree of the harmonics that is evaluated (default: all there are).

    Raises:
        InputError: a tensor has a wrong shape or is not finite, or the backend cannot run here.
    """
    check(splats)
    if backend == "reference":
        from hoi.render.reference import rasterise_reference

        return rasterise_reference(
            splats, camera, background, depth=depth, sh_degree=sh_degree, antialiased=settings.antialiased
        )
    if backend == "gsplat":
        from hoi.render.gsplat_backend import rasterise_gsplat

        return rasterise_gsplat(
            splats, camera, background, depth=depth, sh_degree=sh_degree, antialiased=settings.antialiased
        )
    if backend != "taichi":
        raise InputError(f"backend {backend!r}; allowed are {', '.join(get_args(Backend))}")
    colours = shade(splats, _eye(camera, splats.means), sh_degree)
    behind = _background(background, camera, splats.means)
    kernels.start_kernels(splats.means)
    colour, alpha, z = _Rasterise.apply(
        splats.means, splats.covariances, splats.opacities, colours, behind, camera, settings, depth
    )
    return Picture(colour, alpha, z if depth else None)


def render_frames(
    frames: Iterable[Sequence[Splats]],
    cameras: Camera | Iterable[Camera],
    backgrounds: Colour | Iterator[Tensor] = WHITE,
    *,
    sh_degree: int | None = None,
    backend: Backend = "taichi",
    settings: Settings = Settings(),
) -> Iterator[Picture]:
    """Pictures of frames that are made of parts, without gradients.

    A part that is the same object as in the frame before, under the same camera, is not projected again.

    Args:
        frames: the parts of each frame, e.g. person and object.
        cameras: one for all frames, or one for each.
        backgrounds: one for all frames, as in `rasterise`, or an iterator over one for each.

    Raises:
        InputError: as `rasterise`.
    """
    each_camera = repeat(cameras) if isinstance(cameras, Camera) else cameras
    each_background: Iterator[Colour] = backgrounds if isinstance(backgrounds, Iterator) else repeat(backgrounds)
    last_camera: Camera | None = None
    known: dict[int, tuple[Splats, _Flat]] = {}  # the Splats too, so that its id is not given to another
    for parts, camera, background in zip(frames, each_camera, each_background, strict=False):
        if backend != "taichi":
            yield rasterise(join(parts), camera, background, sh_degree=sh_degree, backend=backend, settings=settings)
            continue
        with torch.no_grad():
            known = known if camera is last_camera else {}
            known = {
                id(part): known.get(id(part)) or (part, _flat(part, camera, sh_degree, settings)) for part in parts
            }
            last_camera = camera
            flats = [flat for _, flat in known.values()]
            whole = _Flat(torch.cat([flat.splats for flat in flats]), torch.cat([flat.boxes for flat in flats]))
            behind = _background(background, camera, whole.splats)
            colour, alpha, _ = _blend(whole, _sort(whole, camera, settings), behind, settings, False)
        yield Picture(colour, alpha)


# --- the Taichi backend ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Flat:
    """Gaussians in the picture plane; see `hoi.render.kernels`."""

    splats: Tensor
    """(N, 11)."""
    boxes: Tensor
    """(N, 4), int32."""


@dataclass(frozen=True)
class _Tiles:
    """Which splats each tile is made of."""

    columns: int
    ends: Tensor
    """Where the members of each tile end, (tiles,), int32."""
    members: Tensor
    """Splats, tile by tile, front to back, (entries,), int32."""
    entries: Tensor
    """The number of each member in the splats' own order, (entries,), int32."""
    counts: Tensor
    """Tiles that each splat reaches, (N,), int32."""
    first: Tensor
    """The number of its first, (N,), int32."""


class _Rasterise(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        covariances: Tensor,
        opacities: Tensor,
        colours: Tensor,
        background: Tensor,
        camera: Camera,
        settings: Settings,
        deep: bool,
    ) -> tuple[Tensor, Tensor, Tensor]:
        flat = _project(means, covariances, opacities, colours, camera, settings)
        tiles = _sort(flat, camera, settings)
        colour, alpha, depth = _blend(flat, tiles, background, settings, deep)
        ctx.save_for_backward(means, covariances, opacities, colour, alpha, depth)
        ctx.flat, ctx.tiles, ctx.camera, ctx.settings, ctx.deep = flat, tiles, camera, settings, deep
        return colour, alpha, depth

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        means, covariances, opacities, colour, alpha, depth = ctx.saved_tensors
        to_colour, to_alpha, to_depth = (gradient.contiguous() for gradient in gradients)
        flat, tiles, settings, deep = ctx.flat, ctx.tiles, ctx.settings, ctx.deep
        rest = (to_colour * colour).sum(-1) + to_alpha * alpha
        if deep:
            rest = rest + to_depth * depth
        if not any(ctx.needs_input_grad[:4]):
            return None, None, None, None, (1 - alpha)[..., None] * to_colour, None, None, None
        to_splats = _blend_back(flat, tiles, to_colour, to_alpha, to_depth, rest, settings, deep)
        to_means, to_covariances = means.new_zeros(means.shape), means.new_zeros(covariances.shape)
        if ctx.needs_input_grad[0] or ctx.needs_input_grad[1]:
            pose, lens = _lens(ctx.camera, means.device)
            means, covariances = means.detach().contiguous(), covariances.detach().contiguous()
            kernels.project_back(
                settings.antialiased, means, covariances, opacities.detach().contiguous(), pose, lens, flat.boxes,
                to_splats, to_means, to_covariances,
            )  # fmt: skip
        to_opacities = to_splats[:, kernels.OPACITY]
        if settings.antialiased:
            to_opacities = to_opacities * flat.splats[:, kernels.OPACITY] / opacities.clamp_min(settings.least_alpha)
        return (
            to_means, to_covariances, to_opacities, to_splats[:, kernels.RED : kernels.BLUE + 1],
            (1 - alpha)[..., None] * to_colour, None, None, None,
        )  # fmt: skip


def _flat(part: Splats, camera: Camera, sh_degree: int | None, settings: Settings = Settings()) -> _Flat:
    check(part)
    colours = shade(part, _eye(camera, part.means), sh_degree)
    kernels.start_kernels(part.means)
    return _project(part.means, part.covariances, part.opacities, colours, camera, settings)


def _project(
    means: Tensor, covariances: Tensor, opacities: Tensor, colours: Tensor, camera: Camera, settings: Settings
) -> _Flat:
    count = len(means)
    splats = means.new_zeros(count, kernels.COLUMNS)
    boxes = torch.empty(count, 4, dtype=torch.int32, device=means.device)
    if count:
        pose, lens = _lens(camera, means.device)
        means, covariances, opacities, colours = (
            array.detach().contiguous() for array in (means, covariances, opacities, colours)
        )
        kernels.project(
            settings.antialiased, means, covariances, opacities, colours, pose, lens, settings.least_alpha,
            camera.width, camera.height, splats, boxes,
        )  # fmt: skip
    return _Flat(splats, boxes)


def _sort(flat: _Flat, camera: Camera, settings: Settings) -> _Tiles:
    """Front to back, and into tiles."""
    device = flat.boxes.device
    columns, rows = -(-camera.width // settings.tile), -(-camera.height // settings.tile)
    counts = torch.zeros(len(flat.boxes), dtype=torch.int32, device=device)
    if len(counts):
        kernels.count_tiles(settings.tile, flat.boxes, counts)
    ends = counts.cumsum(0)
    total = int(ends[-1]) if len(ends) else 0
    if total >= 2**31:
        raise InputError(
            f"{total} splats in tiles; at most {2**31 - 1} can be sorted: fewer Gaussians, or a smaller picture"
        )
    first = (ends - counts).to(torch.int32)
    visible = counts.nonzero()[:, 0]
    depths = flat.splats[visible, kernels.DEPTH]
    if device.type == "cuda":
        order = visible[torch.argsort(depths, stable=True)]
        return _tiles_by_sorting(flat.boxes, order, counts, first, columns, rows, settings.tile)
    order = visible[torch.from_numpy(_front_to_back(depths.numpy()))].to(torch.int32)
    starts = torch.zeros(columns * rows + 1, dtype=torch.int32)
    members, entries = (torch.empty(max(total, 1), dtype=torch.int32) for _ in range(2))
    if len(order):
        for filling in (False, True):
            kernels.fill_tiles(
                settings.tile, filling, torch.get_num_threads(), columns, rows, order, flat.boxes, first, starts,
                members, entries,
            )  # fmt: skip
            starts = starts if filling else starts.cumsum(0).to(torch.int32)
    return _Tiles(columns, starts[:-1], members, entries, counts, first)


def _front_to_back(depths: Any) -> Any:
    """Indices that sort positive depths, equal ones as they come."""
    if depths.dtype != np.float32:
        return np.argsort(depths, kind="stable")
    keys = np.ascontiguousarray(depths).view(np.uint32).astype(np.int64) << 32
    keys |= np.arange(len(depths))
    keys.sort()  # a tenth of the time of finding an order
    return keys & 0xFFFFFFFF


def _tiles_by_sorting(
    boxes: Tensor, order: Tensor, counts: Tensor, first: Tensor, columns: int, rows: int, tile: int
) -> _Tiles:
    """The counting sort of `kernels.fill_tiles` with sorts that a GPU is good at."""
    here = counts[order].long()
    member = torch.repeat_interleave(order, here)
    number = torch.arange(len(member), device=boxes.device) - torch.repeat_interleave(here.cumsum(0) - here, here)
    left, top, right, _ = (boxes[member] // tile).long().unbind(1)
    width = right - left + 1
    tiles = (top + number // width) * columns + left + number % width
    place = torch.argsort(tiles, stable=True)
    ends = torch.bincount(tiles, minlength=columns * rows).cumsum(0).to(torch.int32)
    entries = first[member] + number.to(torch.int32)
    return _Tiles(columns, ends, member[place].to(torch.int32), entries[place], counts, first)


def _blend(
    flat: _Flat, tiles: _Tiles, background: Tensor, settings: Settings, deep: bool
) -> tuple[Tensor, Tensor, Tensor]:
    height, width = background.shape[:2]
    splats, tile = flat.splats, settings.tile
    colour = background.detach().clone(memory_format=torch.contiguous_format)
    alpha, depth = splats.new_zeros(height, width), splats.new_zeros((height, width) if deep else (1, 1))
    if len(splats) == 0:
        return colour, alpha, depth
    exact = settings.exact or splats.dtype == torch.float64
    count, least = len(tiles.ends), settings.least_transmittance
    if _by_pixel(settings, splats):
        blend_pixels.blend_pixels(
            tile, deep, exact, tiles.columns, count, least, splats, tiles.ends, tiles.members,
            colour, alpha, depth,
        )  # fmt: skip
    else:
        tasks = torch.get_num_threads()
        kept = blend_rows.room(tile, 6 * tasks, splats.dtype == torch.float64)
        blend_rows.blend_rows(
            tile, deep, exact, tasks, tiles.columns, count, least, splats, flat.boxes, tiles.ends, tiles.members,
            kept, _queue(), colour, alpha, depth,
        )  # fmt: skip
    return colour, alpha, depth


def _blend_back(
    flat: _Flat, tiles: _Tiles, to_colour: Tensor, to_alpha: Tensor, to_depth: Tensor, rest: Tensor, settings: Settings,
    deep: bool
) -> Tensor:  # fmt: skip
    """Gradients of the splats, (N, 11)."""
    splats, tile = flat.splats, settings.tile
    to_splats = torch.zeros_like(splats)
    total = int(tiles.ends[-1])
    if total == 0:
        return to_splats
    given = splats.new_zeros(total, kernels.COLUMNS)
    exact = settings.exact or splats.dtype == torch.float64
    count, least = len(tiles.ends), settings.least_transmittance
    if _by_pixel(settings, splats):
        blend_pixels.blend_pixels_back(
            tile, deep, exact, tiles.columns, count, least, splats, tiles.ends, tiles.members, tiles.entries,
            to_colour, to_alpha, to_depth, rest, given,
        )  # fmt: skip
    else:
        tasks = torch.get_num_threads()
        kept = blend_rows.room(tile, 7 * tasks, splats.dtype == torch.float64)
        blend_rows.blend_rows_back(
            tile, deep, exact, tasks, tiles.columns, count, least, splats, flat.boxes, tiles.ends, tiles.members,
            tiles.entries, kept, _queue(), to_colour, to_alpha, to_depth, rest, given,
        )  # fmt: skip
    kernels.gather(tiles.counts, tiles.first, given, to_splats)
    return to_splats


def _queue() -> Tensor:
    return torch.zeros(1, dtype=torch.int32)


def _by_pixel(settings: Settings, splats: Tensor) -> bool:
    return splats.is_cuda if settings.by_pixel is None else settings.by_pixel


def _lens(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor]:
    """Pose, and focal lengths, centre, bounds of x/z and y/z in the Jacobian, and near."""
    spare_x, spare_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    numbers = [
        camera.fx, camera.fy, camera.cx, camera.cy,
        -camera.cx / camera.fx - spare_x, (camera.width - camera.cx) / camera.fx + spare_x,
        -camera.cy / camera.fy - spare_y, (camera.height - camera.cy) / camera.fy + spare_y,
        camera.near,
    ]  # fmt: skip
    pose = torch.as_tensor(np.ascontiguousarray(camera.world_to_camera), dtype=torch.float64, device=device)
    return pose, torch.tensor(numbers, dtype=torch.float64, device=device)


def _eye(camera: Camera, like: Tensor) -> Tensor:
    return torch.as_tensor(np.asarray(camera.position), dtype=like.dtype, device=like.device)


def _background(background: Colour, camera: Camera, like: Tensor) -> Tensor:
    behind = torch.as_tensor(background, dtype=like.dtype, device=like.device)
    whole = (camera.height, camera.width, 3)
    if behind.shape not in ((3,), whole):
        raise InputError(f"background: shape {tuple(behind.shape)}; must be (3,) or {whole}")
    if not bool(behind.detach().sum().isfinite()):
        raise InputError("background: holds numbers that are not finite")
    return behind.expand(whole)
