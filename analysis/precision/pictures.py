"""Error against time of the renderer: what a picture loses by each thing that it may leave out.

The truth is the Taichi backend's own picture in float64, with the exact exponential, nothing faint left out and no
pixel ever full: brute force would take minutes at this size. That the two are one is shown at a size where brute force
is affordable, see `disagreement`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from hoi.compute import Precision
from hoi.render.cameras import HEIGHT, WIDTH, Camera
from hoi.render.rasterise import Settings, rasterise
from hoi.render.splats import Picture, Splats, join, sh_degree

from ..splat_scenes import PERSON_GAUSSIANS, as_type, camera_on, default_parts, synthetic_cloud, torch_threads
from .run import clock, with_front

DEFAULT = Settings()
NOTHING_LEFT_OUT = Settings(least_alpha=1e-12, least_transmittance=0.0, exact=True)
"""A Gaussian ends somewhere, but where it has 1e-12 of a pixel."""
CLOUD_GAUSSIANS = 20_000
QUICK_GAUSSIANS = 2_000
QUICK_SHARE = 4
"""By how much smaller pictures are when it has to be quick."""
REFERENCE_SHARE = 15
"""By how much smaller the picture is that is held against brute force."""
COVERED = 0.01
"""Alpha from which a pixel counts in the PSNR: the background, which is always right, shall not."""
PICTURES = 4
"""Timed in each repeat; before the first there is one that is not."""
TYPES: dict[Precision, torch.dtype] = {"float32": torch.float32, "float64": torch.float64}


@dataclass(frozen=True)
class View:
    """What is drawn, and from where."""

    name: str
    title: str
    splats: Splats
    camera: Camera


def scene(quick: bool = False) -> View:
    """The default scene's person and object."""
    splats = join(default_parts(QUICK_GAUSSIANS if quick else PERSON_GAUSSIANS))
    return _view("scene", "person and ball", splats, quick)


def cloud(quick: bool = False) -> View:
    """A cloud whose colours depend on the view."""
    splats = synthetic_cloud(QUICK_GAUSSIANS if quick else CLOUD_GAUSSIANS)
    return _view("cloud", "synthetic, harmonics of degree 3", splats, quick)


VIEWS = (scene, cloud)


@dataclass(frozen=True)
class Variant:
    """One way to make a picture."""

    kind: str
    """What it changes of the base: "base", "harmonics", "alpha", "transmittance", "number", "tile" or, more than one
    thing, "all"."""
    label: str
    settings: Settings = DEFAULT
    precision: Precision = "float32"
    sh_degree: int | None = None


def variants(degree: int, quick: bool = False) -> list[Variant]:
    """The base and what is changed of it, one thing at a time, and then all cut-offs at once."""
    base = DEFAULT
    coarser = replace(base, least_alpha=1 / 64, least_transmittance=1e-2)
    finer = replace(base, least_alpha=1e-4, least_transmittance=1e-6, exact=True)
    alphas, transmittances = (32, 64, 128, 1024, 8192), (1e-1, 1e-2, 1e-3, 1e-6)
    if quick:
        alphas, transmittances = alphas[1:3], transmittances[1:3]
    return [
        Variant("base", "base"),
        *(Variant("harmonics", f"SH degree {lower}", sh_degree=lower) for lower in range(degree)),
        *(Variant("alpha", f"alpha from 1/{a}", replace(base, least_alpha=1 / a)) for a in alphas),
        *(Variant("transmittance", f"T to {t:g}", replace(base, least_transmittance=t)) for t in transmittances),
        Variant("number", "exact exp", replace(base, exact=True)),
        Variant("number", "float64", replace(base, exact=True), "float64"),
        *(Variant("tile", f"tiles of {tile}", replace(base, tile=tile)) for tile in ((8,) if quick else (8, 32))),
        Variant("all", "coarser", coarser),
        Variant("all", "finer", finer),
        Variant("all", "finer, float64", finer, "float64"),
        Variant("all", "nothing left out, float32", NOTHING_LEFT_OUT),
    ]


def truth(view: View) -> Picture:
    """Nothing left out, in float64."""
    return _drawn(view, Variant("truth", "truth", NOTHING_LEFT_OUT, "float64"))


def disagreement(view: View) -> float:
    """The largest difference of a colour, by which the float64 picture is off the brute force one: every pixel times
    every Gaussian in `hoi.render.reference`, under the same cut-offs, in a smaller picture."""
    width, height = view.camera.width // REFERENCE_SHARE, view.camera.height // REFERENCE_SHARE
    small = replace(view, camera=camera_on(view.splats, max(width, 1), max(height, 1)))
    ours = _drawn(small, Variant("number", "float64", Settings(exact=True), "float64"))
    with torch.no_grad():
        brute = rasterise(view.splats, small.camera, backend="reference")
    return float((ours.colour - brute.colour).abs().max())


