"""What each variation of a scene does to the strike, from records: `python -m analysis.variations runs`.

Of each variation (`sweeps/variation`) over its runs, seeds alike: how fast the limb meets the object, how fast the
object leaves, how high they meet, and with which limb. `make variations ARGS='seeds=5'` makes the runs.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.errors import InputError
from hoi.terminal.program import program

from . import command

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hoi.data import Run

VARIATIONS = ("object_low", "object_high", "step", "stand", "object_slow", "object_fast", "gentle", "hard")
HEAD = ("variation", "runs", "v_in [m/s]", "V_post [m/s]", "height of contact [m]", "met with", "as expected")


def collect(folder: Path) -> dict[str, list[Run]]:
    """The finished runs of each variation below a folder, in the order of `VARIATIONS`.

    Raises:
        InputError: there is none, or a record cannot be read.
    """
    from hoi.record import read

    from .records import find

    found: dict[str, list[Run]] = {name: [] for name in VARIATIONS}
    for path in find(folder):
        run = read(path)
        name = run.provenance.get("experiment", "")
        if name in found and run.result.get("status") == "done":
            found[name].append(run)
    if not any(found.values()):
        raise InputError(f"{folder}: no finished run of a variation below it; make variations makes them")
    return {name: runs for name, runs in found.items() if runs}


def row(name: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """A line of the table; means ± sample standard deviation over the runs in which something struck."""
    from hoi.body.parts import is_with, struck_with

    pushes = [(run, push) for run in runs if run.state.contact and (push := run.state.contact.push)]
    limbs = Counter(struck_with(push) for _, push in pushes)
    missed = len(runs) - len(pushes)
    said = [f"{limb} {count}" for limb, count in limbs.most_common()] + ([f"nothing {missed}"] if missed else [])
    expected = sum(is_with(expected_limb(run), push.joint, push.part) for run, push in pushes)
    numbers = (
        [push.v_in for _, push in pushes],
        [float(np.linalg.norm(push.v_post)) for _, push in pushes],
        [float(push.point[2]) for _, push in pushes],
    )
    return name, str(len(runs)), *map(spread, numbers), ", ".join(said), f"{expected} of {len(runs)}"


def expected_limb(run: Run) -> str:
    """What the run's scene expects to strike."""
    import yaml

    return str(yaml.safe_load(run.config_yaml)["scene"]["expected_limb"])


def spread(values: list[float]) -> str:
    """Mean ± sample standard deviation; empty where there is none."""
    if not values:
        return ""
    mean = f"{np.mean(values):.2f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):.2f}"


@command.exit_code("analysis.variations")
def main() -> None:
    parser = command.parser("analysis.variations", "What each variation of a scene does to the strike.", "runs")
    parser.add_argument("folder", type=Path, nargs="?", default=Path("runs"), help="of the runs; default: runs")
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="the table as Markdown")
    options = parser.parse_args()
    from .writers import as_markdown, markdown_table

    found = collect(options.folder)
    lines = [HEAD, *(row(name, runs) for name, runs in found.items())]
    text = markdown_table(*([as_markdown(cell) for cell in line] for line in lines))
    if options.out is not None:
        options.out.write_text(f"{text}\n")
    print(text)


if __name__ == "__main__":
    program(main)
