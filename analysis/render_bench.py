"""Milliseconds a picture: `python -m analysis.render_bench [--threads 1 2] [--cloud FILE] [--peer PYTHON]`.

The default scene, with more Gaussians than it has by default, and a synthetic cloud, 720 x 480, with and without
gradients; what a picture adds to the process's memory; and gsplat beside it. On a GPU that is gsplat's own rasteriser.
On a CPU all that runs of gsplat is the projection of its PyTorch reference, so there the projections are compared: in
this Python, if it has gsplat, or in the one that --peer names.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command
from .command import timed

if TYPE_CHECKING:
    from hoi.render.cameras import Camera
    from hoi.render.splats import Splats

Row = dict[str, float | str]
WARM_UP = 3
WIDTH, HEIGHT = 720, 480


def milliseconds(step: Callable[[], object], turns: int) -> dict[str, float | str]:
    """Best and median [ms] of `turns` turns, after `WARM_UP` that do not count; and the median's pictures a second."""
    spent = [1e3 * seconds for seconds in timed(step, turns, WARM_UP)]
    median = float(np.median(spent))
    return {"best ms": min(spent), "median ms": median, "FPS": 1e3 / median}


# --- pictures --------------------------------------------------------------------------------------------------------


def measure(name: str, splats: "Splats", camera: "Camera", turns: int, backend: str = "taichi") -> list[Row]:
    """Two rows of the table, on the threads that PyTorch has, or on the GPU where the splats are."""
    import torch

    from hoi.render.rasterise import rasterise

    inputs = [splats.means, splats.covariances, splats.opacities, splats.sh]
    head = {"scene": name, "Gaussians": len(splats), "by": {"taichi": "hoi"}.get(backend, backend), "on": _on(splats)}

    def picture() -> None:
        with torch.no_grad():
            rasterise(splats, camera, backend=backend)  # pyright: ignore[reportArgumentType]
        _wait(splats)

    def gradients() -> None:
        for tensor in inputs:
            tensor.requires_grad_().grad = None
        rasterise(splats, camera, backend=backend).colour.square().mean().backward()  # pyright: ignore[reportArgumentType]
        _wait(splats)

    rows = [
        head | {"what": what} | milliseconds(step, turns)
        for what, step in (("picture", picture), ("picture and gradients", gradients))
    ]
    for tensor in inputs:
        tensor.requires_grad_(False)
    return rows


def measure_film(name: str, moving: "Splats", still: "Splats", camera: "Camera", turns: int) -> Row:
    """A row of the table: a frame of a film in which one part moves."""
    from dataclasses import replace

    from hoi.render.rasterise import render_frames

    def frames() -> Iterator[tuple["Splats", "Splats"]]:
        while True:
            yield replace(moving), still

    film = render_frames(frames(), camera)

    def step() -> None:
        next(film)
        _wait(moving)

    head = {"scene": name, "Gaussians": len(moving) + len(still), "by": "hoi", "on": _on(moving)}
    return head | {"what": "frame of a film"} | milliseconds(step, turns)


def _on(splats: "Splats") -> str:
    import torch

    if splats.means.is_cuda:
        return "CUDA"
    count = torch.get_num_threads()
    return "1 thread" if count == 1 else f"{count} threads"


def _wait(splats: "Splats") -> None:
    import torch

    if splats.means.is_cuda:
        torch.cuda.synchronize()


# --- memory ----------------------------------------------------------------------------------------------------------


def memory(count: int, gradients: bool) -> dict[str, float | str]:
    """What a picture of a synthetic cloud adds to the resident memory at its peak [MB], in a process of its own.

    Raises:
        InputError: it failed there.
    """
    freed = {"MALLOC_MMAP_THRESHOLD_": str(2**20)}  # glibc then gives back what is freed, and nothing hides in it
    call = f"render_bench.peak_growth({count}, {gradients})"
    given = command.called_in(sys.executable, call, partial(_failed, "memory", sys.executable), freed)
    what = "picture and gradients" if gradients else "picture"
    return {"Gaussians": count, "what": what, "peak MB": given / 1e6, "bytes/Gaussian": given / count}