def picture_errors(colour: Tensor, true: Picture) -> dict[str, float]:
    """Of colours (height, width, 3) on a scale of 0 to 1: RMS ("error") and PSNR [dB] over the pixels that Gaussians
    cover and the three channels, and the largest of all pixels."""
    off = colour.double() - true.colour.double()
    rms = float(off[true.alpha >= COVERED].square().mean().sqrt())
    psnr = float("inf") if rms == 0 else -20 * np.log10(rms)
    return {"error": rms, "psnr": psnr, "largest": float(off.abs().max())}


def study(
    views: Sequence[View], *, quick: bool = False, repeats: int = 3, threads: int = 1,
    say: Callable[[str], object] = print,
) -> tuple[pd.DataFrame, dict[str, float], dict[str, Picture]]:  # fmt: skip
    """One row a variant of each view: its settings, median, least and most seconds a picture, errors, and whether it is
    on the Pareto front; then the disagreement and the true picture of each view.

    Args:
        quick: leave out some variants.
        repeats: how often `PICTURES` pictures are timed.
        threads: of the renderer.
        say: told of each variant as it is done.
    """
    with torch_threads(threads):
        off = {view.name: disagreement(view) for view in views}
        truths = {view.name: truth(view) for view in views}
        rows = []
        for precision in ("float64", "float32"):  # Taichi starts anew, and loads its kernels again, at each
            jobs = [
                (view, variant)
                for view in views
                for variant in variants(sh_degree(view.splats), quick)
                if variant.precision == precision
            ]
            for (view, variant), (seconds, picture) in zip(jobs, _timed(jobs, repeats, threads), strict=True):
                cost, errors = _spread(seconds), picture_errors(picture.colour, truths[view.name])
                rows.append(_row(view, variant) | cost | errors)
                say(f"{view.name:8} {variant.label:26} {1e3 * cost['seconds']:7.1f} ms  {errors['psnr']:6.1f} dB")
    order = [(view.name, variant.label) for view in views for variant in variants(sh_degree(view.splats), quick)]
    table = pd.DataFrame(sorted(rows, key=lambda row: order.index((row["scene"], row["variant"]))))
    return with_front(table, "scene"), off, truths


def _view(name: str, title: str, splats: Splats, quick: bool) -> View:
    share = QUICK_SHARE if quick else 1
    return View(name, title, splats, camera_on(splats, WIDTH // share, HEIGHT // share))


def _drawn(view: View, variant: Variant) -> Picture:
    splats = as_type(view.splats, TYPES[variant.precision])
    with torch.no_grad():
        return rasterise(splats, view.camera, sh_degree=variant.sh_degree, settings=variant.settings)


def _timed(jobs: Sequence[tuple[View, Variant]], repeats: int, threads: int) -> list[tuple[list[float], Picture]]:
    """Seconds and the last picture of each job. They take turns, lest a slow moment of the machine fall on one."""
    inputs = [as_type(view.splats, TYPES[variant.precision]) for view, variant in jobs]
    seconds: list[list[float]] = [[] for _ in jobs]
    pictures: dict[int, Picture] = {}
    with torch.no_grad():
        for _ in range(1 + PICTURES * repeats):
            for index, (view, variant) in enumerate(jobs):
                began = clock(threads)
                pictures[index] = rasterise(
                    inputs[index], view.camera, sh_degree=variant.sh_degree, settings=variant.settings
                )
                seconds[index].append(clock(threads) - began)
    return [(spent[1:], pictures[index]) for index, spent in enumerate(seconds)]


def _spread(seconds: list[float]) -> dict[str, float]:
    return {
        "seconds": float(np.median(seconds)), "fastest": min(seconds), "slowest": max(seconds), "repeats": len(seconds)
    }  # fmt: skip


def _row(view: View, variant: Variant) -> dict[str, str | float]:
    degree, settings = sh_degree(view.splats), variant.settings
    return {
        "scene": view.name, "kind": variant.kind, "variant": variant.label, "gaussians": len(view.splats),
        "width": view.camera.width, "height": view.camera.height,
        "sh_degree": degree if variant.sh_degree is None else variant.sh_degree,
        "least_alpha": settings.least_alpha, "least_transmittance": settings.least_transmittance,
        "precision": variant.precision, "exact": settings.exact or variant.precision == "float64",
        "tile": settings.tile,
    }  # fmt: skip
