"""Draws docs/films.png, with which the README opens: each scene shortly before, at and after the contact.

    PYTHONPATH=. python -m scripts.docs_films runs/kick_soccer_ball/laptop/full/s0/run.mcap ... [-o docs/films.png]

The records are those of today's method: a change of motion, physics or looks asks for new ones.
"""

import argparse
from pathlib import Path

from hoi import record
from hoi.render.cameras import ACTION
from hoi.render.director import contact_frame
from hoi.render.encode import write_png
from hoi.render.film import cameras_of, film
from hoi.render.layout import tile
from hoi.render.replay import replay

WIDTH, HEIGHT = 360, 240
AROUND = (-3, 0, 5)
"""Frames before and after t_c."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", type=Path, nargs="+", metavar="RUN.mcap")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/films.png"))
    options = parser.parse_args()
    pictures = []
    for path in options.records:
        shown = replay(record.read(path))
        cameras, moment = cameras_of(shown, ACTION, WIDTH, HEIGHT), contact_frame(shown)
        frames = [min(max(moment + step, 0), shown.frames - 1) for step in AROUND]
        pictures += film(shown, [cameras[frame] for frame in frames], frames=frames)
    write_png(tile(pictures, len(AROUND)), options.out)


if __name__ == "__main__":
    main()