def peak_growth(count: int, gradients: bool) -> float:
    """Bytes, in this process; nan where /proc does not tell. The cloud and the compiled kernels do not count."""
    import torch

    from hoi.render.rasterise import rasterise

    from .splat_scenes import camera_on, synthetic_cloud

    torch.set_num_threads(1)

    def draw(splats: "Splats", camera: "Camera") -> None:
        for tensor in (splats.means, splats.covariances, splats.opacities, splats.sh):
            tensor.requires_grad_(gradients)
        colour = rasterise(splats, camera).colour
        if gradients:
            colour.square().mean().backward()

    small, large = synthetic_cloud(1000), synthetic_cloud(count)
    camera = camera_on(large, WIDTH, HEIGHT)
    draw(small, camera)
    reset = Path("/proc/self/clear_refs")
    if not reset.exists():
        return float("nan")
    reset.write_text("5")  # the peak is what is resident now
    before = _resident("VmRSS")
    draw(large, camera)
    return _resident("VmHWM") - before


def _resident(field: str) -> float:
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field)]
    return 1024.0 * int(line.split()[1])


def _failed(what: str, python: str, said: list[str]) -> str:
    return f"{what}: {python} failed: {' '.join(said)}"


# --- gsplat on a CPU -------------------------------------------------------------------------------------------------


def projection_rows(
    name: str, splats: "Splats", camera: "Camera", threads: int, turns: int, peer: str | None
) -> list[Row]:
    """Rows of the table: projecting alone, of this renderer and, in the interpreter `peer`, of gsplat's reference.

    From world means and covariances to centres, inverse covariances, depths and extents in the picture; no colours.

    Raises:
        InputError: it failed there.
    """
    from hoi.render import kernels, rasterise

    colours = splats.sh[:, 0].contiguous()
    settings = rasterise.Settings()
    kernels.start_kernels(splats.means)
    ours = milliseconds(
        lambda: rasterise._project(splats.means, splats.covariances, splats.opacities, colours, camera, settings), turns
    )
    head = {"scene": name, "Gaussians": len(splats)}
    rest = {"on": _on(splats), "what": "projection alone"}
    rows: list[Row] = [head | {"by": "hoi"} | rest | ours]
    if peer is not None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "splats.npz"
            np.savez(
                path,
                means=splats.means.numpy(),
                covariances=splats.covariances.numpy(),
                pose=camera.world_to_camera.astype(np.float32),
                lens=np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float32),
            )
            call = f"render_bench.gsplat_projection({str(path)!r}, {camera.width}, {camera.height}, {threads}, {turns})"
            theirs = command.called_in(peer, call, partial(_failed, "--peer", peer))
            rows.append(head | {"by": "gsplat's PyTorch"} | rest | theirs)
    return rows


def gsplat_projection(path: str, width: int, height: int, threads: int, turns: int) -> dict[str, float | str]:
    """Milliseconds of gsplat's PyTorch projection, in this interpreter, of what `projection_rows` has saved."""
    import torch
    from gsplat.cuda._torch_impl import _fully_fused_projection  # pyright: ignore[reportMissingImports]

    torch.set_num_threads(threads)
    with np.load(path, allow_pickle=False) as file:
        means, covariances, pose, lens = (
            torch.from_numpy(file[name]) for name in ("means", "covariances", "pose", "lens")
        )
    with torch.no_grad():
        return milliseconds(
            lambda: _fully_fused_projection(means, covariances, pose[None], lens[None], width, height), turns
        )


# --- the table -------------------------------------------------------------------------------------------------------


