"""What stage 3 does, to look at: contacts from nearby, before it and after it in several ways."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from matplotlib import pyplot as plt

from hoi.config.compose import config_of
from hoi.data import Array, Motion
from hoi.refine.views import Framing, background, viewpoint
from hoi.render.cameras import Camera
from hoi.render.rasterise import rasterise
from hoi.render.replay import replay
from hoi.render.splats import join
from hoi.reports import quiet

from ..charts import INK, MUTED
from .contacts import Start, Way

SCENES = ("kick_soccer_ball", "punch_blue_ball", "jab_beach_ball")
WAYS = ("geometric, 60 iterations", "embedded", "embedded + geometric")
RADIUS = 0.3
"""Half of what a picture shows [m]."""
SIZE = 320
"""Of a picture [pixel]."""


def closeup(start: Start, motion: Motion, camera: Camera) -> Array:
    """RGB (height, width, 3) of the whole frame nearest to t_c, with the start's motion replaced."""
    shown = replay(replace(start.run, state=replace(start.run.state, motion=motion)))
    with torch.no_grad():
        picture = rasterise(join(shown.parts(math.floor(start.push.frame + 0.5))), camera, background(camera))
    return picture.colour.clamp(0, 1).numpy()


def across(start: Start) -> Camera:
    """The view across the strike, with the point of contact in its middle."""
    push = start.push
    azimuth = math.atan2(push.normal[1], push.normal[0]) + math.pi / 2
    return viewpoint(Framing(np.asarray(push.point, np.float64), RADIUS), azimuth, width=SIZE, height=SIZE)


def draw(starts: Sequence[Start], ways: Sequence[Way], path: Path) -> Path:
    """A row a start, a column a way, before the first one what it was; the path.

    Raises:
        InputError: a prior's weights are missing or damaged.
    """
    columns = 1 + len(ways)
    figure, axes = plt.subplots(
        len(starts), columns, figsize=(3 * columns, 3.4 * len(starts)), squeeze=False, layout="constrained", dpi=110
    )
    for start, row in zip(starts, axes, strict=True):
        motion, scene, camera = start.run.state.motion, start.run.scene, across(start)
        assert motion is not None and scene is not None
        pictures = [(closeup(start, motion, camera), f"{start.scene}, before")]
        for way in ways:
            stage = quiet("refine")
            config = config_of("render=none", *start.overrides, *way.overrides)
            refined = config.stage.refine.refine(scene, start.run.state, config, "cpu", stage)
            numbers = stage.numbers
            before, after = (1e3 * numbers.get(f"penetration_{when}", np.nan) for when in ("before", "after"))
            pictures[0] = (pictures[0][0], f"{start.scene}: {before:.0f} mm deep")
            gap = 1e3 * numbers.get("gap_after", np.nan)
            pictures.append((closeup(start, refined, camera), f"{way.name}: {after:.0f} mm, gap {gap:.0f} mm"))
        for ax, (picture, title) in zip(row, pictures, strict=True):
            ax.imshow(picture)
            ax.set_title(title, fontsize=9, color=INK)
            ax.axis("off")
    figure.supxlabel("deepest in the window, gap at t_c; pictures at the whole frame nearest to t_c", color=MUTED)
    figure.savefig(path)
    plt.close(figure)
    return path
