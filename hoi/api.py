"""The method from Python, in memory: nothing is written, printed or set for the whole process unless asked for.

    config = hoi.compose("scene=kick_soccer_ball", seed=1)
    result = hoi.run(config)                             # what `python -m hoi.run scene=kick_soccer_ball seed=1` does
    ball = hoi.simulate(cloud, "basketball", seconds=2)  # the object alone
    motion = hoi.sample_motion("a person kicks")         # the person alone
    picture = hoi.render(cloud)                          # Gaussians as a picture
    result = hoi.read("run.mcap")                        # what a run recorded

What is wrong with what is given raises `hoi.InputError`, a run that cannot go on `hoi.RunError`, each with one line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hoi.errors import InputError

if TYPE_CHECKING:
    from hoi.config import Config
    from hoi.data import Array, Body, Camera, GaussianCloud, Material, Motion, ObjectTrajectory, Plane, Run


def compose(*overrides: str, **values: object) -> Config:
    """The checked configuration of a run.

    Args:
        overrides: as on the command line: "scene=kick_soccer_ball", "stage.object.cells_across=24", ...
        values: keys of the top level: seed=1, threads=2, ...

    Raises:
        InputError: an override that is not allowed; one line a problem.
    """
    from hoi.config.compose import config_of

    return config_of(*overrides, *(f"{key}={'null' if value is None else value}" for key, value in values.items()))


def run(
    config: Config, *, object: GaussianCloud | None = None, out: str | Path | None = None, progress: bool = False
) -> Run:
    """The whole method, as `python -m hoi.run` does it.

    Args:
        config: of `compose`.
        object: Gaussians in place of those of `config.object`: metres, Z up; `config.scene.placement` says where they
            go, `config.material` what they are made of.
        out: folder for the record and its video, where they are found again when asked for once more; None keeps all in
            memory, and draws no video.
        progress: show bars on stderr, and of a run with `out` what came of it.

    Returns:
        the run: `state.motion`, `state.trajectory`, `state.contact`, `result["outcome"]`, ...

    Raises:
        InputError: bad input, before anything is computed.
        RunError: the run failed.
    """
    import torch

    from hoi.runner.execute import run_one

    cloud = None if object is None else _checked(object)
    with torch.random.fork_rng(devices=[]):
        return run_one(config, cloud, None if out is None else Path(out), progress)


def simulate(
    cloud: GaussianCloud,
    material: str | Material,
    seconds: float = 2.0,
    *,
    fps: float = 20.0,
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    angular_velocity: Sequence[float] = (0.0, 0.0, 0.0),
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    planes: Sequence[Plane] | None = None,
    cells_across: int = 16,
    threads: int = 1,
    device: str = "cpu",
) -> ObjectTrajectory:
    """Gaussians as an object by the MPM, with the same phases (flight, rest) as in a run.

    Args:
        cloud: where it is at t = 0 [m], Z up.
        material: a name in `conf/material/` or a material.
        seconds: how long [s].
        fps: frames that come back a second [1/s].
        velocity: of the centre of mass [m/s]. angular_velocity: about it [rad/s].
        gravity: [m/s^2].
        planes: what it cannot enter; None is the ground z = 0 with the material's friction.
        cells_across: of the grid, along its largest extent.

    Returns:
        the frames 0 .. seconds * fps; the first rows of `positions` are the Gaussians.

    Raises:
        InputError: an unknown material, a number out of range, an object in the ground.
        RunError: the simulation cannot go on.
    """
    from hoi.data import Plane
    from hoi.method.object_motion import World, free_motion
    from hoi.method.scene_representation import check_clear
    from hoi.objects.load import load_cloud, place
    from hoi.plan import material_of
    from hoi.reports import quiet
    from hoi.runner.scene import PARTICLES_PER_CELL

    if not (0 < seconds < math.inf and 0 < fps < math.inf):
        raise InputError("seconds and fps", f"{seconds:g} and {fps:g}", "greater than 0, and finite")
    named = material if isinstance(material, str) else "soft_solid"
    config = compose(f"material={named}", f"stage.object.cells_across={cells_across}")
    made, cloud = material_of(config.material) if isinstance(material, str) else material, _checked(cloud)
    centre = (cloud.means.min(0) + cloud.means.max(0)) / 2
    size = float(np.ptp(cloud.means, axis=0).max())
    spacing = config.stage.object.cell(size) / PARTICLES_PER_CELL ** (1 / 3)
    loaded = load_cloud("object", cloud, spacing, len(cloud))
    thing = place(loaded, made, centre.tolist(), velocity=velocity, angular_velocity=angular_velocity)
    if planes is None:
        planes = (Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), friction=made.ground_friction),)
    check_clear(thing, {"the ground" if not number else f"plane {number}": p for number, p in enumerate(planes)})
    frames = round(seconds * fps) + 1
    world = World(thing, frames, fps, np.array(gravity, np.float64), tuple(planes))
    return free_motion(world, config.stage.object.mover(thing.size, threads, _device(device)), quiet())[0]


def sample_motion(
    prompt: str,
    body: str | Body = "man",
    seed: int = 0,
    *,
    frames: int = 40,
    checkpoint: str | Path | None = None,
    guidance: float | None = None,
    device: str = "cpu",
) -> Motion:
    """A motion from a sentence: what stage 1 starts from in a run of the same prompt, person and seed.

    Args:
        body: a person of the package, or one of `hoi.body`.
        frames: its length, at the prior's frame rate.
        checkpoint: a motion prior's file or folder; None is the one in the package.
        guidance: classifier-free guidance scale; None is a run's.

    Raises:
        InputError: an unknown person, a prior that cannot be loaded, a number of frames that is not allowed.
        RunError: the motion is not finite.
    """
    import torch

    from hoi.runner.sample import drawn

    with torch.random.fork_rng(devices=[]):
        return drawn(prompt, body, seed, frames, checkpoint, guidance, _device(device))[0]


def render(
    cloud: GaussianCloud | Sequence[GaussianCloud],
    camera: Camera | None = None,
    *,
    background: float | Sequence[float] = 1.0,
    sh_degree: int | None = None,
    backend: Any = "taichi",
    device: str = "cpu",
) -> Array:
    """Gaussians as a picture: RGB in [0, 1], (height, width, 3).

    Args:
        camera: None looks at all of it from its front and side, 720 by 480 pixels; `hoi.render.cameras` has others.
        background: a grey or a colour in [0, 1].
        sh_degree: highest degree of the harmonics; None is all.

    Raises:
        InputError: no Gaussians, a background or a degree that is not allowed, or a backend that cannot run here.
    """
    import torch

    from hoi.data import GaussianCloud
    from hoi.render.cameras import VIEWS, frame_action
    from hoi.render.rasterise import rasterise
    from hoi.render.splats import from_cloud, join

    clouds = [_checked(each) for each in ([cloud] if isinstance(cloud, GaussianCloud) else cloud)]
    if not clouds:
        raise InputError("cloud: holds no Gaussian")
    if camera is None:
        points = np.concatenate([each.means for each in clouds])
        camera = frame_action(points, VIEWS["three_quarter"])
    colour = (background,) * 3 if isinstance(background, float | int) else tuple(background)
    splats = join([from_cloud(each, device=_device(device)) for each in clouds])
    with torch.no_grad():
        drawn = rasterise(splats, camera, colour, sh_degree=sh_degree, backend=backend)
    return drawn.colour.clamp(0, 1).cpu().numpy()


def read(path: str | Path) -> Run:
    """The run of a record (.mcap).

    Raises:
        InputError: the file is no whole record.
    """
    from hoi.record import read

    return read(Path(path))


def write(run: Run, path: str | Path, human_points: int = 6000) -> None:
    """A run as a record (.mcap), whole or not at all.

    Args:
        human_points: of the person, for viewers.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full.
    """
    from hoi.plan import format_plan
    from hoi.record import write
    from hoi.runner.jobs import viewing_points

    points = (None, None) if run.scene is None else viewing_points(run.scene, run.state, human_points)
    write(replace(run), Path(path), *points, plan_text=format_plan(run.plan))


def _checked(cloud: GaussianCloud) -> GaussianCloud:
    """A cloud as `hoi.data.GaussianCloud` describes it.

    Raises:
        InputError: it holds no Gaussian, an array of another shape, or a number that is not finite.
    """
    count = len(cloud)
    if count == 0:
        raise InputError("cloud: holds no Gaussian")
    shapes = {"means": [(3,)], "quaternions": [(4,)], "scales": [(3,)], "opacities": [()]}
    shapes |= {"sh": [((degree + 1) ** 2, 3) for degree in range(4)], "surface": [(2, 3)]}
    for name, array in vars(cloud).items():
        if array is None:
            continue
        allowed = [(count, *shape) for shape in shapes[name]]
        if np.shape(array) not in allowed:
            raise InputError(f"cloud.{name}: shape {np.shape(array)}; must be {' or '.join(map(str, allowed))}")
        if not np.isfinite(array).all():
            raise InputError(f"cloud.{name}: holds numbers that are not finite")
    return cloud


def _device(wanted: str) -> str:
    """ "cpu" or "cuda".

    Raises:
        InputError: another name, or there is no such device.
    """
    from hoi.config import Device
    from hoi.runner.jobs import pick_device

    if wanted not in list(Device):
        raise InputError(f"device {wanted!r}: allowed are {', '.join(Device)}")
    return pick_device(Device(wanted))