def measure_all(arguments: argparse.Namespace) -> list[Row]:
    """All rows of the table.

    Raises:
        InputError: a broken file, a peer that fails, or no CUDA device where one is asked for.
    """
    import torch

    from hoi.render.splats import join

    from .splat_scenes import as_type, camera_on, cloud_of_file, default_parts, synthetic_cloud, torch_threads

    on_gpu = arguments.device == "cuda"
    if on_gpu and not torch.cuda.is_available():
        raise InputError("--device cuda: PyTorch finds no CUDA device")
    captured = {} if arguments.cloud is None else {arguments.cloud.name: cloud_of_file(arguments.cloud)}
    person, thing = (as_type(part, torch.float32, arguments.device) for part in default_parts(arguments.person))
    scenes = {"default scene": join((person, thing)), "synthetic": synthetic_cloud(arguments.gaussians)} | captured
    rows = []
    for threads in [1] if on_gpu else arguments.threads:
        with torch_threads(threads):
            for name, splats in scenes.items():
                camera = camera_on(as_type(splats, torch.float32), WIDTH, HEIGHT)
                there = as_type(splats, torch.float32, arguments.device)
                rows += measure(name, there, camera, arguments.turns)
                if name == "default scene":
                    rows.append(measure_film(name, person, thing, camera, arguments.turns))
                if on_gpu:
                    rows += measure(name, there, camera, arguments.turns, "gsplat")
                else:
                    rows += projection_rows(name, splats, camera, threads, arguments.turns, arguments.peer)
    return rows


def with_ratios(rows: list[Row]) -> list[Row]:
    """The rows, where gsplat does the same with how many times as fast as it they are, by the medians."""
    same = ("scene", "on", "what")
    theirs = {tuple(row[name] for name in same): row for row in rows if str(row["by"]).startswith("gsplat")}
    peers = [theirs.get(tuple(row[name] for name in same)) for row in rows]
    return [
        row if peer is None else row | {"times as fast": float(peer["median ms"]) / float(row["median ms"])}
        for row, peer in zip(rows, peers, strict=True)
    ]


@command.exit_code("analysis.render_bench")
def main() -> None:
    parser = command.parser(
        "analysis.render_bench",
        "Milliseconds a picture, of the default scene's person and of larger clouds.",
        "--threads 1 2",
    )
    parser.add_argument("--person", type=int, default=26_000, help="Gaussians of the default scene's person")
    parser.add_argument("--gaussians", type=int, default=100_000, help="of the synthetic cloud (default 100000)")
    parser.add_argument("--cloud", type=Path, metavar="FILE", help="a 3DGS file, measured too")
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--turns", type=int, default=15, help="pictures of which the best and the median count")
    parser.add_argument("--memory", type=int, default=1_000_000, help="Gaussians of the cloud for it; 0: leave it out")
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    command.add_peer(parser, "gsplat", "gsplat")
    arguments = parser.parse_args()
    import pandas as pd  # not at the top: the peer's interpreter may not have it

    from . import sheets

    if min(arguments.gaussians, arguments.turns, *arguments.threads) < 1 or arguments.memory < 0:
        raise InputError("--gaussians, --turns and --threads must be 1 or more, --memory 0 or more")
    table = pd.DataFrame(with_ratios(measure_all(arguments)))
    peaks = [memory(arguments.memory, gradients) for gradients in (False, True) if arguments.memory]
    if arguments.device == "cpu" and arguments.peer is None:
        print("gsplat is not installed here; --peer PYTHON names an interpreter that has it")
    print(*(f"{name}: {value}" for name, value in sheets.facts(1).items() if name != "threads"), sep="; ")
    print(f"pictures of {WIDTH} x {HEIGHT}, {arguments.turns} of each")
    print(sheets.plain(table, na_rep=""))
    if peaks:
        print("Memory that a picture adds, on 1 thread of the CPU")
        print(sheets.plain(pd.DataFrame(peaks), digits=0))


if __name__ == "__main__":
    program(main)
