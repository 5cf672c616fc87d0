"""The picture of docs/answer.md: each scene with a limb that nothing stops, and beside it with the person who answers.

    for scene in ...; do for limb in infinite effective; do
        python -m hoi.run scene=$scene stage.contact.limb=$limb stage/refine=none render=none out=RUNS/${scene}_$limb
    done; done
    python -m scripts.answer_pictures RUNS docs/answer.png

Both halves of a row show the same frames from the same place.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.font_manager import FontProperties, findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from analysis.strip import Film, load
from hoi.render.cameras import VIEWS, Camera, frame_action
from hoi.render.film import film

WIDTH, HEIGHT, GAP, HEAD = 200, 150, 8, 20
"""Of a picture, between the halves, and above a row [pixel]."""
AFTER = (0, 3, 8, 16)
"""Frames shown, from the contact on."""


def place(shown: Film) -> tuple[list[int], Camera]:
    """Which frames of a record are shown, and from where."""
    first = 0 if shown.contact is None else int(np.ceil(shown.contact.frame))
    points = shown.replay.action().points()
    camera = frame_action(points, VIEWS["three_quarter"], width=WIDTH, height=HEIGHT, up=(0, 0, 1))
    return [min(first + after, shown.frames - 1) for after in AFTER], camera


def pictures(shown: Film, frames: list[int], camera: Camera) -> NDArray[np.uint8]:
    """Side by side."""
    return np.concatenate(list(film(shown.replay, [camera] * len(frames), frames=frames)), axis=1)


def speed(shown: Film, frames: list[int]) -> str:
    """Of the object at the last frame but one shown."""
    trajectory = shown.run.state.trajectory
    return "" if trajectory is None else f"{np.linalg.norm(trajectory.com_velocity[frames[-2]]):.2g} m/s"


def main(folder: Path, out: Path) -> None:
    rows = []
    for record in sorted(folder.glob("*_effective/run.mcap")):
        scene = record.parent.name.removesuffix("_effective")
        answered, unstopped = load(record), load(folder / f"{scene}_infinite" / "run.mcap")
        how = place(answered)
        halves = [(pictures(shown, *how), speed(shown, how[0])) for shown in (unstopped, answered)]
        rows.append((scene.replace("_", " "), halves))
        print(scene, flush=True)
    half, font = len(AFTER) * WIDTH, ImageFont.truetype(findfont(FontProperties()), 12)
    sheet = Image.new("RGB", (2 * half + GAP, len(rows) * (HEIGHT + HEAD)), "white")
    pen = ImageDraw.Draw(sheet)
    for row, (scene, halves) in enumerate(rows):
        for column, (picture, gone) in enumerate(halves):
            left, top = column * (half + GAP), row * (HEIGHT + HEAD)
            limb = "a limb that nothing stops" if column == 0 else "the person answers"
            pen.text((left + 2, top + 3), f"{scene}: {limb}; then {gone}", fill="#22262b", font=font)
            sheet.paste(Image.fromarray(picture), (left, top + HEAD))
    sheet.quantize(256).save(out, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
